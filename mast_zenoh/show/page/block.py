"""Frames of a run, finished or running, as one block of bytes: everything that the page shows of them.

The block holds a header (JSON) and columns of integers (`columns`). `docs/how-to-read-a-report.md#the-viewer` describes
the content. objects.parquet has a row per box, agent and estimate: a truth object appears up to thirty times in a
frame, and the picture once for every agent. Here a box is stored once, next to the same object's box in the next frame,
so that neighbours differ little. Velocities, covariances and classes come from the messages and the scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.boxes import Boxes
from mast_zenoh.arrays.geometry import heading, to_world
from mast_zenoh.arrays.states import CLASSES, Bools, Floats, Ints, ObjectStates
from mast_zenoh.errors import MastError
from mast_zenoh.launch.twin import NAME
from mast_zenoh.metrics.estimates import ESTIMATES
from mast_zenoh.run_folder.tables import to_arrow
from mast_zenoh.runs.driven import braking_events, braking_of, cars_of, course_of, twin_course
from mast_zenoh.runs.events import PLACED, Happening, event, first_changes, happenings, lie_frames, node_absences, spans
from mast_zenoh.runs.files import ALL, Table, are_in, column, rows
from mast_zenoh.runs.interposers import adversaries_by_agent, interposers
from mast_zenoh.runs.run import Run
from mast_zenoh.runs.scans import scanned_agents, scans_of
from mast_zenoh.runs.spoofers import spoofers
from mast_zenoh.scenes.recording import TRUTH_COLUMNS, Recording, SceneAgent, truth_states
from mast_zenoh.show.page.motion import Judgements, Meaning, Packer, View, motion_of, recorded_tracks, row_keys
from mast_zenoh.show.palette import STATES, page_colours

FORMAT = 1
#: m, rad and 1: resolution of positions and sizes, of headings, and of scores.
LENGTH, ANGLE, SCORE = 0.01, 0.002, 0.01
#: m/s, m and 1: resolution of velocities, of standard deviations and of correlations; m, of the swept free space.
_SPEED, _SPREAD, _CORRELATION, _SWEPT = 0.05, 0.02, 0.02, 0.5
#: m: resolution of the points of a lidar. Limits on those of one frame, a prime so that no channel is left out for its
#: place in their order, and of all frames: 1 to 2 MB of a page.
_POINT, _MOST_POINTS, _MOST_POINTS_OF_ALL = 0.05, 1999, 400_000
#: Ids from here on do not fit into a column.
_MOST_ID = 1 << 30
#: Flags of an agent in a frame, above its state (0: not judged, else 1 + the row of STATES).
DOWN, LYING = 8, 16
_GEOMETRY = ("x", "y", "z", "l", "w", "h", "yaw")
_TEXT = ("agent", "estimator", "kind", "outcome", "cause", "by")
_COLUMNS = ("frame", "id", "match_id", *_GEOMETRY, "score", *_TEXT)


@dataclass(frozen=True, eq=False)
class AgentPoses:
    """The agents in f frames. position: (f, a, 3) m;  rotation: (f, a, 3, 3) agent to world;  sweeps: of a Recording"""

    position: Floats
    rotation: Floats
    sweeps: tuple[NDArray[Any], ...]


def run_block(run: Run, frame: int | None = None, label: str = "") -> bytes | None:
    """The block of a finished run; None if it has nothing to show: neither boxes nor a scene.

    frame: the frame to show first; None: the first of the run
    label: the name that the page gives it; empty: its own
    Raises ValueError if a number is too large for the block.
    """
    scene = run.files.scene
    truth = truth_of(scene, run.files.sample)
    judged = judgements_of(run.files.all_objects, truth)
    if not len(judged.boxes):
        return None
    first, every = run.files.sample.start, run.files.sample.step
    frames = range(first, int(judged.boxes.group.max()) + 1, every)
    if frame is not None and frame not in frames:
        named = f"0 to {frames[-1]}" if every == 1 else f"{first}, {first + every}, ... {frames[-1]}"
        raise ValueError(f"found frame {frame}, expected one of {named}")
    numbers = np.arange(frames.start, frames.stop, every)
    times = run.times(numbers)
    surroundings = None
    if scene is not None:
        shown = np.minimum(numbers, len(scene) - 1)  # a scene that is shorter keeps its last poses
        sweeps = tuple(sweep[shown] for sweep in scene.sweeps if every == 1)
        surroundings = AgentPoses(scene.agent_position[shown], scene.agent_rotation[shown], sweeps)
    packer = Packer()
    packer.add("time", times, scale=1e-3)
    try:
        motion = motion_of(judged, truth, recorded_tracks(run))
    except (MastError, OSError):
        motion = motion_of(judged, truth, ())
    periods = spans(run, times)
    header = {
        **pack_frames(packer, run, judged, motion, surroundings, frames),
        "label": label or run.name,
        "folder": run.path.name,
        "frame": frames.index(frame) if frame is not None else 0,
        "numbers": [first, every],
        "recorded": (run.path / "messages.mcap").is_file(),
        "spans": periods,
        "events": _events(run, judged, periods, frames, times),
        "points": _add_points(packer, run, frames),
        "spoofers": _add_spoofers(packer, run, numbers),
        "drives": _add_drives(packer, run, frames, times),
    }
    return packer.block(header)


def pack_frames(
    packer: Packer, run: Run, judged: Judgements, motion: Table, surroundings: AgentPoses | None, frames: range
) -> dict[str, Any]:
    """Add all columns of some frames but their times, and return the part of the header that describes them.

    motion: from `motion_of`;  surroundings: None: not known;  frames: their numbers in the run
    """
    header: dict[str, Any] = {
        "format": FORMAT,
        "id": str(run.files.record.get("id", "")),
        "frames": len(frames),
        "ego": run.ego or "",
        "centre": run.has_centre,
        "scored": run.scored_frames and [max(0, (each - frames.start) // frames.step) for each in run.scored_frames],
        "gate_m": run.gate_m,
        "range_m": run.range_m,
        "classes": CLASSES,
        "colours": page_colours(),
    }
    header |= _add_boxes(packer, run, judged, motion, frames)
    header |= _add_surroundings(packer, run, surroundings)
    header |= _add_agent_states(packer, run, [agent["name"] for agent in header["agents"]], frames)
    header |= _add_manipulations(packer, run, frames)
    _add_withheld(packer, run, frames)
    header["series"] = _add_series(packer, run, frames)
    return header


def truth_of(scene: Recording | None, sample: range = ALL) -> tuple[Ints, ObjectStates]:
    """The objects of a scene in the frames of a sample, and (n,) their frames."""
    if scene is None:
        return np.zeros(0, np.int64), ObjectStates.empty()
    frame = np.repeat(np.arange(len(scene)), np.diff(scene.truth_start))
    if sample == ALL:
        return frame, scene.truth
    wanted = np.flatnonzero(are_in(sample, frame))
    return frame[wanted], truth_states({name: getattr(scene.truth, name)[wanted] for name in TRUTH_COLUMNS})


def judgements_of(content: Any | None, truth: tuple[Ints, ObjectStates]) -> Judgements:
    """The boxes and outcomes in an Arrow table with the columns of objects.parquet (None: absent), and the truth."""
    if content is None:
        content = to_arrow({name: np.zeros(0, str if name in _TEXT else np.int64) for name in _COLUMNS})
    table, names = _table(content)
    views = tuple(View(*pair) for pair in names["view"])
    is_truth = table["kind"] == 1
    # The truth of a frame is the same in every view: its id alone identifies it.
    geometry = np.stack([table[name] for name in _GEOMETRY], axis=1)
    score = np.nan_to_num(table["score"])
    of_tracks = np.where(is_truth[:, None], 0.0, np.column_stack([geometry, score]))
    key = row_keys(table["frame"], table["id"], is_truth, of_tracks)
    unique, first, row = np.unique(key, return_index=True, return_inverse=True)
    stream = np.full(len(unique), len(views))
    np.minimum.at(stream, row, table["view"])
    columns = [is_truth[first], table["frame"][first], table["id"][first], geometry[first], score[first]]
    unseen = _unseen(truth, columns[0], columns[1], columns[2])
    columns = [np.concatenate(pair) for pair in zip(columns, unseen, strict=True)]
    stream = np.where(columns[0], -1, np.append(stream, np.zeros(len(unseen[0]), int)))
    order = np.lexsort((columns[1], columns[2], stream))
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    codes = np.zeros((len(views), len(order)), np.uint16)
    codes[table["view"], place[row]] = table["meaning"] + 1
    matches = np.full((len(views), len(order)), -1, np.int64)
    followed = ~is_truth & (table["match_id"] >= 0)
    matches[table["view"][followed], place[row[followed]]] = table["match_id"][followed]
    meanings = tuple(Meaning(*each) for each in names["meaning"])
    is_truth, frame, ids, geometry, score = (each[order] for each in columns)
    boxes = Boxes(frame, ids, geometry[:, :3], geometry[:, 3:6], geometry[:, 6])
    return Judgements(boxes, is_truth, score, views, meanings, codes, matches)


def _table(content: Any) -> tuple[Table, dict[str, list[tuple[str, ...]]]]:
    """The columns as numbers, with `view` and `meaning` as rows of the returned names."""
    count = content.num_rows
    table = {name: content[name].to_numpy() for name in ("frame", "id", "match_id", *_GEOMETRY, "score")}
    text = {name: _words(content[name]) for name in _TEXT}
    kind_words, kinds = text["kind"]
    table["kind"] = np.array([word == "truth" for word in kind_words], np.int64)[kinds] if count else kinds
    names = {}
    for name, parts in (("view", ("agent", "estimator")), ("meaning", ("outcome", "cause", "by"))):
        combined = np.zeros(count, np.int64)
        for part in parts:
            combined = combined * (len(text[part][0]) + 1) + text[part][1]
        _, first, table[name] = np.unique(combined, return_index=True, return_inverse=True)
        names[name] = [tuple(text[part][0][text[part][1][row]] for part in parts) for row in first]
    return table, names


def _words(column: Any) -> tuple[list[str], Ints]:
    """The distinct texts of a column, and the row of each in them."""
    column = column.unify_dictionaries().combine_chunks()
    return column.dictionary.to_pylist(), column.indices.to_numpy().astype(np.int64)


def _unseen(truth: tuple[Ints, ObjectStates], is_truth: Bools, frame: Ints, ids: Ints) -> list[NDArray[Any]]:
    """The objects of the scene that no view has: whether they are the truth, frame, id, geometry and score."""
    frames, states = truth
    last = frame.max() if len(frame) else frames.max(initial=-1)
    known = row_keys(frame[is_truth], ids[is_truth])
    new = ~np.isin(row_keys(frames, states.id), known) & (frames <= last)
    geometry = np.column_stack([states.position, states.size, states.yaw])[new]
    return [np.ones(new.sum(), bool), frames[new], states.id[new], geometry, np.zeros(new.sum())]


def shown_id(ids: Ints) -> Ints:
    """The ids (n,) that a page shows: of numbers that do not fit, which anybody may send, the last 30 bits."""
    return np.where((ids > -_MOST_ID) & (ids < _MOST_ID), ids, ids & (_MOST_ID - 1))


def _places(frames: range, numbers: NDArray[Any]) -> NDArray[Any]:
    """(n,) The places of n frames among those shown."""
    return np.asarray((numbers - frames.start) // frames.step)


def _shown(frames: range, table: Table) -> Table:
    """The rows of a table in the frames shown."""
    return table if frames.step == 1 else rows(table, (table["frame"] - frames.start) % frames.step == 0)


def _add_boxes(packer: Packer, run: Run, judged: Judgements, motion: Table, frames: range) -> dict[str, Any]:
    """Add the columns of boxes and of their meaning in each view, and return `views` and `meanings`."""
    boxes = judged.boxes
    geometry = np.column_stack([boxes.position, boxes.size, boxes.yaw])
    packer.add("box.frame", _places(frames, boxes.group))
    packer.add("box.id", shown_id(boxes.id))
    packer.add("box.truth", judged.is_truth, differences=False)
    for index, name in enumerate(_GEOMETRY):
        packer.add(f"box.{name}", geometry[:, index], scale=ANGLE if name == "yaw" else LENGTH)
    packer.add("box.score", judged.score, scale=SCORE)
    packer.add("box.known", motion["known"], differences=False)
    for index, name in enumerate(("vx", "vy")):
        packer.add(f"box.{name}", motion["velocity"][:, index], scale=_SPEED)
    for index, (name, scale) in enumerate({"sx": _SPREAD, "sy": _SPREAD, "rho": _CORRELATION}.items()):
        packer.add(f"box.{name}", motion["spread"][:, index], scale=scale)
    packer.add("box.kind", motion["kind"], differences=False)
    packer.add("code", judged.codes, differences=False)
    packer.add("match", shown_id(judged.matches[judged.matches >= 0]))
    packer.add("matched", judged.matches >= 0, differences=False)
    row_by_view = {tuple(view): row for row, view in enumerate(judged.views)}
    views = dict(row_by_view)
    for agent, pairs in run.files.summary.get("same_as", {}).items():
        for estimate, original in pairs.items():
            if (agent, original) in row_by_view:
                views.setdefault((agent, estimate), row_by_view[agent, original])
    order = list(ESTIMATES)
    known = sorted((each for each in views if each[1] in order), key=lambda each: (each[0], order.index(each[1])))
    shown = [{"agent": agent, "estimate": estimate, "row": views[agent, estimate]} for agent, estimate in known]
    return {
        "views": shown,
        "estimates": {key: name.column for key, name in ESTIMATES.items()},
        "meanings": [list(each) for each in judged.meanings],
    }


def _add_surroundings(packer: Packer, run: Run, surroundings: AgentPoses | None) -> dict[str, Any]:
    """Add the columns `agents.*` and `swept`, and return `buildings`, their `tops` and `agents` of the header."""
    scene = run.files.scene
    if scene is None or surroundings is None:
        return {"buildings": [], "tops": [], "agents": []}
    attacked = adversaries_by_agent(interposers(run))
    agents: list[dict[str, Any]] = [
        _agent(agent) | {"adversaries": attacked.get(agent.name, ())} for agent in scene.agents
    ]
    for axis, name in enumerate("xyz"):  # frame by frame of one agent: neighbours are alike
        packer.add(f"agents.{name}", surroundings.position[:, :, axis].T, scale=LENGTH)
    for name, turn in _turns(scene, surroundings.rotation).items():
        packer.add(f"agents.{name}", turn.T, scale=ANGLE)
    if surroundings.sweeps:
        swept = [_swept(sweep, agent) for sweep, agent in zip(surroundings.sweeps, scene.agents, strict=True)]
        for entry, distances in zip(agents, swept, strict=True):
            entry["sectors"] = distances.shape[1]
        packer.add("swept", np.concatenate([each.T.ravel() for each in swept]), scale=_SWEPT)
    outlines = [np.round(outline, 2).tolist() for outline in scene.buildings]
    return {"buildings": outlines, "tops": np.round(scene.building_height, 2).tolist(), "agents": agents}


def _agent(agent: SceneAgent) -> dict[str, Any]:
    sensor, camera = agent.sensor, agent.camera
    return {
        "name": agent.name,
        "kind": agent.kind,
        "object": int(shown_id(np.array([agent.object_id]))[0]),
        "range_m": sensor.max_range_m,
        "sector": [float(np.radians(sensor.azimuth_min_deg)), float(np.radians(sensor.azimuth_max_deg))],
        "camera": {
            "position": np.asarray(camera.mount_position, float).tolist(),
            "rotation": np.asarray(camera.mount_rotation, float).ravel().tolist(),
            **{name: getattr(camera, name) for name in ("width", "height", "focal")},
        },
    }


def _turns(scene: Recording, rotation: Floats) -> dict[str, Floats]:
    """(f, a) rad: heading of the sensor, and yaw, pitch and roll of the agent."""
    mounts = np.stack([agent.sensor.mount_rotation for agent in scene.agents])
    headings = np.stack([heading(rotation[:, i] @ mount) for i, mount in enumerate(mounts)], axis=1)
    return {
        "heading": np.unwrap(headings, axis=0),
        "yaw": np.unwrap(np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0]), axis=0),
        "pitch": np.arcsin(np.clip(-rotation[..., 2, 0], -1.0, 1.0)),
        "roll": np.arctan2(rotation[..., 2, 1], rotation[..., 2, 2]),
    }


def _swept(sweep: NDArray[Any], agent: SceneAgent) -> Floats:
    """(f, sectors) m, horizontally, to the first obstacle in any band of each sector."""
    edges = np.radians(
        np.linspace(agent.sensor.elevation_min_deg, agent.sensor.elevation_max_deg, max(sweep.shape[1], 1) + 1)
    )
    across = np.cos((edges[:-1] + edges[1:]) / 2)
    nearest: Floats = (sweep.astype(np.float64) * across[None, :, None]).min(axis=1)
    return nearest


def _add_agent_states(packer: Packer, run: Run, names: list[str], frames: range) -> dict[str, Any]:
    """Add the states of agents and `trust`, a row per agent and frame."""
    numbers = np.arange(frames.start, frames.stop, frames.step)
    state, trust = np.zeros((len(names), len(frames)), np.int64), np.full((len(names), len(frames)), -1.0)
    for row, name in enumerate(names):
        if run.files.trust is not None:
            own = rows(run.files.trust, run.files.trust["agent"] == name)
            place = np.searchsorted(own["frame"], numbers, side="right") - 1
            if len(own["frame"]):
                codes = np.array([1 + list(STATES).index(each) for each in own["state"].tolist()])
                state[row] = np.where(place >= 0, codes[place], 0)
                trust[row] = np.where(place >= 0, column(own, "mean")[place], -1.0)
        for node, start, end in node_absences(run):
            if node == name:
                state[row, (numbers >= int(start)) & (numbers < end)] += DOWN
        state[row, np.isin(numbers, lie_frames(run, name))] += LYING
    packer.add("agents.state", state)
    packer.add("trust", trust, scale=0.001)
    return {"states": list(STATES), "flags": {"down": DOWN, "lying": LYING}, "judged": run.files.trust is not None}


def _add_manipulations(packer: Packer, run: Run, frames: range) -> dict[str, Any]:
    """Add the columns `effects.*`: a row per object that an adversary inserted, removed or moved in a message."""
    effects = list(PLACED)
    places = ("before_x", "before_y", "before_z", "after_x", "after_y", "after_z")
    table = _shown(frames, run.manipulations) if run.manipulations is not None else {}
    placed = rows(table, np.isin(table["effect"], effects)) if table else {}
    if placed:
        order = np.lexsort((placed["frame"], placed["interposer"]))
        placed = {name: values[order] for name, values in placed.items()}
    none = np.zeros(0, str)
    by, subscriber = placed.get("interposer", none), placed.get("before_subscriber", none)
    adversaries, subscribers = (sorted(set(map(str, each))) for each in (by, subscriber))
    packer.add("effects.frame", _places(frames, placed.get("frame", np.zeros(0))))
    packer.add("effects.effect", np.array([effects.index(each) for each in placed.get("effect", ())]))
    packer.add("effects.by", np.array([adversaries.index(each) for each in by]))
    packer.add("effects.downlink", placed.get("message", none) == "picture")
    packer.add("effects.subscriber", np.array([subscribers.index(each) for each in subscriber]))
    for name in places:
        packer.add(f"effects.{name}", np.nan_to_num(column(placed, name)) if placed else np.zeros(0), scale=LENGTH)
    return {"effects": effects, "adversaries": adversaries, "subscribers": subscribers}


def _add_withheld(packer: Packer, run: Run, frames: range) -> None:
    """Add the columns `withheld.*`: the objects that the command centre withholds."""
    names = ("frame", "id", *_GEOMETRY)
    withheld: Table = {name: np.zeros(0) for name in names}
    if (table := run.files.trust_objects) is not None:
        withheld = rows(table, table["withheld"].astype(bool))
        order = np.lexsort((withheld["frame"], withheld["id"]))
        withheld = {name: values[order] for name, values in withheld.items()}
    for name in names:
        scale = {"frame": 1.0, "id": 1.0, "yaw": ANGLE}.get(name, LENGTH)
        values = column(withheld, name)
        packer.add(f"withheld.{name}", _places(frames, values) if name == "frame" else values, scale=scale)


def _add_series(packer: Packer, run: Run, frames: range) -> list[dict[str, str]]:
    """Add `series.*`, a row per frame of each estimate in metrics.parquet, and return which they are.

    RMSE is -1 where there is no matched pair. Where not all frames are shown, `peaks.*` has the largest value of those
    from each frame to the next one shown.
    """
    if run.files.counts is None:
        return []
    end = frames.start + len(frames) * frames.step  # with the frames after the last one shown
    table = rows(run.files.counts, (run.files.counts["frame"] >= frames.start) & (run.files.counts["frame"] < end))
    of_rows = list(zip(table["agent"].tolist(), table["estimator"].tolist(), strict=True))
    pairs = sorted(set(of_rows))
    number = {pair: index for index, pair in enumerate(pairs)}
    series = np.array([number[pair] for pair in of_rows], np.int64)
    for name in ("fn", "fp", "tp", "rmse_m"):
        scale = 0.001 if name == "rmse_m" else 1.0
        every_frame = np.full((len(pairs), len(frames) * frames.step), -1.0)
        every_frame[series, table["frame"].astype(np.int64) - frames.start] = np.nan_to_num(
            column(table, name), nan=-1.0
        )
        by_shown = every_frame.reshape(len(pairs), len(frames), frames.step)
        packer.add(f"series.{name}", by_shown[:, :, 0], scale=scale)
        if frames.step > 1:
            packer.add(f"peaks.{name}", by_shown.max(axis=2), scale=scale)
    return [{"agent": agent, "estimate": estimate} for agent, estimate in pairs]


def _add_drives(packer: Packer, run: Run, frames: range, times: Floats) -> list[dict[str, str]]:
    """Add `drive.*`, a row per frame of each driven car and of the twin's, and return the cars.

    Speeds are -1 where they are not known; without a twin, its places are those of the car. times: (f,) s, of `frames`
    """
    drives: list[dict[str, str]] = []
    columns: dict[str, list[NDArray[Any]]] = {
        name: [] for name in ("speed", "acceleration", "brake", "twin_x", "twin_y")
    }
    for car in cars_of(run):
        course = course_of(run, car)
        assert course is not None
        twin = twin_course(run, car)
        drives.append({"car": car, "twin": "" if twin is None else NAME})
        columns["speed"].append(_by_frame(course, "speed_mps", frames, -1.0))
        columns["acceleration"].append(_by_frame(course, "acceleration_mps2", frames, 0.0))
        columns["brake"].append(braking_of(run, car, times))
        for axis in "xy":
            columns[f"twin_{axis}"].append(_held(course if twin is None else twin, axis, frames))
    for name, parts in columns.items():
        scale = {"speed": _SPEED, "acceleration": _SPEED, "brake": 1.0}.get(name, LENGTH)
        packer.add(f"drive.{name}", np.array(parts).reshape(len(drives), len(times)), scale=scale)
    return drives


def _add_points(packer: Packer, run: Run, frames: range) -> str:
    """Add `points.*`: how many there are in each frame, and x y z, world frame, of some points of the ego's lidar.

    They are evenly spread over a scan. Returns the agent whose lidar it is; empty: no points were recorded.
    """
    scene = run.files.scene
    if scene is None or run.ego not in scanned_agents(run):
        return ""
    row, most = scene.agent_names.index(run.ego), min(_MOST_POINTS, _MOST_POINTS_OF_ALL // len(frames))
    count, parts = np.zeros(len(frames), np.int64), [np.zeros((0, 3))]
    for frame, scan in scans_of(run, run.ego, frames):
        kept = np.arange(min(most, len(scan.points))) * len(scan.points) // min(most, max(len(scan.points), 1))
        points = scan.points.select(kept)
        points = points.select(np.lexsort((points.time_s, points.channel)))  # neighbours differ little
        here = scene.nearest(frame)
        of_agent = to_world(points.position.astype(np.float64), scan.position, scan.rotation)
        parts.append(to_world(of_agent, scene.agent_position[here, row], scene.agent_rotation[here, row]))
        count[(frame - frames.start) // frames.step] = len(kept)
    packer.add("points.count", count)
    for axis, values in zip("xyz", np.concatenate(parts).T, strict=True):
        packer.add(f"points.{axis}", values, scale=_POINT)
    return run.ego


def _add_spoofers(packer: Packer, run: Run, numbers: Ints) -> list[str]:
    """Add `spoofers.*`: x y, world frame, of each spoofer of a lidar in all frames. Returns their adversaries."""
    places = spoofers(run, numbers)
    for row, axis in enumerate("xy" if places else ""):
        packer.add(f"spoofers.{axis}", np.concatenate([place[:, row] for place in places.values()]), scale=LENGTH)
    return list(places)


def _by_frame(course: Table, name: str, frames: range, unknown: float) -> Floats:
    """A column of a course by frame (frames,). unknown: its value elsewhere"""
    result = np.full(len(frames), unknown)
    course = _shown(frames, course)
    inside = (course["frame"] >= frames.start) & (course["frame"] < frames.stop)
    values = course[name][inside].astype(np.float64)
    result[_places(frames, course["frame"][inside].astype(np.int64))] = np.where(np.isfinite(values), values, unknown)
    return result


def _held(course: Table, name: str, frames: range) -> Floats:
    """A column of a course by frame (frames,); its last value goes on."""
    numbers = np.arange(frames.start, frames.stop, frames.step)
    row = np.searchsorted(course["frame"], numbers, side="right") - 1
    values: Floats = course[name].astype(np.float64)[np.maximum(row, 0)]
    return values


def _events(
    run: Run, judged: Judgements, periods: list[dict[str, Any]], frames: range, times: Floats
) -> list[dict[str, Any]]:
    """All events, the earliest first. periods: from `spans`;  times: (f,) s, of the frames shown

    Where not all frames are shown, an event has its time, and the frame that is shown until then.
    """
    if frames.step > 1:  # events know the numbers of all frames
        times = run.times(np.arange(frames.stop))
    everything = [*happenings(run, periods, times), *first_changes(run), *_first_successes(run, judged)]
    everything += braking_events(run, times)
    inside = [each for each in dict.fromkeys(everything) if 0 <= each.frame < len(times)]
    inside.sort(key=lambda each: (each.frame, each.kind, each.text))
    entries = [{name: value for name, value in each._asdict().items() if value is not None} for each in inside]
    if frames.step > 1:
        for each, entry in zip(inside, entries, strict=True):
            place = max(0, (each.frame - frames.start) // frames.step)
            entry |= {"frame": place, "time": round(float(times[each.frame]), 3)}
    return entries


def _first_successes(run: Run, judged: Judgements) -> list[Happening]:
    """The first error of each kind in the ego's copy of the picture that is due to each adversary."""
    result = []
    for estimate in ("picture", "mission"):
        row = next((i for i, view in enumerate(judged.views) if view == (run.ego, estimate)), None)
        if row is None:
            continue
        for number, meaning in enumerate(judged.meanings, 1):
            if not meaning.by or meaning.outcome not in ("false", "missed"):
                continue
            places = np.flatnonzero((judged.codes[row] == number) & (judged.is_truth == (meaning.outcome == "missed")))
            if not len(places):
                continue
            first = places[np.argmin(judged.boxes.group[places])]
            text = event(str(meaning.by), meaning.outcome, estimate, str(meaning.cause), str(run.ego))
            x, y = (round(float(value), 2) for value in judged.boxes.position[first, :2])
            result.append(Happening(int(judged.boxes.group[first]), "effect", text, x, y))
    return result

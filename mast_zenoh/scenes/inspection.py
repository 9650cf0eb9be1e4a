"""What a scene contains, and what is suspicious about it."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from mast_zenoh.arrays.geometry import along_and_across, wrap_angle
from mast_zenoh.arrays.states import CLASSES, Bools, Floats
from mast_zenoh.scenes.recording import NO_MEASUREMENT, SEEN_RETURNS, Recording

_MAX_SPEED_MPS = 70.0
_FARTHEST_M = 1e100  # whose square is a number
_MAX_JUMP_M = 2.0  # of a position against the mean of its velocities before and after
_UNEVEN = 1.5  # periods between two frames
_SHOWN = 3  # objects with one kind of problem
_FLIP = np.pi / 2.0  # rad, from one frame to the next
#: Of detections that seem late or early by more than a share of a period: m/s of the objects, m to the detection, and
#: the least number of pairs.
_SHIFT, _SHIFTED_MPS, _SHIFTED_M, _PAIRS = 0.75, 3.0, 5.0, 30
#: Frames, and rows of the truth in them, that are looked at when a run starts.
_FRAMES_AT_START, _ROWS_AT_START = 150, 8_000


def contents(recording: Recording) -> list[tuple[str, str]]:
    """What a scene has, as pairs of a name and a text."""
    frames, agents = len(recording), len(recording.agents)
    duration = (recording.times_ns[-1] - recording.times_ns[0]) * 1e-9
    ids, first = np.unique(recording.truth.id, return_index=True)
    kinds, count = np.unique(recording.truth.class_id[first], return_counts=True)
    classes = ", ".join(f"{n} {CLASSES[kind]}" for kind, n in zip(kinds, count, strict=True))
    per_frame = np.diff(recording.truth_start)
    seen = recording.points >= SEEN_RETURNS
    shares = ", ".join(
        f"{agent.name} {seen[:, column].sum() / frames:.1f}" for column, agent in enumerate(recording.agents)
    )
    return [
        ("frames", f"{frames} at {1e9 / recording.period_ns:.1f} Hz, {duration:.1f} s"),
        ("agents", f"{agents}: {', '.join(f'{agent.name} ({agent.kind})' for agent in recording.agents)}"),
        *_sensors(recording),
        ("objects", f"{len(ids)}: {classes}; {per_frame.min()} to {per_frame.max()} in a frame"),
        ("seen", f"objects in a frame with at least {SEEN_RETURNS} lidar returns: {shares}"),
        ("detections", _detections(recording)),
        ("buildings", str(len(recording.buildings))),
        *(("note", note) for note in recording.notes),
    ]


def _detections(recording: Recording) -> str:
    """Number, scores and covariances of the detections."""
    detections = recording.detections
    if not len(detections):
        return "none"
    rate = len(detections) / _measured(recording).sum()
    low, high = detections.score.min(), detections.score.max()
    scores = f"all scores {low:.2f}" if low == high else f"scores {low:.2f} to {high:.2f}"
    given = "with" if detections.covariance.any() else "without"
    of_each = "agent and frame" if recording.measurements is None else "measurement"
    return f"{rate:.1f} per {of_each}, {scores}, {given} covariances"


def _measured(recording: Recording) -> Bools:
    """(F, S) whether a sensor has a new measurement in a frame."""
    if recording.measurements is None:
        return np.ones((len(recording), len(recording.sensor_names)), np.bool_)
    return np.asarray(recording.measurements.age_ns != NO_MEASUREMENT)


def _sensors(recording: Recording) -> list[tuple[str, str]]:
    """The rates of the sensors, if some measure at times of their own or an agent has several."""
    if recording.measurements is None:
        return []
    ages, rate = recording.measurements.age_ns, _measured(recording).mean(axis=0) * 1e9 / recording.period_ns
    parts = []
    for column, name in enumerate(recording.sensor_names):
        age = ages[:, column]
        late = age[age != NO_MEASUREMENT] * 1e-6
        parts.append(f"{name} {rate[column]:.3g} Hz, up to {late.max(initial=0.0):.0f} ms before a frame")
    return [("sensors", "; ".join(parts))]


def at_start(recording: Recording) -> str:
    """What is suspicious about the beginning of a scene, in a sentence for the start of a run; "": nothing."""
    frames = int(np.searchsorted(recording.truth_start, _ROWS_AT_START))
    first, *others = problems(recording, min(max(frames, 1), _FRAMES_AT_START)) or [""]
    more = f"; and {len(others)} more: `mast scene check RUN/scene.npz` lists them" if others else ""
    return f"suspicious: {first}{more}" if first else ""


def problems(recording: Recording, frames: int | None = None) -> list[str]:
    """What is probably wrong with a scene that can be read, in sentences.

    frames: how many of its first frames are looked at, where that takes long; None: all
    """
    found = []
    frames = min(frames or len(recording), len(recording))
    steps = np.diff(recording.times_ns) / recording.period_ns
    if (uneven := np.flatnonzero(steps > _UNEVEN)).size:
        gap = f"{steps[uneven[0]]:.1f} periods before frame {uneven[0] + 1}"
        found.append(f"{uneven.size} gaps in time, the first of {gap}")
    speed = np.linalg.norm(recording.truth.velocity, axis=1)
    jumps, holes, flips = _breaks(recording, frames)
    found += _at(recording, speed > _MAX_SPEED_MPS, f"faster than {_MAX_SPEED_MPS:.0f} m/s")
    found += _at(recording, jumps, f"more than {_MAX_JUMP_M:.0f} m from where their velocity leads")
    found += _at(recording, holes, "back after frames without them")
    found += _at(recording, flips, "whose heading turns by more than 90° in a frame")
    found += _at(recording, _inside_others(recording, frames), "with their centre inside another object")
    found += _shifts(recording, frames)
    rows = np.diff(recording.detection_start).reshape(len(recording), -1)
    for column, agent in enumerate(recording.agents):
        seen = recording.points[:, column] >= SEEN_RETURNS
        if not seen.any():
            found.append(f"{agent.name} never sees an object")
        for row, sensor in enumerate(agent.sensors):
            if not rows[:, recording.column(column, row)].any() and len(recording.detections):
                found.append(f"{agent.name}{f', {sensor.name},' if row else ''} has no detections")
    unseen = np.asarray(~(recording.points >= SEEN_RETURNS).any(axis=1))
    if len(unseen) and unseen.mean() > 0.5:
        found.append(f"{unseen.mean():.0%} of the objects in a frame are seen by nobody")
    return found


def _at(recording: Recording, rows: Bools, words: str) -> list[str]:
    """A sentence on the objects in some truth rows, if there are any."""
    where = np.flatnonzero(rows)
    if not len(where):
        return []
    frame = np.searchsorted(recording.truth_start, where, side="right") - 1
    ids, first = np.unique(recording.truth.id[where], return_index=True)
    places = [f"{number} (frame {frame[row]})" for number, row in zip(ids, first, strict=True)]
    more = f" and {len(ids) - _SHOWN} more" if len(ids) > _SHOWN else ""
    return [f"objects {words}: {', '.join(places[:_SHOWN])}{more}"]


def _breaks(recording: Recording, frames: int) -> tuple[Bools, Bools, Bools]:
    """Where objects do not go on as in their row before: (N,) each.

    A row is far from where the one before leads; frames are missing between the two; the heading flips.
    """
    frame = np.repeat(np.arange(frames), np.diff(recording.truth_start[: frames + 1]))
    order = np.lexsort((frame, recording.truth.id[: len(frame)]))
    ids, frame = recording.truth.id[order], frame[order]
    position, velocity = recording.truth.position[order], recording.truth.velocity[order]
    seconds = np.diff(recording.times_ns[frame] * 1e-9)[:, None]
    expected: Floats = position[:-1] + 0.5 * (velocity[:-1] + velocity[1:]) * seconds
    far = np.linalg.norm(position[1:] - expected, axis=1) > _MAX_JUMP_M
    missing, turn = np.diff(frame) > 1, np.abs(wrap_angle(np.diff(recording.truth.yaw[order])))
    result = np.zeros((3, len(recording.truth)), np.bool_)
    result[:, order[1:]] = np.array([far, missing, ~missing & (turn > _FLIP)]) & (ids[1:] == ids[:-1])
    jumps, holes, flips = result
    return jumps, holes, flips


def _shifts(recording: Recording, frames: int) -> list[str]:
    """Sentences on agents whose detections lie ahead of or behind moving objects, as if their time were shifted."""
    if recording.measurements is not None:
        return []
    period_s, found = recording.period_ns * 1e-9, []
    for column, agent in enumerate(recording.agents):
        late: list[Floats] = []
        for frame in range(frames):
            truth, seen = recording.truth_at(frame), recording.detections_at(frame, column).position
            speed = np.hypot(truth.velocity[:, 0], truth.velocity[:, 1])
            moving = np.flatnonzero(speed > _SHIFTED_MPS)
            if not len(moving) or not len(seen):
                continue
            mount, turn = recording.mount_at(frame, column)
            of_agent = seen @ turn.T + mount
            place = of_agent @ recording.agent_rotation[frame, column].T + recording.agent_position[frame, column]
            tree = KDTree(np.clip(place[:, :2], -_FARTHEST_M, _FARTHEST_M))
            here = np.clip(truth.position[moving, :2], -_FARTHEST_M, _FARTHEST_M)
            distance, nearest = (np.asarray(each) for each in tree.query(here, distance_upper_bound=_SHIFTED_M))
            near = np.isfinite(distance)
            offset, velocity = (here[near] - place[nearest[near], :2]), truth.velocity[moving[near], :2]
            late.append(np.asarray((offset * velocity).sum(axis=1) / speed[moving[near]] ** 2))
        pairs = np.concatenate([np.zeros(0), *late])
        if len(pairs) >= _PAIRS and abs(shift_s := float(np.median(pairs))) > _SHIFT * period_s:
            when = "late" if shift_s > 0.0 else "early"
            found.append(f"the detections of {agent.name} seem {abs(shift_s):.2f} s {when}: shifted time stamps?")
    return found


def _inside_others(recording: Recording, frames: int) -> Bools:
    """(N,) whether the centre of an object is in the box of another one, seen from above and by height."""
    inside = np.zeros(len(recording.truth), np.bool_)
    for frame in range(frames):
        truth = recording.truth_at(frame)
        if len(truth) < 2:
            continue
        reach = float(np.hypot(truth.size[:, 0], truth.size[:, 1]).max() / 2)
        position = np.clip(truth.position[:, :2], -_FARTHEST_M, _FARTHEST_M)
        i, j = KDTree(position).query_pairs(min(reach, _FARTHEST_M), output_type="ndarray").T
        first = int(recording.truth_start[frame])
        for a, b in ((i, j), (j, i)):
            offset = truth.position[a] - truth.position[b]
            within = (np.abs(along_and_across(offset, truth.yaw[b])) < truth.size[b, :2] / 2).all(axis=1)
            within &= np.abs(offset[:, 2]) < truth.size[b, 2] / 2
            inside[first + a[within]] = True
    return inside

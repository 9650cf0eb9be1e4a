"""Which lies of a run an honest agent could have noticed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.config.resolved import RECORDING
from mast_zenoh.errors import RunFolderError
from mast_zenoh.metrics.assignment import Places, nearest
from mast_zenoh.metrics.estimates import LOCAL
from mast_zenoh.metrics.trust import detection_delay
from mast_zenoh.run_folder.tables import from_arrow, to_arrow
from mast_zenoh.runs.messages import states, tables_of
from mast_zenoh.runs.run import Run
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import Walls, sensor_pose
from mast_zenoh.sensing.raycast import PlacedSensor, has_returns

#: Lidar returns from which an agent sees an object.
MIN_RETURNS = 5
#: m, from where an object was removed or moved to the real object that it stands for.
HIDDEN_M = 4.0
#: Size m of a false object whose size is not recorded: a car's.
CAR_M = (4.5, 1.8, 1.5)
#: m/s, from which an object looks where it goes.
_MOVING_MPS = 0.5


@dataclass(frozen=True, eq=False)
class Observability:
    """The lies of a run, and who could have noticed them.

    lies: a row per false, removed, moved or altered object and frame: frame, time_s, agent (that lied), effect, id,
          x y z (m), honest_viewers and lying_viewers (agents with MIN_RETURNS returns or more from that object),
          observable (there is an honest viewer), identifiable (more honest viewers than lying ones)
    first_lie_s, first_observable_s: s, by agent that lied; None: no lie was observable
    suspended_after_s, observed_s: s, from the first observable lie to the agent's suspension (None: never, or no trust
          in the run), and for how long it was watched (None: not at all, as it was suspended already)
    """

    lies: pyarrow.Table
    first_lie_s: dict[str, float]
    first_observable_s: dict[str, float | None]
    suspended_after_s: dict[str, float | None]
    observed_s: dict[str, float | None]


def observability(run: Run | str | Path) -> Observability:
    """Find out which lies in a finished run an honest agent could have noticed.

    A false object is observable if an honest agent would have MIN_RETURNS lidar returns from it: cast in the scene of
    the run folder, with the true objects and buildings in the way. A removed, moved or altered object is observable if
    an honest agent sees the true one. The agents that lied at any time of the run are not honest. Lies are those that
    were measured on the wires; a message that was withheld or reframed as a whole has no objects, so no row.
    Raises RunFolderError if a file of the run is missing or broken.
    """
    run = run if isinstance(run, Run) else Run(run)
    try:
        scene = Recording.load(run.path / RECORDING)
    except Exception as error:
        raise RunFolderError(f"{run.path / RECORDING}: {error}") from None
    changes = _changes(run)
    liars = sorted(set(changes["agent"]))
    lying = np.isin(np.array(scene.agent_names), liars)
    sees = np.zeros((len(changes["frame"]), len(scene.agents)), np.bool_)
    inserted = changes["effect"] == "inserted"
    _cast(scene, run, changes, np.flatnonzero(inserted), sees)
    _look_up(scene, changes, np.flatnonzero(~inserted), sees)
    honest, false = sees[:, ~lying].sum(axis=1), sees[:, lying].sum(axis=1)
    times_s = (scene.times_ns - scene.times_ns[0]) * 1e-9
    changes["time_s"] = np.round(times_s[changes["frame"]], 9)
    columns = ("frame", "time_s", "agent", "effect", "id", "x", "y", "z")
    table = {name: changes[name] for name in columns} | {
        "honest_viewers": honest,
        "lying_viewers": false,
        "observable": honest > 0,
        "identifiable": honest > false,
    }
    first: dict[str, float] = {}
    first_observable: dict[str, float | None] = {}
    for agent in liars:
        rows = changes["agent"] == agent
        first[agent] = float(changes["time_s"][rows].min())
        seen = rows & (honest > 0)
        first_observable[agent] = float(changes["time_s"][seen].min()) if seen.any() else None
    delays = {agent: _delay(run, agent, first_observable[agent]) for agent in liars}
    return Observability(
        to_arrow(table),
        first,
        first_observable,
        {agent: delay for agent, (delay, _) in delays.items()},
        {agent: watched for agent, (_, watched) in delays.items()},
    )


def _changes(run: Run) -> dict[str, NDArray[Any]]:
    """Measured changes to objects that agents report, by interposers other than links."""
    table = from_arrow(run.attacks)
    estimates = run.estimate_wires
    wires = estimates.influence.wires.keys() & set(table["wire"].tolist())
    upstream = {wire: agent for wire in sorted(wires) if (agent := estimates.speaker(wire))}
    kinds = ("inserted", "removed", "moved", "altered")
    kept = (table["role"] != "link") & np.isin(table["wire"], list(upstream)) & np.isin(table["effect"], kinds)
    table = {name: column[kept] for name, column in table.items()}
    place = np.where(
        (table["effect"] == "inserted")[:, None],
        np.column_stack([table[f"after_{axis}"] for axis in "xyz"]),
        np.column_stack([table[f"before_{axis}"] for axis in "xyz"]),
    ).reshape(-1, 3)
    known = np.isfinite(place).all(axis=1)
    return {
        "frame": table["frame"][known].astype(np.int64),
        "agent": np.array([upstream[wire] for wire in table["wire"][known].tolist()], object),
        "effect": table["effect"][known],
        "id": table["id"][known].astype(np.int64),
        **{axis: place[known, index] for index, axis in enumerate("xyz")},
        **{axis: np.nan_to_num(table[axis][known]) for axis in ("vx", "vy")},
    }


def _cast(scene: Recording, run: Run, changes: dict[str, NDArray[Any]], rows: Ints, sees: Bools) -> None:
    """Set which agents would see false objects."""
    walls = Walls.of_buildings(scene.buildings, scene.building_height)
    size, yaw = _boxes(run, changes, rows)
    position = np.column_stack([changes[axis][rows] for axis in "xyz"])
    for frame in np.unique(changes["frame"][rows]).tolist():
        of_frame = np.flatnonzero(changes["frame"][rows] == frame)
        boxes, truth = (position[of_frame], size[of_frame], yaw[of_frame]), scene.truth_at(frame)
        for column in range(len(scene.agents)):
            sensor = _placed(scene, frame, column)
            sees[rows[of_frame], column] = has_returns(*boxes, sensor, walls, truth, MIN_RETURNS)


def _placed(scene: Recording, frame: int, column: int) -> PlacedSensor:
    agent = scene.agents[column]
    lidar = agent.sensor
    pose = scene.agent_position[frame, column], scene.agent_rotation[frame, column]
    return PlacedSensor(lidar, *sensor_pose(*pose, lidar.mount_position, lidar.mount_rotation), agent.object_id)


def _boxes(run: Run, changes: dict[str, NDArray[Any]], rows: Ints) -> tuple[Floats, Floats]:
    """Sizes (n, 3) m and yaws (n,) rad of false objects, as recorded on their way to the centre.

    Without a recording, or on a wire without ids: a car that looks where it goes.
    """
    size = np.tile(np.array(CAR_M), (len(rows), 1))
    vx, vy = changes["vx"][rows], changes["vy"][rows]
    yaw = np.where(np.hypot(vx, vy) > _MOVING_MPS, np.arctan2(vy, vx), 0.0)
    names = sorted(set(changes["agent"][rows]))
    wires = {name: found.key for name in names if (found := run.wiring.find(name, estimate=LOCAL))}
    if not wires:
        return size, yaw
    try:
        recorded = tables_of(run.path, wires.values(), states)
    except (RunFolderError, OSError):
        return size, yaw
    for agent, wire in wires.items():
        tracks = from_arrow(recorded[wire])
        keys = zip(tracks["frame"].tolist(), tracks["id"].tolist(), strict=True)
        place = {key: row for row, key in enumerate(keys)}
        for index in np.flatnonzero(changes["agent"][rows] == agent).tolist():
            key = int(changes["frame"][rows[index]]), int(changes["id"][rows[index]])
            if key[1] >= 0 and (row := place.get(key)) is not None:
                size[index] = [tracks[name][row] for name in "lwh"]
                yaw[index] = tracks["yaw"][row]
    return size, yaw


def _look_up(scene: Recording, changes: dict[str, NDArray[Any]], rows: Ints, sees: Bools) -> None:
    """Set which agents see the real objects that were hidden."""
    frames = np.repeat(np.arange(len(scene)), np.diff(scene.truth_start))
    real, _ = nearest(Places.of_rows(changes, rows), Places(frames, scene.truth.position), HIDDEN_M)
    found: Bools = real >= 0
    sees[rows[found]] = scene.points[real[found]] >= MIN_RETURNS


def _delay(run: Run, agent: str, lie_s: float | None) -> tuple[float | None, float | None]:
    """As `detection_delay`, from the trust table of the run; (None, None) without one."""
    try:
        table = from_arrow(run.trust)
    except RunFolderError:
        return None, None
    rows = table["agent"] == agent
    if not rows.any():
        return None, None
    return detection_delay(table["state"][rows] == "suspended", table["time_s"][rows], lie_s)

"""Run folders of long runs, made of short ones whose frames are repeated."""

import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow
from equal_runs import run_alone
from pyarrow import parquet

from mast_zenoh import run_folder
from mast_zenoh.mesh.control.results import TABLES, PartedTables, TablePart
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header
from mast_zenoh.run_folder import read_json
from mast_zenoh.run_folder.recording.reader import events
from mast_zenoh.run_folder.recording.writer import MessageLog
from mast_zenoh.run_folder.tables import read_arrow, read_table
from mast_zenoh.scenes import from_arrays
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import CleanDetector
from mast_zenoh.wiring.model import Wiring

#: Frames of the run that `sparse` repeats; cars of its scene, the ego and others, and how many of them each agent sees.
SHORT_FRAMES, CARS, SEEN = 10, 5, 3


def sparse(folder: Path, frames: int, agents: int) -> Path:
    """The folder of a sound run of so many frames, a multiple of SHORT_FRAMES, and agents: poles around a few cars.

    One pole is an adversary. The recording has the clock of every frame alone. 10,000 frames of 100 agents take 1 GB.
    """
    with tempfile.TemporaryDirectory() as place:
        scene = Path(place) / "scene.npz"
        _few_cars(agents).save(scene)
        settings = ("n_adversaries=1", "compromised=infra_1", "attack_start_s=0.3", f"scene=recording:{scene}")
        short = run_alone(Path(place) / "short", "uncoordinated", *settings, record=True)
        repeated(short, folder, frames // SHORT_FRAMES, noise_m=1e-3)
        _record_clocks(short, folder, frames, read_json(short / "scenario.json")["period_ns"])
    return folder


def _few_cars(agents: int) -> Recording:
    """A scene of cars side by side, with poles in a circle, of which each sees some cars."""
    times = np.arange(SHORT_FRAMES) * 0.1
    lanes = 6.0 * np.arange(CARS)
    position = np.stack(np.broadcast_arrays(10.0 * times[:, None], lanes), axis=2)
    angle = np.linspace(0.0, 2.0 * np.pi, agents - 1, endpoint=False)
    poles = np.column_stack([30.0 * np.cos(angle), 30.0 * np.sin(angle), angle + np.pi])
    first = np.arange(agents) % CARS
    seen = (np.arange(CARS)[:, None] - first) % CARS < SEEN
    points = np.broadcast_to(50.0 * seen, (SHORT_FRAMES, CARS, agents))
    return from_arrays(
        times_s=times, position=position, poles=poles, points=points, detector=CleanDetector(), name="few cars"
    )


def repeated(short: Path, folder: Path, times: int, *, noise_m: float = 0.0) -> Path:
    """The folder of a run that plays another one so often, one after the other: its tables and scene.

    noise_m: standard deviation of what is added to positions in tables, so that they take the space of a long run
    """
    shutil.copytree(short, folder)
    metrics, scenario = read_json(folder / "metrics.json"), read_json(folder / "scenario.json")
    frames, period_ns = metrics["frames"], scenario["period_ns"]
    first, last = metrics["scored_frames"]
    metrics |= {"frames": frames * times, "scored_frames": [first, frames * (times - 1) + last]}
    run_folder.write_json(folder / "metrics.json", metrics)
    for name in ("run.json", "scenario.json"):
        run_folder.write_json(folder / name, read_json(folder / name) | {"frames": frames * times})
    for name in TABLES:
        if (short / f"{name}.parquet").is_file():
            later = {"frame": frames, "time_s": frames * period_ns * 1e-9}
            _repeat_table(short / f"{name}.parquet", folder / f"{name}.parquet", times, later, noise_m)
    _scene(Recording.load(short / "scene.npz"), frames, times).save(folder / "scene.npz")
    return folder


def _repeat_table(short: Path, path: Path, times: int, later: Mapping[str, float], noise_m: float) -> None:
    """Write a table so often, in row groups as a run writes them. later: what is added to columns each time"""
    table, random = read_arrow(short), np.random.default_rng(0)
    rows, in_group = len(table), _rows_in_part(short, times)
    with parquet.ParquetWriter(path, table.schema) as writer:
        for start in range(0, rows * times, in_group):
            turn, row = np.divmod(np.arange(start, min(start + in_group, rows * times)), rows)
            group = table.take(row)
            for place, field in enumerate(table.schema):
                noise = random.normal(scale=noise_m, size=len(row)) if noise_m and field.name in ("x", "y") else 0
                added = turn * later.get(field.name, 0) + noise
                if np.any(added):
                    values = pyarrow.array(group[field.name].to_numpy() + added, from_pandas=True)
                    group = group.set_column(place, field, values)
            writer.write_table(group, row_group_size=in_group)


def _rows_in_part(path: Path, times: int) -> int:
    """How many rows of a table that is repeated a node hands in together."""
    tables, parts = PartedTables(), list[TablePart]()
    tables.hand_in = parts.append
    columns = read_table(path)
    rows = len(columns["frame"])
    for _ in range(times if rows else 0):
        tables.append("t", columns)
        if parts:
            return len(parts[0].columns["frame"])
    return max(1, times * rows)


def _scene(scene: Recording, frames: int, times: int) -> Recording:
    """The first frames of a scene, so often."""
    rows = np.tile(np.arange(int(scene.truth_start[frames])), times)
    sensors = len(scene.sensor_names)
    found = np.tile(np.arange(int(scene.detection_start[frames * sensors])), times)

    def starts(start: np.ndarray) -> np.ndarray:
        return np.concatenate([[0], np.cumsum(np.tile(np.diff(start), times))])

    def tiled(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values[:frames]] * times)

    return replace(
        scene,
        times_ns=np.arange(frames * times) * scene.period_ns,
        truth=scene.truth.select(rows),
        truth_start=starts(scene.truth_start[: frames + 1]),
        points=scene.points[rows],
        agent_position=tiled(scene.agent_position),
        agent_rotation=tiled(scene.agent_rotation),
        agent_velocity=tiled(scene.agent_velocity),
        detections=scene.detections.select(found),
        detection_start=starts(scene.detection_start[: frames * sensors + 1]),
        detection_truth_id=scene.detection_truth_id[found],
        sweeps=tuple(tiled(sweep) for sweep in scene.sweeps),
    )


def _record_clocks(short: Path, folder: Path, frames: int, period_ns: int) -> None:
    """Record the clock of every frame, and nothing else."""
    (folder / "messages.mcap").unlink()
    log = MessageLog(folder / "messages.mcap")
    inputs = Wiring.from_json(read_json(short / "wiring.json")).ports("recorder").inputs
    log.begin(inputs)
    for event in events(short):
        if event.frame < 0:
            log.add_event(event)
    (clock,) = (key for key, of in inputs.items() if of.message == "clock")
    for frame in range(frames):
        header = Header("clock", "simulator", frame, frame * period_ns, frame)
        log.add(clock, codec.encode(codec.conform(header, {})), header, frame)
    log.close()

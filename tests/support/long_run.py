"""Run folders of long runs, made of short ones whose frames are repeated."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from mast_zenoh import run_folder
from mast_zenoh.control.results import EVALUATOR, TABLES
from mast_zenoh.control.tables import PartedTables
from mast_zenoh.launch.table_files import TableFiles
from mast_zenoh.run_folder import read_json
from mast_zenoh.run_folder.recording.reader import events, read
from mast_zenoh.run_folder.recording.writer import MessageLog
from mast_zenoh.run_folder.tables import read_table
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.wiring.model import Wiring


def repeated(short: Path, folder: Path, times: int, *, recording: bool = False) -> Path:
    """The folder of a run that plays another one so often, one after the other: its tables, scene and recording."""
    shutil.copytree(short, folder)
    metrics = read_json(folder / "metrics.json")
    frames, period_ns = metrics["frames"], read_json(folder / "scenario.json")["period_ns"]
    first, last = metrics["scored_frames"]
    metrics |= {"frames": frames * times, "scored_frames": [first, frames * (times - 1) + last]}
    run_folder.write_json(folder / "metrics.json", metrics)
    run_folder.write_json(folder / "run.json", read_json(folder / "run.json") | {"frames": frames * times})
    files, tables = TableFiles(folder), PartedTables()
    tables.hand_in = lambda part: files.add(EVALUATOR, "p", part)
    for name in TABLES:
        if (short / f"{name}.parquet").is_file():
            table = read_table(short / f"{name}.parquet")
            for turn in range(times):
                later = {"frame": table["frame"] + turn * frames} if "frame" in table else {}
                later |= {"time_s": table["time_s"] + turn * frames * period_ns * 1e-9} if "time_s" in table else {}
                tables.append(name, table | later)
    tables.close({})
    files.close()
    _scene(Recording.load(short / "scene.npz"), frames, times).save(folder / "scene.npz")
    if recording:
        _record(short, folder, frames, times, period_ns)
    return folder


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


def _record(short: Path, folder: Path, frames: int, times: int, period_ns: int) -> None:
    """Record the messages of a run, so often."""
    (folder / "messages.mcap").unlink()
    log = MessageLog(folder / "messages.mcap")
    wiring = Wiring.from_json(read_json(short / "wiring.json"))
    log.begin(wiring.ports("recorder").inputs)
    for event in events(short):
        if event.frame < 0:
            log.add_event(event)
    messages = [message for message in read(short) if not message.malformed]
    for turn in range(times):
        for message in messages:
            header = message.header
            later = header._replace(
                frame=header.frame + turn * frames, time_ns=header.time_ns + turn * frames * period_ns
            )
            log.add(message.key, message.payload, later, message.step + turn * frames)
    log.close()

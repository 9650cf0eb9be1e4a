"""Errors of trackers on objects that turn, on those that do not, and their time a step.

    python benchmarks/turns.py [SCENE ...] [--frames 150] [--seeds 0 1 2]

Every tracker gets the same detections: a run in one process for each scene, seed and tracker. An object turns while its
heading changes by more than 0.15 rad/s and its speed is above 2 m/s. A track and an object are a pair if they are
within 2 m, paired by least total distance; errors are those of the horizontal position and velocity. Time is that of a
step with 50 objects, alone in this process.
"""

from __future__ import annotations

import argparse
import tempfile
import time

import numpy as np
import pyarrow
from scipy.optimize import linear_sum_assignment

import mast_zenoh as mast
from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import Detections
from mast_zenoh.tracking import FilterpyBoxTracker3D, InteractingModelsTracker3D, KalmanBoxTracker3D, Tracker

TRACKERS: tuple[type[Tracker], ...] = (KalmanBoxTracker3D, InteractingModelsTracker3D)
TURN_RATE, SPEED, GATE_M = 0.15, 2.0, 2.0
NAMES = ("id", "x", "y", "vx", "vy", "yaw")


def by_frame(table: pyarrow.Table) -> dict[int, np.ndarray]:
    """Rows of NAMES (n, 6) by frame."""
    rows = np.column_stack([table[name].to_numpy() for name in NAMES])
    frames = table["frame"].to_numpy()
    return {int(frame): rows[frames == frame] for frame in np.unique(frames)}


def errors(run: mast.Run) -> tuple[np.ndarray, int]:
    """A row (3,) for each pair: whether the object turns, its squared errors (m², (m/s)²); and id switches in turns."""
    truth = by_frame(run.truth)
    pairs, switches = [], 0
    for agent in run.agents:
        tracks, last = by_frame(run.agent(agent).tracks), {}
        for frame in sorted(tracks.keys() & truth.keys() - {0}):
            objects, before = truth[frame], {row[0]: row[5] for row in truth.get(frame - 1, [])}
            change = np.array([wrap_angle(np.array(row[5] - before.get(row[0], row[5]))) for row in objects])
            turns = (np.abs(change) > TURN_RATE * 0.1) & (np.hypot(objects[:, 3], objects[:, 4]) > SPEED)
            apart = np.linalg.norm(objects[:, None, 1:3] - tracks[frame][None, :, 1:3], axis=2)
            for i, j in zip(*linear_sum_assignment(np.where(apart <= GATE_M, apart, 1e6)), strict=True):
                if apart[i, j] <= GATE_M:
                    error = objects[i, 1:5] - tracks[frame][j, 1:5]
                    pairs.append((turns[i], error[:2] @ error[:2], error[2:] @ error[2:]))
                    switches += bool(turns[i]) and last.get(objects[i, 0], tracks[frame][j, 0]) != tracks[frame][j, 0]
                    last[objects[i, 0]] = tracks[frame][j, 0]
    return np.array(pairs), switches


def step_ms(tracker: Tracker, steps: int = 60) -> float:
    """ms of processor time of a step with 50 objects: the median of `steps`."""
    random, empty = np.random.default_rng(0), Detections.empty()
    position = np.column_stack([random.uniform(-80, 80, (50, 2)), np.full(50, 0.8)])
    columns = empty.columns() | dict(
        position=position, size=np.tile([4.5, 1.8, 1.5], (50, 1)), yaw=np.zeros(50), score=np.full(50, 0.9),
        class_id=np.ones(50, np.uint8), covariance=np.zeros((50, 3, 3)),
    )  # fmt: skip
    began = []
    for frame in range(steps):
        began.append(time.process_time())
        tracker.step(frame * 100_000_000, Detections(**columns))
    return float(np.median(np.diff(began))) * 1e3


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=["intersection:3", "intersection:4", "intersection:5"])
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--seeds", type=int, nargs="*", default=[0, 1, 2])
    arguments = parser.parse_args()
    print(f"{'scene':24}{'tracker':30}{'turning':>9}{'m':>7}{'m/s':>7}{'switches':>10}{'else':>9}{'m':>7}{'m/s':>7}")
    with tempfile.TemporaryDirectory() as folder:
        for scene in arguments.scenes:
            for tracker in TRACKERS:
                setting = {"agents.*.pipeline.tracker": dict(type=tracker.__name__)}
                measured, switches = [], 0
                for seed in arguments.seeds:
                    out = tempfile.mkdtemp(dir=folder)
                    run = mast.run("baseline", scene=scene, seed=seed, frames=arguments.frames, out=out, **setting)
                    pairs, switched = errors(run)
                    measured.append(pairs)
                    switches += switched
                pairs = np.concatenate(measured)
                cells = [f"{scene.rstrip('/').split('/')[-1][:22]:24}{tracker.__name__:30}"]
                for turning in (True, False):
                    chosen = pairs[pairs[:, 0] == turning]
                    position, velocity = np.sqrt(chosen[:, 1:].mean(axis=0))
                    cells.append(f"{len(chosen):9}{position:7.3f}{velocity:7.2f}" + f"{switches:10}" * turning)
                print(*cells, sep="", flush=True)
    for tracker in (*TRACKERS, FilterpyBoxTracker3D):
        print(f"{tracker.__name__:30}{step_ms(tracker()):8.2f} ms a step with 50 objects")


if __name__ == "__main__":
    main()

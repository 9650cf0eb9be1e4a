"""Measures how detections of generated junctions err over time, and how their traffic crowds, beside real data.

    python tools/realism.py --seeds 0 1 2 --detector LastingErrors,clutter_s=0.2,miss_s=0.35

The detector is a class of `mast_zenoh.sensing`, with its parameters. Options: --help.

The counting rules, for each agent and frame. Objects are those within 100 m with a lidar return, except itself.
Detections within 100 m are matched to them within 2 m on the ground, nearest pairs first.

    false detections   those that are not matched. One goes on from the frame before if it is within 2 m of one there,
                       nearest pairs first; the frames of such a chain are its life
    misses             consecutive frames in which an object is there, but not matched, between two in which it is
    position errors    of matched cars, x and y in the world. Correlation of errors of one object a time apart
    time gaps          from the bumper of a moving vehicle to the next one ahead in its lane (2 m aside, 20 degrees,
                       60 m), by the own speed, once a second
"""

from __future__ import annotations

import argparse
import ast
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from mast_zenoh import sensing
from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.matching import greedy_matching, pairs_within_radius
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Floats, Ints
from mast_zenoh.scenes import Intersection, Recording
from mast_zenoh.sensing import sensor_pose, to_world

MATCH_M, RANGE_M, LONG_FRAMES = 2.0, 100.0, 5
MOVING_MPS, LANE_M, AHEAD_M, ALONG_DEG = 1.0, 2.0, 60.0, 20.0
VEHICLES = [CLASS_INDEX[name] for name in ("car", "truck", "bus")]
#: What is measured, as it is in real data (docs/how-to-scenes.md).
REAL = {
    "life of a false detection, frames": "2.2 to 2.3",
    "share of them in runs of 5 and more": "39 to 42 %",
    "length of a miss, frames": "3.1 to 3.6",
    "its 95th percentile, frames": "10 to 11",
    "correlation of position errors after 1 s": ".68 to .80, aimed at .4 to .6",
    "correlation of position errors after 3 s": ".64 to .69, aimed at .3 to .5",
    "precision": ".77 to .81",
    "recall": ".63 to .67",
    "false detections per frame": "about 2",
    "position error per axis, m": "0.3 to 0.6",
    "time gaps below 1 s": "15 %",
    "5th percentile of time gaps, s": "0.67",
    "vehicles within 100 m": "26 to 58",
    "share of them that stands": "53 to 69 %",
}


@dataclass(eq=False)
class Seen:
    """What agents saw, collected over recordings.

    lives, misses: frames, of each chain of false detections and of each miss
    errors: (frames, 2) m of each car that an agent saw, NaN where it was not matched
    counts: matched, false and missed in all frames, and the number of these frames
    """

    lives: list[int] = field(default_factory=list)
    misses: list[int] = field(default_factory=list)
    errors: list[Floats] = field(default_factory=list)
    counts: Ints = field(default_factory=lambda: np.zeros(4, np.int64))


def paired(one: Floats, other: Floats) -> tuple[Ints, Ints]:
    """Rows of the positions (n, 3) and (k, 3) m that are matched, nearest pairs first."""
    radius = np.full(len(one), MATCH_M)
    row, column, distance, _ = pairs_within_radius(one[:, :2], other[:, :2], radius)
    kept = greedy_matching(row, column, distance)
    return row[kept], column[kept]


def watch(recording: Recording, agent: int, seen: Seen) -> None:
    """Add what an agent's first sensor saw to `seen`."""
    described, frames = recording.agents[agent], len(recording)
    ids = np.unique(recording.truth.id)
    there, matched = np.zeros((2, frames, len(ids)), np.bool_)
    error = np.full((frames, len(ids), 2), np.nan)
    is_car = np.zeros(len(ids), np.bool_)
    before, lives = np.zeros((0, 3)), np.zeros(0, np.int64)
    for frame in range(frames):
        place = recording.agent_position[frame, agent]
        truth = recording.truth_at(frame)
        near = np.hypot(*(truth.position - place)[:, :2].T) <= RANGE_M
        truth = truth.select(near & (recording.points_at(frame)[:, agent] > 0) & (truth.id != described.object_id))
        pose = sensor_pose(place, recording.agent_rotation[frame, agent], *recording.mount_at(frame, agent))
        detected = to_world(recording.detections_at(frame, agent), *pose).position
        detected = detected[np.hypot(*(detected - place)[:, :2].T) <= RANGE_M]
        column = np.searchsorted(ids, truth.id)
        there[frame, column], is_car[column] = True, truth.class_id == CLASS_INDEX["car"]
        row, match = paired(truth.position, detected)
        matched[frame, column[row]] = True
        error[frame, column[row]] = (detected[match] - truth.position[row])[:, :2]
        false = np.delete(detected, match, axis=0)
        old, new = paired(before, false)
        now: Ints = np.ones(len(false), np.int64)
        now[new] += lives[old]
        seen.lives += np.delete(lives, old).tolist()
        before, lives = false, now
        seen.counts += [len(match), len(false), len(truth) - len(match), 1]
    seen.lives += lives.tolist()
    for present, found in zip(there.T, matched.T, strict=True):
        seen.misses += miss_lengths(present, found)
    seen.errors += list(np.moveaxis(error[:, is_car], 1, 0))


def miss_lengths(there: Bools, matched: Bools) -> Iterator[int]:
    """Frames of each miss of an object. there, matched: (F,)"""
    length = None  # of the miss so far; None: the object was not matched since it came
    for present, found in zip(there, matched, strict=True):
        if not present:
            length = None
        elif found:
            if length:
                yield length
            length = 0
        elif length is not None:
            length += 1


def correlation(errors: Sequence[Floats], lag: int) -> float:
    """Correlation of errors (frames, 2) of the same object, `lag` frames apart."""
    both = [np.stack([one[:-lag], one[lag:]]).reshape(2, -1) for one in errors if len(one) > lag]
    pairs = np.concatenate(both, axis=1)
    first, second = pairs[:, np.isfinite(pairs).all(axis=0)]
    return float((first * second).mean() / np.sqrt((first**2).mean() * (second**2).mean()))


def traffic(recording: Recording) -> tuple[Floats, Floats, Floats]:
    """Time gaps, s; vehicles within 100 m of the first agent, and the share of them that stands, in each second."""
    gaps, counts, standing = [], [], []
    for frame in range(0, len(recording), round(1e9 / recording.period_ns)):
        truth = recording.truth_at(frame)
        truth = truth.select(np.isin(truth.class_id, VEHICLES))
        speed = np.hypot(*truth.velocity[:, :2].T)
        near = np.hypot(*(truth.position - recording.agent_position[frame, 0])[:, :2].T) <= RANGE_M
        counts.append(near.sum() - np.any(truth.id[near] == recording.agents[0].object_id))
        standing.append((speed[near] < MOVING_MPS).mean())
        away = truth.position[None] - truth.position[:, None]
        c, s = np.cos(truth.yaw)[:, None], np.sin(truth.yaw)[:, None]
        ahead, aside = away[..., 0] * c + away[..., 1] * s, away[..., 1] * c - away[..., 0] * s
        along = np.abs(wrap_angle(truth.yaw[None] - truth.yaw[:, None])) < np.radians(ALONG_DEG)
        next_one = (ahead > 0) & (ahead < AHEAD_M) & (np.abs(aside) < LANE_M) & along
        gap = np.where(next_one, ahead - (truth.size[:, None, 0] + truth.size[None, :, 0]) / 2, np.inf).min(axis=1)
        follows = np.isfinite(gap) & (speed > MOVING_MPS)
        gaps.append(gap[follows] / speed[follows])
    return np.concatenate(gaps), np.array(counts, float), np.array(standing)


def measure(recordings: Sequence[Recording]) -> dict[str, float]:
    """What REAL names, of recordings at 10 Hz."""
    seen = Seen()
    for recording in recordings:
        for agent in range(len(recording.agents)):
            watch(recording, agent, seen)
    matched, false, missed, frames = seen.counts.tolist()
    lives, misses = np.array(seen.lives), np.array(seen.misses)
    gaps, counts, standing = map(np.concatenate, zip(*map(traffic, recordings), strict=True))
    values = (
        *(lives.mean(), 100.0 * lives[lives >= LONG_FRAMES].sum() / lives.sum()),
        *(misses.mean(), np.percentile(misses, 95)),
        *(correlation(seen.errors, 10), correlation(seen.errors, 30)),
        *(matched / (matched + false), matched / (matched + missed), false / frames),
        np.sqrt(np.nanmean(np.concatenate(seen.errors) ** 2)),
        *(100.0 * (gaps < 1.0).mean(), np.percentile(gaps, 5), counts.mean(), 100.0 * standing.mean()),
    )
    return dict(zip(REAL, map(float, values), strict=True))


def detector(text: str) -> sensing.Detector:
    """The detector of a command line: NAME[,PARAMETER=VALUE ...]."""
    name, *settings = text.split(",")
    kind: Callable[..., sensing.Detector] = getattr(sensing, name)
    return kind(**{key: ast.literal_eval(value) for key, value in (each.split("=") for each in settings)})


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", type=int, default=[0, 1, 2, 3, 4])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--detector", default="DetectionModel")
    parser.add_argument("--infrastructure", type=int, default=4)
    parser.add_argument("--mobile", type=int, default=0)
    parser.add_argument("--json", type=Path, help="file for the numbers of each recording alone")
    chosen = parser.parse_args(arguments)
    scene = partial(Intersection, n_infrastructure=chosen.infrastructure, n_mobile=chosen.mobile)
    scenes = [scene(scene_index=index, detector=detector(chosen.detector)) for index in chosen.scenes]
    recordings = [each.record(seed, chosen.frames) for each in scenes for seed in chosen.seeds]
    if chosen.json:
        each_alone = [measure([recording]) for recording in recordings]
        values = {f"{name} (real: {real})": [each[name] for each in each_alone] for name, real in REAL.items()}
        chosen.json.write_text(json.dumps(values), "utf-8")
    for name, value in measure(recordings).items():
        print(f"{name:44} {value:8.2f}   real: {REAL[name]}")


if __name__ == "__main__":
    main()

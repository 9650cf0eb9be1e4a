"""Recall, precision and errors of the detector of points on scans of generated junctions, as tables in Markdown.

    python benchmarks/detector.py [--lidar VLP-32C ...] [--agent ego ...] [--seeds 3] [--frames 10] [--without-clutter]

The scans are cast from the scenes: shapes of a few convex parts, buildings, still objects beside the roads, a flat
ground; `Returns` loses 2 % of the returns, and far dark ones. Lidar `paper` is the one that the scene gives to each
agent. An object
counts from one point on, within 100 m. A detection is right if its middle is within 2 m, or a third of its length, of
the object's. Near vehicles have 30 points and more, within 40 m. Merged: a detection covers the middles of two objects;
split: an object covers those of two detections. Precision is that of all detections, and of those with a score.
The last table is what `DetectionModel` needs to be like the detector: fitted to objects found, and errors below 1 m.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment, minimize

from mast_zenoh import scenes
from mast_zenoh.arrays.geometry import heading, rotation_from_yaw, wrap_angle
from mast_zenoh.arrays.states import CLASSES, Detections, Floats, Ints, ObjectStates
from mast_zenoh.scenes.generated.intersection import Intersection
from mast_zenoh.sensing import ClusterDetector, LidarSensor, PointDetector, Walls, scan, sensor_pose
from mast_zenoh.sensing.beams import MODELS, Beams
from mast_zenoh.sensing.clutter import Clutter, StillObjects
from mast_zenoh.sensing.points import Points
from mast_zenoh.sensing.returns import REFLECTIVITY, Returns
from mast_zenoh.sensing.shapes import Parts


class Case(NamedTuple):
    """A levelled scan, what it should find, and the number of points on each object."""

    points: Points
    truth: ObjectStates
    on_target: Ints


def beams_of(lidar: LidarSensor, model: str) -> Beams:
    """The beams of a model, or of the sensor of the scene."""
    if model != "paper":
        return MODELS[model].beams()
    none = np.zeros(lidar.channels)
    return Beams(lidar.azimuths, lidar.elevations, none, lidar.azimuths * 0.1 / (2.0 * np.pi), 0.5, lidar.max_range_m)


def cases(seed: int, frames: int, sensor: str, model: str, clutter: Clutter) -> Iterator[Case]:
    """The scans of one agent of a junction with still objects beside its roads, every fifth frame."""
    recording = scenes.prepare(Intersection(), seed, 5 * frames, None)
    row = [agent.name for agent in recording.agents].index(sensor)
    agent, random = recording.agents[row], np.random.default_rng(seed)
    lidar, beams = agent.sensor, beams_of(agent.sensor, model)
    still = still_objects(recording, clutter, random)
    buildings = Walls.of_buildings(recording.buildings, recording.building_height)
    pairs = zip(_columns(buildings), _columns(still.kerbs), strict=True)
    walls = Walls(*(np.concatenate(pair) for pair in pairs))
    for frame in range(0, len(recording.times_ns), 5):
        truth = recording.truth_at(frame)
        pose = recording.agent_position[frame, row], recording.agent_rotation[frame, row]
        origin, rotation = sensor_pose(*pose, lidar.mount_position, lidar.mount_rotation)
        yaw, velocity = float(heading(rotation)), recording.agent_velocity[frame, row]
        mount, level = rotation_from_yaw(-yaw) @ rotation, rotation_from_yaw(yaw)
        own = np.flatnonzero((truth.id == agent.object_id) & (truth.id >= 0))
        objects = scan.Moving(
            np.concatenate([truth.position, still.position]),
            np.concatenate([truth.velocity, np.zeros_like(still.position)]),
            np.concatenate([truth.yaw, still.yaw]),
            np.zeros(len(truth) + len(still.yaw)),
        )
        shapes = Parts.of(
            np.concatenate([truth.class_id, np.zeros(len(still.yaw), np.uint8)]),
            np.concatenate([truth.size, still.size]),
        )
        reflectivity = np.concatenate([REFLECTIVITY[truth.class_id], still.reflectivity])
        place = scan.Moving(origin[None], velocity[None], np.array([yaw]), np.zeros(1))
        cast = scan.cast(beams, place, mount, objects, shapes, 0.0, walls, int(own[0]) if len(own) else -1)
        points, source = Returns(dropout=0.02).measure(cast, beams, place, mount, reflectivity, random)
        on_target = np.bincount(source[source >= 0], minlength=len(objects.yaw))[: len(truth)]
        seen = truth.with_(position=(truth.position - origin) @ level, yaw=wrap_angle(truth.yaw - yaw))
        yield Case(points.turned(mount), seen, on_target)


def _columns(walls: Walls) -> tuple[Floats, Floats, Floats]:
    return walls.start, walls.end, walls.top


def still_objects(recording: scenes.Recording, clutter: Clutter, random: np.random.Generator) -> StillObjects:
    """Hedges, kerbs, signs and poles beside the roads of a scene."""
    occupied = np.concatenate([recording.truth.position[:, :2], recording.agent_position.reshape(-1, 3)[:, :2]])
    radius = np.zeros(len(occupied))
    radius[: len(recording.truth)] = np.hypot(recording.truth.size[:, 0], recording.truth.size[:, 1]) / 2.0
    extent = np.array([(-100.0, -100.0), (100.0, 100.0)])
    return clutter.place(occupied, radius, recording.buildings, extent, random)


class Found(NamedTuple):
    """What a detector made of scans.

    objects: (k, 9) class, points, range m, whether found; error m, heading error deg, squared normalised error, whether
    the class is right, score
    false: scores of false detections;  merged, split: how many;  ms: of each scan
    """

    objects: Floats
    false: list[float]
    merged: int
    split: int
    ms: list[float]


def matched(case: Case, found: Detections) -> tuple[Ints, Ints]:
    """Rows of the truth and of the detections that belong together."""
    gap = np.linalg.norm(case.truth.position[:, None, :2] - found.position[None, :, :2], axis=2)
    gate = np.maximum(2.0, case.truth.size[:, :1] / 3.0)
    cost = np.where((gap <= gate) & (case.on_target[:, None] > 0), gap, 1e6)
    rows, columns = linear_sum_assignment(cost)
    right = cost[rows, columns] < 1e6
    return rows[right], columns[right]


def evaluated(detector: PointDetector, scans: list[Case]) -> Found:
    """What the detector makes of scans."""
    rows, ms, false, merged, split = [], [], list[float](), 0, 0
    for case in scans:
        start = time.process_time()
        found = detector.detect(case.points)
        ms.append(1e3 * (time.process_time() - start))
        truth, of_found = case.truth, np.full(len(case.truth), -1)
        true_rows, found_rows = matched(case, found)
        of_found[true_rows] = found_rows
        false.extend(np.delete(found.score, found_rows))
        range_m = np.hypot(truth.position[:, 0], truth.position[:, 1])
        counted = (case.on_target > 0) & (range_m < 100.0)
        seen = truth.select(counted & (case.on_target >= 10))
        merged += int((covered(seen.position, found.position, found.size, found.yaw) > 1).sum())
        split += int((covered(found.position, seen.position, seen.size, seen.yaw) > 1).sum())
        for row in np.flatnonzero(counted):
            error, turn, normalised, right, score = (np.nan,) * 5
            if (match := of_found[row]) >= 0:
                offset = found.position[match, :2] - truth.position[row, :2]
                error = float(np.hypot(*offset))
                turn = np.degrees(abs(wrap_angle(2.0 * (found.yaw[match] - truth.yaw[row])) / 2.0))
                normalised = offset @ np.linalg.solve(found.covariance[match, :2, :2], offset)
                right, score = float(found.class_id[match] == truth.class_id[row]), found.score[match]
            numbers = case.on_target[row], range_m[row], of_found[row] >= 0, error, turn, normalised, right, score
            rows.append((truth.class_id[row], *numbers))
    return Found(np.array(rows, np.float64), false, merged, split, ms)


def covered(position: Floats, middle: Floats, size: Floats, yaw: Floats) -> Ints:
    """(n,) how many positions (k, 3) m are in each of n boxes, in plan."""
    offset = position[None, :, :2] - middle[:, None, :2]
    cosine, sine = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    along, across = offset[..., 0] * cosine + offset[..., 1] * sine, offset[..., 1] * cosine - offset[..., 0] * sine
    inside = (np.abs(along) < size[:, :1] / 2.0) & (np.abs(across) < size[:, 1:2] / 2.0)
    return np.asarray(inside.sum(axis=1))


VEHICLES = [CLASSES.index(name) for name in ("car", "truck", "bus")]
POINTS = (1, 5, 10, 30, 100, 10**6)
RANGES = (0, 20, 40, 60, 100)


def tables(results: dict[tuple[str, str], Found]) -> None:
    """Print by lidar, by points and by range."""
    print(
        "\n| agent, lidar | scans | objects | recall | near vehicles | precision | scores from 0.5 | merged | split |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|")
    for (agent, lidar), found in results.items():
        rows = found.objects
        near = np.isin(rows[:, 0], VEHICLES) & (rows[:, 1] >= 30) & (rows[:, 2] < 40.0)
        many = max(int((rows[:, 1] >= 10).sum()), 1)
        scores = np.concatenate([rows[rows[:, 3] > 0, 8], found.false])
        true = np.arange(len(scores)) < rows[:, 3].sum()
        precision = true.mean(), true[scores >= 0.5].mean()
        shares = rows[:, 3].mean(), rows[near, 3].mean(), *precision, found.merged / many, found.split / many
        print(
            f"| {agent}, {lidar} | {len(found.ms)} | {len(rows)} |", " | ".join(f"{each:.1%}" for each in shares), "|"
        )
    rows = np.concatenate([found.objects for found in results.values()])
    for title, column, edges in (("points", 1, POINTS), ("range, m", 2, RANGES)):
        print(f"\n| class | {title} | objects | recall | error, m | 90 % below | heading, deg | class right | NEES |")
        print("|---|---|---:|---:|---:|---:|---:|---:|---:|")
        for name in CLASSES[1:]:
            for low, high in pairwise(edges):
                part = rows[(rows[:, 0] == CLASSES.index(name)) & (rows[:, column] >= low) & (rows[:, column] < high)]
                hits = part[part[:, 3] > 0]
                if len(hits) < 5:
                    continue
                middle = np.median(hits[:, 4]), np.percentile(hits[:, 4], 90), np.median(hits[:, 5])
                span = f"{low} to {high}" if high < 10**6 else f"{low} and more"
                print(f"| {name} | {span} | {len(part)} | {part[:, 3].mean():.0%} |", end=" ")
                print(f"{middle[0]:.2f} | {middle[1]:.2f} | {middle[2]:.1f} |", end=" ")
                print(f"{hits[:, 7].mean():.0%} | {np.median(hits[:, 6]):.1f} |")
    calibration(rows)
    print("\n| agent, lidar | ms a scan, best | median |\n|---|---:|---:|")
    for (agent, lidar), found in results.items():
        print(f"| {agent}, {lidar} | {min(found.ms):.1f} | {np.median(found.ms):.1f} |")


def calibration(rows: Floats) -> None:
    """Print the parameters of `DetectionModel` that fit best."""
    print("\n| class | points_scale | position_noise_m | range_scale_m | few_points | errors of 1 m and more |")
    print("|---|---:|---:|---:|---:|---:|")
    for name in ("car", "truck", "bus", "bicycle", "pedestrian"):
        _, points, range_m, hit, error, *_ = rows[(rows[:, 0] == CLASSES.index(name)) & (rows[:, 1] >= 5)].T
        scales = np.geomspace(1.0, 200.0, 200)
        chance = np.clip(1.0 - np.exp(-points / scales[:, None]), 1e-6, 1.0 - 1e-6)
        scale = scales[(hit * np.log(chance) + (1.0 - hit) * np.log(1.0 - chance)).sum(axis=1).argmax()]
        small = (hit > 0) & (error < 1.0)
        n, r, square = points[small], range_m[small], error[small] ** 2

        def unlikely(logs: Floats, n: Floats = n, r: Floats = r, square: Floats = square) -> float:
            noise, far, few = np.exp(logs)
            variance = noise**2 * (1.0 + (r / far) ** 2 + few / n)
            return float((np.log(variance) + square / (2.0 * variance)).sum())

        bounds = np.log([(0.01, 1.0), (10.0, 1000.0), (0.1, 1000.0)])
        noise, far, few = np.exp(minimize(unlikely, np.log([0.1, 60.0, 10.0]), bounds=bounds).x)
        large = (error[hit > 0] >= 1.0).mean()
        print(f"| {name} | {scale:.1f} | {noise:.3f} | {far:.0f} | {few:.0f} | {large:.1%} |")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lidar", nargs="+", default=["paper", "VLP-16", "VLP-32C", "OS1-128"])
    parser.add_argument("--agent", nargs="+", default=["ego", "infra_1"])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--without-clutter", action="store_true")
    given = parser.parse_args()
    clutter = Clutter(hedges=0, kerbs=0, signs=0, poles=0) if given.without_clutter else Clutter()
    results = {}
    for agent in given.agent:
        for lidar in given.lidar:
            seeds = range(1, given.seeds + 1)
            scans = [case for seed in seeds for case in cases(seed, given.frames, agent, lidar, clutter)]
            results[agent, lidar] = evaluated(ClusterDetector(), scans)
    tables(results)


if __name__ == "__main__":
    sys.exit(main())

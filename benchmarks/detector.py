"""Recall, precision and errors of the detector of points on scans of generated junctions, as tables in Markdown.

    python benchmarks/detector.py [--lidar VLP-32C ...] [--agent ego ...] [--seeds 3] [--frames 10] [--without-clutter]
        [--worst FOLDER]

The scans are cast from the scenes: shapes of a few convex parts, buildings, still objects beside the roads, a flat
ground; `Returns` loses 2 % of the returns, and far dark ones. Lidar `paper` is the one that the scene gives to each
agent. An object
counts from one point on, within 100 m. A detection is right if its middle is within 2 m, or a third of its length, of
the object's. Near vehicles have 30 points and more, within 40 m. Merged: a detection covers the middles of two objects;
split: an object covers those of two detections. Precision is that of all detections, and of those with a score.
The last table is what `DetectionModel` needs to be like the detector: fitted to objects found, and errors below 1 m.
FOLDER gets worst_detections.png: from above, the worst case of each kind that docs/explanation-points.md names.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.collections import PolyCollection
from matplotlib.patches import Patch
from matplotlib.ticker import MultipleLocator
from scipy.optimize import linear_sum_assignment, minimize

from mast_zenoh import scenes
from mast_zenoh.arrays.boxes import Boxes
from mast_zenoh.arrays.geometry import box_corners, heading, rotation_from_yaw, wrap_angle
from mast_zenoh.arrays.states import CLASSES, Bools, Detections, Floats, Ints, ObjectStates
from mast_zenoh.scenes.generated.intersection import Intersection
from mast_zenoh.sensing import ClusterDetector, LidarSensor, PointDetector, Walls, scan, sensor_pose
from mast_zenoh.sensing.beams import MODELS, Beams
from mast_zenoh.sensing.clutter import KINDS, Clutter, StillObjects
from mast_zenoh.sensing.points import Points
from mast_zenoh.sensing.returns import REFLECTIVITY, Returns
from mast_zenoh.sensing.shapes import Parts
from mast_zenoh.show.figures.birdseye import BoxArtists, draw_ground, face, outlines
from mast_zenoh.show.figures.legend import draw_legend, mark_entry
from mast_zenoh.show.figures.style import THEMES, Figure
from mast_zenoh.show.palette import OUTCOME_LABELS


class Case(NamedTuple):
    """A levelled scan, what it should find, the number of points on each object, and the hedges."""

    points: Points
    truth: ObjectStates
    on_target: Ints
    hedges: Boxes


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
    hedge = still.kind == KINDS.index("hedge")
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
        beside = (still.position[hedge] - origin) @ level
        hedges = Boxes.unnamed(beside, still.size[hedge], wrap_angle(still.yaw[hedge] - yaw))
        yield Case(points.turned(mount), seen, on_target, hedges)


def _columns(walls: Walls) -> tuple[Floats, Floats, Floats]:
    return walls.start, walls.end, walls.top


def still_objects(recording: scenes.Recording, clutter: Clutter, random: np.random.Generator) -> StillObjects:
    """Hedges, kerbs, signs and poles beside the roads of a scene."""
    occupied = np.concatenate([recording.truth.position[:, :2], recording.agent_position.reshape(-1, 3)[:, :2]])
    radius = np.zeros(len(occupied))
    radius[: len(recording.truth)] = np.hypot(recording.truth.size[:, 0], recording.truth.size[:, 1]) / 2.0
    extent = np.array([(-100.0, -100.0), (100.0, 100.0)])
    return clutter.place(occupied, radius, recording.buildings, extent, random)


class DetectorResult(NamedTuple):
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


def matched(case: Case, detections: Detections) -> tuple[Ints, Ints]:
    """Rows of the truth and of the detections that belong together."""
    gap = np.linalg.norm(case.truth.position[:, None, :2] - detections.position[None, :, :2], axis=2)
    gate = np.maximum(2.0, case.truth.size[:, :1] / 3.0)
    cost = np.where((gap <= gate) & (case.on_target[:, None] > 0), gap, 1e6)
    rows, columns = linear_sum_assignment(cost)
    right = cost[rows, columns] < 1e6
    return rows[right], columns[right]


def evaluated(detector: PointDetector, scans: list[Case]) -> DetectorResult:
    """What the detector makes of scans."""
    rows, ms, false, merged, split = [], [], list[float](), 0, 0
    for case in scans:
        start = time.process_time()
        detections = detector.detect(case.points)
        ms.append(1e3 * (time.process_time() - start))
        truth, match_of = case.truth, np.full(len(case.truth), -1)
        true_rows, detected_rows = matched(case, detections)
        match_of[true_rows] = detected_rows
        false.extend(np.delete(detections.score, detected_rows))
        range_m = np.hypot(truth.position[:, 0], truth.position[:, 1])
        counted = (case.on_target > 0) & (range_m < 100.0)
        seen = truth.select(counted & (case.on_target >= 10))
        merged += int((covered(seen.position, detections.position, detections.size, detections.yaw) > 1).sum())
        split += int((covered(detections.position, seen.position, seen.size, seen.yaw) > 1).sum())
        for row in np.flatnonzero(counted):
            error, turn, normalised, right, score = (np.nan,) * 5
            if (match := match_of[row]) >= 0:
                offset = detections.position[match, :2] - truth.position[row, :2]
                error = float(np.hypot(*offset))
                turn = np.degrees(abs(wrap_angle(2.0 * (detections.yaw[match] - truth.yaw[row])) / 2.0))
                normalised = offset @ np.linalg.solve(detections.covariance[match, :2, :2], offset)
                right, score = float(detections.class_id[match] == truth.class_id[row]), detections.score[match]
            numbers = case.on_target[row], range_m[row], match_of[row] >= 0, error, turn, normalised, right, score
            rows.append((truth.class_id[row], *numbers))
    return DetectorResult(np.array(rows, np.float64), false, merged, split, ms)


def covered(position: Floats, middle: Floats, size: Floats, yaw: Floats) -> Ints:
    """(n,) how many positions (k, 3) m are in each of n boxes, in plan."""
    return np.asarray(covered_by(position, middle, size, yaw).sum(axis=1))


def covered_by(position: Floats, middle: Floats, size: Floats, yaw: Floats) -> Bools:
    """(n, k) whether positions (k, 3) m are in each of n boxes, in plan."""
    offset = position[None, :, :2] - middle[:, None, :2]
    cosine, sine = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    along, across = offset[..., 0] * cosine + offset[..., 1] * sine, offset[..., 1] * cosine - offset[..., 0] * sine
    return np.asarray((np.abs(along) < size[:, :1] / 2.0) & (np.abs(across) < size[:, 1:2] / 2.0))


VEHICLES = [CLASSES.index(name) for name in ("car", "truck", "bus")]
POINTS = (1, 5, 10, 30, 100, 10**6)
RANGES = (0, 20, 40, 60, 100)


def tables(results: dict[tuple[str, str], DetectorResult]) -> None:
    """Print by lidar, by points and by range."""
    print(
        "\n| agent, lidar | scans | objects | recall | near vehicles | precision | scores from 0.5 | merged | split |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|")
    for (agent, lidar), result in results.items():
        rows = result.objects
        near = np.isin(rows[:, 0], VEHICLES) & (rows[:, 1] >= 30) & (rows[:, 2] < 40.0)
        many = max(int((rows[:, 1] >= 10).sum()), 1)
        scores = np.concatenate([rows[rows[:, 3] > 0, 8], result.false])
        true = np.arange(len(scores)) < rows[:, 3].sum()
        precision = true.mean(), true[scores >= 0.5].mean()
        shares = rows[:, 3].mean(), rows[near, 3].mean(), *precision, result.merged / many, result.split / many
        print(
            f"| {agent}, {lidar} | {len(result.ms)} | {len(rows)} |", " | ".join(f"{each:.1%}" for each in shares), "|"
        )
    rows = np.concatenate([result.objects for result in results.values()])
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
    for (agent, lidar), result in results.items():
        print(f"| {agent}, {lidar} | {min(result.ms):.1f} | {np.median(result.ms):.1f} |")


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


class Worst(NamedTuple):
    """A case of a kind, how bad it is, its place (3,) m, and what is written above its picture."""

    case: Case
    detections: Detections
    badness: float
    place: Floats
    title: str


def worst_of(detector: PointDetector, scans: dict[tuple[str, str], list[Case]]) -> list[Worst]:
    """The worst case of each kind: a bus seen from an end, a car whose near end is hidden, a hedge taken for a car."""
    kinds: list[list[Worst]] = [[], [], []]
    for (_, lidar), case in ((key, case) for key, of_lidar in scans.items() for case in of_lidar):
        detections, truth = detector.detect(case.points), case.truth
        name = "scene's lidar" if lidar == "paper" else lidar
        for row, match in zip(*matched(case, detections), strict=True):
            place, points = truth.position[row], case.on_target[row]
            far, offset = float(np.hypot(*place[:2])), detections.position[match, :2] - place[:2]
            error, beyond = float(np.hypot(*offset)), float(offset @ place[:2]) / far
            end_on = abs(np.cos(truth.yaw[row] - np.arctan2(place[1], place[0]))) > 0.95
            title = f"{error:.1f} m off\n{name}, {points} points on it"
            if truth.class_id[row] == CLASSES.index("bus") and far > 60.0 and end_on:
                kinds[0].append(Worst(case, detections, error, place, "Bus seen from an end: " + title))
            if truth.class_id[row] == CLASSES.index("car") and beyond > 0.9 * error and hides_near_end(case, row):
                kinds[1].append(Worst(case, detections, error, place, "Car, near end hidden: " + title))
        cars = np.flatnonzero(detections.class_id == CLASSES.index("car"))
        for row in np.setdiff1d(cars, matched(case, detections)[1]):
            place, hedges = detections.position[row], case.hedges
            if covered(place[None], hedges.position, hedges.size, hedges.yaw).any():
                title = f"Hedge taken for a car\n{name}, score {detections.score[row]:.2f}"
                kinds[2].append(Worst(case, detections, float(detections.score[row]), place, title))
    return [max(kind, key=lambda worst: worst.badness) for kind in kinds if kind]


def hides_near_end(case: Case, row: int) -> bool:
    """Whether an object has 10 to 30 points, none of them within 1 m of the corner that is nearest to the lidar."""
    truth, position = case.truth.select(np.array([row])), case.points.position.astype(np.float64)
    on_it = covered_by(position, truth.position, truth.size, truth.yaw)[0]
    corner = np.linalg.norm(box_corners(truth.position, truth.size, truth.yaw)[0, :, :2], axis=1).min()
    near = np.hypot(*position[on_it, :2].T).min(initial=np.inf)
    return bool(10 <= case.on_target[row] <= 30 and near > corner + 1.0)


#: Half of the side of a picture, m. Inches: left edge, side and distance of the panels.
_HALF_M, _LEFT, _SIDE, _GAP = 9.0, 0.5, 2.16, 0.3


def draw(worst: list[Worst], out: Path) -> None:
    """Write pictures from above, side by side. The lidar is below each, so the vertical axis is the range."""
    theme, height = THEMES["dark"], _SIDE + 0.94
    figure = Figure(figsize=(_LEFT + 3 * (_SIDE + _GAP), height), facecolor=theme.ground)
    entries: list[Artist] = [
        Patch(facecolor=face(name, theme.outcomes[name]), edgecolor=theme.outcomes[name], label=label)
        for name, label in OUTCOME_LABELS.items()
    ]
    entries += [Patch(facecolor=theme.building, edgecolor=theme.building_edge, label="hedge")]
    entries += [mark_entry(".", theme.faint, "point above the ground", size=4.0)]
    figure.set_figheight(height + draw_legend(figure, entries, theme, 8.5))
    for column, (case, detections, _, place, title) in enumerate(worst):
        axes = figure.place(_LEFT + column * (_SIDE + _GAP), 0.44, _SIDE, _SIDE)
        draw_ground(axes, None, theme)
        turn, far = float(np.pi / 2.0 - np.arctan2(place[1], place[0])), float(np.hypot(*place[:2]))
        upright = rotation_from_yaw(turn).T

        def turned(
            states: ObjectStates | Detections | Boxes, rows: Ints, turn: float = turn, upright: Floats = upright
        ) -> Boxes:
            return Boxes.unnamed(states.position[rows] @ upright, states.size[rows], states.yaw[rows] + turn)

        true, right = matched(case, detections)
        missed, hit = np.delete(np.arange(len(case.truth)), true), case.on_target > 0
        hedges = turned(case.hedges, np.arange(len(case.hedges)))
        walls = PolyCollection(list(outlines(hedges)), facecolor=theme.building, edgecolor=theme.building_edge)
        axes.add_collection(walls)
        boxes = {
            "unevaluated": turned(case.truth, missed[~hit[missed]]),
            "truth matched": turned(case.truth, true),
            "track matched": turned(detections, right),
            "truth missed": turned(case.truth, missed[hit[missed]]),
            "track false": turned(detections, np.delete(np.arange(len(detections)), right)),
        }
        for order, (name, colour) in enumerate(theme.outcomes.items()):
            BoxArtists(axes, colour, 3 + 0.1 * order, name, 0.8).show(boxes[name])
        ground = float((case.truth.position[:, 2] - case.truth.size[:, 2] / 2.0).min())
        points = case.points.position[case.points.position[:, 2] > ground + 0.2] @ upright
        axes.plot(*points[:, :2].T, ".", ms=2.0, color=theme.faint, zorder=2)
        axes.set(xlim=(-_HALF_M, _HALF_M), ylim=(far - _HALF_M, far + _HALF_M))
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MultipleLocator(5.0))
        axes.set_title(title, color=theme.ink, fontsize=8.5, loc="left", pad=4)
        below = partial(axes.text, y=-0.11, transform=axes.transAxes, fontsize=8.5, va="top")
        below(0.0, s="across (m)", color=theme.faint)
        below(1.0, s=f"\u2193 lidar, {far:.0f} m", color=theme.agent, ha="right")
    figure.axes[0].set_ylabel("from the lidar (m)", color=theme.faint, fontsize=8.5, labelpad=1)
    figure.savefig(out, dpi=200, facecolor=theme.ground)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lidar", nargs="+", default=["paper", "VLP-16", "VLP-32C", "OS1-128"])
    parser.add_argument("--agent", nargs="+", default=["ego", "infra_1"])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--without-clutter", action="store_true")
    parser.add_argument("--worst", type=Path, metavar="FOLDER")
    given = parser.parse_args()
    clutter = Clutter(hedges=0, kerbs=0, signs=0, poles=0) if given.without_clutter else Clutter()
    results, scans = {}, {}
    for agent in given.agent:
        for lidar in given.lidar:
            seeds = range(1, given.seeds + 1)
            key = agent, lidar
            scans[key] = [case for seed in seeds for case in cases(seed, given.frames, agent, lidar, clutter)]
            results[key] = evaluated(ClusterDetector(), scans[key])
    tables(results)
    if given.worst:
        given.worst.mkdir(parents=True, exist_ok=True)
        draw(worst_of(ClusterDetector(), scans), given.worst / "worst_detections.png")


if __name__ == "__main__":
    sys.exit(main())

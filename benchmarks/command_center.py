"""Processor time of a step of the command centre, beside a step of a tracker with as many objects.

    python benchmarks/command_center.py [AGENTSxOBJECTS ...] [--steps 10] [--profile]

Cars drive on a square with 400 m² for each. Every agent reports all of them, at true positions with noise of 0.2 m, and
0.3 m/s; tracks of real trackers scatter more, so another 0.3 m is added, and to the covariances, too. The centre has
the stages of the shipped scenarios. Prints the median of the steps after the first three, which create the objects;
tracker steps alternate with those of the centre. Beside it, the same without the added scatter; below, how many times
as long it takes for twice as many agents.
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
import time
from collections.abc import Iterator

import numpy as np

from mast_zenoh.arrays.states import Detections, ObjectStates, concatenate
from mast_zenoh.fusion import CovarianceIntersectionFusion, GroupTrackerWrapper, SampledAssignmentClusterer
from mast_zenoh.fusion.pipelines import CommandCenterPipeline
from mast_zenoh.tracking import KalmanBoxTracker3D

SIZES = ("5x50", "20x50", "100x50", "20x200", "1000x20")
AREA_M2, POSITION_STD_M, SCATTER_M, VELOCITY_STD_MPS = 400.0, 0.2, 0.3, 0.3
PERIOD_NS, CREATION_STEPS = 100_000_000, 3


def frames(
    agents: int, objects: int, steps: int, scatter_m: float
) -> Iterator[tuple[int, list[ObjectStates], Detections]]:
    """For each step, its time (ns), the tracks of every agent, and the detections of one."""
    position_std_m = float(np.hypot(POSITION_STD_M, scatter_m))
    random = np.random.default_rng(0)
    side = (AREA_M2 * objects) ** 0.5
    cells = random.permutation(int(np.ceil(objects**0.5)) ** 2)[:objects]
    across = int(np.ceil(objects**0.5))
    spacing = side / across
    position = np.column_stack([cells % across, cells // across, np.zeros(objects)]) * spacing
    position[:, :2] += random.uniform(0.2, 0.8, (objects, 2)) * spacing
    position[:, 2] = 0.75
    heading = random.uniform(-np.pi, np.pi, objects)
    velocity = (
        np.column_stack([np.cos(heading), np.sin(heading), np.zeros(objects)]) * random.uniform(0, 12, objects)[:, None]
    )
    size, car = np.tile([4.5, 1.8, 1.5], (objects, 1)), np.ones(objects, np.uint8)
    variances = [position_std_m**2] * 3 + [0.05**2] * 3 + [VELOCITY_STD_MPS**2] * 3
    covariance = np.tile(np.diag(variances), (objects, 1, 1))
    for step in range(steps):
        tracks = [
            ObjectStates(
                id=np.arange(objects),
                position=position + random.normal(0.0, position_std_m, (objects, 3)) * [1.0, 1.0, 0.1],
                velocity=velocity + random.normal(0.0, VELOCITY_STD_MPS, (objects, 3)) * [1.0, 1.0, 0.1],
                size=size,
                yaw=heading,
                covariance=covariance * random.uniform(0.9, 1.1, (objects, 1, 1)),
                score=np.full(objects, 0.9),
                class_id=car,
            )
            for _ in range(agents)
        ]
        columns = Detections.empty().columns() | dict(
            position=tracks[0].position, size=size, yaw=heading, score=tracks[0].score, class_id=car,
            covariance=np.tile(np.eye(3) * position_std_m**2, (objects, 1, 1)),
        )  # fmt: skip
        yield step * PERIOD_NS, tracks, Detections(**columns)
        position = position + velocity * (PERIOD_NS * 1e-9)


def pipeline() -> CommandCenterPipeline:
    """The command centre of the shipped scenarios."""
    tracking = GroupTrackerWrapper(fusion=CovarianceIntersectionFusion(), tracker=KalmanBoxTracker3D())
    return CommandCenterPipeline(clustering=SampledAssignmentClusterer(), group_tracking=tracking)


def measure(
    agents: int, objects: int, steps: int, profile: cProfile.Profile | None = None, scatter_m: float = SCATTER_M
) -> tuple[float, float]:
    """Median ms of a step of the command centre, and of a tracker."""
    center, tracker = pipeline(), KalmanBoxTracker3D()
    names = tuple(f"agent_{k}" for k in range(agents))
    source = np.repeat(np.arange(agents), objects)
    spent = []
    for step, (time_ns, tracks, detections) in enumerate(frames(agents, objects, steps + CREATION_STEPS, scatter_m)):
        states = concatenate(tracks)
        if profile and step >= CREATION_STEPS:
            profile.enable()
        began = time.process_time_ns()
        picture, _ = center.step(time_ns, states, source, names)
        between = time.process_time_ns()
        if profile:
            profile.disable()
        began_tracker = time.process_time_ns()
        tracker.step(time_ns, detections)
        spent.append((between - began, time.process_time_ns() - began_tracker))
    if not 0.9 * objects <= len(picture) <= 1.1 * objects:
        raise SystemExit(f"the picture has {len(picture)} objects, expected about {objects}")
    center_ns, tracker_ns = np.median(spent[CREATION_STEPS:], axis=0)
    return center_ns * 1e-6, tracker_ns * 1e-6


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sizes", nargs="*", default=SIZES)
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--profile", action="store_true", help="print where the command centre spends its time")
    arguments = parser.parse_args()
    headings = f"{'centre ms':>11}{'without scatter':>17}{'ratio':>7}{'tracker ms':>12}{'ratio':>8}{'µs a track':>12}"
    print(f"{'agents x objects':18}{'tracks':>8}{headings}")
    for size in arguments.sizes:
        agents, objects = (int(part) for part in size.split("x"))
        profile = cProfile.Profile() if arguments.profile else None
        center, tracker = measure(agents, objects, arguments.steps, profile)
        without, _ = measure(agents, objects, arguments.steps, scatter_m=0.0)
        tracks = agents * objects
        row = f"{size:18}{tracks:8}{center:11.2f}{without:17.2f}{center / without:7.2f}"
        print(f"{row}{tracker:12.3f}{center / tracker:8.1f}{center / tracks * 1e3:12.2f}", flush=True)
        if profile:
            pstats.Stats(profile).sort_stats("tottime").print_stats(25)
    few, many = (measure(agents, 50, arguments.steps)[0] for agents in (50, 100))
    print(f"100x50 takes {many / few:.2f} times as long as 50x50, with scatter")


if __name__ == "__main__":
    main()

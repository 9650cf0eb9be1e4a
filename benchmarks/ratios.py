"""Ratios of speed: this version to another one, and to peers, measured in turn until the time is up.

    python benchmarks/ratios.py [--minutes 10] [--against COMMIT] [--frames 100] [--json FILE]

    in process    frames of a baseline, an attacked and a defended run in one process, in processor time
    mesh          lock-step frames of the baseline on a mesh, on the wall clock, also of bare messages over the same
                  graph with and without the barrier between frames (see lockstep.py), and with certificates and rights
    tracker       a step with 50 objects, also of filterpy and Stone Soup with equal models, in processor time
    closed loop   frames of a junction whose ego is driven, in processor time, also of the same junction as it was
                  prepared: alone, and with the perception of its agents, which the prepared scene holds
    link          the latency that a link node adds to a message, also that of a bare relay (see link.py)

Above 1, this version is faster. Both sides of a ratio are measured one after the other, in an order that alternates;
the median of the ratios is printed, with the least and the greatest: the more they scatter, the busier the machine was.

Without --against, the other version is the last release (tag), or the commit before this one if there is none. It runs
with the packages that are installed here. `--against peers` has no other version. With --json, all ratios are written.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from itertools import cycle
from pathlib import Path

import cost
import link
import lockstep
import turns
import versions

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.scenes import Intersection
from mast_zenoh.scenes.making.observe import FrameDetection, lidar_visibility
from mast_zenoh.sensing import DetectionModel
from mast_zenoh.tracking import FilterpyBoxTracker3D, KalmanBoxTracker3D, StoneSoupTracker, Tracker

#: Measures the seconds of all sides of a comparison, this version's first.
Comparison = Callable[[], dict[str, float]]
MESSAGES = 100  # in a block of messages through a link
PEERS = "peers"  # instead of the name of a commit


def in_turn(**sides: Callable[[], float]) -> Comparison:
    """Measures all sides one after the other, every other time in reverse order."""
    order = list(sides)

    def measure() -> dict[str, float]:
        order.reverse()
        measured = {side: sides[side]() for side in order}
        return {side: measured[side] for side in sides}

    return measure


def step_s(tracker: type[Tracker]) -> float:
    """Seconds of a step with 50 objects."""
    return turns.step_ms(tracker(), 20) * 1e-3


def closed_loop(frames: int) -> dict[str, Callable[[], float]]:
    """What takes the processor seconds of a junction's frames: driven, as prepared, and as prepared and perceived."""
    path, content = scenario.load("driving")
    driven = scenario.resolve(path, content, frames=frames)
    recorded = scenario.resolve(path, content | {"drivers": {}}, frames=frames)

    def played(resolved: Resolved) -> float:
        began: list[float] = []
        InProcess(resolved, progress=lambda _: began.append(time.process_time())).run()
        return (began[-1] - began[0]) * frames / (len(began) - 1)

    def perceived() -> float:
        world = Intersection().world(driven.seed, frames).now()
        detection = FrameDetection(world, DetectionModel(), driven.seed)
        ready = time.process_time()
        for frame in range(frames):
            points = lidar_visibility(world, walls=detection.walls)
            for _ in detection.of(world, 0, points, number=frame):
                pass
        return time.process_time() - ready

    return {
        "this": partial(played, driven),
        "open_loop": partial(played, recorded),
        "open_loop_and_perception": lambda: played(recorded) + perceived(),
    }


def comparisons(
    this: versions.Version, other: versions.Version | None, bench: link.Bench, frames: int
) -> dict[str, Comparison]:
    """Everything that is compared. other: None: with peers alone"""
    path, loaded = scenario.load("baseline")
    resolved = scenario.resolve(path, loaded, frames=frames)
    sizes = lockstep.payload_sizes(resolved)
    bare = partial(lockstep.bare, resolved, sizes, 3 * frames)

    def added_by_link() -> dict[str, float]:
        p50 = bench.medians(MESSAGES, ("direct", "relay", "link"))
        return {path: (p50[path] - p50["direct"]) * 1e-6 for path in ("link", "relay")}

    of_versions = {"this": this} if other is None else {"this": this, "other": other}
    return {
        **{
            f"in process, {run}": in_turn(
                **{name: partial(version.seconds, "inproc", run) for name, version in of_versions.items()}
            )
            for run in cost.RUNS
            if other is not None
        },
        "mesh, baseline": in_turn(
            **{name: partial(version.seconds, "mesh", "baseline") for name, version in of_versions.items()},
            secured=partial(this.seconds, "secured", "baseline"),
            bare_messages=lambda: 1.0 / bare(barrier=True),
            bare_messages_without_barrier=lambda: 1.0 / bare(barrier=False),
        ),
        "tracker": in_turn(
            this=partial(step_s, KalmanBoxTracker3D),
            filterpy=partial(step_s, FilterpyBoxTracker3D),
            stone_soup=partial(step_s, StoneSoupTracker),
        ),
        "closed loop": in_turn(**closed_loop(frames)),
        "link": added_by_link,
    }


def main() -> None:
    """Measure until the time is up, each comparison at least once, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--against", metavar="COMMIT")
    parser.add_argument("--frames", type=int, default=100, help="of each run")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    commit = None if arguments.against == PEERS else versions.commit_of(arguments.against)
    end = time.monotonic() + 60.0 * arguments.minutes
    ratios: dict[tuple[str, str], list[float]] = defaultdict(list)
    with ExitStack() as stack:
        this = stack.enter_context(versions.Version(versions.ROOT, arguments.frames))
        other = stack.enter_context(versions.Version(versions.built(commit), arguments.frames)) if commit else None
        bench = stack.enter_context(link.running(link.message(20), ("relay", "link")))
        compared = comparisons(this, other, bench, arguments.frames)
        for number, (name, measure) in enumerate(cycle(compared.items())):
            if time.monotonic() > end and number >= len(compared):
                break
            (_, own), *others = measure().items()
            for side, seconds in others:
                ratios[name, side].append(seconds / own)
    version = commit[:12] if commit else PEERS
    print(f"other: {version}; load {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} cores")
    print(f"{'this to':48}{'median':>8}{'least':>8}{'most':>8}{'times':>8}")
    for (name, side), values in ratios.items():
        median, least, most = statistics.median(values), min(values), max(values)
        label = f"{name}: {side.replace('_', ' ')}"
        print(f"{label:48}{median:8.2f}{least:8.2f}{most:8.2f}{len(values):8}")
    if arguments.json:
        arguments.json.write_text(json.dumps({": ".join(of).replace("_", " "): each for of, each in ratios.items()}))


if __name__ == "__main__":
    main()

"""Collisions and lost progress of the shipped drivers without any attack, over many seeds, in one process per core.

    python benchmarks/driving_safety.py [--seeds 200] [--first 0] [--drivers NAME ...]
        [--estimates truth safety mission] [--veto] [--jobs J] [--frames 150]

The seeds are those from --first on. Each is a junction of its own (`scene_index` is the seed), driven once by every
driver on every estimate. Drivers on the truth or on their agent's own tracks alone need no other agents, so these runs
have none.

For each driver and estimate: seeds with a collision, and the first frame of each; the mean and the least way that the
car drove, relative to the same driver on the truth; and hard brakes. Ctrl-C prints what there is so far. Exits with 1
if any car hit anything, or if the mean way on the mission estimate is less than 95 % of that on the truth.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh import scenario
from mast_zenoh.mesh.inproc import InProcess

ESTIMATES = ("truth", "safety", "mission")
DRIVERS = ("FollowingDriver", "ProposalDriver")
LEAST_PROGRESS = 0.95


class Case(NamedTuple):
    """One run."""

    driver: str
    estimate: str
    seed: int
    frames: int = 150
    veto: bool = False


def driven(case: Case) -> dict[str, Any]:
    """What happened to the ego in a run: its part of metrics.json."""
    settings = [f"scene_index={case.seed}", f"driver={case.driver}", f"estimate={case.estimate}"]
    if case.estimate != "mission":
        settings.append("n_infrastructure=0")
    path, content = scenario.load("driving", settings)
    content["drivers"]["ego"]["veto"] = case.veto and case.estimate == "mission"
    resolved = scenario.resolve(path, content, frames=case.frames, seed=case.seed)
    results = InProcess(resolved).run()
    consequences: dict[str, Any] = results["evaluator"]["metrics"]["driven"]
    return consequences["ego"]


def all_driven(cases: list[Case]) -> dict[Case, dict[str, Any]]:
    """What happened in all runs of a seed: they share its junction and its prepared scenes."""
    return {case: driven(case) for case in cases}


def summary(cases: list[Case], found: dict[Case, dict[str, Any]]) -> bool:
    """Print a line for each driver and estimate; whether all is well."""
    rows = defaultdict(list)
    for case in cases:
        rows[case.driver, case.estimate].append(case)
    well = True
    headings = f"{'seeds':>6}{'collide':>9}{'way':>8}{'least':>8}{'hard brakes':>13}"
    print(f"{'driver':18}{'estimate':10}{headings}  collisions")
    for (driver, estimate), runs in rows.items():
        hits = [(run.seed, hit["object"], hit["frame"]) for run in runs for hit in found[run]["collisions"]]
        way = np.array([found[run]["progress_m"] for run in runs])
        twins = [run._replace(estimate="truth") for run in runs]
        on_truth = np.array([found[twin]["progress_m"] if twin in found else np.nan for twin in twins])
        share = float(way.mean() / on_truth.mean())
        least = float(np.min(way / np.maximum(on_truth, 1.0)))
        hard = sum(found[run]["hard_brakes"] for run in runs)
        well &= not hits and not (estimate == "mission" and share < LEAST_PROGRESS)
        print(
            f"{driver:18}{estimate:10}{len(runs):6}{len({seed for seed, _, _ in hits}):9}{share:8.1%}{least:8.1%}"
            f"{hard:13}  {'; '.join(f'seed {seed}: {other} in frame {frame}' for seed, other, frame in hits[:12])}"
        )
    return well


def main() -> None:
    """Run all cases and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--drivers", nargs="+", default=list(DRIVERS))
    parser.add_argument("--estimates", nargs="+", choices=ESTIMATES, default=list(ESTIMATES))
    parser.add_argument("--veto", action="store_true")
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    of_seed = {
        seed: [
            Case(driver, estimate, seed, options.frames, options.veto)
            for driver, estimate in product(options.drivers, options.estimates)
        ]
        for seed in seeds
    }
    found: dict[Case, dict[str, Any]] = {}
    with ProcessPoolExecutor(options.jobs) as pool:
        running = [pool.submit(all_driven, cases) for cases in of_seed.values()]
        try:
            for number, done in enumerate(as_completed(running), 1):
                found |= done.result()
                for case, happened in done.result().items():
                    for hit in happened["collisions"]:
                        print(f"{case}: hits {hit}", file=sys.stderr)
                if number % 10 == 0:
                    print(f"{number} of {len(seeds)} seeds", file=sys.stderr)
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
    sys.exit(not summary([case for cases in of_seed.values() for case in cases if case in found], found))


if __name__ == "__main__":
    main()

"""The cost of security: the same run on an open and a secured mesh, alternating.

    lock-step    frames/s, at full speed
    real time    ms from sending a frame to receiving its picture, at 10 frames/s of scene time

The goal is 0.7 of the open rate. Both run without a recorder.

    python benchmarks/secure.py [--frames 150] [--repeats 3] [--level acl]
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
from collections import defaultdict
from pathlib import Path

from mast_zenoh import scenario
from mast_zenoh.launch import run
from mast_zenoh.mesh.security.levels import LEVELS, SECURE

GOAL = 0.7


def played(mode: str, level: str, frames: int) -> dict[str, float]:
    """Results of one run: frames/s in lock-step, latencies in real time."""
    path, loaded = scenario.load("baseline")
    resolved = scenario.resolve(path, loaded, frames=frames, mode=mode)
    with tempfile.TemporaryDirectory() as out:
        finished = run.run(resolved, Path(out) / "run", secure=level)
        if finished.error:
            raise finished.error
        if mode == "lockstep":
            return {"lock-step, frames/s": float(finished.record["timings"]["frames_per_second"])}
        latency = json.loads((finished.folder / "metrics.json").read_text())["latency_ms"]["sim_to_picture"]
        return {f"real time, ms to the picture, {name}": float(latency[name]) for name in ("p50", "p99")}


def main() -> None:
    """Measure both, alternating, and print them side by side."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--level", choices=LEVELS[1:], default=SECURE)
    arguments = parser.parse_args()
    values: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for repeat in range(arguments.repeats):
        for level in ("open", arguments.level) if repeat % 2 == 0 else (arguments.level, "open"):
            for mode in ("lockstep", "realtime"):
                for quantity, value in played(mode, level, arguments.frames).items():
                    values[quantity][level].append(value)
    print(f"baseline, {arguments.frames} frames, {arguments.repeats} repeats, medians; goal: {GOAL} of the open rate")
    print(f"{'':36}{'open':>8}{arguments.level:>8}{'ratio':>8}   all runs")
    for quantity, by_level in values.items():
        plain, secure = (statistics.median(by_level[level]) for level in ("open", arguments.level))
        runs = " | ".join(", ".join(f"{value:.1f}" for value in by_level[level]) for level in ("open", arguments.level))
        print(f"{quantity:36}{plain:8.1f}{secure:8.1f}{secure / plain:8.2f}   {runs}")


if __name__ == "__main__":
    main()

"""Start-up, frames/s and memory of runs on a mesh, and how long it takes to insert an adversary into a running one.

    python benchmarks/mesh.py [--agents 5 20] [--times 5] [--frames 1000] [--json FILE]

    start     s from the command to the first frame;  rate: frames/s in lock-step, without a recording
    memory    MiB of a node, proportional set size, mean over all nodes
    insertion ms from the beginning of the change of a wire to its end;  release: of the removal
    request   s from the request to the answer: the node's process starts in it

The medians are printed, with the least and the greatest. With --json, all values are written, by what they are.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from contextlib import suppress
from pathlib import Path

import psutil

from mast_zenoh.errors import NotRunning
from mast_zenoh.launch import live_interception
from mast_zenoh.run_folder import read_json

_WIRE, _POLL_S = "agent/infra_1/tracks", 0.05


def memory_mib(process: psutil.Process) -> float:
    """MiB of a node of a launcher, mean over its nodes."""
    nodes = [each for each in process.children() if "mast_zenoh.mesh" in each.cmdline()]
    return statistics.mean(each.memory_full_info().pss for each in nodes) / 2**20


def measured(agents: int, frames: int) -> dict[str, float]:
    """What one run takes."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        words = ["run", "baseline", "--no-report", "--no-record", "--set", f"n_infrastructure={agents - 1}"]
        command = [sys.executable, "-m", "mast_zenoh", *words, "--frames", str(frames), "--out", str(out)]
        run = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        try:
            inserted = None
            while inserted is None:  # until the first frame
                if run.poll() is not None:
                    sys.exit(f"the run ended with {run.returncode} before its first frame")
                time.sleep(_POLL_S)
                asked = time.monotonic()
                with suppress(NotRunning):
                    inserted = live_interception.intercept(out, _WIRE, "UncoordinatedAttack", name="late")
            request_s = time.monotonic() - asked
            memory = memory_mib(psutil.Process(run.pid))
            released = live_interception.release(out, name="late")
            run.wait()
        finally:
            run.terminate()
        timings = read_json(out / "run.json")["timings"]
    return {
        "start (s)": timings["start_s"],
        "frames/s": timings["frames_per_second"],
        "memory of a node (MiB)": memory,
        "insertion (ms)": inserted["took_ms"],
        "release (ms)": released["took_ms"],
        "insertion with the start of its process (s)": request_s,
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--agents", type=int, nargs="+", default=[5, 20])
    parser.add_argument("--times", type=int, default=5)
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    values: dict[str, list[float]] = defaultdict(list)
    for _ in range(options.times):
        for agents in options.agents:
            for name, value in measured(agents, options.frames).items():
                values[f"{agents} agents: {name}"].append(value)
    for name, each in values.items():
        print(f"{name:60}{statistics.median(each):8.2f}{min(each):8.2f}{max(each):8.2f}")
    if options.json:
        options.json.write_text(json.dumps(values), "utf-8")


if __name__ == "__main__":
    main()

"""Stops nodes of lock-step runs for a while at random, from a seed, and compares each run with the undisturbed one.

    python tools/stopped.py --runs 50 --seed 0 [--jobs 2] [--only NUMBER]

Each run is a process of `mast run` on a mesh, of which up to three processes stand still (SIGSTOP, SIGCONT) for 0.5 to
10 s. It then equals the same run in one process, message by message and in metrics.json, or says that it does not.
Prints a line for each, and the command that repeats one that did neither. Exits with 1 if any did.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import random
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import psutil
from disturbing import Tried, left_behind, numbers, parser, tell

from mast_zenoh.errors import (
    HandlerFailed,
    NodeDied,
    NodeLost,
    RunFolderError,
    StallError,
    StartError,
)
from mast_zenoh.messagelog.difference import compare
from mast_zenoh.messagelog.explain import explain

FRAMES = 150
SCENARIOS = {
    "baseline": ("baseline",),
    "attacked": ("coordinated", "--set", "attack_start_s=1.0"),
    "tapped": ("passthrough",),
    "links": ("realistic_network", "--set", "attack=uncoordinated"),
    "faults": ("attack_during_partition",),
    "chaos": ("chaos", "--set", "duration_s=15.0"),
}
LAUNCHER = "launcher"
#: By status, the exit codes of a run that says that it is not the undisturbed one.
SAID = {
    "node_lost": (NodeLost.exit_code,),
    "handler_failures": (HandlerFailed.exit_code,),
    "failed": tuple(error.exit_code for error in (StartError, NodeDied, StallError)),
}
LATEST_S = 6.0  # after the start of the nodes, a stop begins
LONGEST_S = 240.0


@dataclass(frozen=True)
class Stop:
    """which: of the processes, from 0 to 1 in the order of their names; after_s: from when there are nodes."""

    which: float
    after_s: float
    for_s: float


@dataclass(frozen=True)
class Plan:
    """What is done to a run of a scenario."""

    scenario: str
    stops: tuple[Stop, ...]

    @classmethod
    def draw(cls, seed: int, number: int) -> Plan:
        """The plan of a number: one scenario after the other."""
        drawn = random.Random(f"{seed}/{number}")
        name = list(SCENARIOS)[number % len(SCENARIOS)]
        several = drawn.choice((1, 1, 2, 3))
        return cls(
            name,
            tuple(Stop(drawn.random(), drawn.uniform(0.0, LATEST_S), drawn.uniform(0.5, 10.0)) for _ in range(several)),
        )


def run_one(plan: Plan, undisturbed: Path, folder: Path) -> tuple[str, str, list[str]]:
    """Carry out a plan in an empty folder: what was stopped, how the run ended, and what is wrong about that."""
    out = folder / "run"
    with (folder / "output").open("wb") as output:
        process = subprocess.Popen(command(plan.scenario, out), stdout=output, stderr=subprocess.STDOUT)
    names = _nodes_of(process, out)
    done: list[str] = []
    threads = [
        threading.Thread(target=_stop, args=(process.pid, _name(stop, names), stop, done)) for stop in plan.stops
    ]
    for thread in threads:
        thread.start()
    try:
        code = process.wait(LONGEST_S)
    except subprocess.TimeoutExpired:
        process.kill()
        return ", ".join(done), "hung", [f"did not end within {LONGEST_S:.0f} s"]
    finally:
        for thread in threads:
            thread.join()
    how, broken = _judge(out, undisturbed, code, (folder / "output").read_text(errors="replace"))
    return ", ".join(done) or "nothing was stopped in time", how, broken


def command(scenario: str, out: Path, *more: str) -> list[str]:
    """What runs a scenario."""
    run = [sys.executable, "-m", "mast_zenoh", "run", *SCENARIOS[scenario], "--mode", "lockstep"]
    return [*run, "--frames", str(FRAMES), "--no-report", "--out", str(out), *more]


def _nodes_of(process: subprocess.Popen[bytes], out: Path) -> list[str]:
    """The names of what can be stopped, as soon as there are nodes."""
    deadline = time.monotonic() + LONGEST_S
    while process.poll() is None and time.monotonic() < deadline:
        with contextlib.suppress(OSError, ValueError):
            if nodes := json.loads((out / "run.json").read_text())["nodes"]:
                return sorted([*nodes, LAUNCHER])
        threading.Event().wait(0.02)
    return [LAUNCHER]


def _name(stop: Stop, names: list[str]) -> str:
    return names[int(stop.which * len(names))]


def _stop(launcher: int, name: str, stop: Stop, done: list[str]) -> None:
    """Have a process stand still for a while, if it is there, and note that in `done`."""
    threading.Event().wait(stop.after_s)
    with contextlib.suppress(psutil.NoSuchProcess):
        parent = psutil.Process(launcher)
        nodes = [child for child in parent.children() if _is_node(child, name)]
        for process in [parent] if name == LAUNCHER else nodes:
            process.suspend()
            done.append(f"{name} at {stop.after_s:.1f} s for {stop.for_s:.1f} s")
            try:
                threading.Event().wait(stop.for_s)
            finally:
                process.resume()


def _is_node(process: psutil.Process, name: str) -> bool:
    with contextlib.suppress(psutil.NoSuchProcess):
        words = process.cmdline()
        return "--name" in words and words[words.index("--name") + 1] == name
    return False


def _judge(out: Path, undisturbed: Path, code: int, output: str) -> tuple[str, list[str]]:
    """How it ended, in words, and what is wrong about that."""
    record = json.loads((out / "run.json").read_text())
    status, broken = record["status"], []
    if "Traceback" in output:
        broken.append(f"a traceback: {output[-2000:]}")
    if left := left_behind(out):
        broken.append(f"processes left behind: {left}")
    try:
        found = compare(undisturbed, out, taps=True)
    except RunFolderError as error:
        return f"{status}, exit code {code}: no recording", [*broken, str(error)] if status == "ok" else broken
    metrics = [
        (folder / "metrics.json").read_bytes() for folder in (undisturbed, out) if (folder / "metrics.json").is_file()
    ]
    equal = found.first is None and len({*metrics}) == 1 == len(metrics) - 1
    how = f"{status}, exit code {code}: {'equal' if equal else 'not equal'}"
    if status == "ok" and code == 0:
        if record["churn"]:
            broken.append(f"churn in a run that is ok: {record['churn']}")
        if not equal:
            broken.append("; ".join(explain(found)) if found.first else "metrics.json differs")
    elif code not in SAID.get(status, ()):
        broken.append(f"status {status!r} with exit code {code}")
    elif "error: " not in output:
        broken.append("no message")
    else:
        how += f" ({record['message'].partition(chr(10))[0]})"
    return how, broken


def main() -> None:
    """See the module."""
    arguments = _arguments()
    with tempfile.TemporaryDirectory(prefix="mast-stopped-") as kept, ThreadPoolExecutor(arguments.jobs) as pool:
        lock = threading.Lock()

        @cache
        def undisturbed(scenario: str) -> Path:
            out = Path(kept) / scenario
            subprocess.run(command(scenario, out, "--runtime", "inproc"), check=True, capture_output=True)
            return out

        def carry_out(number: int) -> Tried:
            plan = Plan.draw(arguments.seed, number)
            with lock:
                twin = undisturbed(plan.scenario)
            with tempfile.TemporaryDirectory(prefix="mast-stopped-") as folder:
                done, how, broken = run_one(plan, twin, Path(folder))
            return Tried(number, f"{plan.scenario:9} {done}", how, broken)

        tell(pool.map(carry_out, numbers(arguments)), arguments.seed)


def _arguments() -> argparse.Namespace:
    made = parser(__doc__, 50)
    made.add_argument("--jobs", type=int, default=1, help="runs at a time")
    return made.parse_args()


if __name__ == "__main__":
    main()

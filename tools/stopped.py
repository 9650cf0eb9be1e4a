"""Suspends nodes of lock-step runs and compares them with undisturbed runs.

Nodes and times are drawn from a seed.

    python tools/stopped.py --runs 50 --seed 0 [--jobs 2] [--only NUMBER] [--watchers]

Each run is a process of `mast run` on a mesh, of which up to three processes are suspended (SIGSTOP, SIGCONT) for 0.5
to 10 s. It must equal the same run in one process, in all messages and in metrics.json, or report that it does not.
With `--watchers`, no node is suspended but, from a frame drawn from the rest of the run to its end, a client that
watches it: a viewer with an open page, or a foreign client of Zenoh that subscribes to everything. Such runs must be
ok.
Prints a line for each, with the command that repeats a run that did neither. Exits with 1 if any did.
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
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import psutil
import zenoh
from disturbing import PlanResult, left_behind, numbers, parser, report_results
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from mast_zenoh.errors import (
    HandlerFailed,
    NodeDied,
    NodeLost,
    RunFolderError,
    StallError,
    StartError,
)
from mast_zenoh.mesh.control import prefix
from mast_zenoh.mesh.protocol.traffic import stamp_of
from mast_zenoh.mesh.session import open_observer
from mast_zenoh.run_folder.recording.difference import compare, explain

FRAMES, WATCHED_FRAMES = 150, 300  # a watched run lasts until its watcher is there, and longer
LATEST = 0.9  # of the frames of a watched run: the latest at which its watcher is suspended
SCENARIOS = {
    "baseline": ("baseline",),
    "attacked": ("coordinated", "--set", "attack_start_s=1.0"),
    "tapped": ("passthrough",),
    "links": ("realistic_network", "--set", "attack=uncoordinated"),
    "faults": ("attack_during_partition",),
    "chaos": ("chaos", "--set", "duration_s=15.0"),
}
LAUNCHER = "launcher"
#: By status, the exit codes of a run that reports a difference from the undisturbed one.
REPORTED_CODES = {
    "node_lost": (NodeLost.exit_code,),
    "handler_failures": (HandlerFailed.exit_code,),
    "failed": tuple(error.exit_code for error in (StartError, NodeDied, StallError)),
}
LATEST_S = 6.0  # latest start of a suspension, after the start of the nodes
LONGEST_S = 240.0
WATCHERS = ("viewer", "stranger")
#: A client of somebody else, with Zenoh's own settings.
STRANGER = """
import sys, threading, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("scouting/multicast/enabled", "false")
config.insert_json5("connect/endpoints", f'["{sys.argv[1]}"]')
session = zenoh.open(config)
received = session.declare_subscriber("mast/**", zenoh.handlers.RingChannel(1))
print("listening", flush=True)
threading.Event().wait()
"""


@dataclass(frozen=True)
class Stop:
    """A suspension of one process.

    which: the process, 0 to 1 in the order of names; after_s: s after nodes exist; for_s: s, duration
    """

    which: float
    after_s: float
    for_s: float


@dataclass(frozen=True)
class Plan:
    """The suspensions of one run of a scenario.

    moment: when a watcher is suspended, 0 to 1: of the frames from its arrival to the latest one
    """

    scenario: str
    stops: tuple[Stop, ...]
    moment: float

    @classmethod
    def draw(cls, seed: int, number: int) -> Plan:
        """The plan with a number; scenarios take turns."""
        generator = random.Random(f"{seed}/{number}")
        name = list(SCENARIOS)[number % len(SCENARIOS)]
        several = generator.choice((1, 1, 2, 3))
        return cls(
            name,
            tuple(
                Stop(generator.random(), generator.uniform(0.0, LATEST_S), generator.uniform(0.5, 10.0))
                for _ in range(several)
            ),
            generator.random(),
        )


def run_one(plan: Plan, undisturbed: Path, folder: Path) -> tuple[str, str, list[str]]:
    """Carry out a plan; returns what was stopped, how the run ended, and errors."""
    out = folder / "run"
    with (folder / "output").open("wb") as output:
        process = subprocess.Popen(command(plan.scenario, out, FRAMES), stdout=output, stderr=subprocess.STDOUT)
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


def run_watched(plan: Plan, kind: str, undisturbed: Path, folder: Path) -> tuple[str, str, list[str]]:
    """Like `run_one`, with a watcher of this kind, which is suspended from a frame to the end of the run."""
    out = folder / "run"
    with (folder / "output").open("wb") as output:
        words = command(plan.scenario, out, WATCHED_FRAMES)
        process = subprocess.Popen(words, stdout=output, stderr=subprocess.STDOUT)
    _nodes_of(process, out)
    with ExitStack() as stack:
        clock = Clock(out, stack)
        watcher = _watcher(kind, out, stack)
        stack.callback(watcher.kill)
        frame = round(clock.frame + plan.moment * (LATEST * WATCHED_FRAMES - clock.frame))
        while clock.frame < frame and process.poll() is None:
            threading.Event().wait(0.005)
        psutil.Process(watcher.pid).suspend()
        clock.longest_pause_s = 0.0
        done = f"{kind:8} at frame {clock.frame:3}"
        missed = [] if clock.frame < WATCHED_FRAMES - 1 and process.poll() is None else ["the run had ended before"]
        try:
            code = process.wait(LONGEST_S)
        except subprocess.TimeoutExpired:
            process.kill()
            return done, "hung", [f"did not end within {LONGEST_S:.0f} s"]
    how, broken = _judge(out, undisturbed, code, (folder / "output").read_text(errors="replace"))
    if code != 0 and not broken:
        broken = [how]
    if "disconnected" in json.loads((out / "run.json").read_text()):
        how += ", the client was disconnected"
    return f"{done}, longest pause then {clock.longest_pause_s:.2f} s", how, missed + broken


class Clock:
    """The clock of a running run.

    frame: the newest that has begun, -1: none yet;  longest_pause_s: s without a new one, since it was set to 0
    """

    def __init__(self, out: Path, stack: ExitStack) -> None:
        self.frame, self.longest_pause_s = -1, 0.0
        self._began_s = time.monotonic()
        record = json.loads((out / "run.json").read_text())
        session = stack.enter_context(open_observer(record["endpoint"]))
        on_clock: Any = zenoh.handlers.Callback(self._note, indirect=False)
        session.declare_subscriber(f"{prefix(record['id'])}/clock", on_clock)

    def _note(self, sample: zenoh.Sample) -> None:
        now = time.monotonic()
        self.longest_pause_s = max(self.longest_pause_s, now - self._began_s)
        self.frame, self._began_s = stamp_of(sample.attachment, "clock")[1], now


def _watcher(kind: str, out: Path, stack: ExitStack) -> subprocess.Popen[str]:
    """Start a watcher; returns when it is there."""
    endpoint = json.loads((out / "run.json").read_text())["endpoint"]
    view = ["-m", "mast_zenoh", "view", str(out), "--attached"]
    words = {"viewer": view, "stranger": ["-c", STRANGER, endpoint]}[kind]
    watcher = stack.enter_context(
        subprocess.Popen([sys.executable, *words], text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    )
    assert watcher.stdout is not None
    line = watcher.stdout.readline()
    if kind == "viewer":
        socket = stack.enter_context(connect(f"ws://{line.split()[-1].removeprefix('http://')}frames"))
        stack.callback(watcher.kill)  # before the page waits for its answer
        threading.Thread(target=_confirm, args=(socket,), daemon=True).start()
    return watcher


def _confirm(page: ClientConnection) -> None:
    """Do as a page does: confirm every frame."""
    with contextlib.suppress(ConnectionClosed):
        for message in page:
            if isinstance(message, bytes):
                page.send("shown")


def command(scenario: str, out: Path, frames: int, *more: str) -> list[str]:
    """The command that runs a scenario."""
    run = [sys.executable, "-m", "mast_zenoh", "run", *SCENARIOS[scenario], "--mode", "lockstep"]
    return [*run, "--frames", str(frames), "--no-report", "--out", str(out), *more]


def _nodes_of(process: subprocess.Popen[bytes], out: Path) -> list[str]:
    """Wait for the nodes of a run; returns the processes that can be suspended."""
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
    """Suspend a process for a while, if it exists, and note that in `done`."""
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
    """(how the run ended, in words; the promises that it broke)."""
    record = json.loads((out / "run.json").read_text())
    status, broken = record["status"], []
    if "Traceback" in output:
        broken.append(f"a traceback: {output[-2000:]}")
    if left := left_behind(out):
        broken.append(f"processes left behind: {left}")
    try:
        difference = compare(undisturbed, out, taps=True)
    except RunFolderError as error:
        return f"{status}, exit code {code}: no recording", [*broken, str(error)] if status == "ok" else broken
    metrics = [
        (folder / "metrics.json").read_bytes() for folder in (undisturbed, out) if (folder / "metrics.json").is_file()
    ]
    equal = difference.first is None and len({*metrics}) == 1 == len(metrics) - 1
    how = f"{status}, exit code {code}: {'equal' if equal else 'not equal'}"
    if status == "ok" and code == 0:
        if record["churn"]:
            broken.append(f"churn in a run that is ok: {record['churn']}")
        if not equal:
            broken.append("; ".join(explain(difference)) if difference.first else "metrics.json differs")
    elif code not in REPORTED_CODES.get(status, ()):
        broken.append(f"status {status!r} with exit code {code}")
    elif "error: " not in output:
        broken.append("no message")
    else:
        how += f" ({record['message'].partition(chr(10))[0]})"
    return how, broken


def main() -> None:
    """Run the tool."""
    arguments = _arguments()
    with tempfile.TemporaryDirectory(prefix="mast-stopped-") as kept, ThreadPoolExecutor(arguments.jobs) as pool:
        lock = threading.Lock()

        @cache
        def undisturbed(scenario: str) -> Path:
            out = Path(kept) / scenario
            frames = WATCHED_FRAMES if arguments.watchers else FRAMES
            subprocess.run(command(scenario, out, frames, "--runtime", "inproc"), check=True, capture_output=True)
            return out

        def carry_out(number: int) -> PlanResult:
            plan = Plan.draw(arguments.seed, number)
            with lock:
                twin = undisturbed(plan.scenario)
            with tempfile.TemporaryDirectory(prefix="mast-stopped-") as folder:
                if arguments.watchers:
                    kind = WATCHERS[(number + number // len(SCENARIOS)) % len(WATCHERS)]  # each with each scenario
                    done, how, broken = run_watched(plan, kind, twin, Path(folder))
                else:
                    done, how, broken = run_one(plan, twin, Path(folder))
            return PlanResult(number, f"{plan.scenario:9} {done}", how, broken)

        report_results(pool.map(carry_out, numbers(arguments)), arguments.seed)


def _arguments() -> argparse.Namespace:
    arguments_parser = parser(__doc__, 50)
    arguments_parser.add_argument("--jobs", type=int, default=1, help="runs at a time")
    arguments_parser.add_argument("--watchers", action="store_true", help="suspend viewers and foreign clients instead")
    return arguments_parser.parse_args()


if __name__ == "__main__":
    main()

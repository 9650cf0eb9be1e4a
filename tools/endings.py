"""Ends runs at random moments and checks what docs/explanation-architecture.md#how-a-run-ends promises.

The moments and ways to end are drawn from a seed.

    python tools/endings.py --runs 100 --seed 0 [--only NUMBER]

Each run is a process of `mast run`, on a mesh or in one process. Prints a line for each, with the command that repeats
a run that broke a promise. Exits with 1 if any did.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from disturbing import PlanResult, left_behind, numbers, parser, report_results

from mast_zenoh.errors import RunFolderError
from mast_zenoh.launch.liveness import current_record
from mast_zenoh.run_folder.recording.difference import compare
from mast_zenoh.run_folder.recording.reader import first_incomplete_frame, read

WAYS = (
    *("SIGINT", "SIGTERM", "SIGHUP", "SIGINT SIGINT", "SIGTERM SIGINT", "SIGINT SIGINT SIGINT"),
    *("SIGKILL", "SIGSTOP SIGCONT", "output", "disk"),
)
#: Valid exit codes by status. -9 is also possible for a run that is killed while its report is drawn.
CODES = {
    "ok": (0, 28, 130, -9),
    "interrupted": (130, -9),
    "failed": (21, 22, 23, 28),
    "killed": (-9,),
    "": (130, 28, -9),
}
FRAMES = 60
LONGEST_S = 120.0


@dataclass(frozen=True)
class Plan:
    """How to end a run.

    way: of WAYS; after_s: s after its beginning; pause_s: s between two signals; room: bytes of disk space
    """

    runtime: str
    way: str
    after_s: float
    pause_s: float
    room: int

    @classmethod
    def draw(cls, seed: int, number: int, runtime: str | None = None) -> Plan:
        """The plan with a number."""
        generator = random.Random(f"{seed}/{number}")
        chosen = generator.choice(("mesh", "inproc"))
        runtime = runtime or chosen
        after_s = generator.uniform(0.15, 9.0 if runtime == "mesh" else 4.0)
        return cls(
            runtime, generator.choice(WAYS), after_s, generator.uniform(0.0, 1.0), generator.randrange(1 << 14, 4 << 20)
        )


def command(runtime: str, out: Path) -> list[str]:
    """The command that runs the scenario."""
    run = [sys.executable, "-m", "mast_zenoh", "run", "baseline", "--mode", "lockstep", "--runtime", runtime]
    return [*run, "--frames", str(FRAMES), "--out", str(out)]


def end_one(plan: Plan, folder: Path, undisturbed: Path) -> tuple[str, list[str]]:
    """Carry out a plan; returns how the run ended and the promises that it broke."""
    out = folder / "run"
    limit: Callable[[], None] | None = None
    if plan.way == "disk":
        limit = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (plan.room, plan.room))  # noqa: E731
    reading, writing = os.pipe()
    with (folder / "stderr").open("wb") as errors:
        process = subprocess.Popen(command(plan.runtime, out), stdout=writing, stderr=errors, preexec_fn=limit)
    os.close(writing)
    with open(reading, "rb") as output:
        reader = threading.Thread(target=_read, args=(output, plan.after_s if plan.way == "output" else LONGEST_S))
        reader.start()
        if plan.way.startswith("SIG"):
            _signal(process, plan)
        try:
            code = process.wait(LONGEST_S)
        except subprocess.TimeoutExpired:
            process.kill()
            return "hung", [f"did not end within {LONGEST_S:.0f} s"]
        reader.join()
    return _judge(plan, out, undisturbed, code, (folder / "stderr").read_text(errors="replace"))


def _read(output: object, seconds: float) -> None:
    """Read the output of a run for so many seconds or to its end, then close the pipe."""
    deadline = time.monotonic() + seconds
    os.set_blocking(output.fileno(), False)  # type: ignore[attr-defined]
    while time.monotonic() < deadline:
        if output.read(4096) == b"":  # type: ignore[attr-defined]
            break
        threading.Event().wait(0.02)
    output.close()  # type: ignore[attr-defined]


def _signal(process: subprocess.Popen[bytes], plan: Plan) -> None:
    threading.Event().wait(plan.after_s)
    deadline = time.monotonic() + LONGEST_S
    while process.poll() is None and not _answers(process.pid) and time.monotonic() < deadline:
        threading.Event().wait(0.005)
    for name in plan.way.split():
        if process.poll() is None:
            process.send_signal(signal.Signals[name])
        threading.Event().wait(plan.pause_s)


def _answers(pid: int) -> bool:
    """Whether a process handles SIGTERM yet; Python needs time to start."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return True
    caught = next(line.split()[1] for line in status.splitlines() if line.startswith("SigCgt"))
    return bool(int(caught, 16) >> (signal.SIGTERM - 1) & 1)


def _judge(plan: Plan, out: Path, undisturbed: Path, code: int, errors: str) -> tuple[str, list[str]]:
    """(how the run ended, in words; the promises that it broke)."""
    broken = []
    record = json.loads((out / "run.json").read_text()) if (out / "run.json").is_file() else {}
    status = current_record(record).get("status", "")
    if code not in CODES.get(status, ()):
        broken.append(f"status {status!r} with exit code {code}")
    if status == "killed" and plan.way != "SIGKILL":
        broken.append("no final status")
    if "Traceback" in errors:
        broken.append(f"a traceback: {errors[-2000:]}")
    if code not in (0, -9) and "error: " not in errors:
        broken.append("no message")
    if left := left_behind(out):
        broken.append(f"processes left behind: {left}")
    if (out / "messages.mcap").is_file():
        broken += _recording_errors(record, status, out, undisturbed)
    return f"{status or 'no run folder'}, exit code {code}", broken


def _recording_errors(record: dict[str, Any], status: str, out: Path, undisturbed: Path) -> list[str]:
    """False statements of run.json about the recording.

    A complete recording equals that of the undisturbed run, except in the last frame, in which the run may have ended.
    An incomplete one equals it up to the frame that run.json names.
    """
    try:
        frames = [message.frame for message in read(out)]
        expected_count = record.get("recorded", {}).get("messages", len(frames))
        if status != "killed" and expected_count != len(frames):
            return [f"{len(frames)} messages are recorded, run.json says {expected_count}"]
        statement = record.get("recording", {"from_frame": first_incomplete_frame(out)})
        complete_before = min(statement.get("from_frame", FRAMES), FRAMES if status == "ok" else max(frames, default=0))
        if complete_before and compare(undisturbed, out, taps=True, before=complete_before).first is not None:
            difference = f"not that of the undisturbed run before frame {complete_before}"
            return [f"run.json says {statement} of a recording that is {difference}"]
        if status != "killed" and "recording" not in record:
            return ["run.json does not say whether the recording is complete"]
    except RunFolderError as error:
        return [str(error)]
    return []


def main() -> None:
    """Run the tool."""
    arguments = _arguments()
    with tempfile.TemporaryDirectory(prefix="mast-ending-") as kept:
        undisturbed = Path(kept) / "undisturbed"
        subprocess.run([*command("inproc", undisturbed), "--no-report"], check=True, capture_output=True)

        def carry_out(number: int) -> PlanResult:
            plan = Plan.draw(arguments.seed, number, arguments.runtime)
            with tempfile.TemporaryDirectory(prefix="mast-ending-") as folder:
                how, broken = end_one(plan, Path(folder), undisturbed)
            return PlanResult(number, f"{plan.runtime:6} {plan.way:20} at {plan.after_s:4.1f} s", how, broken)

        more = ["--runtime", arguments.runtime] if arguments.runtime else []
        report_results(map(carry_out, numbers(arguments)), arguments.seed, *more)


def _arguments() -> argparse.Namespace:
    arguments_parser = parser(__doc__, 100)
    arguments_parser.add_argument("--runtime", choices=("mesh", "inproc"), help="Default: either.")
    return arguments_parser.parse_args()


if __name__ == "__main__":
    main()

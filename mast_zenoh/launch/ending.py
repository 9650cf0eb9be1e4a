"""Maps every ending to an error, a status in run.json and an exit code.

tests/support/endings_table.py lists all of them; docs/explanation-architecture.md#how-a-run-ends tells the main ones.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mast_zenoh.errors import (
    DiskFull,
    HandlerFailed,
    Interrupted,
    MastError,
    NodeLost,
    ResourcesExhausted,
    RunError,
    StallError,
    StartError,
    is_disk_full,
    is_out_of_resources,
)

RUNNING, KILLED, OK = "running", "killed", "ok"
_SIGNAL_NAMES = {"": "Ctrl-C", "SIGINT": "Ctrl-C", "SIGHUP": "SIGHUP: its terminal is gone"}
_STATUS: dict[type[MastError], str] = {
    Interrupted: "interrupted",
    HandlerFailed: "handler_failures",
    NodeLost: "node_lost",
}


def status(error: MastError | None) -> str:
    """The final status of a run that ended with an error, or without one."""
    return OK if error is None else _STATUS.get(type(error), "failed")


def from_exception(caught: BaseException, activity: str = "") -> MastError | None:
    """The error for a caught exception; None if only a defect explains it.

    activity: what was being done, for the text of an error of the operating system
    """
    disk_full = _disk_full_error(caught)
    if isinstance(disk_full, OSError):
        return DiskFull(_sentence(disk_full, activity))
    if disk_full is not None and disk_full is not caught:  # a node's, in process
        return DiskFull(str(caught))
    if isinstance(caught, MastError):
        return caught
    if isinstance(caught.__cause__, KeyboardInterrupt):  # Python 3.11: raised in the body of a class
        caught = caught.__cause__
    if isinstance(caught, KeyboardInterrupt):
        return Interrupted(f"stopped by {_SIGNAL_NAMES.get(str(caught), caught)}")
    if is_out_of_resources(caught):
        reason = " ".join(str(caught).split()) or type(caught).__name__
        return ResourcesExhausted(f"{activity or 'this command'}: too little memory, or too few descriptors: {reason}")
    if isinstance(caught, OSError):
        return RunError(_sentence(caught, activity))
    return None


def from_signals(received: list[int]) -> Interrupted:
    """The error of a run that was stopped by signals."""
    name = signal.Signals(received[0]).name
    return Interrupted(f"stopped by {_SIGNAL_NAMES.get(name, name)}")


def from_recording(record: Mapping[str, Any]) -> MastError | None:
    """The error of a finished run whose recording could not be written; else None."""
    recorded = record.get("recorded") or {}
    if not recorded.get("problem"):
        return None
    recorder = next((name for name, node in record["nodes"].items() if node["role"] == "recorder"), "recorder")
    text = f"{recorder}: {recorded['problem']}; {recorded.get('lost', 0)} messages are not in the recording"
    return DiskFull(text) if recorded.get("disk_full") else RunError(text)


def of_run(caught: BaseException | None, record: Mapping[str, Any], folder: str) -> MastError | None:
    """The error of a run: from the caught exception, if any, and its recording."""
    recording = from_recording(record)
    if caught is None:
        return recording
    error = from_exception(caught, folder) or RunError(f"{type(caught).__name__}: {caught}")
    return DiskFull(f"{recording}; {error}") if recording and isinstance(error, DiskFull) else error


def with_hint(caught: KeyboardInterrupt | Interrupted | OSError, hint: str) -> MastError:
    """The error for a caught exception, with a hint of what to do."""
    error = from_exception(caught)
    assert error is not None
    return type(error)(f"{error}; {hint}")


def from_failed_start(line: str, exception: str) -> RunError:
    """The error of a run in which a node failed in `start`.

    line: what to report;  exception: as `failures.described` gives it
    """
    return DiskFull(line) if exception.startswith(f"{DiskFull.__name__}:") else StartError(line)


def of_stall(error: StallError, notices: Sequence[Mapping[str, Any]]) -> StallError:
    """The same error with the messages that nodes refused.

    A flood can keep nodes from receiving the messages that they wait for.
    """
    refused = [notice["text"] for notice in notices if notice["kind"] == "rejected"]
    return StallError(f"{error}; refused: {refused[0]}") if refused else error


def _disk_full_error(error: BaseException | None) -> BaseException | None:
    """The first error in a chain of causes that reports a full disk; else None."""
    while error is not None and not (is_disk_full(error) or isinstance(error, DiskFull)):
        error = error.__cause__
    return error


def _sentence(error: OSError, activity: str) -> str:
    reason = error.strerror or str(error)
    reason = f"{error.filename}: {reason}" if error.filename else reason
    return f"{activity}: {reason}" if activity else reason


class Stop:
    """Request to stop a run, with its time, reason and error.

    now_s:   a monotonic clock, s
    since:   time of the request, s; None: not requested
    problem: the first error; the run ends with it
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        self.since: float | None = None
        self.reason = "end"
        self.problem: RunError | None = None
        self._now_s = now_s

    @property
    def requested(self) -> bool:
        """Whether all nodes are asked to finish."""
        return self.since is not None

    def request(self, reason: str = "end") -> None:
        """Ask all nodes to finish from now on; only the first request counts."""
        if self.since is None:
            self.since, self.reason = self._now_s(), reason

    def note(self, problem: RunError) -> None:
        """Note the error with which the run will end; only the first counts."""
        self.problem = self.problem or problem

    def fail(self, problem: RunError, reason: str) -> None:
        """Note an error, and ask all nodes to finish."""
        self.note(problem)
        self.request(reason)

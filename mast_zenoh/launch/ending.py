"""How an ending becomes an error, a status in run.json and an exit code: the one place that decides.

docs/endings.md has the tables of all endings, and its tests read them.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from mast_zenoh.errors import (
    DiskFull,
    HandlerFailed,
    Interrupted,
    MastError,
    NodeLost,
    RunError,
    StallError,
    StartError,
    is_disk_full,
)
from mast_zenoh.launch import stop_signals

RUNNING, KILLED, OK = "running", "killed", "ok"
_NAMES = {"": "Ctrl-C", "SIGINT": "Ctrl-C", "SIGHUP": "SIGHUP: its terminal is gone"}
_STATUS: dict[type[MastError], str] = {
    Interrupted: "interrupted",
    HandlerFailed: "handler_failures",
    NodeLost: "node_lost",
}


def status(error: MastError | None) -> str:
    """The final status of a run that ended with an error, or without one."""
    return OK if error is None else _STATUS.get(type(error), "failed")


def from_exception(caught: BaseException, doing: str = "") -> MastError | None:
    """The error that stands for what was caught; None for an exception that only a defect explains.

    doing: what was being done, for the text of an error of the operating system
    """
    if (full := _no_room(caught)) is not None and not isinstance(caught, DiskFull):
        return DiskFull(_sentence(full, doing))
    if isinstance(caught, MastError):
        return caught
    if isinstance(caught.__cause__, KeyboardInterrupt):  # Python 3.11: of one in a class body that is executed
        caught = caught.__cause__
    if isinstance(caught, KeyboardInterrupt):
        return Interrupted(f"stopped by {_NAMES.get(str(caught), caught)}")
    if isinstance(caught, OSError):
        return RunError(_sentence(caught, doing))
    return None


def from_signals(received: list[int]) -> Interrupted:
    """The error of a run that was stopped by signals."""
    name = signal.Signals(received[0]).name
    return Interrupted(f"stopped by {_NAMES.get(name, name)}")


def from_recording(record: Mapping[str, Any]) -> MastError | None:
    """The error of a run that was played to its end, but whose recording could not be written."""
    recorded = record.get("recorded") or {}
    if not recorded.get("problem"):
        return None
    recorder = next((name for name, node in record["nodes"].items() if node["role"] == "recorder"), "recorder")
    text = f"{recorder}: {recorded['problem']}; {recorded.get('lost', 0)} messages are not in the recording"
    return DiskFull(text) if recorded.get("disk_full") else RunError(text)


def of_run(caught: BaseException | None, record: Mapping[str, Any], folder: str) -> MastError | None:
    """The error of a run in a folder: of what was caught, if anything was, and of its recording."""
    recording = from_recording(record)
    if caught is None:
        return recording
    error = from_exception(caught, folder) or RunError(f"{type(caught).__name__}: {caught}")
    return DiskFull(f"{recording}; {error}") if recording and isinstance(error, DiskFull) else error


def explained(caught: KeyboardInterrupt | OSError, hint: str) -> MastError:
    """The error that stands for what was caught, with a hint of what to do."""
    error = from_exception(caught)
    assert error is not None
    return type(error)(f"{error}; {hint}")


@contextmanager
def written(note: Callable[[str], None]) -> Iterator[None]:
    """Note the status `running`, carry out the block, and note how it ended, whatever ends it.

    Stop signals that come while the end is written are too late to matter.
    """
    note(RUNNING)
    caught: BaseException | None = None
    try:
        yield
    except BaseException as raised:
        caught = raised
    with stop_signals.noted():
        error = None if caught is None else from_exception(caught) or RunError(str(caught))
        try:
            note(status(error))
        except OSError:
            if caught is None:
                raise
    if caught is not None:
        raise caught


def from_failed_start(line: str, exception: str) -> RunError:
    """The error of a run one of whose nodes failed in `start`, with an exception as `failures.described` has it."""
    return DiskFull(line) if exception.startswith(f"{DiskFull.__name__}:") else StartError(line)


def of_stall(error: StallError, notices: Sequence[Mapping[str, Any]]) -> StallError:
    """The same error with the messages that nodes refused: a flood can keep nodes from the messages they owe."""
    refused = [notice["text"] for notice in notices if notice["kind"] == "rejected"]
    return StallError(f"{error}; refused: {refused[0]}") if refused else error


def _no_room(error: BaseException | None) -> BaseException | None:
    """The error itself, or the first of those that it was raised from, that says that there is no room."""
    while error is not None and not is_disk_full(error):
        error = error.__cause__
    return error


def _sentence(error: BaseException, doing: str) -> str:
    assert isinstance(error, OSError)
    reason = error.strerror or str(error)
    reason = f"{error.filename}: {reason}" if error.filename else reason
    return f"{doing}: {reason}" if doing else reason

"""How each way to end a run ends it, for the tests that verify it."""

from __future__ import annotations

from typing import NamedTuple


class Ending(NamedTuple):
    """A row: status in run.json ("": no folder) and exit code."""

    status: str
    code: int


#: By what happened.
ENDINGS: dict[str, Ending] = {
    "signal before the run folder exists": Ending("", 130),
    "signal while nodes start": Ending("interrupted", 130),
    "signal while the scene is played": Ending("interrupted", 130),
    "second signal while the scene is played": Ending("interrupted", 130),
    "signal while results are collected": Ending("ok", 130),
    "signal while the report is drawn": Ending("ok", 130),
    "launcher killed before the run folder exists": Ending("", 137),
    "launcher killed (SIGKILL)": Ending("running", 137),
    "launcher killed while the report is drawn": Ending("ok", 137),
    "launcher suspended for less than 20 s and resumed, lock-step (Ctrl-Z, SIGSTOP)": Ending("ok", 0),
    "launcher suspended for more than 30 s and resumed, lock-step": Ending("failed", 23),
    "launcher suspended for more than 2 s and resumed, real time": Ending("ok", 0),
    "launcher suspended for more than 2 s and resumed, lock-step, nodes elsewhere": Ending("failed", 23),
    "reader of standard output gone (`head -0`)": Ending("ok", 0),
    "reader of standard error gone": Ending("ok", 0),
    "standard output or error closed (`>&-`)": Ending("ok", 0),
    "standard output on a full disk (`> /dev/full`)": Ending("ok", 28),
    "disk full while the run folder is made": Ending("", 28),
    "disk full while nodes start": Ending("failed", 28),
    "disk full while the scene is played": Ending("failed", 28),
    "disk full while results are collected": Ending("failed", 28),
    "disk full while the report is drawn": Ending("ok", 28),
    "run folder cannot be made": Ending("", 15),
    "scenario whose name leaves `runs/`": Ending("", 10),
    "defect in the launcher": Ending("failed", 1),
}


def ending(what: str) -> Ending:
    """The row of this name."""
    return ENDINGS[what]

"""Schemas of the control messages of a run: pure functions, bytes in, typed values out.

A decoder returns a value or raises MessageError, whatever bytes it is given: types, ranges and sizes are checked, and
nothing more than expected is accepted. Each encoder stands beside its decoder.

fields         strict readers of parts: numbers, names, keys, texts
flow           counts, epoch, act, stop, leave, drain, rewire: how frames, members and the wiring change
files          fetch, file: what a node on another host gets from the launcher and gives to it
interception   intercept, release: what a user asks of a run
reports        failed, result: what a node tells the launcher of itself
results        the results themselves, packed;  failures: of handlers, counted, merged, in words
stop_reasons   why a run stops
invalid        counts what was refused
signatures     who a message is from: those of the driver and the launcher are signed above the level "open"

CONTROLS is the table of all keys below mast/{run}/@control/. security/access.py gives nobody more rights than it says.
"""

from __future__ import annotations

from typing import NamedTuple

from mast_zenoh.security.control_keys import DRIVER, LAUNCHER

NODE, USER = "node", "user"


class Control(NamedTuple):
    """One kind of control message.

    senders:   kinds of processes that may send it; with `own`, each on a key that ends with its own name
    receivers: kinds of processes that receive it
    """

    name: str
    senders: tuple[str, ...]
    receivers: tuple[str, ...]
    own: bool
    max_bytes: int

    @property
    def signed(self) -> bool:
        """Whether it is signed above the level "open": true if only the driver or the launcher may send it."""
        return {*self.senders} <= {DRIVER, LAUNCHER}


def prefix(run: str) -> str:
    """The prefix of all keys of a run."""
    return f"mast/{run}"


def control_prefix(run: str) -> str:
    """The prefix of the control keys of a run."""
    return f"{prefix(run)}/@control"


_KIB, _MIB = 1 << 10, 1 << 20

CONTROLS = {
    control.name: control
    for control in (
        Control("epoch", (DRIVER,), (NODE,), False, 16 * _MIB),
        Control("counts", (NODE,), (DRIVER,), True, _MIB),
        Control("failed", (NODE,), (LAUNCHER,), True, 64 * _KIB),
        Control("stop", (DRIVER, LAUNCHER), (NODE,), False, 4 * _KIB),
        Control("leave", (LAUNCHER,), (NODE,), False, 4 * _KIB),
        Control("act", (DRIVER,), (LAUNCHER,), False, _MIB),
        Control("result", (NODE,), (LAUNCHER,), True, 32 * _MIB),
        Control("fetch", (NODE,), (LAUNCHER,), True, 64 * _KIB),
        Control("file", (NODE,), (LAUNCHER,), True, 5 * _MIB),
        Control("drain", (NODE,), (NODE,), False, 4 * _KIB),
        Control("rewire", (LAUNCHER,), (DRIVER,), False, 16 * _MIB),
        Control("intercept", (USER,), (LAUNCHER,), False, 4 * _MIB),
    )
}

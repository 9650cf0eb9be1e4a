"""Schemas of the control messages of a run: pure functions, bytes in, typed values out.

A decoder returns a value or raises MessageError, whatever its input: types, ranges and sizes are checked, and unknown
parts are refused. Each encoder is next to its decoder.

fields         strict readers of parts: numbers, names, keys, texts
flow           counts, epoch, act, stop, leave, drain, rewire: changes of frames, members and the wiring
files          fetch, file: transfers between a node on another host and the launcher
interception   intercept, release: a user's requests to a run
reports        failed, result: a node's reports to the launcher
results        the results themselves, packed;  failures: of handlers, counted, merged, as text
invalid        counts refused messages
signatures     authenticates senders: the driver and the launcher sign their messages above the level "open"

CONTROLS is the table of all keys below mast/{run}/@control/. security/access.py grants no rights beyond it.
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

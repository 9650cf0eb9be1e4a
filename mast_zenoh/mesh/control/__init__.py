"""Encoders and decoders of the control messages of a run; pure functions.

A decoder returns a value or raises MessageError, whatever bytes it is given: types, ranges and sizes are checked, and
nothing more than expected is accepted. Each encoder is next to its decoder; requests of a user are encoded in
launch/live_interception.

codec          strict decoding within limits; types of the parts of messages; counts refused messages; signs messages
               of the driver and the launcher, above the level "open", and verifies them
flow           counts, epoch, act, stop, leave, drain, rewire: how frames, members and the wiring change; stop reasons
files          fetch, file: files between a node on another host and the launcher;  the description of a run
interception   intercept, release: requests of a user
failures       failed: failures of handlers, counted, merged, formatted
results        result: what a node returns and reports at its end, and parts of its tables before; tables in parts:
               checked columns, cut into equal numbers of rows
key_marks      marks of keys in attachments: on which key a message was sent

CONTROLS is the table of all keys below mast/{run}/@control/. security/access.py grants no more rights than it lists.
"""

from __future__ import annotations

from typing import NamedTuple

from mast_zenoh.mesh.security.control_keys import DRIVER, LAUNCHER

NODE, USER = "node", "user"


class Control(NamedTuple):
    """One kind of control message.

    senders: kinds of processes that may send it; with `own`, each on a key that ends with its own name
    """

    name: str
    senders: tuple[str, ...]
    own: bool
    max_bytes: int

    @property
    def signed(self) -> bool:
        """Whether it is signed above the level "open": the driver or launcher sends it."""
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
        Control("epoch", (DRIVER,), False, 16 * _MIB),
        Control("counts", (NODE,), True, _MIB),
        Control("failed", (NODE,), True, 64 * _KIB),
        Control("stop", (DRIVER, LAUNCHER), False, 4 * _KIB),
        Control("leave", (LAUNCHER,), False, 4 * _KIB),
        Control("act", (DRIVER,), False, _MIB),
        Control("result", (NODE,), True, 32 * _MIB),
        Control("fetch", (NODE,), True, 64 * _KIB),
        Control("file", (NODE,), True, 5 * _MIB),
        Control("drain", (NODE,), False, 4 * _KIB),
        Control("rewire", (LAUNCHER,), False, 16 * _MIB),
        Control("intercept", (USER,), False, 4 * _MIB),
    )
}

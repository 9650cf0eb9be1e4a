"""The stamp attached to a data message: a mark of this testbed, epoch and step.

The step is that in which the message was sent. An interposer's messages have the same stamp as the publisher's would,
so it does not reveal them.
"""

from __future__ import annotations

import struct

import zenoh

ATTACHMENT = struct.Struct("<4sIq")
MARK = b"MAST"


def stamp_of(attachment: zenoh.ZBytes | None) -> tuple[int, int]:
    """Epoch and step of an attachment; (-1, -1) for one that is not from this testbed."""
    if attachment is None or len(attachment) != ATTACHMENT.size:
        return -1, -1
    mark, epoch, step = ATTACHMENT.unpack(attachment.to_bytes())
    return (epoch, step) if mark == MARK else (-1, -1)

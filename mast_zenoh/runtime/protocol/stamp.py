"""The stamp attached to a data message: a mark of this testbed, epoch and step.

The step is that in which the message was sent. An interposer's messages have the same stamp as the publisher's would,
so it does not reveal them.
"""

from __future__ import annotations

import struct
from typing import Protocol

ATTACHMENT = struct.Struct("<4sIq")
MARK = b"MAST"


class Attachment(Protocol):
    """An attachment as Zenoh passes it."""

    def __len__(self) -> int: ...

    def to_bytes(self) -> bytes:
        """Its content."""
        ...


def stamp_of(attachment: Attachment | None) -> tuple[int, int]:
    """Epoch and step of an attachment; (-1, -1) for one that is not from this testbed."""
    if attachment is None or len(attachment) != ATTACHMENT.size:
        return -1, -1
    mark, epoch, step = ATTACHMENT.unpack(attachment.to_bytes())
    return (epoch, step) if mark == MARK else (-1, -1)

"""What a data message carries beside its payload: a mark of this testbed's nodes, the epoch, and the step that it was
sent in. An interposer's messages carry the same as the publisher's would, so there is nothing to tell them by."""

from __future__ import annotations

import struct

ATTACHMENT = struct.Struct("<4sIq")
MARK = b"MAST"


def stamp_of(attachment: bytes | None) -> tuple[int, int]:
    """Epoch and step of an attachment; (-1, -1) for one that is none of this testbed's nodes."""
    if attachment is None or len(attachment) != ATTACHMENT.size:
        return -1, -1
    mark, epoch, step = ATTACHMENT.unpack(attachment)
    return (epoch, step) if mark == MARK else (-1, -1)

"""The attachment of each message: rmw_zenoh drops a message without one.

The form without text labels, of Jazzy from 0.2.4, of Kilted and Rolling from 0.6.0, and of Humble from 0.1.2.
"""

from __future__ import annotations

import hashlib
import struct
from typing import NamedTuple

from mast_zenoh.errors import MessageError

#: Bytes of the id of a publisher.
GID_BYTES = 16

_FORM = struct.Struct(f"<qqB{GID_BYTES}s")
#: How the older form begins: the length of a label, and the label.
_LABEL = b"\x0fsequence_number"


class MessageAttachment(NamedTuple):
    """Origin of a message.

    sequence: number of the message, from 1 for each publisher
    stamp_ns: ns since 1970 at the publisher
    gid:      16 bytes, id of the publisher
    """

    sequence: int
    stamp_ns: int
    gid: bytes

    def write(self) -> bytes:
        """The bytes of the attachment; raises ValueError for an id of another length or numbers beyond int64."""
        if len(self.gid) != GID_BYTES:
            raise ValueError(f"gid: found {len(self.gid)} bytes, expected {GID_BYTES}")
        try:
            return _FORM.pack(self.sequence, self.stamp_ns, GID_BYTES, self.gid)
        except struct.error:
            raise ValueError(f"found {self.sequence} and {self.stamp_ns}, expected numbers of 64 bits") from None


def parse_attachment(data: bytes) -> MessageAttachment:
    """The content of an attachment; raises MessageError for an older or an unknown form."""
    if data.startswith(_LABEL):
        raise MessageError(
            "attachment with text labels: expected the form without; the peer's rmw_zenoh is older than 0.2.4 (Jazzy), "
            "0.6.0 (Kilted, Rolling) or 0.1.2 (Humble): update it"
        )
    if len(data) != _FORM.size:
        raise MessageError(f"attachment of {len(data)} bytes: expected {_FORM.size}, without text labels")
    sequence, stamp_ns, length, gid = _FORM.unpack(data)
    if length != GID_BYTES:
        raise MessageError(f"attachment with an id of {length} bytes: expected {GID_BYTES}")
    return MessageAttachment(sequence, stamp_ns, gid)


def gid_of(token: str) -> bytes:
    """An id for the publisher with a token: equal for equal tokens. Peers compare ids, and read nothing from them."""
    return hashlib.blake2b(token.encode(), digest_size=GID_BYTES).digest()

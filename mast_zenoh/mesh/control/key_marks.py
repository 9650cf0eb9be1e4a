"""The mark of a key, which every message carries in its attachment: its receiver checks on which key it was sent.

Zenoh replaces keys by numbers, per connection. If a router was suspended for longer than the lease, and a client's new
connection is accepted before the old one has ended, the router reads numbers of the new one as if they were of the old
one: for a moment it delivers messages on other keys than those on which they were sent (docs/known_limits.md).

Keys are below the run's prefix, so equal runs have equal marks. The attachment of a control message is the mark of its
key; in that of a data message epoch and step follow, see `mesh.protocol.traffic`.
"""

from __future__ import annotations

from functools import lru_cache
from hashlib import blake2b
from typing import Protocol

from mast_zenoh.errors import MessageError

MARK = b"MAST"  #: begins the mark of every key
MARK_BYTES = 12


class ZenohAttachment(Protocol):
    """An attachment as Zenoh passes it."""

    def __len__(self) -> int: ...

    def to_bytes(self) -> bytes:
        """Its content."""
        ...


@lru_cache(1 << 14)
def key_mark(key: str) -> bytes:
    """The mark of a key: MARK, and a hash of the key."""
    return MARK + blake2b(key.encode(), digest_size=MARK_BYTES - len(MARK)).digest()


def control_mark(key: str) -> bytes:
    """The attachment of a control message; key: below @control/."""
    return key_mark(f"@control/{key}")


def check_control_mark(key_expr: object, attachment: ZenohAttachment | None) -> None:
    """Raise MessageError for a message of this testbed that was sent on another key than this control key.

    key_expr: the whole key. A message without a mark is from outside the run, and passes.
    """
    if attachment is None or not MARK_BYTES <= len(attachment) <= 2 * MARK_BYTES:  # also the stamps of data messages
        return
    content, key = attachment.to_bytes(), str(key_expr).partition("/@control/")[2]
    if content.startswith(MARK) and content != control_mark(key):
        raise MessageError(f"{key.partition('/')[0]}: sent on another key: expected the mark of @control/{key}")

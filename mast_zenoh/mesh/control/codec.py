"""Strict decoding of control messages: a typed value, or MessageError.

A message is unpacked within limits on its bytes and on the number of its values, then converted to its type by msgspec:
exact types, ranges and lengths, no unknown field. Types of parts are here, those of messages next to their encoders.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from typing import Annotated, Any, TypeVar

import msgpack
import msgspec
from msgspec import Meta

from mast_zenoh.errors import MessageError
from mast_zenoh.mesh.control import CONTROLS

T = TypeVar("T")

#: msgspec (0.22) crashes the process when two threads convert to a type at once that neither has used before.
_one_at_a_time = threading.Lock()

MAX_NUMBER = 1 << 62  #: counters, frames, times in ns: less than this
MAX_ENTRIES = 1 << 16  #: entries of a list or a map
MAX_VALUES = 1 << 19  #: lists, maps and their entries in one message

#: The name of a node, or of a role.
Name = Annotated[str, Meta(max_length=256, pattern=r"\A[A-Za-z0-9_.\-]+\Z")]
#: Roles of nodes, by name.
Roles = dict[Name, Name]
#: A key below the run's prefix: chunks without wildcards, joined by slashes.
Key = Annotated[str, Meta(max_length=1024, pattern=r"\A[A-Za-z0-9_.\-@]+(/[A-Za-z0-9_.\-@]+)*\Z")]
Text = Annotated[str, Meta(max_length=4096)]
ONE_LINE = r"\A[^\n\r\v\f\x1c-\x1e\x85\u2028\u2029]*\Z"
Line = Annotated[str, Meta(max_length=4096, pattern=ONE_LINE)]
ShortLine = Annotated[str, Meta(max_length=300, pattern=ONE_LINE)]
Id = Annotated[str, Meta(max_length=64)]
#: A counter, a frame or a time in ns.
Whole = Annotated[int, Meta(ge=0, lt=MAX_NUMBER)]
Positive = Annotated[int, Meta(ge=1, lt=MAX_NUMBER)]
#: A frame; -1: before the first.
FrameOrNone = Annotated[int, Meta(ge=-1, lt=MAX_NUMBER)]
Finite = Annotated[float, Meta(ge=-1e15, le=1e15)]
#: Version by package.
Versions = Annotated[
    dict[Annotated[str, Meta(max_length=100)], Annotated[str, Meta(max_length=300)]], Meta(max_length=100)
]


class ControlMessage(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A message, or a part of one, that is a map with exactly these fields."""


def encode(message: Any) -> bytes:
    """Encode a message: a ControlMessage, a tuple, or plain values."""
    return msgspec.msgpack.encode(message)


def decode(kind: type[T], payload: bytes, what: str, max_bytes: int = 0) -> T:
    """Decode a message; raises MessageError.

    kind: the type to decode;  what: its kind for errors, and in CONTROLS;  max_bytes: 0 for the limit in CONTROLS
    """
    message: T = converted(unpack(payload, what, max_bytes), kind, what)
    return message


def converted(value: object, kind: Any, what: str) -> Any:
    """Plain values as an instance of a type; raises MessageError if they are not of exactly that type."""
    try:
        with _one_at_a_time:
            return msgspec.convert(value, kind, builtin_types=(bytes,))
    except Exception as error:  # msgspec has more for values that are not plain, such as arrays, than its own
        raise MessageError(f"{what}: {str(error)[:200]}") from None


def unpack(payload: bytes, what: str, max_bytes: int = 0) -> Any:
    """Unpack a control message to plain values; max_bytes: 0 for the limit in CONTROLS."""
    fits(payload, what, max_bytes)
    count = at_most(MAX_VALUES, what)
    limits = {"max_ext_len": 0, "max_map_len": MAX_ENTRIES, "max_array_len": MAX_ENTRIES}
    try:
        return msgpack.unpackb(payload, strict_map_key=True, object_hook=count, list_hook=count, **limits)
    except MessageError:
        raise
    except Exception as error:  # msgpack has several, and UnicodeDecodeError
        raise MessageError(f"{what}: not MessagePack: {type(error).__name__}: {str(error)[:100]}") from None


def at_most(values: int, what: str) -> Callable[[Any], Any]:
    """A hook for msgpack that limits the number of values in all lists and maps.

    It raises MessageError beyond that number.
    An empty list takes one byte in a message and eighty in memory, so a limit of bytes is not enough.
    """
    remaining = values

    def counted(container: Any) -> Any:
        nonlocal remaining
        remaining -= 1 + len(container)
        if remaining < 0:
            raise MessageError(f"{what}: found more than {values} values")
        return container

    return counted


def fits(payload: bytes, what: str, max_bytes: int = 0) -> None:
    """Raise MessageError for a message that is too long for its kind."""
    limit = max_bytes or CONTROLS[what].max_bytes
    if len(payload) > limit:
        raise MessageError(f"{what}: found {len(payload)} bytes, expected at most {limit}")


def plain_text(payload: bytes, what: str) -> str:
    """Decode a message that is plain UTF-8 text."""
    fits(payload, what)
    try:
        return payload.decode()
    except UnicodeDecodeError:
        raise MessageError(f"{what}: found bytes that are not UTF-8") from None


MAX_KEYS = 256  #: of refused messages counted separately; all others are counted together
OTHERS = "(others)"
_MAX_REASON = 200


class InvalidMessages:
    """Counts refused control messages by key, from any thread; the first on each key is logged.

    log: called with a line about the first on each key
    counts: by key; reasons: why the first of each was refused
    """

    def __init__(self, log: Callable[[str], None]) -> None:
        self.counts: Counter[str] = Counter()
        self.reasons: dict[str, str] = {}
        self._log = log
        self._lock = threading.Lock()

    def note(self, key: str, reason: object) -> None:
        """Count a refused message on a control key."""
        line = " ".join(str(reason).split())[:_MAX_REASON]
        with self._lock:
            if key not in self.reasons and len(self.reasons) >= MAX_KEYS:
                key = OTHERS
            first = key not in self.reasons
            self.reasons.setdefault(key, line)
            self.counts[key] += 1
        if first:
            self._log(f"refused a control message on {key}: {line} (more on this key will only be counted)")

    def entry(self) -> dict[str, list[int | str]]:
        """[number of refused messages, reason of the first] by key, for run.json."""
        with self._lock:
            return {key: [count, self.reasons[key]] for key, count in self.counts.items()}

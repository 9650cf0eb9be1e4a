"""Strict decoding of control messages: a typed value, or MessageError.

A message is unpacked within limits on its bytes and on the number of its values, then converted to its type by msgspec:
exact types, ranges and lengths, no unknown field. Types of parts are here, those of messages next to their encoders.

Signs and verifies control messages of the driver and the launcher.

A signed message is MessagePack [body, signature]. The Ed25519 signature (RFC 8032) covers the run's id, the key below
@control/ and the body, so it is not valid in another run, on another key or for another node. It does not prevent
replays, which have no effect: epochs count up, a step is carried out once, and a second stop changes nothing.
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
from mast_zenoh.mesh.security.control_keys import ControlKeys

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


_ENVELOPE = 256  #: most bytes that a signature and its wrapping take


class Signatures:
    """Signs and checks the control messages of one run.

    keys:   None on an open mesh, where nothing is signed and everything is accepted
    obeyed: number of messages accepted without a signature
    """

    def __init__(self, run: str, keys: ControlKeys | None = None) -> None:
        self.obeyed = 0
        self._run = run
        self._keys = keys

    def sign(self, what: str, body: bytes) -> bytes:
        """Sign a message; what: its key below @control/, like "stop" or "leave/infra_1"."""
        if self._keys is None:
            return body
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey  # slow to load

        key = Ed25519PrivateKey.from_private_bytes(self._keys.private)
        return encode((body, key.sign(self._covered(what, body))))

    def open(self, what: str, payload: bytes, decode: Callable[[bytes], T]) -> T:
        """Verify and decode a message.

        Raises MessageError if no permitted sender has signed it, and whatever `decode` raises.
        """
        if self._keys is None:
            message = decode(payload)
            self.obeyed += 1
            return message
        return decode(self._checked(what, payload, self._keys))

    def _checked(self, what: str, payload: bytes, keys: ControlKeys) -> bytes:
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

        kind = what.partition("/")[0]
        senders, max_bytes = CONTROLS[kind].senders, CONTROLS[kind].max_bytes + _ENVELOPE
        fits(payload, kind, max_bytes)
        try:
            body, signature = decode(tuple[bytes, bytes], payload, kind, max_bytes)
        except MessageError:
            expected = " or the ".join(senders)
            raise MessageError(f"{kind}: found no signature, expected that of the {expected}") from None
        for sender in senders:
            try:
                Ed25519PublicKey.from_public_bytes(keys.public[sender]).verify(signature, self._covered(what, body))
            except InvalidSignature:
                continue
            return body
        raise MessageError(f"{kind}: found a signature that is not that of the {' or the '.join(senders)}")

    def _covered(self, what: str, body: bytes) -> bytes:
        return b"\0".join((b"mast control", self._run.encode(), what.encode(), body))

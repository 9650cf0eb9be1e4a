"""Control messages that no decoder takes, made from sound ones. Pure: a sound value and random draws in, bytes out.

Sound values are plain Python: lists and maps as MessagePack has them, or a str for a control message that is bare text.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import msgpack
import numpy as np

from mast_zenoh.control import CONTROLS, results

Random = np.random.Generator

#: Bytes of the longest payloads: what unpacks to far more than it is has no need of more.
HEAVY_BYTES = 8 << 20

_INVALID = b"\xc1"  # of all first bytes the one that MessagePack never uses
_CLAIMED = (b"\xdd", b"\xdf", b"\xdb", b"\xc6", b"\xc9")  # a list, map, text, bytes, extension of four billion
_NO_INT = (float("nan"), float("inf"), float("-inf"), -5, -(1 << 63), 1 << 62, 1 << 63, (1 << 64) - 1, True, "7", 1.5)
_NO_FLOAT = (float("nan"), float("inf"), float("-inf"), 1 << 63, 1e300, True, "7")
_NO_MESSAGE: tuple[Any, ...] = (
    *(None, True, 7, -1, 1.5, float("nan"), "text", b"bytes"),
    *([], {}, [1], [[], []], {7: 1}, {"x": {}}, [None] * 9),
)


def pack(value: Any) -> bytes:
    """The bytes of a sound value."""
    return value.encode() if isinstance(value, str) else results.pack(value)


def malformed(value: Any, random: Random) -> bytes:
    """A short payload that is refused, by the decoder of that of which `value` is a sound one."""
    makers = _OF_TEXT if isinstance(value, str) else _PACKED
    return makers[int(random.integers(len(makers)))](value, random)


def heavy(value: Any, control: str) -> Iterator[bytes]:
    """Payloads that are refused too, and would take most of the memory of a receiver that unpacks them carelessly."""
    most = CONTROLS[control].max_bytes
    if most < HEAVY_BYTES:
        yield pack(value) + bytes(most)
    if not isinstance(value, str):
        size = min(most, HEAVY_BYTES) - (1 << 16)
        yield _lists(size)
        if control == "result":
            many = b"\xdd" + size.to_bytes(4, "big") + b"\x90" * size
            for code in (1, 2):  # of results: an array, and a column of text
                yield results.pack(value | {"results": {"x": msgpack.ExtType(code, many)}})


def flipped(value: Any, random: Random) -> bytes:
    """The bytes of a sound message, of which some bits, or bytes, are others: it may be sound all the same."""
    payload = bytearray(pack(value))
    for _ in range(int(random.integers(1, 4))):
        at = int(random.integers(len(payload)))
        if random.integers(2):
            payload[at] ^= 1 << int(random.integers(8))
        else:
            payload[at : at + int(random.integers(3))] = random.bytes(int(random.integers(1, 4)))
    return bytes(payload)


def _lists(size: int) -> bytes:
    """So many bytes of empty lists, in lists that are short enough to be taken each by itself."""
    each = 1 << 15
    inner = b"\xdc" + each.to_bytes(2, "big") + b"\x90" * each
    count = max(1, size // len(inner))
    return b"\xdc" + count.to_bytes(2, "big") + inner * count


def _rubbish(value: Any, random: Random) -> bytes:
    return _INVALID + random.bytes(int(random.integers(64)))


def _truncated(value: Any, random: Random) -> bytes:
    payload = pack(value)
    return payload[: int(random.integers(len(payload)))]


def _trailing(value: Any, random: Random) -> bytes:
    return pack(value) + b"\x00" * int(random.integers(1, 9))


def _claimed(value: Any, random: Random) -> bytes:
    return _CLAIMED[int(random.integers(len(_CLAIMED)))] + b"\xff\xff\xff\xff" + random.bytes(8)


def _nested(value: Any, random: Random) -> bytes:
    depth = int(random.choice([3, 40, 511, 1023, 5000, 60000]))
    one = b"\x91" if random.integers(2) else b"\x81\xa0"
    return one * depth + b"\x90"


def _other(value: Any, random: Random) -> bytes:
    return bytes(msgpack.packb(_NO_MESSAGE[int(random.integers(len(_NO_MESSAGE)))]))


def _not_utf8(value: Any, random: Random) -> bytes:
    told = _with_part(value, "\udcff\udcfe", random)
    return bytes(msgpack.packb(told, default=results._encode, unicode_errors="surrogateescape"))


def _wrong_type(value: Any, random: Random) -> bytes:
    return results.pack(_with_part(value, [[[]]], random))


def _extension(value: Any, random: Random) -> bytes:
    code = int(random.choice([0, 7, 42, 127]))
    return results.pack(_with_part(value, msgpack.ExtType(code, random.bytes(int(random.integers(20)))), random))


def _extra(value: Any, random: Random) -> bytes:
    return results.pack([*value, 7] if isinstance(value, list) else value | {"more": 7})


def _missing(value: Any, random: Random) -> bytes:
    if isinstance(value, list):
        return results.pack(value[:-1])
    needed = [name for name in value if name not in ("versions", "clock")]
    gone = needed[int(random.integers(len(needed)))]
    return results.pack({name: part for name, part in value.items() if name != gone})


def _number(value: Any, random: Random) -> bytes:
    """One of the numbers is none, or out of any range; where there are none, one of the parts is of a wrong type."""
    found = list(_numbers(value))
    if not found:
        return _wrong_type(value, random)
    path, number = found[int(random.integers(len(found)))]
    instead: Sequence[Any] = _NO_INT if isinstance(number, int) else _NO_FLOAT
    return results.pack(_replaced(value, path, instead[int(random.integers(len(instead)))]))


def _numbers(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], int | float]]:
    """Where numbers stand in a value whose range is checked."""
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in parts:
        if type(part) in (int, float):
            yield (*path, key), part
        elif key != "results":  # there a node may say what it likes
            yield from _numbers(part, (*path, key))


def _replaced(value: Any, path: tuple[Any, ...], instead: Any) -> Any:
    if not path:
        return instead
    changed = dict(value) if isinstance(value, dict) else list(value)
    changed[path[0]] = _replaced(value[path[0]], path[1:], instead)
    return changed


def _with_part(value: Any, part: Any, random: Random) -> Any:
    """A value of which one part at the top is another."""
    keys = list(value) if isinstance(value, dict) else list(range(len(value)))
    return _replaced(value, (keys[int(random.integers(len(keys)))],), part)


def _no_text(value: Any, random: Random) -> bytes:
    return pack(value) + bytes([int(random.integers(0x80, 0xC0))]) + random.bytes(int(random.integers(16)))


def _cut_text(value: Any, random: Random) -> bytes:
    return pack(value) + "€".encode()[: int(random.integers(1, 3))]


def _long_text(value: Any, random: Random) -> bytes:
    return b"x" * (4 << 10) + pack(value) + b"x"


_PACKED: tuple[Callable[[Any, Random], bytes], ...] = (
    *(_rubbish, _truncated, _trailing, _claimed, _nested, _other),
    *(_not_utf8, _wrong_type, _extension, _extra, _missing, _number, _number),
)
_OF_TEXT: tuple[Callable[[Any, Random], bytes], ...] = (_no_text, _cut_text, _long_text)

"""Malformed control messages; pure functions of a valid message and random draws.

Valid values are plain Python: lists and maps of MessagePack types, or a str for a control message that is bare text.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import msgpack
import numpy as np

from mast_zenoh.control import CONTROLS, results

Random = np.random.Generator

#: Size limit of payloads, bytes; enough for payloads that unpack to many times their size.
HEAVY_BYTES = 8 << 20

_INVALID = b"\xc1"  # the only first byte that MessagePack does not use
#: Headers of a list, map, text, bytes and extension that announce four billion items.
_OVERSIZED_HEADERS = (
    b"\xdd",
    b"\xdf",
    b"\xdb",
    b"\xc6",
    b"\xc9",
)
_BAD_INTS = (float("nan"), float("inf"), float("-inf"), -5, -(1 << 63), 1 << 62, 1 << 63, (1 << 64) - 1, True, "7", 1.5)
_BAD_FLOATS = (float("nan"), float("inf"), float("-inf"), 1 << 63, 1e300, True, "7")
_WRONG_MESSAGES: tuple[Any, ...] = (
    *(None, True, 7, -1, 1.5, float("nan"), "text", b"bytes"),
    *([], {}, [1], [[], []], {7: 1}, {"x": {}}, [None] * 9),
)


def pack(value: Any) -> bytes:
    """The bytes of a valid value."""
    return value.encode() if isinstance(value, str) else results.pack(value)


def malformed(value: Any, random: Random) -> bytes:
    """A short payload that the decoder of the valid `value` rejects."""
    makers = _TEXT_MAKERS if isinstance(value, str) else _PACKED_MAKERS
    return makers[int(random.integers(len(makers)))](value, random)


def heavy(value: Any, control: str) -> Iterator[bytes]:
    """Payloads that exhaust the memory of receivers that unpack them unchecked."""
    max_bytes = CONTROLS[control].max_bytes
    if max_bytes < HEAVY_BYTES:
        yield pack(value) + bytes(max_bytes)
    if not isinstance(value, str):
        size = min(max_bytes, HEAVY_BYTES) - (1 << 16)
        yield _lists(size)
        if control == "result":
            payload = b"\xdd" + size.to_bytes(4, "big") + b"\x90" * size
            for code in (1, 2):  # of results: an array, and a column of text
                yield results.pack(value | {"results": {"x": msgpack.ExtType(code, payload)}})


def flipped(value: Any, random: Random) -> bytes:
    """A valid message with some bits or bytes changed; it may still be valid."""
    payload = bytearray(pack(value))
    for _ in range(int(random.integers(1, 4))):
        index = int(random.integers(len(payload)))
        if random.integers(2):
            payload[index] ^= 1 << int(random.integers(8))
        else:
            payload[index : index + int(random.integers(3))] = random.bytes(int(random.integers(1, 4)))
    return bytes(payload)


def _lists(size: int) -> bytes:
    """About `size` bytes of empty lists, nested in lists of accepted length."""
    length = 1 << 15
    inner = b"\xdc" + length.to_bytes(2, "big") + b"\x90" * length
    count = max(1, size // len(inner))
    return b"\xdc" + count.to_bytes(2, "big") + inner * count


def _invalid_byte(value: Any, random: Random) -> bytes:
    return _INVALID + random.bytes(int(random.integers(64)))


def _truncated(value: Any, random: Random) -> bytes:
    payload = pack(value)
    return payload[: int(random.integers(len(payload)))]


def _trailing(value: Any, random: Random) -> bytes:
    return pack(value) + b"\x00" * int(random.integers(1, 9))


def _oversized_header(value: Any, random: Random) -> bytes:
    return _OVERSIZED_HEADERS[int(random.integers(len(_OVERSIZED_HEADERS)))] + b"\xff\xff\xff\xff" + random.bytes(8)


def _nested(value: Any, random: Random) -> bytes:
    depth = int(random.choice([3, 40, 511, 1023, 5000, 60000]))
    header = b"\x91" if random.integers(2) else b"\x81\xa0"
    return header * depth + b"\x90"


def _wrong_message(value: Any, random: Random) -> bytes:
    return bytes(msgpack.packb(_WRONG_MESSAGES[int(random.integers(len(_WRONG_MESSAGES)))]))


def _not_utf8(value: Any, random: Random) -> bytes:
    altered = _with_part(value, "\udcff\udcfe", random)
    return bytes(msgpack.packb(altered, default=results.encode_extension, unicode_errors="surrogateescape"))


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
    required = [name for name in value if name not in ("versions", "clock")]
    removed = required[int(random.integers(len(required)))]
    return results.pack({name: part for name, part in value.items() if name != removed})


def _number(value: Any, random: Random) -> bytes:
    """Replace a number by an invalid one; without numbers, use a wrong type."""
    numbers = list(_numbers(value))
    if not numbers:
        return _wrong_type(value, random)
    path, number = numbers[int(random.integers(len(numbers)))]
    replacements: Sequence[Any] = _BAD_INTS if isinstance(number, int) else _BAD_FLOATS
    return results.pack(_replaced(value, path, replacements[int(random.integers(len(replacements)))]))


def _numbers(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], int | float]]:
    """Path and value of every number whose range is checked."""
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in parts:
        if type(part) in (int, float):
            yield (*path, key), part
        elif key != "results":  # results may hold anything
            yield from _numbers(part, (*path, key))


def _replaced(value: Any, path: tuple[Any, ...], replacement: Any) -> Any:
    if not path:
        return replacement
    changed = dict(value) if isinstance(value, dict) else list(value)
    changed[path[0]] = _replaced(value[path[0]], path[1:], replacement)
    return changed


def _with_part(value: Any, part: Any, random: Random) -> Any:
    """A copy of a value with one top-level part replaced."""
    keys = list(value) if isinstance(value, dict) else list(range(len(value)))
    return _replaced(value, (keys[int(random.integers(len(keys)))],), part)


def _invalid_text(value: Any, random: Random) -> bytes:
    return pack(value) + bytes([int(random.integers(0x80, 0xC0))]) + random.bytes(int(random.integers(16)))


def _cut_text(value: Any, random: Random) -> bytes:
    return pack(value) + "€".encode()[: int(random.integers(1, 3))]


def _padded_text(value: Any, random: Random) -> bytes:
    return b"x" * (4 << 10) + pack(value) + b"x"


_PACKED_MAKERS: tuple[Callable[[Any, Random], bytes], ...] = (
    *(_invalid_byte, _truncated, _trailing, _oversized_header, _nested, _wrong_message),
    *(_not_utf8, _wrong_type, _extension, _extra, _missing, _number, _number),
)
_TEXT_MAKERS: tuple[Callable[[Any, Random], bytes], ...] = (_invalid_text, _cut_text, _padded_text)

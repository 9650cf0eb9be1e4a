"""Malformed messages, made from valid ones: cut, flipped, extended, and with wrong parts of every kind."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import msgpack
import numpy as np

from mast_zenoh.errors import MessageError

Random = np.random.Generator

_ANY = (
    *(None, True, False, 7, -1, 1.5, float("nan"), "", "text", "x" * 300, b"\xff", [], {}, [[[]]], {"a": 1}, {7: 1}),
    *([None] * 9, 1 << 63, -(1 << 63), *(msgpack.ExtType(code, b"\x91\x00") for code in (0, 1, 7, 127))),
)
_WRONG_INTS = (float("nan"), float("inf"), -5, 2, 1 << 31, 1 << 40, 1 << 62, (1 << 64) - 1)
_WRONG_FLOATS = (float("nan"), float("inf"), float("-inf"), 1e300)
#: Not UTF-8, too long, and types of columns that no message has.
_WRONG_TEXTS = (
    *("\udcff\udcfe", "x" * 5000, "a/**", "clock", "tracks"),
    *("<f4", ">f8", "|O", "|V8", "<M8[s]", "f8", "<f8,<f8", "S8"),
)
#: Beginnings of a list, map, text, bytes and extension that announce four billion items, and of unknown things.
_BEGINNINGS = (
    *(code + b"\xff\xff\xff\xff" for code in (b"\xdd", b"\xdf", b"\xdb", b"\xc6", b"\xc9")),
    b"\xc1",
    b"\xd4",
)
_NESTED = (b"\x91", b"\x81\xa1a", b"\x81\xa0", b"\xdd\x00\x00\x00\x01")


def refused(decode: Callable[[bytes], Any], payload: bytes) -> bool:
    """Whether a decoder refuses a payload; any error but MessageError fails."""
    try:
        decode(payload)
    except MessageError:
        return True
    return False


def flipped(payload: bytes, random: Random) -> bytes:
    """A message with some bits or bytes changed; it may still be valid."""
    damaged = bytearray(payload)
    for _ in range(int(random.integers(1, 4))):
        index = int(random.integers(min(len(damaged), 400)))
        if random.integers(2):
            damaged[index] ^= 1 << int(random.integers(8))
        else:
            damaged[index : index + int(random.integers(3))] = random.bytes(int(random.integers(1, 4)))
    return bytes(damaged) or b"\xc1"


def damaged(payload: bytes, random: Random) -> bytes:
    """A short payload made of a valid one by any kind of damage; it may still be valid."""
    return _MAKERS[int(random.integers(len(_MAKERS)))](payload, random)


def malformed(payload: bytes, decode: Callable[[bytes], Any], random: Random) -> bytes:
    """A short payload that the decoder of a valid one refuses."""
    while not refused(decode, made := damaged(payload, random)):
        pass
    return made


def malformed_payloads(valid: Sequence[bytes], decode: Callable[[bytes], Any], seed: Sequence[int]) -> Iterator[bytes]:
    """Payloads without end, no two the same, that a decoder refuses; made from valid ones."""
    random, earlier = np.random.default_rng(seed), set[bytes]()
    while True:
        payload = malformed(valid[int(random.integers(len(valid)))], decode, random)
        if payload not in earlier:
            earlier.add(payload)
            yield payload


def _pick(values: Sequence[Any], random: Random) -> Any:
    return values[int(random.integers(len(values)))]


def _noise(payload: bytes, random: Random) -> bytes:
    return random.bytes(int(random.integers(300)))


def _cut(payload: bytes, random: Random) -> bytes:
    return payload[: int(random.integers(len(payload)))]


def _extended(payload: bytes, random: Random) -> bytes:
    return payload + _pick(("€".encode()[:2], b"\x80\xff", bytes(1 << 12), random.bytes(9)), random)


def _announced(payload: bytes, random: Random) -> bytes:
    return _pick(_BEGINNINGS, random) + random.bytes(int(random.integers(20)))


def _nested(payload: bytes, random: Random) -> bytes:
    return _pick(_NESTED, random) * int(random.choice([3, 40, 511, 1023, 5000, 60000])) + b"\x90"


def _replaced(payload: bytes, random: Random) -> bytes:
    """A message with a part replaced; of text, another value."""
    try:
        value = msgpack.unpackb(payload, strict_map_key=False, ext_hook=msgpack.ExtType)
    except ValueError:
        value = payload.decode()
    return bytes(msgpack.packb(_with_wrong_part(value, random), unicode_errors="surrogateescape"))


def _with_wrong_part(value: Any, random: Random, path: Sequence[Any] | None = None) -> Any:
    """A value with one of all its parts replaced, however deep."""
    path = _pick(list(_paths(value)), random) if path is None else path
    if not path:
        return _pick(_alternatives(value, random) if random.integers(4) else _ANY, random)
    changed = value.copy()
    changed[path[0]] = _with_wrong_part(value[path[0]], random, path[1:])
    return changed


def _paths(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield path
    for key in value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ():
        yield from _paths(value[key], (*path, key))


def _alternatives(value: Any, random: Random) -> Sequence[Any]:
    """Wrong values of about the type of a valid one."""
    if isinstance(value, bool):
        return (int(value), None, str(value))
    if isinstance(value, int):
        return (*_WRONG_INTS, float(value), str(value), value + 1, -value - 1, bool(value))
    if isinstance(value, float):
        return (*_WRONG_FLOATS, 1 << 63, str(value))
    if isinstance(value, str):
        return (*_WRONG_TEXTS, value.encode(), value + " ", value.title())
    if isinstance(value, list):
        return ([*value, 7], [*value, 1], value[:-1], value[1:], value * 2, dict(enumerate(value)))
    if isinstance(value, dict):
        less = {key: part for key, part in value.items() if key != _pick([*value, None], random)}
        return (less, less, value | {"more": 7}, value | {7: 7}, value | {"more": ["<f8", [0], b""]}, list(value))
    if isinstance(value, bytes) and value:
        wrong = np.frombuffer(value[: len(value) // 8 * 8]).copy()
        wrong[: len(wrong) and int(random.integers(len(wrong))) + 1] = _pick((*_WRONG_FLOATS, -1e10), random)
        unusual = wrong.tobytes() + value[len(wrong) * 8 :]
        return (unusual, unusual, value[:-1], value * 2, bytes(len(value)), b"\xff" * len(value), [value], str(value))
    return _ANY


_MAKERS: tuple[Callable[[bytes, Random], bytes], ...] = (
    *(_noise, _cut, _extended, flipped, _announced, _nested),
    *[_replaced] * 12,
)

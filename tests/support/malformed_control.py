"""Bytes that are not a control message of some kind, made of one that is: random, cut off, damaged, forged."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import msgpack
import numpy as np

from mast_zenoh.control import CONTROLS
from mast_zenoh.errors import MessageError

Rng = np.random.Generator
Decoder = Callable[[bytes], Any]

_SCALARS = (
    *(None, True, False, 0, -1, 1.5, float("nan"), float("inf"), 1e300, 1 << 63, (1 << 64) - 1, -(1 << 63)),
    *("", "x" * 300, "../x", "a/**", "\0", b"", b"\xff", [], {}, [[]], {"a": 1}, {1: 2}, {b"a": 1}, [None] * 40),
    *(msgpack.ExtType(1, b""), msgpack.ExtType(5, b"x"), msgpack.Timestamp(1)),
)
_LENGTHS = (b"\xc6\xff\xff\xff\xff", b"\xdb\xff\xff\xff\xff", b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff")
_DEEP = (b"\x91" * 5000, b"\x81\xa1a" * 2000, b"\xdd\x00\x00\x00\x01" * 3000, b"\x91" * 600 + b"\x90")
_EXTENSIONS = (b"\xd4\x01\x00", b"\xc7\x04\xff\x00\x00\x00\x00", b"\xd6\xff\x00\x00\x00\x00", b"\xc1")
_LONGEST = 5 << 20  # of what is longer than its kind may be; larger kinds are not tried


def _pick(rng: Rng, values: Sequence[Any]) -> Any:
    return values[int(rng.integers(len(values)))]


def _noise(rng: Rng, sound: bytes) -> bytes:
    return rng.bytes(int(rng.integers(0, 300)))


def _cut(rng: Rng, sound: bytes) -> bytes:
    return sound[: int(rng.integers(len(sound)))]


def _more(rng: Rng, sound: bytes) -> bytes:
    return sound + rng.bytes(int(rng.integers(1, 9)))


def _flipped(rng: Rng, sound: bytes) -> bytes:
    damaged = bytearray(sound)
    for _ in range(int(rng.integers(1, 4))):
        damaged[int(rng.integers(len(sound)))] ^= 1 << int(rng.integers(8))
    return bytes(damaged)


def _bomb(rng: Rng, sound: bytes) -> bytes:
    return bytes(_pick(rng, [*_LENGTHS, *_DEEP, *_EXTENSIONS])) + rng.bytes(int(rng.integers(0, 20)))


def _not_text(rng: Rng, sound: bytes) -> bytes:
    at = int(rng.integers(len(sound) + 1))
    return sound[:at] + bytes([int(rng.integers(0x80, 0x100))]) + sound[at:]


def _changed(change: Callable[[Rng, Any], Any]) -> Callable[[Rng, bytes], bytes]:
    """A message one of whose parts, at any depth, is changed; bare bytes for one that is no map or list."""

    def make(rng: Rng, sound: bytes) -> bytes:
        try:
            value = msgpack.unpackb(sound, strict_map_key=False, ext_hook=msgpack.ExtType)
        except ValueError:  # bare text
            return _flipped(rng, sound)
        return bytes(msgpack.packb(_with_one(rng, value, change)))

    return make


def _with_one(rng: Rng, value: Any, change: Callable[[Rng, Any], Any]) -> Any:
    if rng.random() < 0.75:
        if isinstance(value, dict) and value:
            key = _pick(rng, sorted(value, key=str))
            return value | {key: _with_one(rng, value[key], change)}
        if isinstance(value, list) and value:
            at = int(rng.integers(len(value)))
            return [*value[:at], _with_one(rng, value[at], change), *value[at + 1 :]]
    return change(rng, value)


def _replaced(rng: Rng, value: Any) -> Any:
    return _pick(rng, _SCALARS)


def _without(rng: Rng, value: Any) -> Any:
    if isinstance(value, dict) and value:
        gone = _pick(rng, sorted(value, key=str))
        return {key: item for key, item in value.items() if key != gone}
    return value[:-1] if isinstance(value, (list, str, bytes)) and value else None


def _with_more(rng: Rng, value: Any) -> Any:
    if isinstance(value, dict):
        return value | {_pick(rng, ["more", "", 7, b"a", "do "]): _pick(rng, _SCALARS)}
    return [*value, _pick(rng, _SCALARS)] if isinstance(value, list) else [value]


def _nested(rng: Rng, value: Any) -> Any:
    for _ in range(int(rng.integers(1, 400))):
        value = [value]
    return value


_KINDS = (
    *(_noise, _cut, _more, _flipped, _bomb, _not_text),
    *map(_changed, (_replaced, _replaced, _replaced, _without, _with_more, _nested)),
)


def malformed(what: str, sound: bytes, decode: Decoder, seed: Sequence[int]) -> Iterator[bytes]:
    """Payloads without end, no two the same, that `decode` refuses; what: the kind, as in CONTROLS."""
    rng = np.random.default_rng(seed)
    seen: set[bytes] = set()
    most = CONTROLS[what].max_bytes
    if most <= _LONGEST:
        yield sound + bytes(most + 1 - len(sound))
    while True:
        for kind in _KINDS:
            payload = kind(rng, sound)
            if payload not in seen and refused(decode, payload):
                seen.add(payload)
                yield payload


def refused(decode: Decoder, payload: bytes) -> bool:
    """Whether it is none of the messages that a decoder takes."""
    try:
        decode(payload)
    except MessageError:
        return True
    return False

"""Malformed messages made from valid ones: random, cut, damaged, forged."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import msgpack
import numpy as np

from mast_zenoh.errors import MessageError
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import SCHEMAS

Rng = np.random.Generator
Fields = dict[str, Any]

_SCALARS = (None, True, False, -1, 1.5, float("nan"), 2**63, "", "x" * 300, b"\xff", [], {}, [[]], {"a": 1}, -(2**63))
_LENGTHS = (b"\xc6\xff\xff\xff\xff", b"\xdb\xff\xff\xff\xff", b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff")
_DEEP = (b"\x91" * 5000, b"\x81\xa1a" * 2000, b"\xdd\x00\x00\x00\x01" * 3000)
_EXTENSIONS = (b"\xd4\x01\x00", b"\xc7\x04\xff\x00\x00\x00\x00", b"\xd6\xff\x00\x00\x00\x00", b"\xc1")


def _pick(rng: Rng, values: Any) -> Any:
    return values[int(rng.integers(len(values)))]


def _noise(rng: Rng, sound: bytes, fields: Fields) -> bytes:
    return rng.bytes(int(rng.integers(0, 300)))


def _anything(rng: Rng, sound: bytes, fields: Fields) -> bytes:
    return msgpack.packb({key: _pick(rng, (*_SCALARS, fields[key])) for key in fields if rng.random() < 0.9})


def _cut(rng: Rng, sound: bytes, fields: Fields) -> bytes:
    return sound[: int(rng.integers(len(sound)))]


def _more(rng: Rng, sound: bytes, fields: Fields) -> bytes:
    return sound + rng.bytes(int(rng.integers(1, 9)))


def _flipped(rng: Rng, sound: bytes, fields: Fields) -> bytes:
    damaged = bytearray(sound)
    for _ in range(int(rng.integers(1, 4))):
        damaged[int(rng.integers(min(len(sound), 400)))] ^= 1 << int(rng.integers(8))
    return bytes(damaged)


def _header(rng: Rng, sound: bytes, fields: Fields) -> bytes:
    key = _pick(rng, ["schema", "version", "source", "frame", "time_ns", "seq", "body"])
    wrong = {"version": (0, 2, 1.0, True, "1", None, 2**40), "schema": (*_SCALARS, _pick(rng, sorted(SCHEMAS)))}
    return msgpack.packb(fields | {key: _pick(rng, wrong.get(key, _SCALARS))})


def _columns(rng: Rng, sound: bytes, fields: Fields) -> bytes:
    body = dict(fields["body"])
    if body and rng.random() < 0.5:
        del body[_pick(rng, sorted(body))]
    else:
        body[_pick(rng, ["more", "Position", "", "id "])] = ["<f8", [0], b""]
    return msgpack.packb(fields | {"body": body})


def _column(change: Callable[[Rng, list[Any]], Any]) -> Callable[[Rng, bytes, Fields], bytes]:
    """A message with one column changed."""

    def make(rng: Rng, sound: bytes, fields: Fields) -> bytes:
        body = dict(fields["body"])
        if not body:
            return _header(rng, sound, fields)
        name = _pick(rng, sorted(body))
        return msgpack.packb(fields | {"body": body | {name: change(rng, list(body[name]))}})

    return make


def _not_finite(rng: Rng, column: list[Any]) -> Any:
    if column[0] != "<f8" or not column[2]:
        return _shape(rng, column)
    values = np.frombuffer(column[2]).copy()
    values[int(rng.integers(len(values)))] = _pick(rng, [np.nan, np.inf, -np.inf, 1e300, -1e10])
    return [column[0], column[1], values.tobytes()]


def _shape(rng: Rng, column: list[Any]) -> Any:
    dtype, shape, data = column
    forged = [
        [*shape, 1],
        shape[1:],
        [size + 1 for size in shape],
        [-size - 1 for size in shape],
        [2**31, *shape[1:]],
        [2**62] * len(shape),
        [True] * len(shape),
        [float(size) for size in shape],
        [str(size) for size in shape],
        None,
    ]
    return [dtype, _pick(rng, forged), data]


def _dtype(rng: Rng, column: list[Any]) -> Any:
    return [_pick(rng, ["<f4", ">f8", "|O", "|V8", "<M8[s]", "f8", 8, None, "<f8,<f8", "S8"]), *column[1:]]


def _data(rng: Rng, column: list[Any]) -> Any:
    dtype, shape, data = column
    return [
        dtype,
        shape,
        _pick(rng, [None, 3, "", {}, [data], data[:-1] if data else b"\0", data + data + type(data)()]),
    ]


def _blank(rng: Rng, column: list[Any]) -> Any:
    dtype, shape, data = column
    return [dtype, shape, bytes([int(_pick(rng, [0, 255]))]) * len(data) if isinstance(data, bytes) else ["x" * 400]]


def _not_a_column(rng: Rng, column: list[Any]) -> Any:
    return _pick(rng, [*_SCALARS, column[:2], [*column, 0], dict(enumerate("abc"))])


def _bomb(rng: Rng, sound: bytes, fields: Fields) -> bytes:
    return _pick(rng, [*_LENGTHS, *_DEEP, *_EXTENSIONS]) + rng.bytes(int(rng.integers(0, 20)))


_KINDS = (
    _noise,
    _anything,
    _cut,
    _more,
    _flipped,
    _header,
    _columns,
    _column(_not_finite),
    _column(_shape),
    _column(_dtype),
    _column(_data),
    _column(_not_a_column),
    _column(_blank),
    _bomb,
)


def malformed(schema: str, sound: Sequence[bytes], count: int, seed: Sequence[int]) -> Iterator[bytes]:
    """`count` distinct payloads that are not valid messages of `schema`."""
    rng = np.random.default_rng(seed)
    unpacked = [msgpack.unpackb(payload) for payload in sound]
    seen: set[bytes] = set()
    for i in range(20 * count):
        which = int(rng.integers(len(sound)))
        payload = _KINDS[i % len(_KINDS)](rng, sound[which], unpacked[which])
        if payload in seen:
            continue
        try:
            codec.decode(payload, schema)
        except MessageError:
            seen.add(payload)
            yield payload
            if len(seen) == count:
                return
    raise AssertionError(f"{schema}: only {len(seen)} malformed payloads")

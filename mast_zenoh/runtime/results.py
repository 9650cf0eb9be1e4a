"""Results of nodes: on their way to the launcher, nested plain values and arrays as MessagePack; and what they say."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgpack
import numpy as np

_ARRAY = 1
_TEXTS = 2


def pack(value: Any) -> bytes:
    """The bytes of nested dicts, lists, numbers, strings and arrays (of numbers or of strings)."""
    packed: bytes = msgpack.packb(value, default=_encode)
    return packed


def unpack(payload: bytes) -> Any:
    """What `pack` packed."""
    return msgpack.unpackb(payload, ext_hook=_decode, strict_map_key=False)


def late(results: Mapping[str, Mapping[str, Any]]) -> dict[str, int]:
    """How many messages of each agent came after their batch had been emitted, by what the broker has handed in."""
    counts = [outcome["collation"]["late"] for outcome in results.values() if "collation" in outcome]
    return {agent: sum(count.get(agent, 0) for count in counts) for agent in sorted(set().union(*counts))}


def _encode(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        if value.dtype.kind in "OU":
            return msgpack.ExtType(_TEXTS, msgpack.packb([str(item) for item in value]))
        array = np.ascontiguousarray(value)
        return msgpack.ExtType(_ARRAY, msgpack.packb([array.dtype.str, list(array.shape), array.tobytes()]))
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a result holds a {type(value).__name__}, expected plain values and arrays")


def _decode(code: int, data: bytes) -> Any:
    if code == _TEXTS:
        return np.array(msgpack.unpackb(data), dtype=object)
    dtype, shape, raw = msgpack.unpackb(data)
    return np.frombuffer(raw, dtype=dtype).reshape(shape)

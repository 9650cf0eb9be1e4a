"""Results of nodes: on their way to the launcher, nested plain values and arrays as MessagePack; and what they say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgpack
import numpy as np

from mast_zenoh.resolved import NodeSpec

#: The node whose metrics and tables are those of the run: every scenario has one of this name.
EVALUATOR = "evaluator"

_ARRAY = 1
_TEXTS = 2
_PLAIN = (str, int, float, type(None), np.bool_, np.integer, np.floating, np.ndarray)


def pack(value: Any) -> bytes:
    """The bytes of nested dicts, lists, numbers, strings and arrays (of numbers or of strings)."""
    packed: bytes = msgpack.packb(value, default=_encode)
    return packed


def unpack(payload: bytes) -> Any:
    """What `pack` packed."""
    return msgpack.unpackb(payload, ext_hook=_decode, strict_map_key=False)


def checked(value: Any) -> dict[str, Any]:
    """What a node's `finish` has returned, None being nothing; raises TypeError for what cannot be handed in."""
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise TypeError(f"finish returned a {type(value).__name__}, expected a dict")
    _check(value, "results")
    return value


def collations(results: Mapping[str, Mapping[str, Any]], nodes: Mapping[str, NodeSpec]) -> list[dict[str, Any]]:
    """What the brokers have counted, as they returned it in `collation`: batches, messages left out, `late` by agent.

    Anything else in it is left out: a user's own broker may return what it likes.
    """
    brokers = [result for name, result in results.items() if name in nodes and nodes[name].role == "broker"]
    returned = [result["collation"] for result in brokers if isinstance(result.get("collation"), Mapping)]
    return [_counts(collation) | {"late": _counts(collation.get("late"))} for collation in returned]


def late(collations: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """How many messages of each agent came after their batch had been emitted, from what the brokers have counted."""
    counts = [collation["late"] for collation in collations]
    return {agent: sum(count.get(agent, 0) for count in counts) for agent in sorted(set().union(*counts))}


def _counts(value: object) -> dict[str, int]:
    return {str(name): n for name, n in value.items() if type(n) is int} if isinstance(value, Mapping) else {}


def _check(value: Any, path: str) -> None:
    if isinstance(value, dict):
        for key, item in value.items():
            if not isinstance(key, (str, int, float)):
                raise TypeError(f"{path}: found the key {key!r}, expected a string or a number")
            _check(item, f"{path}.{key}")
    elif isinstance(value, (list, tuple)):
        for index, item in enumerate(value):
            _check(item, f"{path}[{index}]")
    elif not isinstance(value, _PLAIN):
        raise TypeError(f"{path}: found a {type(value).__name__}, expected plain values and arrays")
    elif isinstance(value, int) and not -(1 << 63) <= value < 1 << 64:
        raise TypeError(f"{path}: found {value}, expected a number of at most 64 bits")
    elif isinstance(value, np.ndarray) and value.dtype.kind not in "biufOU":
        raise TypeError(f"{path}: found an array of {value.dtype}, expected numbers or text")
    elif isinstance(value, np.ndarray) and value.dtype.kind in "OU" and value.ndim != 1:
        raise TypeError(f"{path}: found {value.ndim}-dimensional text, expected one column")


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

"""Malformed control messages without end, made from a valid one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import msgpack
import numpy as np
from insider.malformed import flipped, malformed

from mast_zenoh.control import CONTROLS
from mast_zenoh.errors import MessageError

Decoder = Callable[[bytes], Any]

_MAX_OVERSIZED = 5 << 20  # bytes; kinds that may be larger are not tested with an oversized payload


def malformed_payloads(control: str, valid: bytes, decode: Decoder, seed: Sequence[int]) -> Iterator[bytes]:
    """Payloads without end, no two the same, that `decode` refuses.

    control: its kind, of CONTROLS
    """
    random = np.random.default_rng(seed)
    value = _plain(valid)
    earlier: set[bytes] = set()
    if (size := CONTROLS[control].max_bytes) <= _MAX_OVERSIZED:
        yield valid + bytes(size + 1 - len(valid))
    while True:
        payload = (malformed, flipped)[int(random.integers(2))](value, random)
        if payload not in earlier and refused(decode, payload):
            earlier.add(payload)
            yield payload


def refused(decode: Decoder, payload: bytes) -> bool:
    """Whether a decoder refuses a payload."""
    try:
        decode(payload)
    except MessageError:
        return True
    return False


def _plain(valid: bytes) -> Any:
    """The plain values of a valid message; a str for bare text."""
    try:
        return msgpack.unpackb(valid, strict_map_key=False, ext_hook=msgpack.ExtType)
    except ValueError:
        return valid.decode()

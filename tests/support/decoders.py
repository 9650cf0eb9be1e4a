"""Decoders of control messages by kind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mast_zenoh.control import failures, files, flow, interception, results
from mast_zenoh.errors import MessageError


def decoder(control: str, node: str, *, drives: bool = False) -> Callable[[bytes], Any]:
    """The decoder of messages of this kind from a node."""
    return {
        "counts": flow.decode_counts,
        "epoch": flow.decode_epoch,
        "failed": failures.decode_failure,
        "stop": flow.decode_stop,
        "leave": flow.decode_stop,
        "act": flow.decode_act,
        "result": lambda payload: results.decode_result(payload, node, drives=drives),
        "fetch": files.decode_fetch,
        "file": files.decode_file,
        "drain": flow.decode_drain,
        "rewire": flow.decode_rewire,
        "intercept": interception.sealed_parts,
    }[control]


def refused(control: str, node: str, payload: bytes) -> bool:
    """Whether the decoder refuses a payload; any error but MessageError fails."""
    try:
        decoder(control, node)(payload)
    except MessageError:
        return True
    return False

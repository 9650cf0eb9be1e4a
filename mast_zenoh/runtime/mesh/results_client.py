"""Hands in the results of a node to the launcher."""

from __future__ import annotations

import logging
import time

import zenoh

from mast_zenoh.control import files

_TIMEOUT_S = 20.0


def hand_in(session: zenoh.Session, prefix: str, name: str, payload: bytes, log: logging.Logger) -> None:
    """Send results until the launcher accepts or refuses them, or a timeout."""
    deadline = time.monotonic() + _TIMEOUT_S
    while time.monotonic() < deadline:
        for reply in session.get(f"{prefix}/@control/result/{name}", payload=payload, timeout=5.0):
            if reply.ok is not None:
                return
            if reply.err is not None and (refusal := files.decode_refusal(reply.err.payload.to_bytes())):
                log.error("the launcher refuses the results: %s", refusal)
                return
    log.error("the launcher has not acknowledged the results within %.0f s", _TIMEOUT_S)

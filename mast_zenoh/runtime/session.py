"""Zenoh sessions as this testbed opens them: everything explicit, nothing discovered."""

from __future__ import annotations

import json
from typing import Any

import zenoh

#: Off, because it finds meshes that nobody meant: multicast and gossip. Off, because it goes around network shaping
#: and TLS: shared memory (on by default from 3 KiB up). Off, because nobody needs it: a stamp by every router.
_ALWAYS: dict[str, Any] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "scouting/delay": 0,
    "transport/shared_memory/enabled": False,
    "transport/link/tx/lease": 2000,
    "timestamping/enabled": False,
}

_CLIENT: dict[str, Any] = {
    "mode": "client",
    "connect/timeout_ms": -1,
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 400, "period_increase_factor": 2},
}


def _open(settings: dict[str, Any]) -> zenoh.Session:
    config = zenoh.Config()
    for path, value in (_ALWAYS | settings).items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)


def open_router(listen: str = "tcp/127.0.0.1:0") -> tuple[zenoh.Session, str]:
    """(session, endpoint) of a router in this process; port 0 is a free one, and the endpoint says which."""
    session = _open({"mode": "router", "listen/endpoints": [listen], "adminspace/enabled": True})
    zid = session.info.zid()
    for reply in session.get(f"@/{zid}/router", timeout=5.0):
        if reply.ok is not None:
            locators = json.loads(reply.ok.payload.to_string())["locators"]
            return session, str(locators[0])
    session.close()
    raise OSError(f"the router at {listen} does not say where it listens")


def open_client(endpoint: str) -> zenoh.Session:
    """A client of the router at `endpoint`; it retries until the router is there."""
    return _open(_CLIENT | {"connect/endpoints": [endpoint]})

"""Zenoh sessions as this testbed opens them: everything explicit, nothing discovered."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import socket
import stat
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import zenoh

from mast_zenoh.errors import CredentialsError
from mast_zenoh.security import explain
from mast_zenoh.security.credentials import UNREACHED, Credentials
from mast_zenoh.security.levels import client_settings

log = logging.getLogger("mast")

_WAIT_BEFORE_DROP = "transport/link/tx/queue/congestion_control/drop/wait_before_drop"

#: Off, because it finds meshes that nobody meant: multicast and gossip. Off, because it goes around network shaping
#: and TLS: shared memory (on by default from 3 KiB up). Off, because nobody needs it: a stamp by every router.
#: Of what may be dropped (real time) nothing is, as long as everybody reads, however busy the machine: room for 16
#: batches and 1 s (µs here); with Zenoh's 2 batches and 1 ms about 5 % were lost on a machine with nothing else to do.
_ALWAYS: dict[str, Any] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "scouting/delay": 0,
    "transport/shared_memory/enabled": False,
    "transport/link/tx/lease": 2000,
    "timestamping/enabled": False,
    "transport/link/tx/queue/size/data": 16,
    _WAIT_BEFORE_DROP: 1_000_000,
}

#: ms, the lease in lock-step on one machine. A node that a debugger, a full memory or a closed lid holds up is waited
#: for; that a process has ended shows at once, by its sockets.
_PATIENT_LEASE_MS = 3_600_000

#: The same for a link on which nothing more fits: Zenoh gives up one on which a message has waited for 5 s (µs here).
_PATIENT: dict[str, Any] = {
    "transport/link/tx/lease": _PATIENT_LEASE_MS,
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 1000 * _PATIENT_LEASE_MS,
}

#: ms, the same for a router whose links may be cut: while it waits for one that nothing reaches, the others wait too.
CUT_LINKS_WAIT_MS = 50

#: A link that does not acknowledge for so long ends: less than the lease, see `_end_silent_links`.
_SILENCE_MS = 1500

_CLIENT: dict[str, Any] = {
    "mode": "client",
    "connect/timeout_ms": -1,
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 400, "period_increase_factor": 2},
}

#: How long a client with credentials tries before it asks itself why it does not get in.
_ASK_WHY_MS = 5000


def open_session(settings: Mapping[str, Any]) -> zenoh.Session:
    """A session with these settings (path to value) over those that all of ours have; raises zenoh.ZError."""
    config = zenoh.Config()
    for path, value in {**_ALWAYS, **settings}.items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)


def open_router(
    listen: str = "tcp/127.0.0.1:0",
    *more: str,
    security: Mapping[str, Any] | None = None,
    links_may_be_cut: bool = False,
    patient: bool = False,
) -> tuple[zenoh.Session, str]:
    """(session, endpoint) of a router in this process; port 0 is a free one, and the endpoint says which.

    security: its settings as `security.levels.router_settings` makes them; none: an open mesh
    patient: clients that say nothing for long are waited for
    """
    settings: dict[str, Any] = {"mode": "router", "listen/endpoints": [listen, *more], "adminspace/enabled": True}
    if links_may_be_cut:
        settings[_WAIT_BEFORE_DROP] = 1000 * CUT_LINKS_WAIT_MS
    if patient:
        settings |= _PATIENT
    session = open_session({**settings, **(security or {})})
    zid = session.info.zid()
    for reply in session.get(f"@/{zid}/router", timeout=5.0):
        if reply.ok is not None:
            locators = json.loads(reply.ok.payload.to_string())["locators"]
            if not patient:
                _end_silent_links(locators)
            return session, str(locators[0])
    session.close()
    raise OSError(f"the router at {listen} does not say where it listens")


def _end_silent_links(locators: Sequence[str]) -> None:
    """Have the kernel end links of this process's router whose other end acknowledges nothing, before the lease does.

    Zenoh gives its sockets SO_LINGER: to close one with bytes that nobody acknowledges blocks a thread of the router
    for up to 10 s, and with it other clients (eclipse-zenoh/zenoh#1101). A socket that has timed out closes at once.
    What is accepted inherits TCP_USER_TIMEOUT from the listening socket.
    """
    ports = {int(locator.rpartition(":")[2]) for locator in locators if locator.startswith(("tcp/", "tls/"))}
    for name in os.listdir("/proc/self/fd") if sys.platform == "linux" else ():
        with contextlib.suppress(OSError):
            if not stat.S_ISSOCK(os.fstat(int(name)).st_mode):
                continue
            with socket.socket(fileno=os.dup(int(name))) as ours:
                listens = ours.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN)
                if listens and ours.family != socket.AF_UNIX and ours.getsockname()[1] in ports:
                    ours.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _SILENCE_MS)


def open_client(
    endpoint: str, credentials: Credentials | None = None, *, try_ms: int | None = None, patient: bool = False
) -> zenoh.Session:
    """A client of the router at `endpoint`; it retries until the router is there and answers.

    With credentials it raises CredentialsError, which says why, when they are refused, or the router's are. What only
    time can help is logged: no router yet, or one that answers nothing, as it does while others flood it.

    try_ms: try once, for so long, and raise zenoh.ZError
    patient: the router is to wait for it, however long it says nothing
    """
    settings = _CLIENT | {"connect/endpoints": [endpoint]}
    if patient:
        settings |= _PATIENT
    if try_ms is not None:
        settings |= {"connect/timeout_ms": try_ms} | (client_settings(credentials) if credentials else {})
        return open_session(settings)
    if credentials is None:
        return open_session(settings)
    settings |= client_settings(credentials) | {"connect/timeout_ms": _ASK_WHY_MS}
    logged = ""
    while True:
        try:
            return open_session(settings)
        except zenoh.ZError:
            reasons = explain(credentials, endpoint)
        why = "; ".join(reasons) or f"{endpoint}: no connection within {_ASK_WHY_MS / 1000:g} s, and no reason for it"
        if any(UNREACHED not in reason for reason in reasons):
            raise CredentialsError(why)
        if why != logged:
            log.warning("%s; trying again", why)
            logged = why

"""Zenoh sessions with this testbed's settings: explicit endpoints, no discovery."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import random
import socket
import stat
import sys
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any

import zenoh

from mast_zenoh.errors import CredentialsError, NotRunning
from mast_zenoh.mesh.security import explain
from mast_zenoh.mesh.security.credentials import UNREACHED, Credentials
from mast_zenoh.mesh.security.levels import client_settings

log = logging.getLogger("mast")

_WAIT_BEFORE_DROP = "transport/link/tx/queue/congestion_control/drop/wait_before_drop"

#: Multicast and gossip are off because they find unrelated meshes; shared memory (default from 3 KiB up), because
#: it bypasses network shaping and TLS; timestamps of routers, because they are not used.
#: Queues of 16 batches, and 1 s (µs here) before a message is dropped in real time: nothing is lost on a busy machine
#: while all processes read. With Zenoh's 2 batches and 1 ms about 5 % were lost on an idle machine.
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

#: The lease in lock-step on one machine, ms: a node stopped by a debugger, full memory or suspend is waited for.
#: The end of a process is noticed immediately, by its sockets.
_PATIENT_LEASE_MS = 3_600_000

#: The same for a blocked link (µs here): by default, Zenoh closes one on which a message has waited for 5 s.
_PATIENT: dict[str, Any] = {
    "transport/link/tx/lease": _PATIENT_LEASE_MS,
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 1000 * _PATIENT_LEASE_MS,
}

#: Ids of sessions that only observe. Routers drop what such a session does not take in time. What a node does not take
#: blocks in lock-step, with all threads of the router, as the driver counts on every message to arrive.
OBSERVERS = tuple(f"feed0b5e{number:02x}" for number in range(64))

#: Rewrites messages to observers when they leave a router; other links have no such step, so it costs them nothing.
_DROP_FOR_OBSERVERS: dict[str, Any] = {
    "qos/network": [
        {
            "zids": OBSERVERS,
            "messages": ["put", "delete", "query"],
            "flows": ["egress"],
            "overwrite": {"congestion_control": "drop"},
        }
    ]
}

#: Time before a patient router drops a message, ms: all others wait for it, once each time an observer falls behind.
_PATIENT_DROP_MS = 50

#: How long an observer tries to connect, s, and with one id, ms: another observer may have it.
_OBSERVER_S, _OBSERVER_TRY_MS = 10.0, 3000

#: Time before a router whose links may be cut drops a message, ms: an unreachable link delays all others.
CUT_LINKS_WAIT_MS = 50

#: Time without acknowledgements after which a link ends, ms: less than the lease, see `_end_silent_links`.
_SILENCE_MS = 1500

_CLIENT: dict[str, Any] = {
    "mode": "client",
    "connect/timeout_ms": -1,
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 400, "period_increase_factor": 2},
}

#: How long a client with credentials tries to connect before it looks for a reason, ms.
_DIAGNOSE_MS = 5000


def open_session(settings: Mapping[str, Any]) -> zenoh.Session:
    """Open a session with these settings (path to value) and the common ones.

    Raises zenoh.ZError if it cannot be opened.
    """
    config = zenoh.Config()
    for path, value in {**_ALWAYS, **settings}.items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)


def open_router(
    listen: str = "tcp/127.0.0.1:0",
    *more_endpoints: str,
    security: Mapping[str, Any] | None = None,
    links_may_be_cut: bool = False,
    patient: bool = False,
) -> tuple[zenoh.Session, str]:
    """Open a router in this process; returns (session, endpoint).

    listen: endpoint; with port 0 a free port is chosen, which the returned endpoint contains
    security: settings from `security.levels.router_settings`; None: an open mesh
    patient: wait for clients that do not respond
    """
    settings: dict[str, Any] = {
        "mode": "router",
        "listen/endpoints": [listen, *more_endpoints],
        "adminspace/enabled": True,
        **_DROP_FOR_OBSERVERS,
    }
    if links_may_be_cut:
        settings[_WAIT_BEFORE_DROP] = 1000 * CUT_LINKS_WAIT_MS
    if patient:
        settings |= {**_PATIENT, _WAIT_BEFORE_DROP: 1000 * _PATIENT_DROP_MS}
    session = open_session({**settings, **(security or {})})
    zid = session.info.zid()
    for reply in session.get(f"@/{zid}/router", timeout=5.0):
        if reply.ok is not None:
            locators = json.loads(reply.ok.payload.to_string())["locators"]
            if not patient:
                _end_silent_links(locators)
            return session, str(locators[0])
    session.close()
    raise OSError(f"the router at {listen} does not report its endpoint")


def _end_silent_links(locators: Sequence[str]) -> None:
    """Have the kernel end this router's links that acknowledge nothing.

    Zenoh's sockets have SO_LINGER: closing one with unacknowledged bytes blocks a thread of the router for up to 10 s,
    and with it other clients (eclipse-zenoh/zenoh#1101). A socket that has timed out closes immediately. Accepted
    sockets inherit TCP_USER_TIMEOUT from the listening socket.
    """
    ports = {int(locator.rpartition(":")[2]) for locator in locators if locator.startswith(("tcp/", "tls/"))}
    for own in own_sockets(ports):
        if own.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
            own.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _SILENCE_MS)


def own_sockets(ports: Collection[int]) -> Iterator[socket.socket]:
    """The TCP sockets of this process on these local ports, among them those that Zenoh has opened; on Linux only.

    They are copies, closed when the next one is asked for. One that ends meanwhile is left out.
    """
    for name in os.listdir("/proc/self/fd") if sys.platform == "linux" else ():
        with contextlib.suppress(OSError):
            if not stat.S_ISSOCK(os.fstat(int(name)).st_mode):
                continue
            with socket.socket(fileno=os.dup(int(name))) as own:
                if own.family != socket.AF_UNIX and own.getsockname()[1] in ports:
                    yield own


def direct(call: Callable[..., object], ended: Callable[[], object] | None = None) -> Any:
    """A handler of Zenoh that calls in Zenoh's own threads. ended: called after the last time"""
    return zenoh.handlers.Callback(call, ended, indirect=False)


def open_client(
    endpoint: str,
    credentials: Credentials | None = None,
    *,
    try_ms: int | None = None,
    patient: bool = False,
    zid: str | None = None,
) -> zenoh.Session:
    """Open a client session with the router at `endpoint`; retries until it answers.

    try_ms: try only once, for this time, and raise zenoh.ZError
    patient: have the router wait for this client when it does not respond
    zid: the session's Zenoh id, lower-case hexadecimal; None: a random one

    With credentials it raises CredentialsError, with the reason, if a side refuses the other's. Temporary problems are
    logged: no router yet, or one that does not answer, such as one flooded by others.
    """
    settings = _CLIENT | {"connect/endpoints": [endpoint]}
    if patient:
        settings |= _PATIENT
    if zid is not None:
        settings |= {"id": zid}
    if try_ms is not None:
        settings |= {"connect/timeout_ms": try_ms} | (client_settings(credentials) if credentials else {})
        return open_session(settings)
    if credentials is None:
        return open_session(settings)
    settings |= client_settings(credentials) | {"connect/timeout_ms": _DIAGNOSE_MS}
    logged = ""
    while True:
        try:
            return open_session(settings)
        except zenoh.ZError:
            reasons = explain(credentials, endpoint)
        problem = (
            "; ".join(reasons) or f"{endpoint}: no connection within {_DIAGNOSE_MS / 1000:g} s, for no known reason"
        )
        if any(UNREACHED not in reason for reason in reasons):
            raise CredentialsError(problem)
        if problem != logged:
            log.warning("%s; trying again", problem)
            logged = problem


def open_observer(endpoint: str, credentials: Credentials | None = None) -> zenoh.Session:
    """Open a session that only observes: routers of this testbed drop what it does not take, and never wait for it.

    Raises NotRunning if no router answers in time, CredentialsError if one of the sides refuses the other's.
    """
    deadline = time.monotonic() + _OBSERVER_S
    settings = _CLIENT | _PATIENT | {"connect/endpoints": [endpoint], "connect/timeout_ms": _OBSERVER_TRY_MS}
    settings |= client_settings(credentials) if credentials else {}
    while True:
        try:
            return open_session(settings | {"id": random.choice(OBSERVERS)})
        except zenoh.ZError:
            reasons = explain(credentials, endpoint) if credentials else []
        if any(UNREACHED not in reason for reason in reasons):
            raise CredentialsError("; ".join(reasons))
        if time.monotonic() > deadline:
            raise NotRunning(
                f"{endpoint}: something listens there, but no Zenoh router answered within {_OBSERVER_S:g} s: expected "
                "the router of a running run"
            )

"""A run that plays while attackers act: their access to it, and its outcome."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import zenoh

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.control import failures, prefix
from mast_zenoh.control.failures import described
from mast_zenoh.errors import ConfigurationError, HandlerFailed, Interrupted, MastError, RunError, nearest
from mast_zenoh.launch import run
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import SCHEMAS, Header, Message, text
from mast_zenoh.runtime.mesh.session import open_session
from mast_zenoh.security.authority import Authority
from mast_zenoh.security.credentials import Credentials
from mast_zenoh.security.levels import client_settings, endpoint
from mast_zenoh.wiring.model import Wiring

#: Values of an attempt's `shows`, besides names of nodes: the credentials that an outsider presents.
NOTHING, FOREIGN, EXPIRED = "nothing", "foreign", "expired"

OUTSIDER = "outsider"

_JOIN_MS = 1500
_START_S = 60.0
_END_S = 30.0
_POLL_S = 0.02
_CONNECT_S = 2.0


class AttackedRun:
    """A context manager for a run with attackers.

    On entry the run has played its first frames; on exit it has ended.

    resolved: the run; level: security level of its mesh; folder: its run folder
    detoured: nodes whose connection to the router passes through the outsider
    """

    def __init__(self, resolved: Resolved, folder: Path, level: str, detoured: Collection[str] = ()) -> None:
        self.level = level
        self.wiring = Wiring.from_json(resolved.wiring)
        self.detours: dict[str, Detour] = {}
        self.crash = ""  # the exception that ended the launcher, if any
        self._resolved = resolved
        self._folder = folder
        self._detoured = detoured
        self._context: RunContext | None = None
        self._ended: run.EndedRun | None = None
        self._thread = threading.Thread(target=self._play, name="attacked-run")
        self._resources = ExitStack()
        self._foreign: Authority | None = None

    def __enter__(self) -> AttackedRun:
        for node in self._detoured:
            self.detours[node] = self._resources.enter_context(closing(Detour(lambda: _port(self.endpoint))))
        self._thread.start()
        try:
            self.wait(lambda: self.frame >= 1, _START_S, "the run has begun")
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        self._resources.close()

    # -- knowledge and credentials of the outsider -----------------------------------------------------------------

    @property
    def frame(self) -> int:
        """The newest frame that has begun; -1 before the first."""
        return -1 if self._context is None else self._context.frame

    @property
    def period_ns(self) -> int:
        """ns of scene time from one frame to the next."""
        return self._resolved.period_ns

    @property
    def endpoint(self) -> str:
        """The router's endpoint.

        Addresses, the authority's certificate and the run's id are public.
        """
        return str(self._joined.record["endpoint"])

    @property
    def prefix(self) -> str:
        """The prefix of all keys of the run."""
        return prefix(self._joined.run_id)

    def credentials(self, shows: str) -> Credentials | None:
        """The credentials that an outsider presents; None on an open mesh.

        shows: NOTHING, FOREIGN (issued by the outsider's own authority), EXPIRED, or a node whose files it has stolen
        """
        deployment = self._mesh.deployment
        if deployment is None or deployment.authority is None:
            return None
        public = Credentials(deployment.authority.pem)
        if shows == NOTHING:
            return public
        if shows == FOREIGN:
            issued = self.foreign.issue("infra_1")
            return Credentials(public.authority, issued.certificate, issued.key)
        if shows == EXPIRED:
            now = datetime.now(UTC)
            return deployment.authority.issue("infra_1", begins=now - timedelta(hours=2), ends=now - timedelta(hours=1))
        credential_files = deployment.of(self.require_node(shows))
        assert credential_files is not None
        return Credentials.read(credential_files)

    @property
    def foreign(self) -> Authority:
        """The outsider's own authority, for certificates that imitate the real ones."""
        if self._foreign is None:
            self._foreign = Authority(self._joined.run_id)
        return self._foreign

    def join(self, shows: str, zid: str | None = None) -> zenoh.Session:
        """Open a session, with a Zenoh id if given; raises zenoh.ZError if refused."""
        credentials = self.credentials(shows)
        settings = {
            "mode": "client",
            "connect/endpoints": [self.endpoint],
            "connect/timeout_ms": _JOIN_MS,
            **({} if credentials is None else client_settings(credentials)),
            **({} if zid is None else {"id": zid}),
        }
        return open_session(settings)

    def zid(self, node: str) -> str:
        """The Zenoh id of a node's session, which any client of an open mesh can query."""
        session = self._mesh.session
        key = f"@/{session.info.zid()}/router/token/{self.prefix}/alive/{self.require_node(node)}"
        for reply in session.get(key, timeout=5.0):
            if reply.ok is not None:
                return str(json.loads(reply.ok.payload.to_bytes())["clients"][0])
        raise RunError(f"the router knows no session of {node}")

    def forged_message(self, key: str) -> bytes:
        """An empty message for the wire of this key, with OUTSIDER as its source.

        A host that receives it therefore rejects and counts it.
        """
        schema = SCHEMAS[self._leg(key)[0].message]
        sizes = [[0 if isinstance(size, str) else size for size in column.shape] for column in schema.columns]
        body = {
            column.name: text([]) if column.dtype == "str" else np.zeros(size, column.dtype)
            for column, size in zip(schema.columns, sizes, strict=True)
        }
        return codec.encode(Message(Header(schema.name, OUTSIDER, self.frame, 0, 0), body))

    def subscriber_count(self, key: str) -> int:
        """The number of nodes that receive messages on this key."""
        wire, leg = self._leg(key)
        return len(wire.receivers(leg)) + len(self.wiring.overhearers)

    def require_node(self, node: str) -> str:
        """The name of a node of the run; raises ConfigurationError."""
        if node not in self._resolved.nodes:
            raise ConfigurationError(f"outsider: no node {node!r}{nearest(node, self._resolved.nodes)}")
        return node

    @property
    def _joined(self) -> RunContext:
        assert self._context is not None
        return self._context

    @property
    def _mesh(self) -> Mesh:
        assert self._joined.mesh is not None
        return self._joined.mesh

    def _leg(self, key: str) -> tuple[Any, Any]:
        for wire, leg in self.wiring.legs():
            if leg.key == key:
                return wire, leg
        raise ConfigurationError(f"outsider: no wire has the key {key!r}{nearest(key, self.wiring.keys())}")

    # -- progress and outcome of the run ---------------------------------------------------------------------------

    def wait(self, condition: Callable[[], Any], seconds: float, description: str = "") -> bool:
        """Wait for a condition while the run plays; False after a timeout of `seconds`.

        description: if given, a timeout raises RunError with it. Raises RunError if the run has ended.
        """
        pause, deadline = threading.Event(), time.monotonic() + seconds
        while not condition():
            if not self._thread.is_alive():
                error = self.crash or (self._ended and self._ended.error)
                raise RunError(f"the run ended before the attackers had finished: {error or 'all frames are played'}")
            if time.monotonic() > deadline:
                if description:
                    raise RunError(f"timed out after {seconds:.0f} s, waiting until {description}")
                return False
            pause.wait(_POLL_S)
        return True

    def wait_until_ended(self, seconds: float) -> run.EndedRun | None:
        """Wait for the run to end by itself; its outcome, or None after `seconds`."""
        self._thread.join(seconds)
        return self._ended

    def stop(self) -> run.EndedRun | None:
        """Stop the run if it is still playing; its outcome."""
        if self._thread.is_alive() and self._context is not None:
            self._context.interrupt()
        self._thread.join(_END_S)
        return self._ended

    def foreign_messages(self) -> dict[str, dict[str, int]]:
        """Stop the run; returns counts of foreign messages by node and key.

        Foreign messages come from outside the run and reached the node's host.
        """
        finished = self.stop()
        if finished is None or (finished.error is not None and not isinstance(finished.error, Interrupted)):
            raise RunError(
                f"the attacked run failed: {finished.error if finished else self.crash or 'it did not stop'}"
            )
        if finished.failures:
            raise HandlerFailed(failures.summary(finished.failures, finished.logs))
        counts: dict[str, dict[str, int]] = {}
        for name, node in finished.record["nodes"].items():
            if node["foreign"] is None:
                raise RunError(f"{name} reported no results: {node['ended']}")
            counts[name] = node["foreign"]
        return counts

    def _play(self) -> None:
        def prepare(context: RunContext) -> None:
            context.detours |= {
                node: endpoint(self.level, f"tcp/127.0.0.1:{detour.port}") for node, detour in self.detours.items()
            }
            self._context = context

        try:
            self._ended = run.run(self._resolved, self._folder, secure=self.level, prepare=prepare)
        except Exception as error:  # a defect that the attackers may have triggered
            self.crash = described(error)


@contextmanager
def attacker_errors(name: str, call: Callable[..., Any]) -> Iterator[None]:
    """Turn errors in `call`, an attacker's code, into HandlerFailed with the line."""
    try:
        yield
    except (MastError, zenoh.ZError):
        raise
    except Exception as error:
        where = failures.location(error, call)
        raise HandlerFailed(f"the attacker {name!r} failed: {described(error)} ({where})") from error


def _port(address: str) -> int:
    return int(address.rpartition(":")[2])


class Detour:
    """Relays connections byte for byte to the port that `target` returns, until redirected.

    It models redirection in a real network (a forged ARP or DNS reply, a NAT rule), and needs no privileges.

    target: returns the local port to connect to; called for each connection
    """

    def __init__(self, target: Callable[[], int]) -> None:
        self._target = target
        self._override_port: int | None = None
        self._open: set[socket.socket] = set()
        self._lock = threading.Lock()
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self._threads = [threading.Thread(target=self._accept, name="detour")]
        self._threads[0].start()

    def redirect(self, port: int | None) -> None:
        """Close all connections, and relay new ones to a port; None: the original target."""
        self._override_port = port
        self._disconnect()

    def close(self) -> None:
        """Close all connections and stop."""
        with suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)  # wakes the accepting thread; closing alone does not
        self._server.close()
        self._disconnect()
        for thread in self._threads:
            thread.join()

    def _disconnect(self) -> None:
        with self._lock:
            _shut_down(*self._open)

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._server.accept()
            except OSError:
                return
            try:
                port = self._target() if self._override_port is None else self._override_port
                far = socket.create_connection(("127.0.0.1", port), _CONNECT_S)
            except OSError:
                near.close()
                continue
            far.settimeout(None)
            with self._lock:
                self._open |= {near, far}
            self._threads.append(threading.Thread(target=self._relay, args=(near, far), name="detour"))
            self._threads[-1].start()

    def _relay(self, near: socket.socket, far: socket.socket) -> None:
        """Relay a connection; when one direction ends, so does the other."""

        def copy(source: socket.socket, target: socket.socket) -> None:
            source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with suppress(OSError):
                while data := source.recv(65536):
                    target.sendall(data)
            _shut_down(near, far)

        back = threading.Thread(target=copy, args=(far, near), name="detour")
        back.start()
        copy(near, far)
        back.join()
        with self._lock:
            self._open -= {near, far}
        near.close()
        far.close()


def _shut_down(*ends: socket.socket) -> None:
    for end in ends:
        with suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)

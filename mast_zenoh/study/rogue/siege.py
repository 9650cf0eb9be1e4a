"""A run that goes on while an outsider tries to get at it: what the outsider is given, and what the run says after."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import zenoh
from rich.console import Console

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.control import failures
from mast_zenoh.control.failures import described
from mast_zenoh.errors import ConfigurationError, HandlerFailed, Interrupted, MastError, RunError, nearest
from mast_zenoh.launch import run
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.launch.engine import Engine
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import SCHEMAS, Header, Message, text
from mast_zenoh.runtime.mesh.node import prefix
from mast_zenoh.runtime.mesh.session import open_session
from mast_zenoh.security.authority import Authority
from mast_zenoh.security.credentials import Credentials
from mast_zenoh.security.levels import client_settings, endpoint
from mast_zenoh.study.rogue.detour import Detour
from mast_zenoh.wiring.model import Wiring

#: What an outsider may show besides the certificate of a node: `shows` of an attempt.
NOTHING, FOREIGN, EXPIRED = "nothing", "foreign", "expired"

OUTSIDER = "outsider"

_JOIN_MS = 1500
_START_S = 60.0
_END_S = 30.0
_POLL_S = 0.02


class Siege:
    """A context: entered, the run has played its first frames; left, it has ended.

    resolved: the run; level: of its mesh; folder: of its results
    detoured: nodes whose way to the router leads past the outsider
    engine, console: as for `launch.run`
    """

    def __init__(
        self,
        resolved: Resolved,
        folder: Path,
        level: str,
        detoured: Collection[str] = (),
        *,
        engine: Engine | None = None,
        console: Console | None = None,
    ) -> None:
        self.level = level
        self.wiring = Wiring.from_json(resolved.wiring)
        self.detours: dict[str, Detour] = {}
        self.crash = ""  # the exception with which the launcher has ended, if it has
        self._resolved = resolved
        self._folder = folder
        self._detoured = detoured
        self._engine = engine
        self._console = console
        self._context: RunContext | None = None
        self._ended: run.Run | None = None
        self._thread = threading.Thread(target=self._play, name="siege")
        self._resources = ExitStack()
        self._foreign: Authority | None = None

    def __enter__(self) -> Siege:
        for node in self._detoured:
            self.detours[node] = self._resources.enter_context(Detour(lambda: _port(self.endpoint)))
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
        self.end()
        self._resources.close()

    # -- what the outsider knows and has -------------------------------------------------------------------------

    @property
    def frame(self) -> int:
        """The newest frame that has begun; -1 before the first."""
        return -1 if self._context is None else self._context.frame

    @property
    def endpoint(self) -> str:
        """Of the router. Addresses and the authority's certificate are public; so is the run's id on a wire."""
        return str(self._joined.record["endpoint"])

    @property
    def prefix(self) -> str:
        """Of all keys of the run."""
        return prefix(self._joined.run_id)

    def credentials(self, shows: str) -> Credentials | None:
        """What an outsider has who shows this; None on an open mesh, where there is nothing to show.

        shows: NOTHING, FOREIGN (certified by an authority of his own), EXPIRED, or a node whose files he has
        """
        deployment = self._mesh.deployment
        if deployment is None or deployment.authority is None:
            return None
        public = Credentials(deployment.authority.pem)
        if shows == NOTHING:
            return public
        if shows == FOREIGN:
            theirs = self.foreign.issue("infra_1")
            return Credentials(public.authority, theirs.certificate, theirs.key)
        if shows == EXPIRED:
            now = datetime.now(UTC)
            return deployment.authority.issue("infra_1", begins=now - timedelta(hours=2), ends=now - timedelta(hours=1))
        stolen = deployment.of(self.known(shows))
        assert stolen is not None
        return Credentials.read(stolen)

    @property
    def foreign(self) -> Authority:
        """An authority of the outsider's own, which says of its certificates what the real one would."""
        if self._foreign is None:
            self._foreign = Authority(self._joined.run_id)
        return self._foreign

    def join(self, shows: str, zid: str | None = None) -> zenoh.Session:
        """A session on the run's mesh; raises zenoh.ZError when it is refused. zid: Zenoh's id of the session."""
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
        """The Zenoh id of a node's session. On an open mesh everybody may ask for it; here the router itself does."""
        session = self._mesh.session
        key = f"@/{session.info.zid()}/router/token/{self.prefix}/alive/{self.known(node)}"
        for reply in session.get(key, timeout=5.0):
            if reply.ok is not None:
                return str(json.loads(reply.ok.payload.to_bytes())["clients"][0])
        raise RunError(f"the router knows no session of {node}")

    def forged(self, key: str) -> bytes:
        """A message as the wire of this key carries it, empty, whose source says who has made it.

        So the host that gets it refuses it, and counts it.
        """
        schema = SCHEMAS[self._leg(key)[0].message]
        sizes = [[0 if isinstance(size, str) else size for size in column.shape] for column in schema.columns]
        body = {
            column.name: text([]) if column.dtype == "str" else np.zeros(size, column.dtype)
            for column, size in zip(schema.columns, sizes, strict=True)
        }
        return codec.encode(Message(Header(schema.name, OUTSIDER, self.frame, 0, 0), body))

    def hearers(self, key: str) -> int:
        """How many nodes hear what is sent on this key."""
        wire, leg = self._leg(key)
        return len(wire.hearers(leg)) + len(self.wiring.overhearers)

    def known(self, node: str) -> str:
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

    # -- what becomes of the run ---------------------------------------------------------------------------------

    def wait(self, condition: Callable[[], Any], seconds: float, what: str = "") -> bool:
        """Wait until something is the case, while the run goes on; False when it takes too long.

        what: raise RunError then, which names it. Raises RunError when the run has ended.
        """
        pause, deadline = threading.Event(), time.monotonic() + seconds
        while not condition():
            if not self._thread.is_alive():
                error = self.crash or (self._ended and self._ended.error)
                raise RunError(f"the run ended while the attackers were at it: {error or 'all frames are played'}")
            if time.monotonic() > deadline:
                if what:
                    raise RunError(f"not within {seconds:.0f} s: {what}")
                return False
            pause.wait(_POLL_S)
        return True

    def ended(self, seconds: float) -> run.Run | None:
        """What has become of the run when it has ended by itself; None when it has not within so many seconds."""
        self._thread.join(seconds)
        return self._ended

    def end(self) -> run.Run | None:
        """Have the run end, if it has not; what has become of it."""
        if self._thread.is_alive() and self._context is not None:
            self._context.interrupt()
        self._thread.join(_END_S)
        return self._ended

    def received(self) -> dict[str, dict[str, int]]:
        """After the end, by node and key: messages without the mark of this run's nodes that have reached its host."""
        ended = self.end()
        if ended is None or (ended.error is not None and not isinstance(ended.error, Interrupted)):
            raise RunError(f"the run under siege failed: {ended.error if ended else self.crash or 'it does not end'}")
        if ended.failures:
            raise HandlerFailed(failures.summary(ended.failures, ended.logs))
        found: dict[str, dict[str, int]] = {}
        for name, node in ended.record["nodes"].items():
            if node["foreign"] is None:
                raise RunError(f"{name} handed in nothing: {node['ended']}")
            found[name] = node["foreign"]
        return found

    def _play(self) -> None:
        def prepare(context: RunContext) -> None:
            context.detours |= {
                node: endpoint(self.level, f"tcp/127.0.0.1:{detour.port}") for node, detour in self.detours.items()
            }
            self._context = context

        more: dict[str, Any] = {"engine": self._engine, "console": self._console}
        try:
            self._ended = run.run(self._resolved, self._folder, secure=self.level, prepare=prepare, **more)
        except Exception as error:  # a defect, which the attackers may have found
            self.crash = described(error)


@contextmanager
def attackers_own(name: str, call: Callable[..., Any]) -> Iterator[None]:
    """Raises HandlerFailed, with file and line, where the code of an attacker fails; `call` is that code."""
    try:
        yield
    except (MastError, zenoh.ZError):
        raise
    except Exception as error:
        where = failures.location(error, call)
        raise HandlerFailed(f"the attacker {name!r} failed: {described(error)} ({where})") from error


def _port(address: str) -> int:
    return int(address.rpartition(":")[2])

"""Serves requests to insert nodes into wires of a running run, and to remove them.

A client sends a query on @control/intercept, sealed with a secret in the run folder: the launcher starts processes
only for users who may read that folder. Requests are served one after the other, one step in each iteration of the
launcher's loop.
"""

from __future__ import annotations

import hashlib
import hmac
import queue
import secrets
import threading
import time
from collections.abc import Callable, Generator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import msgpack
import zenoh

from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.control import fields, files, flow, prefix
from mast_zenoh.control import interception as control
from mast_zenoh.control.failures import described
from mast_zenoh.errors import ConfigurationError, MastError, MessageError, NotRunning, RunError, StartError
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch.context import RunContext
from mast_zenoh.launch.supervisor import Child, Supervisor
from mast_zenoh.wiring import insertion
from mast_zenoh.wiring.insertion import Place
from mast_zenoh.wiring.model import Wiring

SECRET_FILE = "control.key"
MAX_WAITING = 64  #: requests in the queue
_DRIVER_TIMEOUT_S = 60.0
_START_TIMEOUT_S = 60.0
_LEAVE_GRACE_S = 5.0

#: Work in steps: yields whenever it has to wait, and returns the answer.
Work = Generator[None, None, dict[str, Any]]


def seal(request: dict[str, Any], secret: bytes) -> bytes:
    """Encode and sign a request; a random number makes it unique."""
    body: bytes = msgpack.packb(request | {"number": secrets.token_hex(8)})
    return bytes(msgpack.packb([body, hmac.digest(secret, body, hashlib.sha256)]))


def unseal(payload: bytes, secret: bytes) -> dict[str, Any]:
    """Decode a request; raises MessageError if it was not sealed with the secret."""
    body, digest = control.sealed_parts(payload)
    if hmac.compare_digest(digest, hmac.digest(secret, body, hashlib.sha256)):
        return fields.mapping(fields.unpack(body, "intercept"), "intercept")
    raise MessageError("a request that was not sealed with this run's secret")


class Interceptions:
    """Serves requests to change a run's wiring; heals wires if inserted nodes die."""

    def __init__(self, context: RunContext, session: zenoh.Session, supervisor: Supervisor[Any]) -> None:
        self._context = context
        self._session = session
        self._supervisor = supervisor
        self._base = prefix(context.run_id)
        self._secret = secrets.token_bytes(32)
        self._secret_file = context.folder / SECRET_FILE
        self._secret_file.touch(mode=0o600)
        self._secret_file.write_bytes(self._secret)
        self._requests: queue.Queue[tuple[zenoh.Query, str, control.Intercept | control.Release]]
        self._requests = queue.Queue(MAX_WAITING)
        self._served_ids: set[str] = set()
        self._work: Generator[None] | None = None
        self._inserted: set[str] = set()
        self._alive: set[str] = set()
        self._changes: list[dict[str, Any]] = context.record.setdefault("interceptions", [])
        on_query: Any = zenoh.handlers.Callback(self._on_query, indirect=False)
        presence: Any = zenoh.handlers.Callback(self._note_presence, indirect=False)
        self._declared: list[Any] = [
            session.declare_queryable(f"{self._base}/@control/intercept", on_query),
            session.liveliness().declare_subscriber(f"{self._base}/alive/*", presence, history=True),
        ]

    def advance(self) -> None:
        """Do the next step of the current request, or of healing a wire, if any."""
        if self._work is None:
            self._work = self._next()
        if self._work is not None:
            try:
                next(self._work)
            except StopIteration:
                self._work = None

    def close(self) -> None:
        """End the service: refuse the requests that have not been served."""
        while self._work is not None or not self._requests.empty():
            self.advance()
        for entity in self._declared:
            entity.undeclare()
        self._secret_file.unlink(missing_ok=True)

    def _on_query(self, query: zenoh.Query) -> None:
        """Queue a request, in Zenoh's thread; refuse a malformed one."""
        try:
            request = unseal(query.payload.to_bytes() if query.payload else b"", self._secret)
            request_id = fields.text(request.get("number"), "intercept: number", 64)
            action = control.request_of(request)
            self._requests.put_nowait((query, request_id, action))
        except queue.Full:
            self._refuse(query, MessageError(f"more than {MAX_WAITING} requests are waiting"))
        except MessageError as error:
            self._refuse(query, error)

    def _refuse(self, query: zenoh.Query, error: Exception) -> None:
        if not isinstance(error, MastError) or isinstance(error, MessageError):
            self._context.invalid.note("intercept", described(error))
        with suppress(zenoh.ZError):
            query.reply_err(files.encode_refusal(error))
        query.drop()

    def _note_presence(self, token: zenoh.Sample) -> None:
        """Note in Zenoh's thread which nodes are on the mesh."""
        name = str(token.key_expr).rpartition("/")[2]
        (self._alive.add if token.kind == zenoh.SampleKind.PUT else self._alive.discard)(name)

    def _next(self) -> Generator[None] | None:
        for name in sorted(self._inserted):
            child = self._supervisor.children[name]
            died = child.exit is not None and not child.exit_expected and not (child.exit == 0 and child.handed_in)
            if died and not self._context.stop.requested:
                return self._heal(child)
        return None if self._requests.empty() else self._serve(*self._requests.get())

    def _serve(
        self, query: zenoh.Query, request_id: str, action: control.Intercept | control.Release
    ) -> Generator[None]:
        try:
            if request_id in self._served_ids:
                raise MessageError("a request that was sent before")
            self._served_ids.add(request_id)
            self._check_running()
            if isinstance(action, control.Intercept):
                answer = yield from self._intercept(*action)
            else:
                answer = yield from self._release(*action)
        except Exception as error:  # one request never ends the run
            self._refuse(query, error)
        else:
            query.reply(query.key_expr, msgpack.packb(answer))
            query.drop()

    def _intercept(self, name: str, spec: NodeSpec, place: Place, modules: tuple[str, ...]) -> Work:
        """Start a node, and put it on its wire once it has joined the mesh."""
        before = self._context.resolved
        if name in before.nodes or any(child.name == name for child in self._supervisor.running()):
            raise ConfigurationError(f"node {name!r} already exists: give another --name")
        after = insertion.insert(Wiring.from_json(before.wiring), name, place)
        yield from self._until(lambda: self._context.frame >= 0)
        modules = tuple(dict.fromkeys([*before.modules, *modules]))
        self._adopt(replace(before, nodes={**before.nodes, name: spec}, wiring=after.to_json(), modules=modules))
        try:
            running = {child.name for child in self._supervisor.running()}
            self._supervisor.start(name, spec, before.nodes.keys() - running)
            child = self._supervisor.children[name]
            yield from self._until(lambda: name in self._alive or child.exit is not None, _START_TIMEOUT_S)
            if name not in self._alive:
                problem = f"{name} ended before it could be put on {place.wire}: {child.ended}"
                raise StartError(f"{problem}; see logs/{name}.log")
            answer = yield from self._ask_driver(after, {name: spec.role}, [])
        except MastError:
            self._adopt(before)
            if name in self._supervisor.children:
                yield from self._end(self._supervisor.children[name], "not put on its wire")
            raise
        self._inserted.add(name)
        return self._record("intercept", name, [place.wire], answer)

    def _release(self, named: str | None, wire: str | None) -> Work:
        """Take a node off its wires, and end it once it has forwarded everything."""
        wiring = Wiring.from_json(self._context.resolved.wiring)
        name = named or insertion.interposer_of(wiring, wire or "")
        yield from self._until(lambda: self._context.frame >= 0)
        answer = yield from self._take_off(name)
        self._inserted.discard(name)
        if name in self._supervisor.children:
            yield from self._end(self._supervisor.children[name], "released")
        return self._record("release", name, answer.pop("wires"), answer)

    def _heal(self, child: Child) -> Generator[None]:
        """Reconnect the ends of a dead node's wires; the messages inside it are lost."""
        self._inserted.discard(child.name)
        try:
            answer = yield from self._take_off(child.name)
        except MastError as error:
            self._context.show(f"[yellow]the wire of {child.name} could not be healed: {error}")
            return
        self._supervisor.dispose(child)
        wires = answer.pop("wires")
        self._record("heal", child.name, wires, answer)
        self._context.show(f"[yellow]{', '.join(wires)} healed without {child.name}: the messages in it are lost")

    def _take_off(self, name: str) -> Work:
        before = self._context.resolved
        wiring = Wiring.from_json(before.wiring)
        after = insertion.remove(wiring, name)
        wires = [wire.key for wire in wiring.wires if name in wire.interposers]
        nodes = {other: spec for other, spec in before.nodes.items() if other != name}
        self._adopt(replace(before, nodes=nodes, wiring=after.to_json()))
        try:
            answer = yield from self._ask_driver(after, {}, [name])
        except MastError:
            self._adopt(before)
            raise
        return answer | {"wires": wires}

    def _ask_driver(self, wiring: Wiring, join: dict[str, str], leave: list[str]) -> Work:
        """Have the driver switch all nodes to a new wiring; return its answer."""
        replies: list[zenoh.Reply] = []
        finished = threading.Event()
        handler: Any = zenoh.handlers.Callback(replies.append, finished.set, indirect=False)
        self._session.get(
            f"{self._base}/@control/rewire",
            handler,
            payload=self._context.signatures.sign("rewire", flow.encode_rewire(wiring, join, leave)),
            timeout=_DRIVER_TIMEOUT_S,
        )
        yield from self._until(finished.is_set)
        for reply in replies:
            if reply.ok is not None:
                answer = flow.decode_rewired(reply.ok.payload.to_bytes())
                if "error" in answer:
                    raise RunError(f"nothing was changed: {answer['error']}")
                return answer
        raise RunError("nothing was changed: the driver does not answer")

    def _end(self, child: Child, reason: str) -> Generator[None]:
        """Ask a process to leave; kill it if it does not."""
        child.exit_expected = True
        child.notes.append(reason)
        message = self._context.signatures.sign(f"leave/{child.name}", reason.encode())
        self._session.put(f"{self._base}/@control/leave/{child.name}", message)
        deadline = time.monotonic() + _LEAVE_GRACE_S
        while child.exit is None and time.monotonic() < deadline:
            yield
        if child.exit is None:
            self._supervisor.end_now(child)
        self._supervisor.dispose(child)
        while child.name in self._alive and time.monotonic() < deadline + _LEAVE_GRACE_S:
            yield  # its name may be used again once all nodes know that it is gone

    def _until(self, condition: Callable[[], object], seconds: float = float("inf")) -> Generator[None]:
        """Wait for a condition; raises NotRunning if the run stops, StartError on timeout."""
        deadline = time.monotonic() + seconds
        while True:
            self._check_running()
            if condition():
                return
            if time.monotonic() > deadline:
                raise StartError(f"timed out after {seconds:.0f} s")
            yield

    def _check_running(self) -> None:
        if self._context.stop.requested or not self._supervisor.running():
            raise NotRunning("the run is over")

    def _adopt(self, resolved: Resolved) -> None:
        """Make this the run's scenario, for nodes that start later and in the run folder."""
        self._context.resolved = resolved
        run_folder.write_json(self._context.folder / "wiring.json", resolved.wiring)
        run_folder.write_json(self._context.folder / "scenario.json", resolved.to_json())

    def _record(self, action: str, name: str, wires: list[str], answer: dict[str, Any]) -> dict[str, Any]:
        """Record a change in run.json, and return it."""
        change = {"action": action, "node": name, "wires": wires, **answer}
        self._changes.append(change)
        self._context.record["nodes"] = self._supervisor.to_json({})
        run_folder.write_json(self._context.folder / "run.json", self._context.record)
        return change

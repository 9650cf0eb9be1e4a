"""Inserts nodes into wires of a running run, and releases them, as requested; heals wires if inserted nodes die.

Requests are served one after the other, one step in each iteration of the launcher's loop.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator
from dataclasses import replace
from typing import Any

import msgpack

from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.control import flow
from mast_zenoh.control import interception as control
from mast_zenoh.control.signatures import Signatures
from mast_zenoh.errors import ConfigurationError, MastError, MessageError, NotRunning, RunError, StartError
from mast_zenoh.launch.launcher_protocol import LauncherActions, Query, RunState
from mast_zenoh.launch.supervisor import Child, Supervisor
from mast_zenoh.wiring import insertion
from mast_zenoh.wiring.insertion import Place
from mast_zenoh.wiring.model import Wiring

MAX_WAITING = 64  #: requests in the queue
_START_TIMEOUT_S = 60.0
_LEAVE_GRACE_S = 5.0

#: Work in steps: yields whenever it has to wait, and returns the answer.
Work = Generator[None, None, dict[str, Any]]


class Interceptions:
    """Changes a run's wiring.

    signatures: of control messages
    alive: nodes with a liveliness token
    """

    def __init__(
        self,
        state: RunState,
        supervisor: Supervisor[Any],
        actions: LauncherActions,
        signatures: Callable[[], Signatures],
    ) -> None:
        self.alive: set[str] = set()
        self._state = state
        self._supervisor = supervisor
        self._actions = actions
        self._signatures = signatures
        self._requests: deque[tuple[Query, str, control.Intercept | control.Release]] = deque()
        self._served_ids: set[str] = set()
        self._work: Generator[None] | None = None
        self._inserted: set[str] = set()

    def add(self, query: Query, request_id: str, action: control.Intercept | control.Release) -> None:
        """Queue a request, from any thread; raises MessageError if too many wait."""
        if len(self._requests) >= MAX_WAITING:
            raise MessageError(f"more than {MAX_WAITING} requests are waiting")
        self._requests.append((query, request_id, action))

    def note_presence(self, node: str, present: bool) -> None:
        """Note that a node has appeared on the mesh, or gone; from any thread."""
        (self.alive.add if present else self.alive.discard)(node)

    def advance(self) -> None:
        """Do the next step of the current request, or of healing a wire, if any."""
        if self._work is None:
            self._work = self._next()
        if self._work is not None:
            try:
                next(self._work)
            except StopIteration:
                self._work = None

    def finish(self) -> None:
        """Refuse the requests that have not been served: the run is over."""
        while self._work is not None or self._requests:
            self.advance()

    def _next(self) -> Generator[None] | None:
        for name in sorted(self._inserted):
            child = self._supervisor.children[name]
            died = child.exit is not None and not child.exit_expected and not (child.exit == 0 and child.handed_in)
            if died and not self._state.stop.requested:
                return self._heal(child)
        return self._serve(*self._requests.popleft()) if self._requests else None

    def _serve(self, query: Query, request_id: str, action: control.Intercept | control.Release) -> Generator[None]:
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
            self._actions.refuse(query, error)
        else:
            self._actions.answer(query, msgpack.packb(answer))

    def _intercept(self, name: str, spec: NodeSpec, place: Place, modules: tuple[str, ...]) -> Work:
        """Start a node, and put it on its wire once it has joined the mesh."""
        before = self._state.resolved
        if name in before.nodes or any(child.name == name for child in self._supervisor.running()):
            raise ConfigurationError(f"node {name!r} already exists: give another --name")
        after = insertion.insert(Wiring.from_json(before.wiring), name, place)
        yield from self._until(lambda: self._state.frame >= 0)
        modules = tuple(dict.fromkeys([*before.modules, *modules]))
        planned = replace(before, nodes={**before.nodes, name: spec}, wiring=after.to_json(), modules=modules)
        self._adopt(before, (name, planned))
        try:
            self._supervisor.start(name, spec)
            child = self._supervisor.children[name]
            yield from self._until(lambda: name in self.alive or child.exit is not None, _START_TIMEOUT_S)
            if name not in self.alive:
                problem = f"{name} ended before it could be put on {place.wire}: {child.ended}"
                raise StartError(f"{problem}; see logs/{name}.log")
            answer = yield from self._ask_driver(after, {name: spec.role}, [])
        except MastError:
            self._adopt(before)
            if name in self._supervisor.children:
                yield from self._end(self._supervisor.children[name], "not put on its wire")
            raise
        self._adopt(planned)
        self._inserted.add(name)
        return self._record("intercept", name, [place.wire], answer)

    def _release(self, named: str | None, wire: str | None) -> Work:
        """Take a node off its wires, and end it once it has forwarded everything."""
        wiring = Wiring.from_json(self._state.resolved.wiring)
        name = named or insertion.interposer_of(wiring, wire or "")
        yield from self._until(lambda: self._state.frame >= 0)
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
            self._state.show(f"[yellow]the wire of {child.name} could not be healed: {error}")
            return
        self._supervisor.dispose(child)
        wires = answer.pop("wires")
        self._record("heal", child.name, wires, answer)
        self._state.show(f"[yellow]{', '.join(wires)} healed without {child.name}: the messages in it are lost")

    def _take_off(self, name: str) -> Work:
        before = self._state.resolved
        wiring = Wiring.from_json(before.wiring)
        after = insertion.remove(wiring, name)
        wires = [wire.key for wire in wiring.wires if name in wire.interposers]
        nodes = {other: spec for other, spec in before.nodes.items() if other != name}
        answer = yield from self._ask_driver(after, {}, [name])
        self._adopt(replace(before, nodes=nodes, wiring=after.to_json()))
        return answer | {"wires": wires}

    def _ask_driver(self, wiring: Wiring, join: dict[str, str], leave: list[str]) -> Work:
        """Have the driver switch all nodes to a new wiring; return its answer."""
        answers: list[bytes | None] = []
        request = flow.encode_rewire(wiring, join, leave)
        self._actions.rewire(self._signatures().sign("rewire", request), answers.append)
        yield from self._until(lambda: answers)
        if answers[0] is None:
            raise RunError("nothing was changed: the driver does not answer")
        answer = flow.decode_rewired(answers[0])
        if answer.error:
            raise RunError(f"nothing was changed: {answer.error}")
        return {"frame": answer.frame, "took_ms": answer.took_ms}

    def _end(self, child: Child, reason: str) -> Generator[None]:
        """Ask a process to leave; kill it if it does not."""
        child.exit_expected = True
        child.notes.append(reason)
        self._actions.leave(child.name, reason)
        deadline = self._state.now_s() + _LEAVE_GRACE_S
        while child.exit is None and self._state.now_s() < deadline:
            yield
        if child.exit is None:
            self._supervisor.end_now(child)
        self._supervisor.dispose(child)
        deadline += _LEAVE_GRACE_S
        while child.name in self.alive and self._supervisor.running() and self._state.now_s() < deadline:
            yield  # its name may be used again once all nodes know that it is gone

    def _until(self, condition: Callable[[], object], seconds: float = float("inf")) -> Generator[None]:
        """Wait for a condition; raises NotRunning if the run stops, StartError on timeout."""
        deadline = self._state.now_s() + seconds
        while True:
            self._check_running()
            if condition():
                return
            if self._state.now_s() > deadline:
                raise StartError(f"timed out after {seconds:.0f} s")
            yield

    def _check_running(self) -> None:
        if self._state.stop.requested or not self._supervisor.running():
            raise NotRunning("the run is over")

    def _adopt(self, resolved: Resolved, joining: tuple[str, Resolved] | None = None) -> None:
        """Make this the run's scenario: nodes begin with it that start from now on, except one that is inserted."""
        self._state.resolved, self._state.joining = resolved, joining
        self._actions.adopt(resolved, joining)

    def _record(self, action: str, name: str, wires: list[str], answer: dict[str, Any]) -> dict[str, Any]:
        """Record a change in run.json, and return it."""
        change = {"action": action, "node": name, "wires": wires, **answer}
        self._actions.record(change)
        return change

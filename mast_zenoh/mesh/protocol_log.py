"""The log of a process: all that its protocol was given and asked for; and its replay by another protocol.

A log is a sequence of records, each after its length in four bytes. A Beginning describes a process; a Step follows for
each call of the protocol. What no event says is an answer: the time, which publishers have subscribers, a signature. A
replay gives the same events and answers, so the same code asks for the same actions.
"""

from __future__ import annotations

import hashlib
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext, suppress
from itertools import zip_longest
from threading import get_ident
from types import SimpleNamespace
from typing import Any, NamedTuple

import msgspec

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import MessageError
from mast_zenoh.mesh.protocol.driver import protocol_of
from mast_zenoh.mesh.protocol.events import Actions, AnyEvent, Clocks
from mast_zenoh.mesh.protocol.node import NodeProtocol
from mast_zenoh.mesh.protocol.traffic import EventInbox, ProcessContext
from mast_zenoh.node import Node
from mast_zenoh.wiring.model import Wiring

PROTOCOL_LOGS = "logs/protocol"  #: of a run folder: its nodes write their logs there, if it exists
MAX_BYTES = 256 << 20  #: of the log of a process, which later steps are not in
_MAX_ARGUMENT = 256  # bytes; a longer one is logged as its length and digest


class Beginning(msgspec.Struct, frozen=True, tag=True, array_like=True):
    """A process begins: its node and its id, and what it has read of the scenario."""

    node: str
    process: str
    scenario: dict[str, Any]
    wiring: dict[str, Any]


class Step(msgspec.Struct, frozen=True, tag=True, array_like=True):
    """A call of the protocol.

    call:    start, handle, idle or release;  event: which it has handled; None: none
    actions: that it has asked for: name and arguments of each;  answers: in the order of its questions
    """

    call: str
    event: AnyEvent | None
    actions: list[list[Any]]
    answers: list[Any]


class ProcessLog(NamedTuple):
    """The log of one process; whole: whether it ends with a record, not within one"""

    beginning: Beginning
    steps: list[Step]
    whole: bool = True


_encode = msgspec.msgpack.Encoder(enc_hook=Wiring.to_json).encode
_decode = msgspec.msgpack.Decoder(Beginning | Step, dec_hook=lambda _, value: Wiring.from_json(value)).decode


def logged_protocol(
    write: Callable[[bytes], object], resolved: Resolved, name: str, node: Node, context: ProcessContext
) -> NodeProtocol:
    """As `protocol_of`, with a log of all calls of the protocol; write: takes its records."""
    recorder = _Recorder(write)
    recorder.write(Beginning(name, context.process, resolved.to_json(), resolved.wiring))
    actions, inbox, clocks, _, signatures = context
    _replace(actions, recorder.action, *Actions.__abstractmethods__)
    _replace(actions, recorder.answer, "unmatched")
    _replace(signatures, recorder.action, "sign")
    _replace(signatures, recorder.answer, "sign")
    _replace(inbox, recorder.answer, "take_dropped")
    context = context._replace(clocks=Clocks(*(recorder.answer("", clock) for clock in clocks)))
    protocol = protocol_of(resolved, name, node, context)
    _replace(protocol, recorder.step, "start", "handle", "idle")
    _replace(protocol.host, recorder.step, "release")
    _replace(protocol, recorder.answer, "process_facts")
    return protocol


def _replace(owner: Any, wrap: Callable[[str, Any], Any], *methods: str) -> None:
    for name in methods:
        setattr(owner, name, wrap(name, getattr(owner, name)))


class _Recorder:
    """Wraps methods so that what happens during a step is written with it; calls of other threads are not."""

    def __init__(self, write: Callable[[bytes], object]) -> None:
        self._write = write
        self._room = MAX_BYTES
        self._thread = 0  # that runs the protocol
        self._queries: list[Any] = []
        self._actions: list[list[Any]] = []
        self._answers: list[Any] = []

    def write(self, record: Beginning | Step) -> None:
        """Write a record, if there is room for it."""
        content = _encode(record)
        self._room -= len(content)
        if self._room >= 0:
            try:
                self._write(len(content).to_bytes(4, "little") + content)
            except OSError:  # a full disk costs the rest of the log alone
                self._room = -1

    def step(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        """A method of the protocol: each call is a step, but for those within one."""

        def call(event: Any = None) -> Any:
            arguments = () if event is None and name != "handle" else (event,)
            if self._thread == get_ident():
                return method(*arguments)
            self._actions, self._answers, self._thread = [], [], get_ident()
            if hasattr(event, "query"):
                logged = msgspec.structs.replace(event, query=self._plain(event.query))
            else:
                logged = event
            try:
                return method(*arguments)
            except BaseException as error:
                self._actions.append(["raise", type(error).__name__])
                raise
            finally:
                self._thread = 0
                self.write(Step(name, logged, self._actions, self._answers))

        return call

    def action(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        """A method that the protocol asks for something."""

        def call(*arguments: Any) -> Any:
            if self._thread == get_ident():
                self._actions.append([name, *map(self._plain, arguments)])
            return method(*arguments)

        return call

    def answer(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        """A method that tells the protocol something that no event says."""

        def call(*arguments: Any) -> Any:
            answer = method(*arguments)
            if self._thread == get_ident():
                self._answers.append(list(answer.items()) if isinstance(answer, Counter) else answer)
            return answer

        return call

    def _plain(self, value: Any) -> Any:
        """An argument as it is logged: a set sorted, a query as its number."""
        if isinstance(value, bytes) and len(value) > _MAX_ARGUMENT:
            return f"{len(value)} bytes, {hashlib.sha256(value).hexdigest()[:16]}"
        if value is None or isinstance(value, (str, bytes, int)):
            return value
        if isinstance(value, Iterable):
            return sorted(value)
        if value not in self._queries:
            self._queries.append(value)
        return self._queries.index(value)


def read(content: bytes) -> list[ProcessLog]:
    """The logs in a file of a node, one for each of its processes; raises MessageError for something else.

    A log may end within a record: its process was killed.
    """
    logs: list[ProcessLog] = []
    at = 0
    while at + 4 <= len(content):
        begin, end = at + 4, at + 4 + int.from_bytes(content[at : at + 4], "little")
        at = end
        if end > len(content):
            logs[-1:] = [each._replace(whole=False) for each in logs[-1:]]
            break
        try:
            record = _decode(content[begin:end])
        except Exception as error:  # msgspec's, and those of a wiring
            raise MessageError(f"protocol log: byte {begin}: found no record: {error!s:.200}") from None
        if isinstance(record, Beginning):
            logs.append(ProcessLog(record, []))
        elif logs:
            logs[-1].steps.append(record)
        else:
            raise MessageError("protocol log: its first record is a step, expected the beginning of a process")
    if not logs:
        raise MessageError(f"protocol log: found no process in {len(content)} bytes")
    return logs


def replay(log: ProcessLog, node: Node) -> ProcessLog:
    """The log of another protocol, of a new node, that is given the same events and answers."""
    answers: deque[Any] = deque()

    def answer(*arguments: Any) -> Any:
        if not answers:
            raise LookupError("the protocol asks for more than the log answers")
        return answers.popleft()

    actions: Any = SimpleNamespace(**dict.fromkeys(Actions.__abstractmethods__, lambda *arguments: None))
    actions.unmatched = lambda keys: set(answer())
    inbox = EventInbox(lambda item: None, nullcontext())
    inbox.take_dropped = lambda: Counter({tuple(key): n for key, n in answer()})  # type: ignore[method-assign]
    resolved = Resolved.from_json(log.beginning.scenario, log.beginning.wiring)
    written: list[bytes] = []
    signatures: Any = SimpleNamespace(sign=answer)
    context = ProcessContext(actions, inbox, Clocks(answer, answer), log.beginning.process, signatures)
    protocol: Any = logged_protocol(written.append, resolved, log.beginning.node, node, context)
    protocol.process_facts = answer
    for step in log.steps:
        answers.clear()
        answers.extend(step.answers)
        owner = protocol.host if step.call == "release" else protocol
        with suppress(Exception):  # which is in the step
            getattr(owner, step.call)(*[step.event][: step.call == "handle"])
    (replayed,) = read(b"".join(written))
    return replayed


def difference(one: ProcessLog, other: ProcessLog) -> str:
    """Where two logs part: the first event or action that differs, with its place in each; "" if none does."""
    for items in zip_longest(_items(one), _items(other)):
        if items[0] != items[1]:
            first, second = ("the end" if item is None else f"{item[0]}: {item[1]!r:.400}" for item in items)
            return f"{first}\n{second}"
    return ""


def _items(log: ProcessLog) -> Iterator[tuple[str, Any]]:
    for number, step in enumerate(log.steps):
        yield f"step {number}: {step.call}", step.event
        for place, action in enumerate(step.actions):
            yield f"step {number}: action {place}", action

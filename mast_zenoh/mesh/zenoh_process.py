"""Connects a node's protocol to a Zenoh session: carries out its actions, and brings it what arrives.

Zenoh's threads call the protocol's `receive_…` methods, which check what arrives and put it into the inbox; the main
thread takes it out and runs the protocol. In real time, a
node that is `prompt` handles a message immediately in Zenoh's thread, if no other waits: switching threads takes longer
than relaying a message.
"""

from __future__ import annotations

import ctypes
import logging
import os
import queue
import threading
import time
from collections.abc import Callable, Collection
from functools import partial
from typing import Any, TypeVar

import zenoh

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import MessageError
from mast_zenoh.mesh.control import files, prefix
from mast_zenoh.mesh.control.codec import Signatures
from mast_zenoh.mesh.control.key_marks import check_control_mark, control_mark
from mast_zenoh.mesh.host import OpenedOutside
from mast_zenoh.mesh.outside_link import OutsideLink
from mast_zenoh.mesh.protocol import events
from mast_zenoh.mesh.protocol.driver import DriverProtocol, protocol_of
from mast_zenoh.mesh.protocol.events import DOZE_S, DRAIN_TIMEOUT_S, OFFER_TIMEOUT_S, Actions, Clocks
from mast_zenoh.mesh.protocol.node import HAND_IN_TIMEOUT_S
from mast_zenoh.mesh.protocol.traffic import EventInbox, Item, ProcessContext, stamp_of
from mast_zenoh.mesh.protocol_log import logged_protocol
from mast_zenoh.mesh.session import direct
from mast_zenoh.messages.schemas import SCHEMAS
from mast_zenoh.node import Node

T = TypeVar("T")

#: Parts of tables that wait to be sent; beyond, the node waits.
_WAITING_PARTS = 2

log = logging.getLogger("mast")

_thread = threading.local()


def keeping_state(callback: Callable[[T], None]) -> Callable[[T], None]:
    """The callback, for threads that Python has not started.

    Python makes a state for such a thread at each call, and deletes it afterwards: mapping and unmapping its 16 KiB
    costs more than taking a sample. A thread that has called this keeps its state.
    """

    def call(argument: T) -> None:
        if not hasattr(_thread, "state"):
            _thread.state = ctypes.pythonapi.PyGILState_Ensure()  # never released
        callback(argument)

    return call


class ZenohProcess(Actions):
    """One node's process on the mesh.

    run: its id;  resolved: the scenario with the node `name`;  signatures: of control messages
    write: takes the records of the protocol's log; None: no log
    protocol: of the node;  inbox: what has arrived for it
    hand_in_files: sends the rest of the files that the node has written
    """

    def __init__(
        self,
        run: str,
        resolved: Resolved,
        name: str,
        node: Node,
        session: zenoh.Session,
        signatures: Signatures,
        write: Callable[[bytes], object] | None = None,
    ) -> None:
        self.session = session
        self.hand_in_files: Callable[[], None] = lambda: None
        self.prefix = prefix(run)
        self._declared: list[Any] = []  # subscribers and queryables, which end when nothing refers to them
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._control_publishers: dict[str, zenoh.Publisher] = {}
        self._listeners: dict[str, Any] = {}  # of publishers without a subscriber, by key
        self._token: Any = None
        lockstep = resolved.mode == "lockstep"
        self._congestion = zenoh.CongestionControl.BLOCK if lockstep else zenoh.CongestionControl.DROP
        self._prompt = node.prompt and not lockstep
        self._lock = threading.RLock()  # held by the thread that runs the protocol
        self._n_queued = 0  # messages put into the inbox, counted by Zenoh's thread
        self._n_handled = 0  # of them, those that the main thread has handled; counted after it released the lock
        self._queue: queue.SimpleQueue[Item] = queue.SimpleQueue()
        self.inbox = EventInbox(self._queue.put, threading.Lock())
        clocks = Clocks(time.monotonic_ns, time.process_time)
        context = ProcessContext(self, self.inbox, clocks, os.urandom(8).hex(), signatures)
        build = protocol_of if write is None else partial(logged_protocol, write)
        self.protocol = build(resolved, name, node, context)
        self._parts = _PartSender(session, f"{self.prefix}/@control", f"result/{name}")
        self._receive_control()

    def run(self) -> None:
        """Join the mesh, take part until the run stops, hand in the results.

        Raises NotRunning for a node whose link to programs outside the run cannot be opened.
        """
        link = self._open_link()
        try:
            self._take_part()
        finally:
            if link is not None:
                link.close()

    def _take_part(self) -> None:
        protocol, inbox = self.protocol, self.inbox
        protocol.start()
        while not protocol.ended:
            try:
                item: Item | None = self._queue.get_nowait()
            except queue.Empty:
                item = self._wait()
            with self._lock:
                protocol.handle(None if item is None else inbox.take(item))
            if item is not None and item[1]:
                self._n_handled += 1
        self._token.undeclare()

    def stop(self, reason: str) -> None:
        """Have the node hand in its results and end; from any thread, or a signal handler."""
        self.protocol.request_stop(reason)

    def _open_link(self) -> OpenedOutside | None:
        """Open the node's link to programs outside the run, if it has topics there."""
        protocol = self.protocol
        topics = protocol.host.node.outside_topics(protocol.host)
        if topics is None:
            return None

        def notify() -> None:
            if not protocol.lockstep:  # there, the handler that waits takes what arrives
                self.inbox.put(events.OutsideEvent())

        link = OutsideLink(protocol.name, topics, waits=protocol.lockstep, notify=notify)
        protocol.host.link, protocol.on_stop = link, link.end
        return link

    def _wait(self) -> Item | None:
        """The next item; None if the protocol is due first."""
        if self.protocol.dozes:
            time.sleep(DOZE_S)
        with self._lock:
            wait_s = self.protocol.idle()
        try:
            return self._queue.get(timeout=wait_s)
        except queue.Empty:
            return None

    # -- what arrives, in Zenoh's threads --------------------------------------------------------------------------

    def _receive_control(self) -> None:
        """Subscribe to the control messages of the protocol."""
        protocol, name = self.protocol, self.protocol.name
        for key, receive in protocol.receivers().items():
            self._obey(key, receive)
        self._answer(f"drain/{name}", protocol.receive_drain)
        if isinstance(protocol, DriverProtocol):
            driver = protocol
            self._answer("rewire", driver.receive_rewire)

            def on_token(token: zenoh.Sample) -> None:
                node = str(token.key_expr).rpartition("/")[2]
                driver.receive_presence(node, token.kind == zenoh.SampleKind.PUT)

            tokens = self.session.liveliness()
            self._declared.append(tokens.declare_subscriber(f"{self.prefix}/alive/*", direct(on_token), history=True))

    def _subscribe(self, key: str, callback: Callable[[zenoh.Sample], None]) -> None:
        """Subscribe to a key; the callback runs in Zenoh's thread and must return quickly."""
        self._declared.append(self.session.declare_subscriber(f"{self.prefix}/{key}", direct(keeping_state(callback))))

    def _obey(self, key: str, receive: Callable[[str, bytes], None]) -> None:
        """Receive the messages on a control key."""
        base = f"{self.prefix}/@control/"

        def on_sample(sample: zenoh.Sample) -> None:
            if self._was_sent_here(key, sample):
                receive(str(sample.key_expr).removeprefix(base), sample.payload.to_bytes())

        self._subscribe(f"@control/{key}", on_sample)

    def _was_sent_here(self, key: str, message: zenoh.Sample | zenoh.Query) -> bool:
        """Whether a control message was sent on the key on which it has arrived; else it is counted as invalid."""
        try:
            check_control_mark(message.key_expr, message.attachment)
        except MessageError as error:
            self.protocol.invalid.note(key, error)
            return False
        return True

    def _answer(self, key: str, receive: Callable[[zenoh.Query, bytes], None]) -> None:
        """Receive the queries on a control key."""

        def on_query(query: zenoh.Query) -> None:
            if self._was_sent_here(key, query):
                receive(query, query.payload.to_bytes() if query.payload else b"")
            else:
                self.answer(query, None)

        self._declared.append(self.session.declare_queryable(f"{self.prefix}/@control/{key}", direct(on_query)))

    def _on_message(self, key: str) -> Callable[[zenoh.Sample], None]:
        """The callback for the messages of a wire on a key."""
        receive = self.protocol.receive_message

        def on_sample(sample: zenoh.Sample) -> None:
            message = events.MessageEvent(key, sample.payload.to_bytes(), *stamp_of(sample.attachment, key))
            if self._prompt and self._handle_promptly(message):
                return
            if receive(message):
                self._n_queued += 1

        return on_sample

    def _handle_promptly(self, message: events.MessageEvent) -> bool:
        """Handle a message in the receiving thread; False if others wait or it is busy."""
        if self._n_queued != self._n_handled or not self._lock.acquire(blocking=False):
            return False
        try:
            if not self.protocol.epoch:
                return False
            self.protocol.handle(message)
            due_s = self.protocol.host.release()
        finally:
            self._lock.release()
        if due_s is not None:
            self.inbox.put(events.DueEvent())
        return True

    # -- actions ---------------------------------------------------------------------------------------------------

    def subscribe(self, key: str) -> None:
        self._subscribe(key, self._on_message(key))

    def declare(self, key: str, message: str) -> None:
        """All legs of a wire have equal settings."""
        schema = SCHEMAS[message]
        self._publishers[key] = self.session.declare_publisher(
            f"{self.prefix}/{key}",
            encoding=f"application/msgpack;schema={schema.name}.{schema.version}",
            congestion_control=self._congestion,
            express=True,
        )

    def undeclare(self, key: str) -> None:
        self._listeners.pop(key, None)
        self._publishers.pop(key).undeclare()

    def unmatched(self, keys: Collection[str]) -> set[str]:
        unmatched = {key for key in keys if not self._matching(key)}
        for key in unmatched - self._listeners.keys():
            self._listeners[key] = self._publishers[key].declare_matching_listener(self._on_matching(key))
        return {key for key in unmatched if not self._matching(key)}

    def _matching(self, key: str) -> bool:
        status: Any = self._publishers[key].matching_status  # an object, not the bool that zenoh's stub says
        return bool(status.matching)

    def _on_matching(self, key: str) -> Any:
        def on_status(status: zenoh.MatchingStatus) -> None:
            if status.matching:
                self.inbox.put(events.MatchedEvent(key))

        return direct(on_status)

    def publish(self, key: str, payload: bytes, attachment: bytes) -> None:
        self._publishers[key].put(payload, attachment=attachment)

    def control(self, key: str, payload: bytes) -> None:
        """The queue of control messages overtakes blocked data."""
        if key not in self._control_publishers:
            self._control_publishers[key] = self.session.declare_publisher(
                f"{self.prefix}/@control/{key}",
                congestion_control=zenoh.CongestionControl.BLOCK,
                priority=zenoh.Priority.INTERACTIVE_HIGH,
                express=True,
            )
        self._control_publishers[key].put(payload, attachment=control_mark(key))

    def ask_drained(self, node: str, key: str) -> None:
        self._query(
            f"drain/{node}",
            key.encode(),
            lambda replies: events.DrainedEvent(key, any(reply.ok for reply in replies)),
            timeout=DRAIN_TIMEOUT_S,
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.DATA,
            express=True,
        )

    def answer(self, query: zenoh.Query, payload: bytes | None) -> None:
        if payload is not None:
            query.reply(query.key_expr, payload)
        query.drop()

    def appear(self) -> None:
        self._token = self.session.liveliness().declare_token(f"{self.prefix}/alive/{self.protocol.name}")

    def hand_in_part(self, part: bytes) -> None:
        self._parts.put(part)

    def hand_in(self, results: bytes) -> None:
        """Files and parts of tables first: the launcher need not wait for a node with results."""
        self.hand_in_files()
        self._parts.finish()
        self._query(f"result/{self.protocol.name}", results, _handed_in, timeout=OFFER_TIMEOUT_S)

    def _query(self, key: str, payload: bytes, event: Callable[..., events.Event], **options: Any) -> None:
        """Send a query on a control key; once it has ended, put the event of its replies into the inbox."""
        replies = list[zenoh.Reply]()
        handler = direct(replies.append, lambda: self.inbox.put(event(replies)))
        stamp = control_mark(key)
        self.session.get(f"{self.prefix}/@control/{key}", handler, payload=payload, attachment=stamp, **options)


class _PartSender:
    """Hands in parts of tables in a thread of its own, one at a time: each again until the launcher has it."""

    def __init__(self, session: zenoh.Session, base: str, key: str) -> None:
        self._session = session
        self._key, self._mark = f"{base}/{key}", control_mark(key)
        self._queue: queue.Queue[bytes | None] = queue.Queue(_WAITING_PARTS)
        self._thread = threading.Thread(target=self._run, name="tables", daemon=True)
        self._finishing = False
        self._last_sign_s = 0.0  # of the launcher, since it is finishing

    def put(self, part: bytes) -> None:
        """Have a part sent; waits as long as others are waiting."""
        if self._thread.ident is None:
            self._thread.start()
        self._queue.put(part)

    def finish(self) -> None:
        """Wait until all parts are sent, or the launcher has not answered for a while."""
        if self._thread.is_alive():
            self._finishing, self._last_sign_s = True, time.monotonic()
            self._queue.put(None)
            self._thread.join()

    def _run(self) -> None:
        problem = ""
        while (part := self._queue.get()) is not None:
            if not problem and (problem := self._send(part)):  # then the launcher takes no later one
                log.error("a part of a table was not taken, nor are later ones: %s", problem)

    def _send(self, part: bytes) -> str:
        """Send a part; returns why the launcher has not taken it, or an empty string."""
        while not self._finishing or time.monotonic() - self._last_sign_s < HAND_IN_TIMEOUT_S:
            replies = list(self._session.get(self._key, payload=part, attachment=self._mark, timeout=OFFER_TIMEOUT_S))
            refusal = _handed_in(replies).refusal
            if refusal is not None:
                self._last_sign_s = time.monotonic()
                return refusal
        return f"the launcher has not answered within {HAND_IN_TIMEOUT_S:.0f} s"


def _handed_in(replies: list[zenoh.Reply]) -> events.HandedInEvent:
    """The event of the launcher's replies to results."""
    if any(reply.ok is not None for reply in replies):
        return events.HandedInEvent("")
    refusals = [files.decode_refusal(reply.err.payload.to_bytes()) for reply in replies if reply.err is not None]
    return events.HandedInEvent(next((str(refusal) for refusal in refusals if refusal), None))

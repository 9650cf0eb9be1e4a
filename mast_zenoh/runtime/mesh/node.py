"""Hosts one node as a process on a Zenoh mesh.

A Zenoh thread only puts samples on this process's inbox; the main thread takes them out, lets the host handle them,
and sends what the node has published. A node that is `prompt` handles what comes in real time in Zenoh's thread at
once, if nothing waits before it: from thread to thread costs more time than passing a message on. Control traffic lies
under mast/{run}/@control/, a verbatim chunk, where no wildcard sees it:

    epoch            driver → all      who takes part from now on; counters start anew
    counts/{node}    node → driver     messages sent and handled by key, whenever the inbox is empty
    failed/{node}    node → launcher   a handler has failed: its process, and an entry of mast_zenoh.control.failures
    stop             driver, launcher → all   finish, hand in results, leave
    leave/{node}     launcher → node   the same, for one of them
    act              driver → launcher what the scenario does to processes before this frame
    result/{node}    node → launcher   a query: the results, acknowledged by the reply
    fetch/{node}     node → launcher   a query, and
    file/{node}      node → launcher   another: see mast_zenoh.runtime.remote_node
    launcher         launcher          its liveliness token
    drain/{node}     node → node       see mast_zenoh.runtime.mesh.rewiring

mast_zenoh.control has their schemas, and says which of them are signed. What is none of these messages is counted,
logged once for each key, and dropped.
"""

from __future__ import annotations

import os
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from typing import Any

import zenoh

from mast_zenoh.control import files, flow, reports, results
from mast_zenoh.control.failures import Failure
from mast_zenoh.control.flow import WiringUpdate
from mast_zenoh.control.invalid import InvalidMessages
from mast_zenoh.control.signatures import Signatures
from mast_zenoh.errors import MessageError
from mast_zenoh.messages.schemas import SCHEMAS, Header
from mast_zenoh.messages.timespan import Timespan
from mast_zenoh.node import Node
from mast_zenoh.runtime.context import Outgoing
from mast_zenoh.runtime.host import Host
from mast_zenoh.runtime.limits import EARLY, INBOX, Room
from mast_zenoh.runtime.mesh.inbox import Inbox
from mast_zenoh.runtime.mesh.rewiring import Outlet, Rewiring, counted
from mast_zenoh.runtime.mesh.stamp import ATTACHMENT, MARK, stamp_of
from mast_zenoh.wiring.model import Leg, Wire, Wiring

_MATCH_TIMEOUT_S = 10.0
NOTED_FRAMES = 4096  #: of which a node knows when their messages came, by key

_RESULT_TIMEOUT_S = 20.0
_LINGER_S = 0.01


def prefix(run: str) -> str:
    """Where all keys of a run begin."""
    return f"mast/{run}"


class MeshNode:
    """One node on the mesh; `run_until_stopped` is its life. See the module's docstring.

    signatures: of the control messages of this run
    period_ns: of the scene's frames; lockstep: whether time goes by frames; without: nodes that are not up now
    timespan: the frames and times that messages can have; None: any
    """

    def __init__(
        self,
        run: str,
        name: str,
        node: Node,
        wiring: Wiring,
        seed: int,
        session: zenoh.Session,
        *,
        signatures: Signatures,
        period_ns: int,
        lockstep: bool,
        without: Collection[str] = (),
        timespan: Timespan | None = None,
    ) -> None:
        self.name = name
        self.wiring = wiring
        self.without = frozenset(without)
        self.ports = wiring.ports(name)
        now = None if lockstep else time.monotonic_ns
        self.host = Host(
            name,
            node,
            self.ports,
            seed,
            encode=True,
            period_ns=period_ns,
            now=now,
            emit=self._put,
            wiring=wiring,
            timespan=timespan,
        )
        self.session = session
        self.signatures = signatures
        self.inbox = Inbox()
        self.members: dict[str, str] = {}
        self.epoch = 0
        self.stop_reason: str | None = None
        self.foreign: Counter[str] = Counter()  # by key, messages that no node of this run has sent
        self.invalid = InvalidMessages(self.host.log.warning)  # control messages, by key
        self.arrived_ns: dict[str, dict[int, int]] = {}
        self.of_host: dict[str, Any] = {}  # what is known of where it runs, for run.json
        self._prefix = prefix(run)
        self._process = os.urandom(8).hex()  # tells this process from others that are the same node before and after it
        self.host.on_failure = self._report_failure
        self._started = False
        self._cpu_begun = time.process_time()
        self._early: list[tuple[str, bytes, int, int]] = []
        self._early_room = Room(EARLY)
        self._early_dropped: Counter[str] = Counter()  # of the next epoch, by key
        self._in_frame = 0  # messages that have come in this frame
        self._in_frames = (0, 0)  # and in the two before
        self.lockstep = lockstep
        self.outlets: dict[str, Outlet] = {}  # by the key of now, when the process begins
        self.newest: dict[str, bytes] = {}  # the last message of each key
        self.rewiring = Rewiring(self, self._prefix)
        self._inside = threading.RLock()  # one thread at a time is inside the node
        self._prompt = node.prompt and not lockstep
        self._queued = 0  # samples put into the inbox, counted by Zenoh's thread
        self._taken = 0  # samples handled from there, counted by the main thread
        self._subscribers: list[Any] = []
        self._declare()

    # -- life ----------------------------------------------------------------------------------------------------

    def run_until_stopped(self) -> None:
        """Join the mesh, take part until told to stop, hand in the results."""
        self.await_matching()
        alive = self.session.liveliness().declare_token(f"{self._prefix}/alive/{self.name}")
        while self.stop_reason is None:
            self.turn()
        self._prompt = False
        with self._inside:
            self.hand_in()
        alive.undeclare()

    def turn(self) -> None:
        """Send what is due, handle one event, or report when there is none."""
        with self._inside:
            due_s = self.host.release()
        try:
            event: tuple[Any, ...] | None = self.inbox.get_nowait()
        except queue.Empty:
            event = self.idle(due_s)
        if event is None:
            return
        with self._inside:
            self.handle(event)
        if event[0] == "sample":
            self._taken += 1

    def idle(self, due_s: float | None = None) -> tuple[Any, ...] | None:
        """Nothing to do: say so, and wait for the next event; None when a delayed message is due after `due_s`.

        While less has come than in the frames before, more is likely to be on its way: linger a little, because a
        report too many costs the driver more than the wait costs us. It is sent in any case.
        """
        if due_s is None and self._in_frame < min(self._in_frames):
            try:
                return self.inbox.get(timeout=_LINGER_S)
            except queue.Empty:
                pass
        self.report()
        try:
            return self.inbox.get(timeout=due_s)
        except queue.Empty:
            return None

    def handle(self, event: tuple[Any, ...]) -> None:
        """One event from the inbox."""
        kind, *rest = event
        if kind == "sample":
            frame = self.host.frame
            self._sample(*rest)
            if self.host.frame != frame:
                self._in_frames = (self._in_frames[1], self._in_frame)
                self._in_frame = 0
            self._in_frame += 1
        elif kind == "epoch":
            self._enter_epoch(*rest[0])
        elif kind == "stop":
            self.stop_reason = rest[0]
        elif kind == "dropped":
            self._note_dropped()
        elif kind in ("drain", "drained"):
            self.rewiring.handle(event)
        self.rewiring.answer()

    def report(self) -> None:
        """Tell the driver what has been sent and handled."""
        with self._inside:
            if self.epoch and not self.rewiring.busy:
                sent = counted(self.host.sent, self.outlets)
                self._counts.put(flow.encode_counts(self.epoch, sent, self.host.handled))

    def hand_in(self) -> None:
        """Finish the node and give its results to the launcher; keep trying until it says that it has them."""
        self._note_dropped()
        cpu_s = time.process_time() - self._cpu_begun
        outcome = {
            "results": self.host.finish() if self._started else {},
            "rejected": {f"{key}: {reason}": n for (key, reason), n in self.host.rejected.items()},
            "first_rejected": self.host.first_rejected,
            "foreign": dict(self.foreign),
            "invalid": self.invalid.entry(),
            "unsigned": self.signatures.obeyed,
            "process": self._process,
            "failures": [failure.entry() for failure in self.host.failures.values()],
            "last_frame": self.host.frame,
            "cpu_s": round(cpu_s, 4),
            "arrived_ns": self.arrived_ns,
        } | self.extra_results()
        outcome |= self.of_host
        payload = results.pack(outcome)
        deadline = time.monotonic() + _RESULT_TIMEOUT_S
        while time.monotonic() < deadline:
            for reply in self.session.get(f"{self._prefix}/@control/result/{self.name}", payload=payload, timeout=5.0):
                if reply.ok is not None:
                    return
                if reply.err is not None and (refusal := files.decode_refusal(reply.err.payload.to_bytes())):
                    self.host.log.error("the launcher refuses the results: %s", refusal)
                    return
        self.host.log.error("nobody took the results within %.0f s", _RESULT_TIMEOUT_S)

    def _report_failure(self, failure: Failure) -> None:
        """Tell the launcher at once, ahead of the counts: a process that is killed hands in nothing."""
        self._failed.put(reports.encode_failure(self._process, failure.entry()))

    def extra_results(self) -> dict[str, Any]:
        """What a special process adds to its results."""
        return {}

    def note_arrivals(self) -> None:
        """From now on note when the first message of each frame came on each key, on the wall clock.

        For measuring latency; of the newest frames only, so that no run is long enough to fill the memory.
        """

        def note(key: str, header: Header) -> None:
            came = self.arrived_ns.setdefault(key, {})
            came.setdefault(header.frame, time.time_ns())
            if len(came) > NOTED_FRAMES:
                del came[next(iter(came))]

        self.host.observe = note

    # -- messages ------------------------------------------------------------------------------------------------

    def _put(self, message: Outgoing) -> None:
        """Send what the node publishes, at once: whoever waits for it can begin while this node goes on."""
        assert isinstance(message.payload, bytes)
        attachment = ATTACHMENT.pack(MARK, self.epoch, message.step)
        self.outlets[message.key].put(message.payload, attachment)

    def _sample(self, key: str, payload: bytes, epoch: int, step: int) -> None:
        """A message of a wire; epoch, step: as `stamp_of` tells them."""
        if epoch < 0:
            self.foreign[key] += 1
            if self._started:
                self.host.deliver(key, payload, -1, counted=False)
        elif epoch > self.epoch and not self.rewiring.leaving:
            self._keep_early(key, payload, epoch, step)
        elif self._started:
            self.newest[key] = payload
            self.host.deliver(key, payload, step, counted=epoch == self.epoch)

    def _keep_early(self, key: str, payload: bytes, epoch: int, step: int) -> None:
        """Keep a message of an epoch that is still to come."""
        source = self.host.publisher(key)
        if self._early_room.take(source, len(payload)):
            self._early.append((key, payload, epoch, step))
            return
        self.host.drop(key, f"early: more than {EARLY} of {source} are of an epoch to come")
        if epoch == self.epoch + 1:
            self._early_dropped[key] += 1  # the driver will wait for it

    def _note_dropped(self) -> None:
        """Count what found no room in the inbox: rejected, and dealt with as far as lock-step goes."""
        for (key, epoch), count in self.inbox.take_dropped().items():
            reason = f"queued: more than {INBOX} of {self.host.publisher(key)} wait in the inbox"
            self.host.drop(key, reason, count=count, counted=count if epoch == self.epoch else 0)
            if epoch == self.epoch + 1:
                self._early_dropped[key] += count

    def control_came(self, key: str, payload: bytes) -> None:
        """Take up a control message, in Zenoh's thread: one that is malformed or not signed waits nowhere.

        key: below @control/, one of `epoch`, `stop`, and `leave` with this node's name
        """
        try:
            if key == "epoch":
                self.inbox.put(("epoch", self.signatures.open(key, payload, flow.decode_epoch)))
            else:
                self.inbox.put(("stop", self.signatures.open(key, payload, flow.decode_stop)))
        except MessageError as error:
            self.invalid.note(key, error)

    def _enter_epoch(self, epoch: int, members: dict[str, str], told: WiringUpdate | None = None) -> None:
        if epoch <= self.epoch or self.name not in members:
            return
        before, self.members, self.epoch = self.members, members, epoch
        self.host.reset_counts()
        dropped, self._early_dropped = self._early_dropped, Counter()
        self.host.handled.update(dropped)
        if not self._started:
            self._started = True
            self._cpu_begun = time.process_time()
            self.host.start({name: role for name, role in members.items() if name != self.name})
        else:
            for name in sorted(before.keys() - members.keys()):
                self.host.left(name, before[name])
            for name in sorted(members.keys() - before.keys()):
                self.host.joined(name, members[name])
        if told is not None:
            self.rewiring.follow(told)
            if told.active and told.wiring != self.host.wiring:
                self.host.rewired(told.wiring)
        early, self._early, self._early_room = self._early, [], Room(EARLY)
        for message in early:
            self._sample(*message)
        if told is not None:
            self.report()  # the change goes on when all have: do not linger

    # -- declarations --------------------------------------------------------------------------------------------

    def _declare(self) -> None:
        for key in self.ports.inputs:
            self.hear(key)
        drain: Any = zenoh.handlers.Callback(self.rewiring.take_question, indirect=False)
        self._subscribers.append(self.session.declare_queryable(f"{self._prefix}/@control/drain/{self.name}", drain))
        for key in ("epoch", "stop", f"leave/{self.name}"):
            self._subscribers.append(self.subscribe(f"@control/{key}", self._on_control(key)))
        for wire, leg in self.wiring.legs():
            if leg.publisher.node == self.name:
                self.outlets[leg.key] = Outlet(leg.key, self.declare_publisher(leg.key, wire.message))
        self._counts, self._failed = (
            self.session.declare_publisher(
                f"{self._prefix}/@control/{what}/{self.name}",
                congestion_control=zenoh.CongestionControl.BLOCK,
                priority=zenoh.Priority.INTERACTIVE_HIGH,
                express=True,
            )
            for what in ("counts", "failed")
        )

    def declare_publisher(self, key: str, message: str) -> zenoh.Publisher:
        """A publisher of a wire's messages on one of its keys: all legs alike, so that none can be told by it."""
        schema = SCHEMAS[message]
        # Lock-step waits for every message. In real time nobody waits: in a router, one whom nothing reaches any more
        # would hold up all others.
        congestion = zenoh.CongestionControl.BLOCK if self.lockstep else zenoh.CongestionControl.DROP
        return self.session.declare_publisher(
            f"{self._prefix}/{key}",
            encoding=f"application/msgpack;schema={schema.name}.{schema.version}",
            congestion_control=congestion,
            express=True,
        )

    def hear(self, key: str) -> None:
        """Have what comes on a wire's key come to the inbox."""
        self._subscribers.append(self.subscribe(key, self._on_sample(key)))

    def _on_control(self, key: str) -> Callable[[zenoh.Sample], None]:
        return lambda sample: self.control_came(key, sample.payload.to_bytes())

    def _on_sample(self, key: str) -> Callable[[zenoh.Sample], None]:
        put = self.inbox.put_sample

        def on_sample(sample: zenoh.Sample) -> None:
            attachment = sample.attachment
            epoch, step = stamp_of(attachment.to_bytes() if attachment else None)
            came = key, sample.payload.to_bytes(), epoch, step
            if self._prompt and self._handled_at_once(*came):
                return
            counts = epoch if epoch - self.epoch in (0, 1) else -1
            if put(self.host.publisher(key), ("sample", *came), counts):
                self._queued += 1

        return on_sample

    def _handled_at_once(self, key: str, payload: bytes, epoch: int, step: int) -> bool:
        """Handle a sample in the thread that brings it, unless another waits before it or the node is busy."""
        if self._queued != self._taken or not self._started or not self._inside.acquire(blocking=False):
            return False
        try:
            self._sample(key, payload, epoch, step)
            due_s = self.host.release()
        finally:
            self._inside.release()
        if due_s is not None or self.rewiring.asked:
            self.inbox.put(("due",))  # the main thread is to see to it
        return True

    def subscribe(self, key: str, callback: Callable[[zenoh.Sample], None]) -> Any:
        """A subscriber below the run's prefix whose callback runs in Zenoh's own thread: it must return at once."""
        handler = zenoh.handlers.Callback(callback, indirect=False)
        return self.session.declare_subscriber(f"{self._prefix}/{key}", handler)

    def await_matching(self) -> None:
        """Wait until every wire that somebody listens to has its listener, so that no first message is lost."""
        heard = [self.outlets[leg.key].publisher for wire, leg in self.wiring.legs() if self._is_heard(wire, leg)]
        self.await_listeners([*heard, self._counts, self._failed])

    def await_listeners(self, awaited: Sequence[zenoh.Publisher]) -> None:
        """Wait until each of these publishers has somebody who listens; go on without after a while."""
        pending = threading.Semaphore(0)
        direct: Any = zenoh.handlers.Callback(lambda status: pending.release(), indirect=False)
        listeners = [publisher.declare_matching_listener(direct) for publisher in awaited]
        deadline = time.monotonic() + _MATCH_TIMEOUT_S
        while missing := [publisher for publisher in awaited if not publisher.matching_status]:
            left = deadline - time.monotonic()
            if left <= 0:
                names = ", ".join(str(publisher.key_expr) for publisher in missing)
                self.host.log.warning("nobody listens to %s after %.0f s; going on", names, _MATCH_TIMEOUT_S)
                break
            pending.acquire(timeout=min(left, 0.1))
        for listener in listeners:
            listener.undeclare()

    def _is_heard(self, wire: Wire, leg: Leg) -> bool:
        """Whether it is a leg that this node speaks on and another that is up listens to."""
        hearers = {end.node for end in (*wire.hearers(leg), *self.wiring.overhearers)}
        return leg.publisher.node == self.name and bool(hearers - self.without)

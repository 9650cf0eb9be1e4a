"""Hosts one node as a process on a Zenoh mesh.

Zenoh's threads only put samples and control messages into this process's inbox; the main thread takes them out, lets
the host handle them, and sends the node's messages. In real time, a node that is `prompt` handles a sample immediately
in Zenoh's thread, if no other waits: switching threads takes longer than relaying a message.
"""

from __future__ import annotations

import os
import queue
import time
from collections.abc import Callable, Collection
from functools import partial
from typing import Any, ClassVar

import zenoh

from mast_zenoh.control import flow, prefix, reports, results
from mast_zenoh.control.failures import Failure
from mast_zenoh.control.flow import WiringUpdate
from mast_zenoh.control.invalid import InvalidMessages
from mast_zenoh.control.signatures import Signatures
from mast_zenoh.errors import MessageError
from mast_zenoh.messages.timespan import Timespan
from mast_zenoh.node import Node
from mast_zenoh.runtime.context import Outgoing
from mast_zenoh.runtime.host import Host
from mast_zenoh.runtime.lockstep.pacer import waits_for_listeners
from mast_zenoh.runtime.mesh import drain, results_client
from mast_zenoh.runtime.mesh.arrivals import Arrivals
from mast_zenoh.runtime.mesh.drain import DrainQueries
from mast_zenoh.runtime.mesh.inbox import Event, Inbox
from mast_zenoh.runtime.mesh.intake import Intake
from mast_zenoh.runtime.mesh.outlets import Outlets
from mast_zenoh.runtime.mesh.stamp import ATTACHMENT, MARK
from mast_zenoh.runtime.mesh.wiring_follower import WiringFollower
from mast_zenoh.runtime.mesh.zenoh_threads import keeping_state
from mast_zenoh.wiring.model import Wiring

_LINGER_S = 0.01  # for messages that are probably in transit
_DOZE_S = 0.004  # of a node that only listens


class MeshNode:
    """One node on the mesh, run by `run_until_stopped`.

    signatures: of control messages; period_ns: interval of the scene's frames, ns
    lockstep: whether time advances with frames; without: nodes that are not running yet
    timespan: valid frames and times of messages; None: any
    """

    #: the control messages that it publishes about itself
    report_kinds: ClassVar[Collection[str]] = ("counts", "failed")

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
        self.without = frozenset(without)
        self.ports = wiring.ports(name)
        self.host = Host(
            name,
            node,
            self.ports,
            seed,
            encode=True,
            period_ns=period_ns,
            now=None if lockstep else time.monotonic_ns,
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
        self.on_kill: Callable[[], None] | None = None  # ends the process at once
        self.hand_in_files: Callable[[], None] = lambda: None  # sends the rest of the files that the node has written
        self.invalid = InvalidMessages(self.host.log.warning)  # control messages, by key
        self.arrivals = Arrivals()
        self.host_facts: dict[str, Any] = {}  # facts of its host, for run.json
        self.lockstep = lockstep
        self._prefix = prefix(run)
        self._process = os.urandom(8).hex()  # distinguishes this process from earlier and later ones of this node
        self.host.on_failure = self._report_failure
        self._cpu_start_s = time.process_time()
        self.outlets = Outlets(session, self._prefix, self.host.log, lockstep=lockstep)
        self.drains = DrainQueries(
            name, self.host, self.ports, self.outlets, wiring, put=self.inbox.put, refuse=self.invalid.note
        )
        self.intake = Intake(self.host, self.inbox, self.drains, prompt=node.prompt and not lockstep)
        self.follower = WiringFollower(
            name,
            self.host,
            self.ports,
            self.outlets,
            self.drains,
            lockstep=lockstep,
            subscribe=self._subscribe_wire,
            ask=partial(drain.ask, session, self._prefix, self.inbox.put),
            report=self.report,
        )
        self._subscribers: list[Any] = []
        self._declare(wiring)

    # -- running -------------------------------------------------------------------------------------------------

    def run_until_stopped(self) -> None:
        """Join the mesh, take part until the run stops, hand in the results."""
        self.await_matching()
        alive = self.session.liveliness().declare_token(f"{self._prefix}/alive/{self.name}")
        while self.stop_reason is None:
            self.run_once()
        self.intake.prompt = False
        with self.intake.lock:
            self.hand_in()
        alive.undeclare()

    def run_once(self) -> None:
        """Send what is due, then handle one event, or report if there is none."""
        with self.intake.lock:
            due_s = self.host.release()
        try:
            event: Event | None = self.inbox.get_nowait()
        except queue.Empty:
            event = self.wait_for_event(due_s)
        if event is None:
            return
        with self.intake.lock:
            self.handle(event)
        if event[0] == "sample":
            self.intake.handled += 1

    def wait_for_event(self, due_s: float | None = None) -> Event | None:
        """Report, then wait for the next event; None if a delayed message is due first.

        due_s: time until then, s; None: no message is delayed

        While fewer messages were received than in the frames before, more are probably in transit. Waiting briefly for
        them costs less than an unnecessary report costs the driver. A node that the driver does not wait for sleeps, so
        that it takes many messages at once.
        """
        dozes = self.lockstep and not self.outlets and not waits_for_listeners(self.host.frame + 1)
        if dozes:
            time.sleep(_DOZE_S)
        if due_s is None and (dozes or self.intake.expects_more):
            try:
                return self.inbox.get(timeout=_LINGER_S)
            except queue.Empty:
                pass
        self.report()
        try:
            return self.inbox.get(timeout=due_s)
        except queue.Empty:
            return None

    def handle(self, event: Event) -> None:
        """Handle one event from the inbox."""
        kind = event[0]
        if kind == "sample":
            self.intake.handle(*event[1:])
        elif kind == "epoch":
            self._enter_epoch(*event[1])
        elif kind == "stop":
            self.stop_reason = event[1]
        elif kind == "dropped":
            self.intake.note_dropped()
        elif kind == "drain":
            self.drains.begin(*event[1:])
        elif kind == "drained":
            self.follower.resume(*event[1:])
        self.drains.answer()

    def report(self) -> None:
        """Tell the driver what has been sent and handled."""
        with self.intake.lock:
            if self.epoch and not self.follower.busy:
                sent = self.outlets.counted(self.host.sent)
                self._reports["counts"].put(flow.encode_counts(self.epoch, sent, self.host.handled))

    def hand_in(self) -> None:
        """Finish the node, and hand in its files and its results to the launcher."""
        self.intake.note_dropped()
        outcome = {
            "cpu_s": round(time.process_time() - self._cpu_start_s, 4),
            "results": self.host.finish() if self.intake.started else {},
            "rejected": {f"{key}: {reason}": n for (key, reason), n in self.host.rejected.items()},
            "first_rejected": self.host.first_rejected,
            "foreign": dict(self.intake.foreign),
            "invalid": self.invalid.entry(),
            "unsigned": self.signatures.obeyed,
            "process": self._process,
            "failures": [failure.entry() for failure in self.host.failures.values()],
            "last_frame": self.host.frame,
            "arrived_ns": self.arrivals.by_key,
            **self.extra_results(),
            **self.host_facts,
        }
        self.hand_in_files()  # first: the launcher need not wait for a node with results
        results_client.hand_in(self.session, self._prefix, self.name, results.pack(outcome), self.host.log)

    def _report_failure(self, failure: Failure) -> None:
        """Report a failure immediately: a process that is killed hands in no results."""
        self._reports["failed"].put(reports.encode_failure(self._process, failure.entry()))

    def extra_results(self) -> dict[str, Any]:
        """Additional results of the process, for subclasses."""
        return {}

    def note_arrivals(self) -> None:
        """From now on note when messages arrive, for measuring latency."""
        self.host.observe = self.arrivals.note

    def _put(self, message: Outgoing) -> None:
        """Send a message immediately: subscribers can handle it while this node continues."""
        assert isinstance(message.payload, bytes)
        self.outlets[message.key].put(message.payload, ATTACHMENT.pack(MARK, self.epoch, message.step))

    def _on_control(self, key: str, sample: zenoh.Sample) -> None:
        """Receive an epoch, stop or leave, in Zenoh's thread; invalid ones are dropped."""
        decode: Callable[[bytes], Any] = flow.decode_epoch if key == "epoch" else flow.decode_stop
        try:
            message = self.signatures.open(key, sample.payload.to_bytes(), decode)
        except MessageError as error:
            self.invalid.note(key, error)
        else:
            if self.on_kill is not None and key == f"leave/{self.name}" and message == flow.KILL:
                self.on_kill()
            self.inbox.put(("epoch" if key == "epoch" else "stop", message))

    def _enter_epoch(self, epoch: int, members: dict[str, str], update: WiringUpdate | None = None) -> None:
        if epoch <= self.epoch or self.name not in members:
            return
        previous, self.members, self.epoch = self.members, members, epoch
        self.host.reset_counts()
        self.host.handled.update(self.intake.enter_epoch(epoch))
        if not self.intake.started:
            self.intake.started = True
            self._cpu_start_s = time.process_time()
            self.host.start({name: role for name, role in members.items() if name != self.name})
        else:
            for name in sorted(previous.keys() - members.keys()):
                self.host.left(name, previous[name])
            for name in sorted(members.keys() - previous.keys()):
                self.host.joined(name, members[name])
        if update is not None:
            self.follower.follow(update)
            if update.active and update.wiring != self.host.wiring:
                self.host.rewired(update.wiring)
        self.intake.deliver_early()
        if update is not None:
            self.report()  # immediately: the change continues when all nodes have reported

    # -- declarations --------------------------------------------------------------------------------------------

    def _declare(self, wiring: Wiring) -> None:
        for key in self.ports.inputs:
            self._subscribe_wire(key)
        drains: Any = zenoh.handlers.Callback(self.drains.take, indirect=False)
        self._subscribers.append(self.session.declare_queryable(f"{self._prefix}/@control/drain/{self.name}", drains))
        for control in ("epoch", "stop", f"leave/{self.name}"):
            self._subscribers.append(self.subscribe(f"@control/{control}", partial(self._on_control, control)))
        for wire, leg in wiring.legs():
            if leg.publisher.node == self.name:
                self.outlets.add(leg.key, wire.message)
        self._reports = {kind: self._declare_control(f"{kind}/{self.name}") for kind in self.report_kinds}

    def _declare_control(self, key: str) -> zenoh.Publisher:
        """Declare a publisher of control messages; their own queue overtakes blocked data."""
        return self.session.declare_publisher(
            f"{self._prefix}/@control/{key}",
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
        )

    def _subscribe_wire(self, key: str) -> None:
        """Subscribe to a key of a wire; its messages go to the inbox."""
        self._subscribers.append(self.subscribe(key, self.intake.callback(key)))

    def subscribe(self, key: str, callback: Callable[[zenoh.Sample], None]) -> Any:
        """Declare a subscriber below the run's prefix.

        Its callback runs in Zenoh's thread and must return quickly.
        """
        return self.session.declare_subscriber(
            f"{self._prefix}/{key}", zenoh.handlers.Callback(keeping_state(callback), indirect=False)
        )

    def await_matching(self) -> None:
        """Wait until all wires with subscribers are matched, so that no message is lost."""
        subscribed = self.outlets.subscribed(self.follower.wiring, self.name, self.without)
        self.outlets.await_subscribers([*subscribed, *self._reports.values()])

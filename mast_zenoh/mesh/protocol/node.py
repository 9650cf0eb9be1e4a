"""A node's process as a state machine: events in, actions out, see `events`.

`receive_…` methods take what arrives, from any thread: they check it and put an event into the inbox. All others are
for one thread, which takes events from the inbox.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import Enum
from typing import Any

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import MessageError
from mast_zenoh.mesh.control import flow, results
from mast_zenoh.mesh.control.codec import InvalidMessages
from mast_zenoh.mesh.control.failures import Failure, encode_failure
from mast_zenoh.mesh.control.flow import WiringUpdate
from mast_zenoh.mesh.host import Host
from mast_zenoh.mesh.protocol import events
from mast_zenoh.mesh.protocol.events import Query
from mast_zenoh.mesh.protocol.pacer import waits_for_listeners
from mast_zenoh.mesh.protocol.rewiring import WiringFollower
from mast_zenoh.mesh.protocol.traffic import Outlets, ProcessContext, Receiving
from mast_zenoh.messages.schemas import Header
from mast_zenoh.node import Node
from mast_zenoh.wiring.model import Wiring

#: Source of clocks in the inbox, where other messages of their publisher take none of their room: without its clock, a
#: frame's messages would be held forever.
CLOCK = "clock"

MAX_FRAMES = 4096  #: number of frames, by key, whose times are kept: the newest
MATCH_TIMEOUT_S = 10.0  #: for a publisher to find its subscribers
HAND_IN_TIMEOUT_S = 20.0  #: for the launcher to accept the results
_HAND_IN_EVERY_S = 0.1  # as long as it does not answer
_LINGER_S = 0.01  # for messages that are probably in transit


class State(Enum):
    """What a node's process is doing."""

    JOINING = "joining"  # it has declared what it sends and receives, and waits for its first epoch
    MATCHING = "matching"  # in an epoch; its publishers do not know all their subscribers, so it does not report
    RUNNING = "running"  # it handles messages, and reports
    DRAINING = "draining"  # a publisher holds messages back until a node that leaves has forwarded everything
    HANDING_IN = "handing in"  # it has been stopped, and offers its results to the launcher
    ENDED = "ended"


class NodeProtocol:
    """One node in its process.

    resolved: the scenario, with the node `name`
    """

    def __init__(self, resolved: Resolved, name: str, node: Node, context: ProcessContext) -> None:
        self.name = name
        self.actions, self.inbox, self.clocks, process, self.signatures = context
        actions, clocks = self.actions, self.clocks
        self.lockstep = lockstep = resolved.mode == "lockstep"
        self.members: dict[str, str] = {}
        self.stop_reason: str | None = None
        self.on_kill: Callable[[], None] | None = None  # ends the process at once
        self.on_stop: Callable[[], None] = lambda: None  # ends what a handler waits for
        self.arrived_ns: dict[str, dict[int, int]] = {}  # in real time: by key, when the newest frames arrived
        self.host_facts: dict[str, Any] = {}  # facts of its host, for run.json
        self._process = process
        self._ended = False
        self._lingered = False
        self._unmatched: set[str] = set()
        self._match_deadline_ns = 0
        self._results: bytes | None = None  # when it hands them in
        self._hand_in_deadline_ns = 0
        self._offered = False  # whether it waits for the launcher's answer to them
        self._next_offer_ns = 0  # otherwise: when it offers them again
        self._cpu_start_s = 0.0
        wiring = Wiring.from_json(resolved.wiring)
        self.outlets = Outlets(wiring, name, actions)
        now = None if lockstep else clocks.monotonic_ns
        self.host = Host.of(resolved, name, node, wiring, encode=True, emit=self._emit, now=now)
        self.host.on_failure = self._report_failure
        self.host.observe = None if lockstep else self._note_arrival
        self.host.tables.hand_in = lambda part: actions.hand_in_part(results.encode_part(process, part))
        self.invalid = InvalidMessages(self.host.log.warning)  # control messages, by key
        self.receiving = Receiving(self.host)
        self.follower = WiringFollower(
            *(name, self.host, wiring.ports(name), self.outlets, self.receiving, actions),
            lockstep=lockstep,
            now_ns=clocks.monotonic_ns,
        )

    @property
    def epoch(self) -> int:
        """The current epoch; 0 before the first."""
        return self.receiving.epoch

    @property
    def state(self) -> State:
        """What the process is doing."""
        if self._ended:
            return State.ENDED
        if self._results is not None:
            return State.HANDING_IN
        if not self.epoch:
            return State.JOINING
        if self.follower.busy:
            return State.DRAINING
        return State.MATCHING if self._unmatched else State.RUNNING

    @property
    def ended(self) -> bool:
        """Whether the process is to end now."""
        return self._ended

    @property
    def dozes(self) -> bool:
        """Whether to sleep a little before the next message: a node that the driver does not wait for takes many."""
        return self.lockstep and not self.outlets and not waits_for_listeners(self.host.frame + 1)

    # -- what arrives, in any thread -------------------------------------------------------------------------------

    def receive_message(self, message: events.MessageEvent) -> bool:
        """Receive a message of a wire; False if there is no room for it."""
        counted = self.receiving.counted_epoch(message.epoch)
        port_input = self.host.subscriptions.get(message.key)
        is_clock = port_input is not None and port_input.message == "clock"
        source = CLOCK if is_clock else self.host.publisher(message.key)
        return self.inbox.put_message(source, message, counted)

    def receivers(self) -> dict[str, Callable[[str, bytes], None]]:
        """By control key, what receives the messages there, with their key; `*` stands for any node."""
        return {"epoch": self.receive_epoch, "stop": self.receive_stop, f"leave/{self.name}": self.receive_stop}

    def receive_epoch(self, key: str, payload: bytes) -> None:
        """Receive an epoch of the driver."""
        with self._refusing(key):
            self.inbox.put(events.EpochEvent(self.signatures.open(key, payload, flow.decode_epoch)))

    def receive_stop(self, key: str, payload: bytes) -> None:
        """Receive a request to stop; key: below @control/."""
        with self._refusing(key):
            reason = self.signatures.open(key, payload, flow.decode_stop)
            if self.on_kill is not None and key == f"leave/{self.name}" and reason == flow.KILL:
                self.on_kill()
            self.request_stop(reason)

    def request_stop(self, reason: str) -> None:
        """Have the node hand in its results and end; from any thread, or a signal handler."""
        self.on_stop()
        self.inbox.put(events.StopEvent(reason))

    def receive_drain(self, query: Query, payload: bytes) -> None:
        """Receive a drain query."""
        key = ""
        with self._refusing(f"drain/{self.name}"):
            key = self.follower.check_query(payload)
            self.inbox.put(events.DrainEvent(query, key))
        if not key:
            self.actions.answer(query, None)

    # -- running ---------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Join the mesh: others see the token after what was declared before it."""
        for key in self.host.subscriptions:
            self.actions.subscribe(key)
        self.outlets.declare(self.follower.wiring)
        self.actions.appear()

    def idle(self) -> float | None:
        """Prepare to wait for an event: report. Returns the time after which `handle` must be called, s; None: none.

        While fewer messages were received than in the frames before, more are probably in transit. Waiting briefly for
        them costs less than an unnecessary report costs the driver.
        """
        if self._results is not None:
            return self._seconds_until(self._hand_in_deadline_ns if self._offered else self._next_offer_ns)
        due_s = self.host.release()
        if not self._lingered and due_s is None and (self.dozes or self.receiving.expects_more):
            self._lingered = True
            return _LINGER_S
        self._lingered = False
        self.report()
        if self._unmatched:
            left_s = self._seconds_until(self._match_deadline_ns)
            return left_s if due_s is None else min(due_s, left_s)
        return due_s

    def handle(self, event: events.Event | None) -> None:
        """Handle an event from the inbox; None: the time that `idle` returned has passed."""
        if self._results is not None and not (self._offered or self._seconds_until(self._next_offer_ns)):
            self._offer(self._results)  # also between two of the launcher's requests to stop
        if event is None:
            if self._results is not None and not self._seconds_until(self._hand_in_deadline_ns):
                self.host.log.error("the launcher has not acknowledged the results within %.0f s", HAND_IN_TIMEOUT_S)
                self._ended = True
            return
        self._lingered = False
        if not self.lockstep:
            self.host.release()  # what is due leaves first
        match event:
            case events.MessageEvent():
                if self._results is None:
                    self.receiving.receive(event)
            case events.EpochEvent(epoch):
                self._enter_epoch(*epoch)
            case events.OutsideEvent():
                if self.receiving.started and self._results is None:
                    self.host.arrived()
            case events.StopEvent(reason):
                self._stop(reason)
            case events.MatchedEvent(key):
                self._unmatched.discard(key)
            case events.DroppedEvent(counts):
                self.receiving.note_dropped(counts)
            case events.DrainEvent(query, key):
                self.follower.begin_drain(query, key)
            case events.DrainedEvent(key, answered):
                self.follower.resume(key, answered)
            case events.HandedInEvent(refusal):
                self._note_handed_in(refusal)
        if self.follower.questioned:
            self.follower.answer_queries()

    def report(self) -> None:
        """Tell the driver what has been sent and handled."""
        if self.epoch and self._matched and not self.follower.busy and self._results is None:
            sent = self.outlets.counted(self.host.sent)
            self._send_counts(flow.encode_counts(self.epoch, sent, self.host.handled))

    # -- inside ----------------------------------------------------------------------------------------------------

    def _emit(self, message: Any) -> None:
        self.outlets.send(message, self.receiving.epoch)

    def _send_counts(self, counts: bytes) -> None:
        self.actions.control(f"counts/{self.name}", counts)

    def _report_failure(self, failure: Failure) -> None:
        """Report a failure immediately: a process that is killed hands in no results."""
        self.actions.control(f"failed/{self.name}", encode_failure(self._process, failure.entry()))

    @contextmanager
    def _refusing(self, key: str) -> Iterator[None]:
        """Count a malformed or unsigned control message on a key instead of raising MessageError."""
        try:
            yield
        except MessageError as error:
            self.invalid.note(key, error)

    @property
    def _matched(self) -> bool:
        """Whether all publishers have subscribers; after a while it goes on without those that are missing."""
        if self._unmatched and not self._seconds_until(self._match_deadline_ns):
            names = ", ".join(sorted(self._unmatched))
            self.host.log.warning("no subscriber for %s after %.0f s; continuing", names, MATCH_TIMEOUT_S)
            self._unmatched.clear()
        return not self._unmatched

    def _enter_epoch(self, epoch: int, members: dict[str, str], update: WiringUpdate | None = None) -> None:
        if epoch <= self.epoch or self.name not in members or self._results is not None:
            return
        previous, self.members = self.members, members
        first = not self.receiving.started
        self.receiving.enter_epoch(epoch)
        if first:
            self._cpu_start_s = self.clocks.cpu_s()
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
        self._match(update.wiring if update else self.follower.wiring)
        self.receiving.deliver_early()
        if update is not None:
            self.report()  # immediately: the change continues when all nodes have reported

    def _match(self, next_wiring: Wiring) -> None:
        """Begin to wait for the subscribers of all publishers; without them messages would be lost."""
        keys = self.outlets.received_by(self.members, self.outlets.keys_now, self.follower.wiring)
        keys |= self.outlets.received_by(self.members, self.follower.next_keys.values(), next_wiring)
        self._unmatched = self.actions.unmatched(keys)
        self._match_deadline_ns = self._after_ns(MATCH_TIMEOUT_S)

    def _stop(self, reason: str) -> None:
        """Finish the node, and begin to hand in its results."""
        if self._results is None:
            self.stop_reason = reason
            self.receiving.note_dropped(self.inbox.take_dropped())
            self._results = results.pack(self._outcome())
            self._hand_in_deadline_ns = self._after_ns(HAND_IN_TIMEOUT_S)
            self._offer(self._results)

    def _offer(self, packed: bytes) -> None:
        self._offered = True
        self.actions.hand_in(packed)

    def _outcome(self) -> dict[str, Any]:
        """The results of the node and of its process."""
        host = self.host
        return {
            "cpu_s": round(self.clocks.cpu_s() - self._cpu_start_s, 4),
            "results": host.finish() if self.receiving.started else {},
            "rejected": {f"{key}: {reason}": n for (key, reason), n in host.rejected.items()},
            "first_rejected": host.first_rejected,
            "unaccepted": host.unaccepted,
            "foreign": dict(self.receiving.foreign),
            "process": self._process,
            "failures": [failure.entry() for failure in host.failures.values()],
            "last_frame": host.frame,
            "arrived_ns": self.arrived_ns,
            **self.process_facts(),
        }

    def process_facts(self) -> dict[str, Any]:
        """What does not follow from the events that it has handled."""
        return {"invalid": self.invalid.entry(), "unsigned": self.signatures.obeyed, **self.host_facts}

    def _note_handed_in(self, refusal: str | None) -> None:
        if refusal:
            self.host.log.error("the launcher refuses the results: %s", refusal)
        self._ended, self._offered = refusal is not None, False
        self._next_offer_ns = self._after_ns(_HAND_IN_EVERY_S)

    def _after_ns(self, seconds: float) -> int:
        return self.clocks.monotonic_ns() + round(seconds * 1e9)

    def _seconds_until(self, deadline_ns: int) -> float:
        return max(0.0, (deadline_ns - self.clocks.monotonic_ns()) * 1e-9)

    def _note_arrival(self, key: str, header: Header) -> None:
        """Note the arrival of a valid message: of the first of each frame, and of the newest frames."""
        arrived_ns = self.arrived_ns.setdefault(key, {})
        arrived_ns.setdefault(header.frame, self.clocks.monotonic_ns())
        if len(arrived_ns) > MAX_FRAMES:
            del arrived_ns[next(iter(arrived_ns))]

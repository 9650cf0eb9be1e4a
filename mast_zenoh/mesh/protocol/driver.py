"""The driver as a state machine: the process of the scene's node, which begins each frame.

In lock-step, when the mesh is quiet; in real time, when the frame is due, whether nodes are ready or not. In both modes
a node that dies is dropped immediately, and one that joins or returns takes part from the next frame.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from mast_zenoh.config.resolved import LEAVING, ProcessStep, Resolved
from mast_zenoh.errors import MessageError
from mast_zenoh.mesh.control import flow
from mast_zenoh.mesh.control.flow import END, MAX_TEXT, StopKind, StopReason, decode_reason, encode_reason
from mast_zenoh.mesh.host import Outgoing
from mast_zenoh.mesh.protocol.events import CountsEvent, Event, PresenceEvent, Query, RewireEvent, StopEvent
from mast_zenoh.mesh.protocol.node import MAX_FRAMES, NodeProtocol
from mast_zenoh.mesh.protocol.pacer import Membership, Pacer, Timetable, TokenPresence, waits_for_listeners
from mast_zenoh.mesh.protocol.rewiring import Rewiring
from mast_zenoh.mesh.protocol.traffic import ProcessContext
from mast_zenoh.node import Context, Node, Source

#: How long the driver of a real-time run waits for the last messages before it stops all nodes.
REALTIME_GRACE_S = 0.5

#: Time without a report in lock-step, s, after which the driver checks whether the reports are plausible.
SUSPECT_S = 3.0

#: Nodes that publish nothing are waited for by this factor longer: an evaluator scores many frames at once.
LISTENER_PATIENCE = 6.0

#: A phase of the run. It yields the time until which it waits for an event, s, and gets whether there was one.
Phase = Generator[float, bool, StopReason | None]
#: The same, for a wait that tells whether there was an event.
Wait = Generator[float, bool, bool]


def protocol_of(resolved: Resolved, name: str, node: Node, context: ProcessContext) -> NodeProtocol:
    """The protocol of a node of a scenario; that of a Source drives the run."""
    if isinstance(node, Source):
        return DriverProtocol(resolved, name, node, context)
    return NodeProtocol(resolved, name, node, context)


class DriverState(Enum):
    """What the driver waits for."""

    GATHERING = "gathering"  # all nodes that are present from the beginning
    SETTLING = "settling"  # a quiet mesh; in real time at the end, the last messages
    ACTING = "acting"  # the launcher, which carries out process steps
    PACING = "pacing"  # in real time, the time of the next frame
    FINISHED = "finished"  # the launcher, which takes the results


class DriverProtocol(NodeProtocol):
    """A NodeProtocol whose node is a Source: it publishes in `advance`.

    timetable: the process steps; nodes that start later are not waited for at the beginning
    start_timeout_s, stall_timeout_s: how long to wait for nodes to start, and for the mesh to become quiet
    """

    start_timeout_s = 60.0
    stall_timeout_s = 30.0

    def __init__(self, resolved: Resolved, name: str, node: Source, context: ProcessContext) -> None:
        super().__init__(resolved, name, node, context)
        self.scene = SceneFrames(node, self.host, super()._emit, self.clocks.monotonic_ns)
        self.pacer = Pacer(self.host.wiring)
        self.membership = Membership(name, {other: spec.role for other, spec in resolved.nodes.items()})
        self.timetable = Timetable(resolved, lockstep=self.lockstep)
        self.period_s = resolved.period_ns * 1e-9 / resolved.rate
        self.frames = 0
        self.wall_s = 0.0
        self.fatal_problem = ""  # why the run must end, such as implausible counters of a node
        self.rewiring = Rewiring(
            *(self.membership, self.pacer, self.follower, self.actions, self.host.log),
            now_ns=self.clocks.monotonic_ns,
            frame=lambda: self.frames,
            begin_epoch=self._begin_epoch,
        )
        self.driver_state = DriverState.GATHERING
        self._phases = self._run()
        self._deadline_s = 0.0
        self._announcement = b""

    # -- what arrives, in any thread -------------------------------------------------------------------------------

    def receivers(self) -> dict[str, Callable[[str, bytes], None]]:
        return {**super().receivers(), "counts/*": self.receive_counts}

    def receive_counts(self, key: str, payload: bytes) -> None:
        """Receive and decode a node's counters.

        Decoding here keeps the main thread free. Messages that this thread does not read in time fill the router's
        queue, until the router closes the link.
        """
        node = key.removeprefix("counts/")
        try:
            counts = flow.decode_counts(payload)
            if node == self.name:
                raise MessageError(f"counts: of {node}, the driver, which counts its messages itself")
        except MessageError as error:
            self.invalid.note(f"counts/{node if node in self.membership.expected else '*'}", error)
        else:
            self.inbox.put_newest(CountsEvent(node, counts))

    def receive_presence(self, node: str, present: bool) -> None:
        """Receive a change of a node's liveliness token."""
        self.inbox.put_newest(PresenceEvent(node, TokenPresence(not present, present)))

    def receive_rewire(self, query: Query, payload: bytes) -> None:
        """Receive a request to change the wiring; refuse malformed ones."""
        change = None
        with self._refusing("rewire"):
            change = self.signatures.open("rewire", payload, flow.decode_rewire)
            self.inbox.put(RewireEvent(query, change))
        if change is None:
            self.actions.answer(query, None)

    # -- running ---------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Join the mesh, and begin to wait for the nodes."""
        super().start()
        self._deadline_s = next(self._phases)

    def idle(self) -> float | None:
        """The time after which `handle` must be called, s."""
        if self._results is not None:
            return super().idle()
        return max(0.0, self._deadline_s - self._now_s)

    def handle(self, event: Event | None) -> None:
        """Handle an event from the inbox, and go on with the run; None: the time that `idle` returned has passed."""
        if self._results is not None:
            super().handle(event)
            return
        match event:
            case CountsEvent(node, counts):
                self.fatal_problem = self.fatal_problem or self.pacer.report(node, *counts)
            case PresenceEvent(node, presence):
                participants = self.members.keys() & self.pacer.heard
                problem = self.membership.note(node, presence, self.frames, participants)
                self.fatal_problem = self.fatal_problem or problem
                self.pacer.drop(self.pacer.members.keys() - self.membership.present.keys())
            case StopEvent(reason):
                self.stop_reason = reason
            case RewireEvent(query, change):
                if refusal := self.rewiring.add(change, query):
                    self.invalid.note("rewire", refusal)
                    self.actions.answer(query, None)
                self.report()
            case None:
                self.report()
            case _:
                super().handle(event)
                self.report()
        try:
            self._deadline_s = self._phases.send(event is not None)
        except StopIteration:
            self._finish()

    def report(self) -> None:
        """Take the driver's own counts, without the mesh: they would return after later ones."""
        if not self._matched:
            return
        self.pacer.report(self.name, self.epoch, self.outlets.counted(self.scene.sent), dict(self.host.handled))

    # -- phases: each returns a reason to stop, or None-------------------------------------------------------------

    def _run(self) -> Generator[float, bool, None]:
        reason = (yield from self._gather()) or (yield from self._play())
        self.driver_state = DriverState.FINISHED
        if self.stop_reason is None:
            self.stop_reason = encode_reason(reason)[:MAX_TEXT] if reason else ""
            self.actions.control("stop", self.signatures.sign("stop", self.stop_reason.encode()))

    def _finish(self) -> None:
        assert self.stop_reason is not None
        self._stop(self.stop_reason)

    def _gather(self) -> Phase:
        """Wait until all initial nodes are alive and have entered an epoch: a token alone may be a foreign client's."""
        deadline = self._now_s + self.start_timeout_s
        nodes = self.membership
        while missing := nodes.expected.keys() - self.timetable.absent - (nodes.present.keys() & self.pacer.members):
            if missing <= nodes.alive:
                self._begin_epoch()
                if reason := (yield from self._await_quiet(include_listeners=True)):
                    return reason
            elif not (yield from self._wait(DriverState.GATHERING, deadline)):
                problem = f"not there after {self.start_timeout_s:.0f} s: {', '.join(sorted(missing))}"
                return self._end_reason or StopReason(StopKind.START, problem)
        return None

    def _play(self) -> Phase:
        started = self._now_s
        reason = yield from self._play_frames(started)
        self.wall_s = self._now_s - started
        if reason == END and self.lockstep:
            reason = (yield from self._await_quiet(include_listeners=True)) or reason
        if reason == END and not self.lockstep:
            grace = self._now_s + REALTIME_GRACE_S
            while (yield from self._wait(DriverState.SETTLING, grace)):
                pass
        return reason

    def _play_frames(self, started: float) -> Phase:
        while True:
            while self.lockstep and (self.membership.differs(self.members) or self.rewiring.due):
                if reason := (yield from self._update_members()) or (yield from self._rewire()):
                    return reason
                if self.members.keys() == {self.name} and not self.membership.differs(self.members):
                    return self._stalled(f"no other node is on the mesh before frame {self.frames}")
            if not self.lockstep:
                yield from self._await_due(started + self.frames * self.period_s)
            if reason := self._end_reason or (yield from self._carry_out()):
                return reason
            if not self._send_frame():
                return END
            self.frames += 1
            if self.lockstep and (
                reason := (yield from self._await_quiet(include_listeners=waits_for_listeners(self.frames)))
            ):
                return reason

    def _await_due(self, due: float) -> Generator[float, bool, None]:
        """In real time, wait until a frame is due; nodes join and leave meanwhile, and the wiring changes."""
        while (yield from self._wait(DriverState.PACING, due)):
            while self.membership.differs(self.members):
                self._begin_epoch()
            self.rewiring.advance()

    def _update_members(self) -> Phase:
        """In lock-step, begin an epoch between two frames whenever nodes have come or gone."""
        while self.membership.differs(self.members):
            if reason := (yield from self._await_quiet(include_listeners=True)):
                return reason
            self._begin_epoch()
            if reason := (yield from self._await_quiet(include_listeners=True)):
                return reason
        return None

    def _rewire(self) -> Phase:
        """Carry out requested changes of the wiring, between two frames.

        Listeners are waited for, too: what is on the way to them counts for nothing in the next epoch.
        """
        under_way = self.rewiring.due
        while under_way:
            if reason := (yield from self._await_quiet(include_listeners=True)):
                return reason
            under_way = self.rewiring.advance() or bool(self.pacer.silent)  # also after one that was cancelled
        return None

    def _carry_out(self) -> Phase:
        """Have the launcher carry out the process steps before the next frame.

        In lock-step the mesh must be quiet first, and each group of steps is followed by a new epoch. So is a node that
        comes or goes meanwhile: perhaps no step is left then.
        """
        alive = self.membership.alive
        if self.lockstep and any(self.timetable.before(self.frames, alive)):
            quiet = yield from self._await_quiet(include_listeners=True)
            if reason := quiet or (yield from self._update_members()):
                return reason
        for group in self.timetable.before(self.frames, alive if self.lockstep else None):
            self.membership.leaving |= {step.node for step in group if step.action in LEAVING}
            act = flow.encode_act(self.frames, [(step.action, step.node) for step in group])
            self.actions.control("act", self.signatures.sign("act", act))
            if self.lockstep and (reason := (yield from self._await_done(group))):
                return reason
        return None

    def _await_done(self, group: list[ProcessStep]) -> Phase:
        """Wait until the nodes of a group have ended or started, and all others know it."""
        deadline, alive = self._now_s + self.start_timeout_s, self.membership.alive
        while pending_steps := [step for step in group if (step.node in alive) != (step.action == "start")]:
            if not (yield from self._wait(DriverState.ACTING, deadline)):
                names = ", ".join(f"{step.action} {step.node}" for step in pending_steps)
                return self._stalled(f"not done before frame {self.frames}: {names}")
        return (yield from self._update_members())

    def _await_quiet(self, *, include_listeners: bool = False) -> Phase:
        """In lock-step, wait until no message is in transit."""
        begin = self._now_s
        while not self.pacer.quiet(include_listeners=include_listeners):
            only_listeners = include_listeners and self.pacer.quiet()
            deadline = begin + self.stall_timeout_s * (LISTENER_PATIENCE if only_listeners else 1.0)
            if not (yield from self._wait(DriverState.SETTLING, min(deadline, self._now_s + SUSPECT_S))):
                if self.pacer.silent:  # a node whose token was claimed before it was there has missed the epoch
                    self.actions.control("epoch", self._announcement)
                self.fatal_problem = self.fatal_problem or self.pacer.implausible()
                if self._end_reason or self._now_s >= deadline:
                    return self._stalled("; ".join(list(self.pacer.unsettled())[:5]))
        return None

    def _wait(self, state: DriverState, deadline: float) -> Wait:
        """Wait for one event; False if the deadline, s, has passed or the run ends."""
        self.driver_state = state
        return not self._end_reason and (yield deadline)

    # -- inside ----------------------------------------------------------------------------------------------------

    @property
    def _now_s(self) -> float:
        return self.clocks.monotonic_ns() * 1e-9

    @property
    def _end_reason(self) -> StopReason | None:
        """Why the run ends now; None if it continues."""
        if self.stop_reason:
            return decode_reason(self.stop_reason)
        return StopReason(StopKind.IMPLAUSIBLE, self.fatal_problem) if self.fatal_problem else None

    def _stalled(self, detail: str) -> StopReason:
        return self._end_reason or StopReason(StopKind.STALL, detail)

    def _send_frame(self) -> bool:
        """Send a frame, and prepare the next one; False if the scene has ended."""
        if not self.scene.send(self.frames):
            return False
        self.report()
        if not self.host.subscriptions:  # otherwise the next frame depends on what arrives during this one
            self.scene.prepare()
        return True

    def _emit(self, message: Outgoing) -> None:
        self.scene.keep(message)

    def _begin_epoch(self) -> None:
        members, update = self.membership.begin_epoch(), self.rewiring.update
        left, joined = self.members.keys() - members.keys(), members.keys() - self.members.keys()
        if self.frames:
            self.host.log.info("frame %d: left: %s; joined: %s", self.frames, sorted(left), sorted(joined))
        epoch = self.pacer.begin_epoch(members)
        self.scene.sent.clear()
        self._announcement = self.signatures.sign("epoch", flow.encode_epoch(epoch, members, update))
        self.actions.control("epoch", self._announcement)
        self._enter_epoch(epoch, members, update)
        self.report()

    def _outcome(self) -> dict[str, Any]:
        """Also the duration of the run, when each frame was sent, and which nodes were lost."""
        facts = {"frames": self.frames, "wall_s": self.wall_s, "stop_reason": self.stop_reason}
        return super()._outcome() | facts | {"sent_ns": self.scene.sent_ns, "churn": self.membership.churn}


@dataclass(eq=False)
class SceneFrames:
    """Prepares each frame while the mesh handles the previous one, if it does not depend on that.

    Until it is sent, a frame is only bytes in this process: no node can act on it too early.

    send_message: sends it;  now_ns: the monotonic clock
    sent:    messages of the current epoch, by key
    sent_ns: times when the newest frames were sent, ns
    """

    source: Source
    context: Context
    send_message: Callable[[Outgoing], None]
    now_ns: Callable[[], int]
    sent: Counter[str] = field(default_factory=Counter)
    sent_ns: dict[int, int] = field(default_factory=dict)
    _ready: list[Outgoing] | None = None

    def keep(self, message: Outgoing) -> None:
        """Keep what the source publishes until its frame is sent."""
        assert self._ready is not None
        self._ready.append(message)

    def prepare(self) -> None:
        """Prepare the next frame; at the end of the scene it has no messages."""
        self._ready = []
        self.source.advance(self.context)

    def send(self, number: int) -> bool:
        """Send the prepared frame as frame `number`; False if there is none."""
        if self._ready is None:
            self.prepare()
        if not self._ready:
            return False
        self.sent_ns[number] = self.now_ns()
        self.sent_ns.pop(number - MAX_FRAMES, None)
        for message in self._ready:
            self.send_message(message)
            self.sent[message.key] += 1
        self._ready = None
        return True

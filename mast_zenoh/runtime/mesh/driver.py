"""The driver: the process of the scene's node, which begins each frame.

In lock-step, when the mesh is quiet; in real time, when the frame is due, whether nodes are ready or not. In both modes
a node that dies is dropped immediately, and one that joins or returns takes part from the next frame.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Collection
from typing import Any

import zenoh

from mast_zenoh.config.process_steps import ProcessStep
from mast_zenoh.control import flow
from mast_zenoh.control.flow import Counts
from mast_zenoh.control.signatures import Signatures
from mast_zenoh.control.stop_reasons import END, MAX_TEXT, StopKind, StopReason, decode_reason, encode_reason
from mast_zenoh.errors import MessageError
from mast_zenoh.messages.timespan import Timespan
from mast_zenoh.node import Source
from mast_zenoh.runtime.context import Outgoing
from mast_zenoh.runtime.lockstep.pacer import Pacer, waits_for_listeners
from mast_zenoh.runtime.lockstep.timetable import LEAVING, Timetable
from mast_zenoh.runtime.mesh.inbox import Event
from mast_zenoh.runtime.mesh.membership import Membership
from mast_zenoh.runtime.mesh.newest import NewestByNode
from mast_zenoh.runtime.mesh.node import MeshNode
from mast_zenoh.runtime.mesh.scene_frames import SceneFrames
from mast_zenoh.runtime.mesh.wiring_coordinator import WiringCoordinator
from mast_zenoh.wiring.model import Wiring

#: How long the driver of a real-time run waits for the last messages before it stops all nodes.
REALTIME_GRACE_S = 0.5

#: Time without a report in lock-step, s, after which the driver checks whether the reports are plausible.
SUSPECT_S = 3.0


class Driver(MeshNode):
    """A MeshNode whose node is a Source: it has no inputs and publishes in `advance`.

    expected: name to role of all nodes
    timetable: the process steps; nodes that start later are not waited for at the beginning
    start_timeout_s, stall_timeout_s: how long to wait for nodes to start, and for the mesh to become quiet
    """

    report_kinds = ("failed",)

    def __init__(
        self,
        run: str,
        name: str,
        node: Source,
        wiring: Wiring,
        seed: int,
        session: zenoh.Session,
        *,
        signatures: Signatures,
        expected: dict[str, str],
        period_ns: int,
        lockstep: bool,
        rate: float,
        timetable: Timetable,
        without: Collection[str] = (),
        timespan: Timespan | None = None,
        start_timeout_s: float = 60.0,
        stall_timeout_s: float = 30.0,
    ) -> None:
        options: Any = {"period_ns": period_ns, "lockstep": lockstep, "without": without, "timespan": timespan}
        super().__init__(run, name, node, wiring, seed, session, signatures=signatures, **options)
        self.scene = SceneFrames(node, self.host, super()._put)
        self.pacer = Pacer(wiring)
        self.membership = Membership(name, expected, self.inbox.put)
        self.timetable = timetable
        self.period_s = period_ns * 1e-9 / rate
        self.start_timeout_s = start_timeout_s
        self.stall_timeout_s = stall_timeout_s
        self.frames = 0
        self.wall_s = 0.0
        self.fatal_problem = ""  # why the run must end, such as implausible counters of a node
        self._newest_counts: NewestByNode[Counts] = NewestByNode("counts", self.inbox.put)
        self.coordinator = WiringCoordinator(
            self.membership,
            self.pacer,
            self.follower,
            self.host.log,
            frame=lambda: self.frames,
            begin_epoch=self._begin_epoch,
        )
        self._epoch_publisher, self._act_publisher, self._stop_publisher = map(
            self._declare_control, ("epoch", "act", "stop")
        )
        self._subscribers.append(self.subscribe("@control/counts/*", self._on_counts))
        rewire: Any = zenoh.handlers.Callback(self._on_rewire, indirect=False)
        self._subscribers.append(session.declare_queryable(f"{self._prefix}/@control/rewire", rewire))
        presence: Any = zenoh.handlers.Callback(self.membership.on_token, indirect=False)
        liveliness = session.liveliness()
        self._subscribers.append(liveliness.declare_subscriber(f"{self._prefix}/alive/*", presence, history=True))

    def run_until_stopped(self) -> None:
        """Wait for all nodes, play the scene, stop all nodes, hand in the results."""
        self.await_matching()
        alive = self.session.liveliness().declare_token(f"{self._prefix}/alive/{self.name}")
        reason = self._gather() or self._play()
        if self.stop_reason is None:
            self.stop_reason = encode_reason(reason)[:MAX_TEXT]
            self._stop_publisher.put(self.signatures.sign("stop", self.stop_reason.encode()))
        self.hand_in()
        alive.undeclare()

    def report(self) -> None:
        """Take the driver's own counts, without the mesh: they would return after later ones."""
        self.pacer.report(self.name, self.epoch, self.outlets.counted(self.scene.sent), dict(self.host.handled))

    def extra_results(self) -> dict[str, Any]:
        """Duration of the run, when each frame was sent, and which nodes were lost."""
        facts = {"frames": self.frames, "wall_s": self.wall_s, "stop_reason": self.stop_reason}
        return facts | {"sent_ns": self.scene.sent_ns, "churn": self.membership.churn}

    # -- phases: each returns a reason to stop, or None-----------------------------------------------------------

    def _gather(self) -> StopReason | None:
        """Wait until all initial nodes are alive and have entered an epoch: a token alone may be a foreign client's."""
        deadline = time.monotonic() + self.start_timeout_s
        nodes = self.membership
        while missing := nodes.expected.keys() - self.timetable.absent - (nodes.alive & self.pacer.members.keys()):
            if missing <= nodes.alive:
                self._begin_epoch()
                if reason := self._await_quiet(include_listeners=True):
                    return reason
            elif not self._wait(deadline):
                problem = f"not there after {self.start_timeout_s:.0f} s: {', '.join(sorted(missing))}"
                return self._end_reason or StopReason(StopKind.START, problem)
        return None

    def _play(self) -> StopReason:
        started = time.monotonic()
        reason = self._play_frames(started)
        self.wall_s = time.monotonic() - started
        if reason == END and self.lockstep:
            reason = self._await_quiet(include_listeners=True) or reason
        if reason == END and not self.lockstep:
            grace = time.monotonic() + REALTIME_GRACE_S
            while self._wait(grace):
                pass
        return reason

    def _play_frames(self, started: float) -> StopReason:
        while True:
            if self.membership.differs(self.members):
                self._begin_epoch()
                if self.lockstep and self.members.keys() == {self.name}:
                    return self._stalled(f"no other node is on the mesh before frame {self.frames}")
                if self.lockstep and (reason := self._await_quiet()):
                    return reason
            if self.lockstep and (reason := self._rewire()):
                return reason
            if not self.lockstep:
                due = started + self.frames * self.period_s
                while self._wait(due):
                    if self.membership.differs(self.members):
                        self._begin_epoch()
                    self.coordinator.advance()
            if reason := self._end_reason or self._carry_out():
                return reason
            if not self._send_frame():
                return END
            self.frames += 1
            if self.lockstep and (reason := self._await_quiet(include_listeners=waits_for_listeners(self.frames))):
                return reason

    def _rewire(self) -> StopReason | None:
        """Carry out requested changes of the wiring, between two frames."""
        while self.coordinator.advance():
            if reason := self._await_quiet(include_listeners=True):
                return reason
        return None

    def _carry_out(self) -> StopReason | None:
        """Have the launcher carry out the process steps before the next frame.

        In lock-step the mesh must be quiet first, and each group of steps is followed by a new epoch.
        """
        alive = self.membership.alive
        has_steps = self.lockstep and any(self.timetable.before(self.frames, alive))
        if has_steps and (reason := self._await_quiet(include_listeners=True)):
            return reason
        for group in self.timetable.before(self.frames, alive if self.lockstep else None):
            self.membership.leaving |= {step.node for step in group if step.action in LEAVING}
            act = flow.encode_act(self.frames, [(step.action, step.node) for step in group])
            self._act_publisher.put(self.signatures.sign("act", act))
            if self.lockstep and (reason := self._await_done(group)):
                return reason
        return None

    def _await_done(self, group: list[ProcessStep]) -> StopReason | None:
        """Wait until the nodes of a group have ended or started, and all others know it."""
        deadline, alive = time.monotonic() + self.start_timeout_s, self.membership.alive
        while pending_steps := [step for step in group if (step.node in alive) != (step.action == "start")]:
            if not self._wait(deadline):
                names = ", ".join(f"{step.action} {step.node}" for step in pending_steps)
                return self._stalled(f"not done before frame {self.frames}: {names}")
        self._begin_epoch()
        return self._await_quiet(include_listeners=True)

    def _send_frame(self) -> bool:
        """Send a frame, and prepare the next one; False if the scene has ended."""
        if not self.scene.send(self.frames):
            return False
        self.report()
        self.scene.prepare()
        return True

    def _put(self, message: Outgoing) -> None:
        self.scene.keep(message)

    def _await_quiet(self, *, include_listeners: bool = False) -> StopReason | None:
        deadline = time.monotonic() + self.stall_timeout_s
        while not self.pacer.quiet(include_listeners=include_listeners):
            if not self._wait(min(deadline, time.monotonic() + SUSPECT_S)):
                if self.pacer.silent:  # a node whose token was claimed before it was there has missed the epoch
                    self._epoch_publisher.put(self._announcement)
                self.fatal_problem = self.fatal_problem or self.pacer.implausible()
                if self._end_reason or time.monotonic() >= deadline:
                    return self._stalled("; ".join(list(self.pacer.unsettled())[:5]))
            self.pacer.drop(self.pacer.members.keys() - self.membership.alive)
        return None

    # -- inside --------------------------------------------------------------------------------------------------

    @property
    def _end_reason(self) -> StopReason | None:
        """Why the run ends now; None if it continues."""
        if self.stop_reason:
            return decode_reason(self.stop_reason)
        return StopReason(StopKind.IMPLAUSIBLE, self.fatal_problem) if self.fatal_problem else None

    def _stalled(self, detail: str) -> StopReason:
        return self._end_reason or StopReason(StopKind.STALL, detail)

    def _wait(self, deadline: float) -> bool:
        """Handle one event; False if the deadline has passed or the run ends."""
        if self._end_reason:
            return False
        try:
            event: Event = self.inbox.get(timeout=max(0.0, deadline - time.monotonic()))
        except queue.Empty:
            return False
        if event[0] == "counts":
            self._take_counts(event[1])
        elif event[0] == "alive":
            lost_too_often = self.membership.take(event[1], self.frames, self.members.keys() & self.pacer.heard)
            self.fatal_problem = self.fatal_problem or lost_too_often
        else:
            self.handle(event)
            self.report()
        return True

    def _on_counts(self, sample: zenoh.Sample) -> None:
        """Receive and decode a node's counters, in Zenoh's thread.

        Decoding here keeps the main thread free. Samples that this thread does not read in time fill the router's
        queue, until the router closes the link.
        """
        node = str(sample.key_expr).rpartition("/")[2]
        try:
            counts = flow.decode_counts(sample.payload.to_bytes())
            if node == self.name:
                raise MessageError(f"counts: of {node}, the driver, which counts its messages itself")
        except MessageError as error:
            self.invalid.note(f"counts/{node if node in self.membership.expected else '*'}", error)
        else:
            self._newest_counts.note(node, counts)

    def _take_counts(self, node: str) -> None:
        self.fatal_problem = self.fatal_problem or self.pacer.report(node, *self._newest_counts.take(node))

    def _on_rewire(self, query: zenoh.Query) -> None:
        """Receive a request to change the wiring, in Zenoh's thread; drop malformed ones."""
        try:
            payload = query.payload.to_bytes() if query.payload else b""
            self.coordinator.add(self.signatures.open("rewire", payload, flow.decode_rewire), query)
        except MessageError as error:
            self.invalid.note("rewire", error)
            query.drop()
        else:
            self.inbox.put(("rewire",))

    def _begin_epoch(self) -> None:
        members, update = self.membership.present, self.coordinator.update
        left, joined = self.members.keys() - members.keys(), members.keys() - self.members.keys()
        if self.frames:
            self.host.log.info("frame %d: left: %s; joined: %s", self.frames, sorted(left), sorted(joined))
        epoch = self.pacer.begin_epoch(members)
        self.scene.sent.clear()
        self._announcement = self.signatures.sign("epoch", flow.encode_epoch(epoch, members, update))
        self._epoch_publisher.put(self._announcement)
        self._enter_epoch(epoch, members, update)
        if update is None:  # with one, it has reported
            self.report()

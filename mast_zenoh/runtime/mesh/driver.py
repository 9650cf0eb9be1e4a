"""The process of the node that drives the scene: it decides when the next frame begins.

Lock-step: when the mesh is quiet. Real time: when its time has come, whether nodes are ready or not. In both modes a
node that dies is dropped at once, and one that comes (back) takes part from the next frame on.
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
from mast_zenoh.runtime.lockstep.pacer import Pacer
from mast_zenoh.runtime.lockstep.timetable import LEAVING, Timetable
from mast_zenoh.runtime.mesh.inbox import Event
from mast_zenoh.runtime.mesh.membership import Membership
from mast_zenoh.runtime.mesh.newest import NewestByNode
from mast_zenoh.runtime.mesh.node import MeshNode
from mast_zenoh.runtime.mesh.scene_frames import SceneFrames
from mast_zenoh.runtime.mesh.wiring_coordinator import WiringCoordinator
from mast_zenoh.wiring.model import Wiring

#: How long the last messages of a real-time run may be under way before all nodes are told to stop.
REALTIME_GRACE_S = 0.5

#: After so long without a report in lock-step, seconds, the driver asks whether the reports can be true.
SUSPECT_S = 3.0

#: After so many frames of lock-step, nodes that only listen must have caught up.
SETTLE_EVERY = 50


class Driver(MeshNode):
    """A MeshNode whose node is a Source, which hears nothing and publishes in `advance`.

    expected: name to role of all nodes
    timetable: what happens to their processes; a node that is not there at the beginning is not waited for
    start_timeout_s, stall_timeout_s: how long to wait for them, and for the mesh to become quiet
    """

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
        more: Any = {"period_ns": period_ns, "lockstep": lockstep, "without": without, "timespan": timespan}
        super().__init__(run, name, node, wiring, seed, session, signatures=signatures, **more)
        self.scene = SceneFrames(node, self.host, super()._put)
        self.pacer = Pacer(wiring)
        self.membership = Membership(name, expected, self.inbox.put)
        self.timetable = timetable
        self.period_s = period_ns * 1e-9 / rate
        self.start_timeout_s = start_timeout_s
        self.stall_timeout_s = stall_timeout_s
        self.frames = 0
        self.wall_s = 0.0
        self.complaint = ""  # why the run cannot go on: a node's counters cannot be true
        self._newest_counts: NewestByNode[Counts] = NewestByNode("counts", self.inbox.put)
        self.coordinator = WiringCoordinator(
            self.membership,
            self.pacer,
            self.follower,
            self.host.log,
            frame=lambda: self.frames,
            begin_epoch=self._begin_epoch,
        )
        self._epoch, self._act, self._stop = map(self._declare_control, ("epoch", "act", "stop"))
        self._subscribers.append(self.subscribe("@control/counts/*", self._on_counts))
        rewire: Any = zenoh.handlers.Callback(self._on_rewire, indirect=False)
        self._subscribers.append(session.declare_queryable(f"{self._prefix}/@control/rewire", rewire))
        presence: Any = zenoh.handlers.Callback(self.membership.on_token, indirect=False)
        liveliness = session.liveliness()
        self._subscribers.append(liveliness.declare_subscriber(f"{self._prefix}/alive/*", presence, history=True))

    def run_until_stopped(self) -> None:
        """Wait for all nodes, play the scene, tell all nodes to stop, hand in the results."""
        self.await_matching()
        alive = self.session.liveliness().declare_token(f"{self._prefix}/alive/{self.name}")
        reason = self._gather() or self._play()
        if self.stop_reason is None:
            self.stop_reason = encode_reason(reason)[:MAX_TEXT]
            self._stop.put(self.signatures.sign("stop", self.stop_reason.encode()))
        self.hand_in()
        alive.undeclare()

    def extra_results(self) -> dict[str, Any]:
        """How fast the run was, when each frame was sent, and which nodes were lost."""
        return {
            "frames": self.frames,
            "wall_s": self.wall_s,
            "stop_reason": self.stop_reason,
            "sent_ns": self.scene.sent_ns,
            "churn": self.membership.churn,
        }

    # -- phases: each returns why to stop, or None ---------------------------------------------------------------

    def _gather(self) -> StopReason | None:
        """Wait until all nodes of the beginning are there, and have entered the first epoch."""
        deadline = time.monotonic() + self.start_timeout_s
        members = self.membership
        while missing := members.expected.keys() - self.timetable.absent - members.alive:
            if not self._wait(deadline):
                late = f"not there after {self.start_timeout_s:.0f} s: {', '.join(sorted(missing))}"
                return self._over or StopReason(StopKind.START, late)
        self._begin_epoch()
        return self._await_quiet(everyone=True)

    def _play(self) -> StopReason:
        begun = time.monotonic()
        reason = self._frames(begun)
        self.wall_s = time.monotonic() - begun
        if reason == END and self.lockstep:
            reason = self._await_quiet(everyone=True) or reason
        if reason == END and not self.lockstep:
            grace = time.monotonic() + REALTIME_GRACE_S
            while self._wait(grace):
                pass
        return reason

    def _frames(self, begun: float) -> StopReason:
        while True:
            if self.membership.differs(self.members):
                self._begin_epoch()
                if self.lockstep and self.members.keys() == {self.name}:
                    return self._stalled(f"nobody else is on the mesh before frame {self.frames}")
                if self.lockstep and (reason := self._await_quiet()):
                    return reason
            if self.lockstep and (reason := self._rewire()):
                return reason
            if not self.lockstep:
                due = begun + self.frames * self.period_s
                while self._wait(due):
                    if self.membership.differs(self.members):
                        self._begin_epoch()
                    self.coordinator.turn()
            if reason := self._over or self._carry_out():
                return reason
            if not self._send_frame():
                return END
            self.frames += 1
            if self.lockstep and (reason := self._await_quiet(everyone=self.frames % SETTLE_EVERY == 0)):
                return reason

    def _rewire(self) -> StopReason | None:
        """Change the wiring between two frames, if that has been requested."""
        while self.coordinator.turn():
            if reason := self._await_quiet(everyone=True):
                return reason
        return None

    def _carry_out(self) -> StopReason | None:
        """Have the launcher carry out the process steps of the scenario before the next frame.

        In lock-step all nodes settle first, and enter a new epoch when a group of steps has been carried out.
        """
        alive = self.membership.alive
        ahead = self.lockstep and any(self.timetable.before(self.frames, alive))
        if ahead and (reason := self._await_quiet(everyone=True)):
            return reason
        for group in self.timetable.before(self.frames, alive if self.lockstep else None):
            self.membership.leaving |= {step.node for step in group if step.action in LEAVING}
            act = flow.encode_act(self.frames, [(step.action, step.node) for step in group])
            self._act.put(self.signatures.sign("act", act))
            if self.lockstep and (reason := self._await_done(group)):
                return reason
        return None

    def _await_done(self, group: list[ProcessStep]) -> StopReason | None:
        """Wait until the nodes of a group have gone or come, and all others know."""
        deadline, alive = time.monotonic() + self.start_timeout_s, self.membership.alive
        while undone := [step for step in group if (step.node in alive) != (step.action == "start")]:
            if not self._wait(deadline):
                names = ", ".join(f"{step.action} {step.node}" for step in undone)
                return self._stalled(f"not done before frame {self.frames}: {names}")
        self._begin_epoch()
        return self._await_quiet(everyone=True)

    def _send_frame(self) -> bool:
        """Send a frame, and make the next one while the mesh is busy with it; False if the scene has ended."""
        if not self.scene.send(self.frames):
            return False
        self._report_self()
        self.scene.prepare()
        return True

    def _put(self, message: Outgoing) -> None:
        self.scene.keep(message)

    def _await_quiet(self, *, everyone: bool = False) -> StopReason | None:
        deadline = time.monotonic() + self.stall_timeout_s
        while not self.pacer.quiet(everyone=everyone):
            if not self._wait(min(deadline, time.monotonic() + SUSPECT_S)):
                self.complaint = self.complaint or self.pacer.implausible()
                if self._over or time.monotonic() >= deadline:
                    return self._stalled("; ".join(list(self.pacer.unsettled())[:5]))
            self.pacer.drop(self.pacer.members.keys() - self.membership.alive)
        return None

    # -- inside --------------------------------------------------------------------------------------------------

    @property
    def _over(self) -> StopReason | None:
        """Why there are no further frames; None while there are."""
        if self.stop_reason:
            return decode_reason(self.stop_reason)
        return StopReason(StopKind.IMPLAUSIBLE, self.complaint) if self.complaint else None

    def _stalled(self, detail: str) -> StopReason:
        return self._over or StopReason(StopKind.STALL, detail)

    def _wait(self, deadline: float) -> bool:
        """Handle one event; False when the deadline has passed or it is time to stop."""
        if self._over:
            return False
        try:
            event: Event = self.inbox.get(timeout=max(0.0, deadline - time.monotonic()))
        except queue.Empty:
            return False
        if event[0] == "counts":
            self._take_counts(event[1])
        elif event[0] == "alive":
            gone_too_often = self.membership.take(event[1], self.frames, self.members)
            self.complaint = self.complaint or gone_too_often
        else:
            self.handle(event)
            self._report_self()
        return True

    def _on_counts(self, sample: zenoh.Sample) -> None:
        """A node's counters have come, in Zenoh's thread, where they are decoded.

        The main thread has little to do then, and this one goes on reading: what it does not read in time fills the
        router's queue, and at last the router ends our link.
        """
        node = str(sample.key_expr).rpartition("/")[2]
        try:
            counts = flow.decode_counts(sample.payload.to_bytes())
        except MessageError as error:
            self.invalid.note(f"counts/{node if node in self.membership.expected else '*'}", error)
        else:
            self._newest_counts.note(node, counts)

    def _take_counts(self, node: str) -> None:
        self.complaint = self.complaint or self.pacer.report(node, *self._newest_counts.take(node))

    def _on_rewire(self, query: zenoh.Query) -> None:
        """A change of the wiring is requested, in Zenoh's thread; a malformed request takes no room."""
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
        gone, come = self.members.keys() - members.keys(), members.keys() - self.members.keys()
        if self.frames:
            self.host.log.info("frame %d: gone: %s; come: %s", self.frames, sorted(gone), sorted(come))
        epoch = self.pacer.begin_epoch(members)
        self.scene.sent.clear()
        self._epoch.put(self.signatures.sign("epoch", flow.encode_epoch(epoch, members, update)))
        self._enter_epoch(epoch, members, update)
        self._report_self()

    def _report_self(self) -> None:
        self.pacer.report(self.name, self.epoch, self.outlets.counted(self.scene.sent), dict(self.host.handled))

"""The process of the node that drives the scene: it decides when the next frame begins.

Lock-step: when the mesh is quiet. Real time: when its time has come, whoever is ready or not. In both modes a node that
dies is dropped at once, and one that comes (back) takes part from the next frame on.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import Counter
from collections.abc import Collection
from typing import Any

import zenoh

from mast_zenoh.config.process_steps import ProcessStep
from mast_zenoh.control import flow
from mast_zenoh.control.flow import WiringUpdate
from mast_zenoh.control.signatures import Signatures
from mast_zenoh.errors import MessageError
from mast_zenoh.messagelog.churn import BACK, LOST
from mast_zenoh.messages.timespan import Timespan
from mast_zenoh.node import Source
from mast_zenoh.runtime.context import Outgoing
from mast_zenoh.runtime.lockstep.pacer import Pacer
from mast_zenoh.runtime.lockstep.timetable import LEAVING, Timetable
from mast_zenoh.runtime.mesh.node import NOTED_FRAMES, MeshNode
from mast_zenoh.runtime.mesh.rewiring import Rewirer, counted
from mast_zenoh.wiring.model import Wiring

#: How long the last messages of a real-time run may be under way before everyone is told to stop.
REALTIME_GRACE_S = 0.5

#: After so long without a report in lock-step, seconds, it is asked whether the reports can be true.
SUSPECT_S = 3.0

#: How often a node may be lost and come back: one that does so more often is made to.
MAX_LOSSES = 50

MAX_REASON = 2000  #: characters of why a run stops

#: How many frames those who only listen may fall behind in lock-step.
SETTLE_EVERY = 50


class Driver(MeshNode):
    """A MeshNode whose node is a Source, which hears nothing and says what it says in `advance`.

    expected: name to role of all nodes
    timetable: what happens to their processes; who is not there at the beginning is not waited for
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
        self.source = node
        self.pacer = Pacer(wiring)
        self.expected = expected
        self.timetable = timetable
        self.lockstep = lockstep
        self.period_s = period_ns * 1e-9 / rate
        self.start_timeout_s = start_timeout_s
        self.stall_timeout_s = stall_timeout_s
        self.alive: set[str] = {name}
        self.frames = 0
        self.wall_s = 0.0
        self.sent_ns: dict[int, int] = {}
        self.complaint = ""  # why the run cannot go on: a node's counters cannot be true
        self.churn: list[dict[str, Any]] = []  # see mast_zenoh.messagelog.churn
        self._leaving: set[str] = set()  # those whose end the scenario wants
        self._ready: list[Outgoing] | None = None
        self._sent: Counter[str] = Counter()
        self._newest_counts: dict[str, flow.Counts] = {}  # by node, until they are looked at
        self._presence: dict[str, tuple[bool, bool]] = {}  # by node, until it is looked at: has gone, is there
        self._lock = threading.Lock()  # of the two
        # A queue of their own: in that of the data they would wait for one whom nothing reaches any more.
        urgent: Any = {
            "congestion_control": zenoh.CongestionControl.BLOCK,
            "priority": zenoh.Priority.INTERACTIVE_HIGH,
            "express": True,
        }
        self._epoch = session.declare_publisher(f"{self._prefix}/@control/epoch", **urgent)
        self._act = session.declare_publisher(f"{self._prefix}/@control/act", **urgent)
        self._stop = session.declare_publisher(f"{self._prefix}/@control/stop", **urgent)
        self._subscribers.append(self.subscribe("@control/counts/*", self._on_counts))
        self.rewirer = Rewirer(self)
        rewire: Any = zenoh.handlers.Callback(self.rewirer.ask, indirect=False)
        self._subscribers.append(session.declare_queryable(f"{self._prefix}/@control/rewire", rewire))
        presence: Any = zenoh.handlers.Callback(self._on_presence, indirect=False)
        liveliness = session.liveliness()
        self._subscribers.append(liveliness.declare_subscriber(f"{self._prefix}/alive/*", presence, history=True))

    def run_until_stopped(self) -> None:
        """Wait for everybody, play the scene, tell everybody to stop, hand in the results."""
        self.await_matching()
        alive = self.session.liveliness().declare_token(f"{self._prefix}/alive/{self.name}")
        reason = self._gather() or self._play()
        if self.stop_reason is None:
            self.stop_reason = reason[:MAX_REASON]
            self._stop.put(self.signatures.sign("stop", self.stop_reason.encode()))
        self.hand_in()
        alive.undeclare()

    def extra_results(self) -> dict[str, Any]:
        """How fast it went, when each frame was sent, and who was lost."""
        told = ("frames", "wall_s", "stop_reason", "sent_ns", "churn")
        return {name: getattr(self, name) for name in told}

    # -- phases: each returns why to stop, or "" -----------------------------------------------------------------

    def _gather(self) -> str:
        """Wait until all are there who are to be there from the beginning, and have entered the first epoch."""
        deadline = time.monotonic() + self.start_timeout_s
        while missing := self.expected.keys() - self.timetable.absent - self.alive:
            if not self._wait(deadline):
                return self._or_stopped(
                    f"start: not there after {self.start_timeout_s:.0f} s: {', '.join(sorted(missing))}"
                )
        self._begin_epoch()
        return self._await_quiet(everyone=True)

    def _play(self) -> str:
        begun = time.monotonic()
        reason = self._frames(begun)
        self.wall_s = time.monotonic() - begun
        if reason == "end" and self.lockstep:
            reason = self._await_quiet(everyone=True) or reason
        if reason == "end" and not self.lockstep:
            grace = time.monotonic() + REALTIME_GRACE_S
            while self._wait(grace):
                pass
        return reason

    def _frames(self, begun: float) -> str:
        while True:
            if self._membership_changed():
                self._begin_epoch()
                if self.lockstep and self.members.keys() == {self.name}:
                    return self._or_stopped(f"stall: nobody else is on the mesh before frame {self.frames}")
                if self.lockstep and (reason := self._await_quiet()):
                    return reason
            if self.lockstep and (reason := self._rewire()):
                return reason
            if not self.lockstep:
                due = begun + self.frames * self.period_s
                while self._wait(due):
                    if self._membership_changed():
                        self._begin_epoch()
                    self.rewirer.turn()
            if reason := self._over or self._carry_out():
                return reason
            if not self._send_frame():
                return "end"
            self.frames += 1
            if self.lockstep and (reason := self._await_quiet(everyone=self.frames % SETTLE_EVERY == 0)):
                return reason

    def _rewire(self) -> str:
        """Change the wiring between two frames, if that has been asked for."""
        while self.rewirer.turn():
            if reason := self._await_quiet(everyone=True):
                return reason
        return ""

    def _carry_out(self) -> str:
        """Have the launcher do what the scenario does to processes before the next frame.

        In lock-step everybody has settled before, waits until it is done, and enters a new epoch after each group.
        """
        ahead = self.lockstep and any(self.timetable.before(self.frames, self.alive))
        if ahead and (reason := self._await_quiet(everyone=True)):
            return reason
        for group in self.timetable.before(self.frames, self.alive if self.lockstep else None):
            self._leaving |= {step.node for step in group if step.action in LEAVING}
            act = flow.encode_act(self.frames, [(step.action, step.node) for step in group])
            self._act.put(self.signatures.sign("act", act))
            if self.lockstep and (reason := self._await_done(group)):
                return reason
        return ""

    def _await_done(self, group: list[ProcessStep]) -> str:
        """Wait until those of a group have gone or come, and all others know."""
        deadline = time.monotonic() + self.start_timeout_s
        while undone := [step for step in group if (step.node in self.alive) != (step.action == "start")]:
            if not self._wait(deadline):
                said = ", ".join(f"{step.action} {step.node}" for step in undone)
                return self._or_stopped(f"stall: not done before frame {self.frames}: {said}")
        self._begin_epoch()
        return self._await_quiet(everyone=True)

    def _send_frame(self) -> bool:
        """Send the frame that was made ready while the mesh was busy with the one before; False if there is none.

        Until its clock is sent, a frame is no more than bytes in this process: nobody can act on it too early.
        """
        if self._ready is None:
            self._ready = self._made()
        if not self._ready:
            return False
        self.sent_ns[self.frames] = time.time_ns()
        self.sent_ns.pop(self.frames - NOTED_FRAMES, None)
        for message in self._ready:
            super()._put(message)
            self._sent[message.key] += 1
        self._report_self()
        self._ready = self._made()
        return True

    def _made(self) -> list[Outgoing]:
        """The messages of the next frame; none at the end of the scene."""
        self._ready = []
        self.source.advance(self.host)
        return self._ready

    def _put(self, message: Outgoing) -> None:
        """What the source publishes is kept until its frame begins."""
        assert self._ready is not None
        self._ready.append(message)

    def _await_quiet(self, *, everyone: bool = False) -> str:
        deadline = time.monotonic() + self.stall_timeout_s
        while not self.pacer.quiet(everyone=everyone):
            if not self._wait(min(deadline, time.monotonic() + SUSPECT_S)):
                self.complaint = self.complaint or self.pacer.implausible()
                if self._over or time.monotonic() >= deadline:
                    return self._or_stopped(f"stall: {'; '.join(list(self.pacer.owing())[:5])}")
            self.pacer.drop(self.pacer.members.keys() - self.alive)
        return ""

    # -- inside --------------------------------------------------------------------------------------------------

    @property
    def _over(self) -> str:
        """Why there are no further frames; "" while there are."""
        return self.stop_reason or (f"implausible: {self.complaint}" if self.complaint else "")

    def _or_stopped(self, reason: str) -> str:
        return self._over or reason

    def _wait(self, deadline: float) -> bool:
        """Handle one event; False when the deadline has passed or it is time to stop."""
        if self._over:
            return False
        try:
            event = self.inbox.get(timeout=max(0.0, deadline - time.monotonic()))
        except queue.Empty:
            return False
        kind, *rest = event
        if kind == "counts":
            self._take_counts(*rest)
        elif kind == "alive":
            self._take_presence(*rest)
        else:
            self.handle(event)
            self._report_self()
        return True

    def _on_counts(self, sample: zenoh.Sample) -> None:
        """A node's counters have come, in Zenoh's thread. Of each node only the newest wait, so no flood fills a queue.

        The main thread has little to do then, and this one is not kept from reading: what it does not read in time
        fills the router's queue, and at last the router ends our link.
        """
        node = str(sample.key_expr).rpartition("/")[2]
        try:
            counts = flow.decode_counts(sample.payload.to_bytes())
        except MessageError as error:
            self.invalid.note(f"counts/{node if node in self.expected else '*'}", error)
            return
        with self._lock:
            waits = node in self._newest_counts
            self._newest_counts[node] = counts
        if not waits:
            self.inbox.put(("counts", node))

    def _take_counts(self, node: str) -> None:
        with self._lock:
            counts = self._newest_counts.pop(node)
        self.complaint = self.complaint or self.pacer.report(node, *counts)

    def _on_presence(self, token: zenoh.Sample) -> None:
        """A node's token has come or gone, in Zenoh's thread: the newest of each waits, and that it was gone."""
        name, there = str(token.key_expr).rpartition("/")[2], token.kind == zenoh.SampleKind.PUT
        with self._lock:
            waits = name in self._presence
            gone, _ = self._presence.get(name, (False, False))
            self._presence[name] = (gone or not there, there)
        if not waits:
            self.inbox.put(("alive", name))

    def _take_presence(self, name: str) -> None:
        """First that it has gone, and in an event of its own, after which members may have changed, that it is back."""
        with self._lock:
            gone, there = self._presence.pop(name)
            if gone and there:
                self._presence[name] = (False, True)
        if gone and there:
            self.inbox.put(("alive", name))
        self._note_presence(name, there and not gone)

    def _note_presence(self, name: str, there: bool) -> None:
        """A node has come or gone: as the scenario wants it, by a change of the wiring, or of itself."""
        if there or name == self.name:  # our own token may be late; we are here
            self.alive.add(name)
            self._leaving.discard(name)
            before = [each["what"] for each in self.churn if each["node"] == name]
            if before and before[-1] == LOST:
                self.churn.append({"frame": self.frames, "node": name, "what": BACK})
            return
        self.alive.discard(name)
        if name in self.members and name in self.expected and name not in self._leaving:
            self.churn.append({"frame": self.frames, "node": name, "what": LOST})
            if sum(each["node"] == name for each in self.churn) > 2 * MAX_LOSSES:
                self.complaint = self.complaint or f"{name} has gone and come back more than {MAX_LOSSES} times"

    def _membership_changed(self) -> bool:
        return (self.alive & self.expected.keys()) != self.members.keys()

    def _begin_epoch(self) -> None:
        members = {name: role for name, role in self.expected.items() if name in self.alive}
        gone, come = self.members.keys() - members.keys(), members.keys() - self.members.keys()
        if self.frames:
            self.host.log.info("frame %d: gone: %s; come: %s", self.frames, sorted(gone), sorted(come))
        epoch = self.pacer.begin_epoch(members)
        self._sent.clear()
        told = self.rewirer.told
        self._epoch.put(self.signatures.sign("epoch", flow.encode_epoch(epoch, members, told)))
        self._enter_epoch(epoch, members, told)
        self._report_self()

    def begin_epoch_of(self, told: WiringUpdate) -> None:
        """A new epoch, in which the wiring changes."""
        self.pacer.rewire(told.wiring)
        self._begin_epoch()

    def _report_self(self) -> None:
        self.pacer.report(self.name, self.epoch, counted(self._sent, self.outlets), dict(self.host.handled))

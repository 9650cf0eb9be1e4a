"""The process of the node that drives the scene: it decides when the next frame begins.

Lock-step: when the mesh is quiet. Real time: when its time has come, whoever is ready or not. In both modes a node that
dies is dropped at once, and one that comes (back) takes part from the next frame on.
"""

from __future__ import annotations

import queue
import time
from collections import Counter
from typing import Any

import msgpack
import zenoh

from mast_zenoh.node import Source
from mast_zenoh.runtime.host import Outgoing
from mast_zenoh.runtime.mesh import MeshNode
from mast_zenoh.runtime.pacer import Pacer
from mast_zenoh.wiring import Wiring

#: How long the last messages of a real-time run may be under way before everyone is told to stop.
REALTIME_GRACE_S = 0.5

#: How many frames those who only listen may fall behind in lock-step.
SETTLE_EVERY = 50


class Driver(MeshNode):
    """A MeshNode whose node is a Source, which hears nothing and says what it says in `advance`.

    expected: name to role of all nodes that must be there before the first frame
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
        expected: dict[str, str],
        mode: str,
        rate: float,
        start_timeout_s: float = 60.0,
        stall_timeout_s: float = 30.0,
    ) -> None:
        super().__init__(run, name, node, wiring, seed, session)
        self.source = node
        self.pacer = Pacer(wiring)
        self.expected = expected
        self.lockstep = mode == "lockstep"
        self.period_s = node.period_ns * 1e-9 / rate
        self.start_timeout_s = start_timeout_s
        self.stall_timeout_s = stall_timeout_s
        self.alive: set[str] = {name}
        self.frames = 0
        self.wall_s = 0.0
        self.sent_ns: dict[int, int] = {}
        self._ready: list[Outgoing] | None = None
        self._sent: Counter[str] = Counter()
        self._epoch = session.declare_publisher(
            f"{self._prefix}/@control/epoch", congestion_control=zenoh.CongestionControl.BLOCK, express=True
        )
        self._stop = session.declare_publisher(
            f"{self._prefix}/@control/stop", congestion_control=zenoh.CongestionControl.BLOCK, express=True
        )
        put = self.inbox.put
        self._subscribers.append(
            self.subscribe(
                "@control/counts/*",
                lambda s: put(("counts", str(s.key_expr).rpartition("/")[2], s.payload.to_bytes())),
            )
        )
        presence: Any = zenoh.handlers.Callback(
            lambda s: put(("alive", str(s.key_expr).rpartition("/")[2], s.kind == zenoh.SampleKind.PUT)),
            indirect=False,
        )
        liveliness = session.liveliness()
        self._subscribers.append(liveliness.declare_subscriber(f"{self._prefix}/alive/*", presence, history=True))

    def run_until_stopped(self) -> None:
        """Wait for everybody, play the scene, tell everybody to stop, hand in the results."""
        self.await_matching()
        alive = self.session.liveliness().declare_token(f"{self._prefix}/alive/{self.name}")
        reason = self._gather() or self._play()
        if self.stop_reason is None:
            self.stop_reason = reason
            self._stop.put(reason)
        self.hand_in()
        alive.undeclare()

    def extra_results(self) -> dict[str, Any]:
        """How fast it went, and when each frame was sent."""
        return {"frames": self.frames, "wall_s": self.wall_s, "stop_reason": self.stop_reason, "sent_ns": self.sent_ns}

    # -- phases: each returns why to stop, or "" -----------------------------------------------------------------

    def _gather(self) -> str:
        """Wait until all expected nodes are there, and have entered the first epoch."""
        deadline = time.monotonic() + self.start_timeout_s
        while missing := self.expected.keys() - self.alive:
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
                if self.lockstep and (reason := self._await_quiet()):
                    return reason
            if not self.lockstep:
                due = begun + self.frames * self.period_s
                while self._wait(due):
                    if self._membership_changed():
                        self._begin_epoch()
            if self.stop_reason is not None:
                return self.stop_reason
            if not self._send_frame():
                return "end"
            self.frames += 1
            if self.lockstep and (reason := self._await_quiet(everyone=self.frames % SETTLE_EVERY == 0)):
                return reason

    def _send_frame(self) -> bool:
        """Send the frame that was made ready while the mesh was busy with the one before; False if there is none.

        Until its clock is sent, a frame is no more than bytes in this process: nobody can act on it too early.
        """
        if self._ready is None:
            self._ready = self._made()
        if not self._ready:
            return False
        self.sent_ns[self.frames] = time.time_ns()
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
            if not self._wait(deadline):
                return self._or_stopped(f"stall: {'; '.join(list(self.pacer.owing())[:5])}")
            self.pacer.drop(self.pacer.members.keys() - self.alive)
        return ""

    # -- inside --------------------------------------------------------------------------------------------------

    def _or_stopped(self, reason: str) -> str:
        return self.stop_reason or reason

    def _wait(self, deadline: float) -> bool:
        """Handle one event; False when the deadline has passed or it is time to stop."""
        if self.stop_reason is not None:
            return False
        try:
            event = self.inbox.get(timeout=max(0.0, deadline - time.monotonic()))
        except queue.Empty:
            return False
        kind, *rest = event
        if kind == "counts":
            self.pacer.report(rest[0], *msgpack.unpackb(rest[1]))
        elif kind == "alive":
            (self.alive.add if rest[1] else self.alive.discard)(rest[0])
        else:
            self.handle(event)
            self._report_self()
        return True

    def _membership_changed(self) -> bool:
        return (self.alive & self.expected.keys()) != self.members.keys()

    def _begin_epoch(self) -> None:
        members = {name: role for name, role in self.expected.items() if name in self.alive}
        gone, come = self.members.keys() - members.keys(), members.keys() - self.members.keys()
        if self.frames:
            self.host.log.info("frame %d: gone: %s; come: %s", self.frames, sorted(gone), sorted(come))
        epoch = self.pacer.begin_epoch(members)
        self._sent.clear()
        self._epoch.put(msgpack.packb([epoch, members]))
        self._enter_epoch(epoch, members)
        self._report_self()

    def _report_self(self) -> None:
        self.pacer.report(self.name, self.epoch, dict(self._sent), dict(self.host.handled))

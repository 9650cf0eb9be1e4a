"""Hosts one node as a process on a Zenoh mesh.

A Zenoh thread only puts samples on this process's inbox; the main thread takes them out, lets the host handle them,
and sends what the node has published. Control traffic lies under mast/{run}/@control/, a verbatim chunk, where no
wildcard sees it:

    epoch            driver → all      who takes part from now on; counters start anew
    counts/{node}    node → driver     messages sent and handled by key, whenever the inbox is empty
    stop             anyone → all      finish, hand in results, leave
    result/{node}    node → launcher   a query: the results, acknowledged by the reply
"""

from __future__ import annotations

import queue
import struct
import threading
import time
from collections.abc import Callable
from typing import Any

import msgpack
import zenoh

from mast_zenoh.messages import SCHEMAS, Header
from mast_zenoh.node import Node
from mast_zenoh.runtime import results
from mast_zenoh.runtime.host import Host, Outgoing
from mast_zenoh.wiring import Leg, Wiring

#: What a message carries beside its payload: a mark of this testbed's nodes, the epoch, and the step that it was sent
#: in. An interposer's messages carry the same as the publisher's would, so there is nothing to tell them by.
ATTACHMENT = struct.Struct("<4sIq")
MARK = b"MAST"

_MATCH_TIMEOUT_S = 10.0
_RESULT_TIMEOUT_S = 20.0
_LINGER_S = 0.01


def prefix(run: str) -> str:
    """Where all keys of a run begin."""
    return f"mast/{run}"


class MeshNode:
    """One node on the mesh; `run_until_stopped` is its life. See the module's docstring."""

    def __init__(self, run: str, name: str, node: Node, wiring: Wiring, seed: int, session: zenoh.Session) -> None:
        self.name = name
        self.wiring = wiring
        self.ports = wiring.ports(name)
        self.host = Host(name, node, self.ports, seed, encode=True, emit=self._put)
        self.session = session
        self.inbox: queue.SimpleQueue[tuple[Any, ...]] = queue.SimpleQueue()
        self.members: dict[str, str] = {}
        self.epoch = 0
        self.stop_reason: str | None = None
        self.foreign = 0  # messages that no node of this run has sent
        self.arrived_ns: dict[str, dict[int, int]] = {}
        self._prefix = prefix(run)
        self._started = False
        self._cpu_begun = time.process_time()
        self._early: list[tuple[str, bytes, int, int]] = []
        self._in_frame = 0  # messages that have come in this frame
        self._in_frames = (0, 0)  # and in the two before
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._subscribers: list[Any] = []
        self._declare()

    # -- life ----------------------------------------------------------------------------------------------------

    def run_until_stopped(self) -> None:
        """Join the mesh, take part until told to stop, hand in the results."""
        self.await_matching()
        alive = self.session.liveliness().declare_token(f"{self._prefix}/alive/{self.name}")
        while self.stop_reason is None:
            self.turn()
        self.hand_in()
        alive.undeclare()

    def turn(self) -> None:
        """Handle one event, or report when there is none."""
        try:
            event = self.inbox.get_nowait()
        except queue.Empty:
            event = self.idle()
        self.handle(event)

    def idle(self) -> tuple[Any, ...]:
        """Nothing to do: say so, and wait for the next event.

        While less has come than in the frames before, more is likely to be on its way: linger a little, because a
        report too many costs the driver more than the wait costs us. It is sent in any case.
        """
        if self._in_frame < min(self._in_frames):
            try:
                return self.inbox.get(timeout=_LINGER_S)
            except queue.Empty:
                pass
        self.report()
        return self.inbox.get()

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
            self._enter_epoch(*msgpack.unpackb(rest[0]))
        elif kind == "stop":
            self.stop_reason = rest[0]

    def report(self) -> None:
        """Tell the driver what has been sent and handled."""
        if self.epoch:
            self._counts.put(msgpack.packb([self.epoch, dict(self.host.sent), dict(self.host.handled)]))

    def hand_in(self) -> None:
        """Finish the node and give its results to the launcher; keep trying until it says that it has them."""
        cpu_s = time.process_time() - self._cpu_begun
        outcome = {
            "results": self.host.finish() if self._started else {},
            "rejected": {f"{key}: {reason}": n for (key, reason), n in self.host.rejected.items()},
            "foreign": self.foreign,
            "failures": dict(self.host.failures),
            "last_frame": self.host.frame,
            "cpu_s": round(cpu_s, 4),
            "arrived_ns": self.arrived_ns,
        } | self.extra_results()
        payload = results.pack(outcome)
        deadline = time.monotonic() + _RESULT_TIMEOUT_S
        while time.monotonic() < deadline:
            for reply in self.session.get(f"{self._prefix}/@control/result/{self.name}", payload=payload, timeout=5.0):
                if reply.ok is not None:
                    return
        self.host.log.error("nobody took the results within %.0f s", _RESULT_TIMEOUT_S)

    def extra_results(self) -> dict[str, Any]:
        """What a special process adds to its results."""
        return {}

    def note_arrivals(self) -> None:
        """From now on note when the message of each frame came on each key (wall clock): for measuring latency."""

        def note(key: str, header: Header) -> None:
            self.arrived_ns.setdefault(key, {}).setdefault(header.frame, time.time_ns())

        self.host.observe = note

    # -- messages ------------------------------------------------------------------------------------------------

    def _put(self, message: Outgoing) -> None:
        """Send what the node publishes, at once: whoever waits for it can begin while this node goes on."""
        assert isinstance(message.payload, bytes)
        attachment = ATTACHMENT.pack(MARK, self.epoch, message.step)
        self._publishers[message.key].put(message.payload, attachment=attachment)

    def _sample(self, key: str, payload: bytes, attachment: bytes | None) -> None:
        mark, epoch, step = (
            ATTACHMENT.unpack(attachment) if attachment and len(attachment) == ATTACHMENT.size else (b"", 0, -1)
        )
        if mark != MARK:
            self.foreign += 1
            if self._started:
                self.host.deliver(key, payload, -1, counted=False)
        elif epoch > self.epoch:
            self._early.append((key, payload, epoch, step))
        elif self._started:
            self.host.deliver(key, payload, step, counted=epoch == self.epoch)

    def _enter_epoch(self, epoch: int, members: dict[str, str]) -> None:
        if epoch <= self.epoch or self.name not in members:
            return
        before, self.members, self.epoch = self.members, members, epoch
        self.host.reset_counts()
        if not self._started:
            self._started = True
            self._cpu_begun = time.process_time()
            self.host.start({name: role for name, role in members.items() if name != self.name})
        else:
            for name in sorted(before.keys() - members.keys()):
                self.host.left(name, before[name])
            for name in sorted(members.keys() - before.keys()):
                self.host.joined(name, members[name])
        early, self._early = self._early, []
        for key, payload, its_epoch, step in early:
            self._sample(key, payload, ATTACHMENT.pack(MARK, its_epoch, step))

    # -- declarations --------------------------------------------------------------------------------------------

    def _declare(self) -> None:
        for key in self.ports.inputs:
            self._subscribers.append(self.subscribe(key, self._on_sample(key)))
        put = self.inbox.put
        self._subscribers.append(self.subscribe("@control/epoch", lambda s: put(("epoch", s.payload.to_bytes()))))
        self._subscribers.append(self.subscribe("@control/stop", lambda s: put(("stop", s.payload.to_string()))))
        for wire, leg in self.wiring.legs():
            if leg.publisher.node == self.name:
                schema = SCHEMAS[wire.message]
                self._publishers[leg.key] = self.session.declare_publisher(
                    f"{self._prefix}/{leg.key}",
                    encoding=f"application/msgpack;schema={schema.name}.{schema.version}",
                    congestion_control=zenoh.CongestionControl.BLOCK,
                    express=True,
                )
        self._counts = self.session.declare_publisher(
            f"{self._prefix}/@control/counts/{self.name}",
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
        )

    def _on_sample(self, key: str) -> Callable[[zenoh.Sample], None]:
        put = self.inbox.put

        def on_sample(sample: zenoh.Sample) -> None:
            attachment = sample.attachment
            put(("sample", key, sample.payload.to_bytes(), attachment.to_bytes() if attachment else None))

        return on_sample

    def subscribe(self, key: str, callback: Callable[[zenoh.Sample], None]) -> Any:
        """A subscriber below the run's prefix whose callback runs in Zenoh's own thread: it must return at once."""
        handler = zenoh.handlers.Callback(callback, indirect=False)
        return self.session.declare_subscriber(f"{self._prefix}/{key}", handler)

    def await_matching(self) -> None:
        """Wait until every wire that somebody listens to has its listener, so that no first message is lost."""
        awaited = [self._publishers[leg.key] for _, leg in self.wiring.legs() if self._is_mine(leg)] + [self._counts]
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

    def _is_mine(self, leg: Leg) -> bool:
        return leg.publisher.node == self.name and bool(leg.subscribers or self.wiring.overhearers)

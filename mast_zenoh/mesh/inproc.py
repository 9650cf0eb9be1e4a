"""Runs all nodes in one process, deterministic: for studies, tests and debugging.

The nodes, hosts and wiring are the same as on a mesh; only the transport is a list. Messages are not encoded, but are
checked as the decoder would check them.
"""

from __future__ import annotations

import time
from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from mast_zenoh.config.resolved import LEAVING, ProcessStep, Resolved, build_node
from mast_zenoh.errors import NodeDied, RunError, StartError
from mast_zenoh.mesh.control.failures import Entry, described, lines, location, merged
from mast_zenoh.mesh.control.results import TablePart
from mast_zenoh.mesh.host import Host, Outgoing
from mast_zenoh.mesh.outside_link import OutsideLink
from mast_zenoh.mesh.protocol.pacer import Timetable
from mast_zenoh.messages import user_types
from mast_zenoh.node import Source
from mast_zenoh.wiring.model import Wiring

MAX_DELIVERIES = 200_000  #: of messages in one frame


class InProcess:
    """A run in this process.

    shuffle: seed of a random order of delivery, in which messages on one key stay in order for each subscriber, as on
             the mesh; None: first in, first out
    encode:  pass bytes between the nodes, as a mesh does, instead of messages
    tap:     called with every message sent, tap legs included
    progress: called with the number of frames played; the run ends early when it returns False
    stopping: whether the run is to end after the current frame: then no node waits for programs outside it
    hand_in: called with a node, its process and a part of its tables, as the launcher gets them on a mesh; None: tables
             stay in memory, in the results
    """

    def __init__(
        self,
        resolved: Resolved,
        *,
        shuffle: int | None = None,
        encode: bool = False,
        tap: Callable[[Outgoing], None] | None = None,
        progress: Callable[[int], bool | None] | None = None,
        stopping: Callable[[], bool] = lambda: False,
        hand_in: Callable[[str, str, TablePart], None] | None = None,
    ) -> None:
        resolved.refuse_interpreters("in one process")
        self._resolved = resolved
        user_types.use(resolved.messages)
        self._wiring = Wiring.from_json(resolved.wiring)
        self._encode = encode
        self._roles = {name: spec.role for name, spec in resolved.nodes.items()}
        self._subscribers: dict[str, list[str]] = defaultdict(list)
        for key, _, subscriber in self._wiring.flows():
            self._subscribers[key].append(subscriber)
        self._tap = tap
        self._progress = progress
        self._stopping = stopping
        self._hand_in = hand_in
        self._pending: _Fifo | _Shuffled = _Fifo() if shuffle is None else _Shuffled(shuffle)
        self._results: dict[str, dict[str, Any]] = {}
        self._all_hosts: list[Host] = []  # including those of nodes that ended or were restarted
        #: running nodes
        self.hosts = {name: self._build_host(name) for name in resolved.nodes}
        sources = [host for host in self.hosts.values() if isinstance(host.node, Source)]
        if len(sources) != 1:
            raise RunError(f"{len(sources)} nodes drive the scene, expected one simulator")
        self._source = sources[0]
        self.timetable = Timetable(resolved, lockstep=True)
        #: process steps carried out, and the hosts of nodes that ended
        self.steps: list[ProcessStep] = []
        self.ended_hosts: dict[str, Host] = {}
        for name in self.timetable.absent:
            del self.hosts[name]

    def run(self) -> dict[str, dict[str, Any]]:
        """Run to the end of the scene; returns the results of every node's `finish`.

        The number of frames and the wall-clock time, s, are under "". Raises StartError for a node whose `start` fails,
        and NodeDied when the node that drives the scene fails. Raises NotRunning for a node whose link to programs
        outside the run cannot be opened.
        """
        try:
            return self._run()
        finally:
            for host in self._all_hosts:
                _close_link(host)

    def _run(self) -> dict[str, dict[str, Any]]:
        for name in list(self.hosts):
            self._start(name)
        self._drain()
        started = time.perf_counter()
        source, frames = self._source, 0
        self._carry_out(0)
        while self._advance(source, frames):
            self._drain()
            frames += 1
            if self._progress and self._progress(frames) is False:
                break
            self._carry_out(frames)
        self._drain()
        elapsed = time.perf_counter() - started
        self._results |= {name: host.finish() for name, host in self.hosts.items()}
        results = {name: self._results[name] for name in self._roles if name in self._results}
        return {"": {"frames": frames, "wall_s": elapsed}, **results}

    def failures(self) -> dict[str, list[Entry]]:
        """Failures of handlers, by node; only nodes that have any."""
        entries: dict[str, list[list[Entry]]] = {name: [] for name in self._roles}
        for host in self._all_hosts:
            entries[host.name].append([failure.entry() for failure in host.failures.values()])
        return {name: merged(parts) for name, parts in entries.items() if any(parts)}

    def _start(self, name: str) -> None:
        host = self.hosts[name]
        if (topics := host.node.outside_topics(host)) is not None:
            host.link = OutsideLink(name, topics, waits=True, stopping=self._stopping)
        try:
            host.start(self._peers(name))
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # GeneratorExit and CancelledError are not Exceptions
            (line,) = lines({name: [host.failures["start"].entry()]})
            raise StartError(line) from error

    def _advance(self, source: Host, frame: int) -> bool:
        """Have the source publish the next frame; False if there is none."""
        assert isinstance(source.node, Source)
        try:
            return source.node.advance(source)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # GeneratorExit and CancelledError are not Exceptions
            where = location(error, source.node.advance)
            what = f"{source.name}.advance failed before frame {frame}"
            raise NodeDied(f"{what}: {described(error)} ({where})") from error

    def _build_host(self, name: str) -> Host:
        """Build a node and its host."""
        node = build_node(self._resolved.nodes[name], name)
        host = Host.of(self._resolved, name, node, self._wiring, encode=self._encode, emit=self._enqueue)
        if self._hand_in is not None:
            host.tables.hand_in = partial(self._hand_in, name, str(len(self._all_hosts)))
        self._all_hosts.append(host)
        return host

    def _peers(self, name: str) -> dict[str, str]:
        return {peer: self._roles[peer] for peer in self.hosts if peer != name}

    def _carry_out(self, frame: int) -> None:
        """Carry out the process steps before a frame, as the driver does on a mesh."""
        for group in self.timetable.before(frame, self.hosts):
            new_hosts = {step.node: self._build_host(step.node) for step in group if step.action not in LEAVING}
            for step in group:
                if step.action in LEAVING:
                    self.ended_hosts[step.node] = self.hosts.pop(step.node)
                if step.action == "leave":
                    self._results[step.node] = self.ended_hosts[step.node].finish()
                if step.action in LEAVING:
                    _close_link(self.ended_hosts[step.node])
            for host in self.hosts.values():
                for step in group:
                    (host.joined if step.node in new_hosts else host.left)(step.node, self._roles[step.node])
            self.hosts |= new_hosts
            for name in new_hosts:
                self.ended_hosts.pop(name, None)
                self._start(name)
            self.steps += group
            self._drain()

    def _drain(self) -> None:
        """Deliver messages until none is left: the end of a frame; raises RunError if there is no end."""
        for _ in range(MAX_DELIVERIES):
            if not self._pending:
                return
            name, (key, payload, step, flaw) = self._pending.next()
            host = self.hosts.get(name)
            if host:
                host.deliver(key, payload, step, flaw=flaw)
        problem = f"frame {self._source.frame}: more than {MAX_DELIVERIES} deliveries, the last one on {key} to {name}"
        raise RunError(f"{problem}: expected that nodes stop answering each other")

    def _enqueue(self, message: Outgoing) -> None:
        """Queue a message that a node has sent, for each subscriber of its key."""
        if self._tap:
            self._tap(message)
        self._pending.push(self._subscribers[message.key], message)


def _close_link(host: Host) -> None:
    """Close a node's link to programs outside the run, if it has one."""
    if host.link is not None:
        host.link.close()
        host.link = None


class _Fifo(deque[tuple[str, Outgoing]]):
    """Deliveries in the order of sending."""

    def push(self, subscribers: Sequence[str], message: Outgoing) -> None:
        self.extend([(subscriber, message) for subscriber in subscribers])

    def next(self) -> tuple[str, Outgoing]:
        return self.popleft()


class _Shuffled:
    """Deliveries in random order, except for those of one key to one subscriber."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._queues: dict[tuple[str, str], deque[tuple[str, Outgoing]]] = {}

    def push(self, subscribers: Sequence[str], message: Outgoing) -> None:
        for subscriber in subscribers:
            self._queues.setdefault((subscriber, message.key), deque()).append((subscriber, message))

    def next(self) -> tuple[str, Outgoing]:
        names = list(self._queues)
        name = names[int(self._rng.integers(len(names)))]
        queue = self._queues[name]
        delivery = queue.popleft()
        if not queue:
            del self._queues[name]
        return delivery

    def __bool__(self) -> bool:
        return bool(self._queues)

"""All nodes of a run in one process, deterministic: for studies, tests and debugging.

The nodes, hosts and wiring are those of the mesh; only the transport is a list. Messages are passed on without being
encoded, and checked as the decoder would check them.
"""

from __future__ import annotations

import time
from collections import defaultdict, deque
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from mast_zenoh.errors import RunError
from mast_zenoh.node import Source
from mast_zenoh.runtime.host import Host, Outgoing
from mast_zenoh.scenario import Resolved, build_node
from mast_zenoh.wiring import Wiring


class InProcess:
    """A run in this process.

    shuffle: seed of an order of delivery drawn at random among all that is possible (messages on one key stay in
             their order for each subscriber, as on the mesh); None: first in, first out
    encode:  pass bytes between the nodes as a mesh does, instead of the messages themselves
    tap:     called with every message sent, tap legs included
    progress: called with the number of frames played; the run ends early when it returns False
    """

    def __init__(
        self,
        resolved: Resolved,
        *,
        shuffle: int | None = None,
        encode: bool = False,
        tap: Callable[[Outgoing], None] | None = None,
        progress: Callable[[int], bool | None] | None = None,
    ) -> None:
        wiring = Wiring.from_json(resolved.wiring)
        self._roles = {name: spec.role for name, spec in resolved.nodes.items()}
        self.hosts = {
            name: Host(name, build_node(spec, name), wiring.ports(name), resolved.seed, encode=encode)
            for name, spec in resolved.nodes.items()
        }
        sources = [host for host in self.hosts.values() if isinstance(host.node, Source)]
        if len(sources) != 1:
            raise RunError(f"{len(sources)} nodes drive the scene, expected one simulator")
        self._source = sources[0]
        self._hears: dict[str, list[Host]] = defaultdict(list)
        for key, _, subscriber in wiring.flows():
            self._hears[key].append(self.hosts[subscriber])
        self._tap = tap
        self._progress = progress
        self._pending: _Fifo | _Shuffled = _Fifo() if shuffle is None else _Shuffled(shuffle)

    def run(self) -> dict[str, dict[str, Any]]:
        """Run to the end of the scene; the results of every node's `finish`, and wall-clock timings under ""."""
        for name, host in self.hosts.items():
            host.start({peer: role for peer, role in self._roles.items() if peer != name})
        self._drain()
        begun = time.perf_counter()
        source, frames = self._source, 0
        assert isinstance(source.node, Source)
        while source.node.advance(source):
            self._drain()
            frames += 1
            if self._progress and self._progress(frames) is False:
                break
        self._drain()
        elapsed = time.perf_counter() - begun
        results = {name: host.finish() for name, host in self.hosts.items()}
        return {"": {"frames": frames, "wall_s": elapsed}, **results}

    def _drain(self) -> None:
        """Deliver until nothing is under way: the frame is over."""
        for host in self.hosts.values():
            self._collect(host)
        while self._pending:
            host, message = self._pending.pop()
            host.deliver(message.key, message.payload, message.step, flaw=message.flaw)
            self._collect(host)

    def _collect(self, host: Host) -> None:
        if not host.outbox:
            return
        for message in host.outbox:
            if self._tap:
                self._tap(message)
            for subscriber in self._hears[message.key]:
                self._pending.push(subscriber, message)
        host.outbox.clear()


class _Fifo:
    """Deliveries in the order in which they were sent."""

    def __init__(self) -> None:
        self._queue: deque[tuple[Host, Outgoing]] = deque()
        self.push = lambda host, message: self._queue.append((host, message))
        self.pop = self._queue.popleft

    def __bool__(self) -> bool:
        return bool(self._queue)


class _Shuffled:
    """Deliveries in a random order that keeps the order of each key at each subscriber."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._queues: dict[tuple[str, str], deque[tuple[Host, Outgoing]]] = {}

    def push(self, host: Host, message: Outgoing) -> None:
        self._queues.setdefault((host.name, message.key), deque()).append((host, message))

    def pop(self) -> tuple[Host, Outgoing]:
        names = list(self._queues)
        name = names[int(self._rng.integers(len(names)))]
        queue = self._queues[name]
        delivery = queue.popleft()
        if not queue:
            del self._queues[name]
        return delivery

    def __bool__(self) -> bool:
        return bool(self._queues)


def results_of(runs: Mapping[str, dict[str, Any]], key: str) -> Any:
    """The one result named `key` among the results of all nodes, or None."""
    found = [results[key] for results in runs.values() if key in results]
    return found[0] if found else None

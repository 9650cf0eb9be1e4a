"""All nodes of a run in one process, deterministic: for studies, tests and debugging.

The nodes, hosts and wiring are those of the mesh; only the transport is a list. Messages are passed on without being
encoded, and checked as the decoder would check them.
"""

from __future__ import annotations

import time
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from mast_zenoh.config.process_steps import ProcessStep
from mast_zenoh.config.resolved import Resolved, build_node
from mast_zenoh.control.failures import Entry, described, lines, location, merged
from mast_zenoh.errors import NodeDied, RunError, StartError
from mast_zenoh.messages import user_types
from mast_zenoh.node import Source
from mast_zenoh.runtime.context import Outgoing
from mast_zenoh.runtime.host import Host
from mast_zenoh.runtime.lockstep.timetable import LEAVING, Timetable
from mast_zenoh.wiring.model import Wiring


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
        self._resolved = resolved
        user_types.use(resolved.messages)
        self._wiring = Wiring.from_json(resolved.wiring)
        self._encode = encode
        self._roles = {name: spec.role for name, spec in resolved.nodes.items()}
        self._hears: dict[str, list[str]] = defaultdict(list)
        for key, _, subscriber in self._wiring.flows():
            self._hears[key].append(subscriber)
        self._tap = tap
        self._progress = progress
        self._pending: _Fifo | _Shuffled = _Fifo() if shuffle is None else _Shuffled(shuffle)
        self._results: dict[str, dict[str, Any]] = {}
        self._made: list[Host] = []  # all hosts, also of nodes that have gone or come again
        #: those who are up
        self.hosts = {name: self._built(name) for name in resolved.nodes}
        sources = [host for host in self.hosts.values() if isinstance(host.node, Source)]
        if len(sources) != 1:
            raise RunError(f"{len(sources)} nodes drive the scene, expected one simulator")
        self._source = sources[0]
        self.timetable = Timetable(resolved, lockstep=True)
        #: what has been done to whom; those who were up and are not any more
        self.steps: list[ProcessStep] = []
        self.gone: dict[str, Host] = {}
        for name in self.timetable.absent:
            del self.hosts[name]

    def run(self) -> dict[str, dict[str, Any]]:
        """Run to the end of the scene; the results of every node's `finish`, and wall-clock timings under "".

        Raises StartError for a node whose `start` fails, and NodeDied when the node that drives the scene fails.
        """
        for name in list(self.hosts):
            self._start(name)
        self._drain()
        begun = time.perf_counter()
        source, frames = self._source, 0
        self._carry_out(0)
        while self._advance(source, frames):
            self._drain()
            frames += 1
            if self._progress and self._progress(frames) is False:
                break
            self._carry_out(frames)
        self._drain()
        elapsed = time.perf_counter() - begun
        self._results |= {name: host.finish() for name, host in self.hosts.items()}
        in_order = {name: self._results[name] for name in self._roles if name in self._results}
        return {"": {"frames": frames, "wall_s": elapsed}, **in_order}

    def failures(self) -> dict[str, list[Entry]]:
        """The failures of handlers by node; nodes without any are left out."""
        entries: dict[str, list[list[Entry]]] = {name: [] for name in self._roles}
        for host in self._made:
            entries[host.name].append([failure.entry() for failure in host.failures.values()])
        return {name: merged(parts) for name, parts in entries.items() if any(parts)}

    def _start(self, name: str) -> None:
        host = self.hosts[name]
        try:
            host.start(self._peers(name))
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # GeneratorExit and CancelledError are no Exception
            (line,) = lines({name: [host.failures["start"].entry()]})
            raise StartError(line) from error

    def _advance(self, source: Host, frame: int) -> bool:
        """Have the source publish the next frame; False when there is none."""
        assert isinstance(source.node, Source)
        try:
            return source.node.advance(source)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # GeneratorExit and CancelledError are no Exception
            where = location(error, source.node.advance)
            what = f"{source.name}.advance failed before frame {frame}"
            raise NodeDied(f"{what}: {described(error)} ({where})") from error

    def _built(self, name: str) -> Host:
        """A host of a node that is newly made."""
        node, ports = build_node(self._resolved.nodes[name], name), self._wiring.ports(name)
        period_ns = self._resolved.period_ns
        host = Host(
            name,
            node,
            ports,
            self._resolved.seed,
            encode=self._encode,
            period_ns=period_ns,
            emit=self._sent,
            wiring=self._wiring,
            timespan=self._resolved.timespan,
        )
        self._made.append(host)
        return host

    def _peers(self, name: str) -> dict[str, str]:
        return {peer: self._roles[peer] for peer in self.hosts if peer != name}

    def _carry_out(self, frame: int) -> None:
        """What the scenario does to processes before a frame, when all is quiet; as `Driver` does it on a mesh."""
        for group in self.timetable.before(frame, self.hosts):
            come = {step.node: self._built(step.node) for step in group if step.action not in LEAVING}
            for step in group:
                if step.action in LEAVING:
                    self.gone[step.node] = self.hosts.pop(step.node)
                if step.action == "leave":
                    self._results[step.node] = self.gone[step.node].finish()
            for host in self.hosts.values():
                for step in group:
                    (host.joined if step.node in come else host.left)(step.node, self._roles[step.node])
            self.hosts |= come
            for name in come:
                self.gone.pop(name, None)
                self._start(name)
            self.steps += group
            self._drain()

    def _drain(self) -> None:
        """Deliver until nothing is under way: the frame is over."""
        while self._pending:
            name, (key, payload, step, flaw) = self._pending.next()
            host = self.hosts.get(name)
            if host:
                host.deliver(key, payload, step, flaw=flaw)

    def _sent(self, message: Outgoing) -> None:
        """A node has sent a message: it is under way to all who hear it."""
        if self._tap:
            self._tap(message)
        self._pending.push(self._hears[message.key], message)


class _Fifo(deque[tuple[str, Outgoing]]):
    """Deliveries in the order in which they were sent."""

    def push(self, subscribers: Sequence[str], message: Outgoing) -> None:
        self.extend([(subscriber, message) for subscriber in subscribers])

    def next(self) -> tuple[str, Outgoing]:
        return self.popleft()


class _Shuffled:
    """Deliveries in a random order that keeps the order of each key at each subscriber."""

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


def results_of(runs: Mapping[str, dict[str, Any]], key: str) -> Any:
    """The one result named `key` among the results of all nodes, or None."""
    found = [results[key] for results in runs.values() if key in results]
    return found[0] if found else None

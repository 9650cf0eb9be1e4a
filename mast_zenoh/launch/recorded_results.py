"""Computes the results of a node that receives every key from a recording.

A node that measures a run depends on messages alone, so it measures the same from the run's recording: with other
parameters, with a later version, or after the run was killed before the node handed in its results.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from mast_zenoh.config.resolved import Resolved, build_node
from mast_zenoh.control import failures
from mast_zenoh.errors import HandlerFailed, RunFolderError
from mast_zenoh.messagelog import channels
from mast_zenoh.messagelog.events import JOINED, LEFT, REWIRED, Event
from mast_zenoh.messagelog.reader import Recorded, events, file_of, read
from mast_zenoh.messages import user_types
from mast_zenoh.messages.row_limits import RowLimits
from mast_zenoh.runtime.host import Host
from mast_zenoh.wiring.model import ANY, Endpoint, Wiring

#: Frames for which messages wait for others of their key and frame: the largest error of times in headers.
_HELD_FRAMES = 8


def results_of(resolved: Resolved, name: str, path: Path) -> dict[str, Any]:
    """The results of a node's `finish` after it has received a recording.

    resolved: the scenario of the recorded run, with the user's modules loaded
    name:     a node of that scenario that receives every key
    path:     the recording, or the folder of the run

    Recordings of earlier versions contain neither changes of the run nor the frame in which a message was sent: the
    initial nodes and wiring are assumed throughout, and each message to have been sent in its own frame.
    Raises RunFolderError for a recording that is missing or damaged, and HandlerFailed if the node fails.
    """
    path = file_of(path)
    changes = deque(events(path) or _initial_events(resolved))
    if changes[0].what != REWIRED:
        raise RunFolderError(f"{path}: the first event is not the wiring that the run began with")
    user_types.use(resolved.messages)
    node = build_node(resolved.nodes[name], name)
    overhearers = [Endpoint(name, port) for port, message in node.inputs.items() if message == ANY]
    wiring = _wiring(changes.popleft(), overhearers, path)
    period_ns = resolved.period_ns
    host = Host(
        name,
        node,
        wiring.ports(name),
        resolved.seed,
        encode=True,
        emit=lambda out: None,
        period_ns=period_ns,
        wiring=wiring,
        timespan=resolved.timespan,
    )
    host.limits = RowLimits(resolved.max_rows)
    present = {}
    while changes and changes[0].what == JOINED and changes[0].frame < 0:
        event = changes.popleft()
        present[event.node] = event.role
    host.start({peer: role for peer, role in present.items() if peer != name})

    def change(event: Event) -> None:
        if event.what == REWIRED:
            new = _wiring(event, overhearers, path)
            for key, port_input in new.ports(name).inputs.items():
                host.add_input(key, port_input)
            host.rewired(new)
        elif event.node != name:
            (host.left if event.what == LEFT else host.joined)(event.node, event.role)

    for step, message in _in_order_sent(_by_step(read(path)), [event.frame for event in changes]):
        while changes and step > changes[0].frame:
            change(changes.popleft())
        host.deliver(message.key.removesuffix(f"/{channels.MALFORMED}"), message.payload, message.step, counted=False)
    for event in changes:
        change(event)
    results = host.finish()
    if host.failures:
        failed = failures.summary({name: [failure.entry() for failure in host.failures.values()]})
        raise HandlerFailed(f"{failed}\nnothing was written: the results of the run itself are kept")
    return results


def _in_order_sent(messages: Iterable[tuple[int, Recorded]], changes: Sequence[int]) -> Iterator[tuple[int, Recorded]]:
    """The messages; messages with the same key and frame are in the order of sending.

    changes: frames after which the run changed, ascending; no message is moved across a change
    """
    held: list[tuple[int, int, Recorded]] = []
    upcoming = deque(changes)

    def release(before: int) -> Iterator[tuple[int, Recorded]]:
        ready = sorted((each for each in held if each[1] < before), key=lambda each: each[0])
        held[:] = [each for each in held if each[1] >= before]
        yield from ((step, message) for _, step, message in ready)

    for step, message in messages:
        while upcoming and step > upcoming[0]:
            yield from release(upcoming.popleft() + 1)
        if message.message == "clock":
            yield from release(message.frame - _HELD_FRAMES)
        if message.rank >= 0:
            held.append((message.rank, step, message))
        else:
            yield step, message
    yield from ((step, message) for _, step, message in sorted(held, key=lambda each: each[0]))


def _by_step(messages: Iterable[Recorded]) -> Iterator[tuple[int, Recorded]]:
    """Pairs (step, message): messages by frame, delayed to the step of sending."""
    waiting: list[tuple[int, int, Recorded]] = []
    for count, message in enumerate(messages):
        while waiting and waiting[0][0] < message.frame:
            step, _, late = heapq.heappop(waiting)
            yield step, late
        if message.step > message.frame >= 0:
            heapq.heappush(waiting, (message.step, count, message))
        else:
            yield max(message.frame, message.step), message
    while waiting:
        step, _, late = heapq.heappop(waiting)
        yield step, late


def _wiring(event: Event, overhearers: Sequence[Endpoint], path: Path) -> Wiring:
    """The wiring in an event, with these overhearers even if the run lacked them."""
    try:
        wiring = Wiring.from_json(event.wiring)
    except (ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        raise RunFolderError(f"{path}: the wiring of frame {event.frame} cannot be read: {error!r}") from None
    added = [end for end in overhearers if end not in wiring.overhearers]
    return Wiring(wiring.wires, (*wiring.overhearers, *added))


def _initial_events(resolved: Resolved) -> list[Event]:
    """The events of a run that does not change."""
    joined = [Event(JOINED, -1, node, spec.role) for node, spec in resolved.nodes.items()]
    return [Event(REWIRED, -1, wiring=resolved.wiring), *joined]

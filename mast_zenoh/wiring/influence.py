"""What the messages on a wire can affect: reachability in a wiring. Pure.

A wire leads to its subscribers; a node, from each input to the outputs that it affects, after a number of frames
(`NodeFlow`). Interposers forward on their wire. A message has no influence on an agent that gets it back in objects
that say from which agents they come, nor through the world: what a car does changes the world, not what is said of it.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Mapping
from typing import NamedTuple

from mast_zenoh.messages.schemas import SCHEMAS
from mast_zenoh.wiring.model import NodeFlow, Wire, Wiring, agent_of

_FORWARDS = NodeFlow()


class Reach(NamedTuple):
    """Where the influence of messages ends up, each with the least number of frames after which.

    sent:    by key, the wires on which messages depend on them
    arrived: by key of a wire and node, the subscribers of their own wire and of those in `sent`
    """

    sent: Mapping[str, int]
    arrived: Mapping[tuple[str, str], int]


class Influence:
    """The influence of the wires of a wiring."""

    def __init__(self, wiring: Wiring) -> None:
        self.wires = {wire.key: wire for wire in wiring.wires}
        self._flows = wiring.nodes
        #: types of messages whose objects say from which agents they come, so that these leave them out
        self._with_origins = {message for message in {wire.message for wire in wiring.wires} if _has_origins(message)}
        self._outputs: defaultdict[str, list[tuple[str, Wire]]] = defaultdict(list)  # by node: port and wire
        for wire in wiring.wires:
            publisher = wire.legs[0].publisher
            self._outputs[publisher.node].append((publisher.port, wire))
        self._known: dict[tuple[str, str, bool], Reach] = {}

    def of(self, key: str, before: str = "", *, fused: bool = True) -> Reach:
        """The reach of messages on a wire.

        before: the only subscriber that receives them; empty: all
        fused: False: without what depends on them only together with what other agents say (`NodeFlow.fuses`)
        """
        known = self._known.get((key, before, fused))
        if known is None:
            known = self._known[key, before, fused] = self._reach(self.wires[key], before, fused)
        return known

    def _reach(self, begin: Wire, before: str, fused: bool) -> Reach:
        origin = agent_of(begin.subject)
        sent: dict[str, int] = {}
        arrived: dict[tuple[str, str], int] = {}
        waiting = [(0, begin.key, before)]
        while waiting:
            frames, key, only = heapq.heappop(waiting)
            wire = self.wires[key]
            if frames > sent.get(key, frames):
                continue
            left_out = wire.message in self._with_origins
            for end in (*wire.subscribers, *(each.end for each in wire.listeners if not each.source)):
                if only not in ("", end.node) or (left_out and origin in self._agents_of(end.node)):
                    continue
                if frames >= arrived.get((key, end.node), frames + 1):
                    continue
                arrived[key, end.node] = frames
                flow = self._flows.get(end.node, _FORWARDS)
                delays = flow.delays(end.port, wire.traits)
                for port, other in self._outputs[end.node]:
                    delay = 0 if delays is None else delays.get(port)
                    if delay is None or (port in flow.fuses and not fused):
                        continue
                    if frames + delay < sent.get(other.key, frames + delay + 1):
                        sent[other.key] = frames + delay
                        heapq.heappush(waiting, (frames + delay, other.key, ""))
        return Reach(sent, arrived)

    def _agents_of(self, node: str) -> set[str]:
        """The agents about which a node publishes."""
        return {agent_of(wire.subject) for _, wire in self._outputs[node]}


def _has_origins(message: str) -> bool:
    """Whether the objects of a type of messages say from which agents they come."""
    schema = SCHEMAS.get(message)
    return schema is not None and any(
        column.name == "origin" and column.shape == ("n", "a") for column in schema.columns
    )

"""Which estimates are on the wires of a run, and what can affect them. Pure."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Bools, Ints
from mast_zenoh.metrics.estimates import LOCAL, PICTURE, PICTURE_ON_ARRIVAL, PICTURE_RECEIVED, RECEIVED
from mast_zenoh.metrics.record import Series
from mast_zenoh.wiring.influence import Influence
from mast_zenoh.wiring.model import SENSOR, UP, InterposedWire, Wire, Wiring, agent_of

#: Types of messages with an agent's own tracks, alone or among those of others.
TRACKS = ("tracks", "collated")
#: Types of messages that say nothing of the world: what an agent thinks of others.
_OPINIONS = ("gossip",)


class Carried(NamedTuple):
    """An estimate on a key. wire: that of the key; receiver: the node that receives it so; empty: as it is sent"""

    wire: Wire
    key: str
    series: Series
    receiver: str = ""


def estimates_on(wiring: Wiring, agents: Collection[str]) -> Iterator[Carried]:
    """The estimates on all wires, by their traits; of a wire first as it is sent, then as it is received."""
    brokers = {wire.legs[0].publisher.node for wire in wiring.wires if wire.message == "collated"}
    for wire in wiring.wires:
        if name := wire.traits.estimate:
            source, subject = wire.legs[0], agent_of(wire.subject)
            ends = {end.node: leg.key for leg in wire.every_leg for end in leg.subscribers}
            of_region = subject not in ("", *agents)
            if of_region and not any(end in agents for end in ends):
                continue  # for another centre
            owner = "" if of_region else subject
            yield Carried(wire, source.key, Series(owner, name))
            for end, key in ends.items():
                if name == LOCAL and end in brokers:
                    yield Carried(wire, key, Series(owner, RECEIVED), end)
                elif name == PICTURE and end in agents:
                    yield Carried(wire, key, Series(end, PICTURE_RECEIVED), end)


class EstimateWires:
    """The estimates in one wiring, and what can affect them.

    sent, received: by estimate, the wires with it as it is sent; and by key, the nodes that receive it on that wire
    """

    def __init__(self, wiring: Wiring, agents: Collection[str]) -> None:
        wiring = wiring.recorded or wiring  # a replay leaves out what nobody needs
        self.influence = Influence(wiring)
        self.sent: defaultdict[tuple[str, str], list[Wire]] = defaultdict(list)
        self.received: defaultdict[tuple[str, str], dict[str, str]] = defaultdict(dict)
        for wire, _, series, receiver in estimates_on(wiring, agents):
            if receiver:
                self.received[series][wire.key] = receiver
            else:
                self.sent[series].append(wire)
        self._estimates = {wire.key for wires in self.sent.values() for wire in wires}
        self._roles = {name: flow.role for name, flow in wiring.nodes.items()}
        self._agents, self._speakers = agents, dict[str, str]()
        self._tracks_on: dict[str, frozenset[str]] | None = None

    def frames(self, key: str, before: str, series: tuple[str, str], fused: bool = True) -> int | None:
        """Number of frames after which messages on a wire can affect an estimate; None: they cannot.

        before, fused: see `Influence.of`
        """
        reach = self.influence.of(key, before, fused=fused)
        found = [reach.sent.get(wire.key) for wire in self.sent_as(series)]
        found += [reach.arrived.get(place) for place in self.received[_as_received(series)].items()]
        return min((frames for frames in found if frames is not None), default=None)

    def carries(self, key: str, series: tuple[str, str]) -> bool:
        """Whether an estimate as received is what a wire carries."""
        return key in self.received[_as_received(series)]

    def arrives_at(self, key: str, before: str, series: tuple[str, str]) -> bool:
        """Whether messages on a wire reach the node that makes an estimate, fused with nobody's before."""
        makers = {wire.legs[0].publisher.node for wire in self.sent_as(series)}
        return any(node in makers for _, node in self.influence.of(key, before, fused=False).arrived)

    def sent_as(self, series: tuple[str, str]) -> list[Wire]:
        """The wires with an estimate of an agent, or with the one that it shares with others."""
        return self.sent.get(series) or self.sent.get(("", series[1]), [])

    def enters_world(self, key: str, before: str = "") -> bool:
        """Whether messages on a wire change the world itself, which every estimate is about."""
        return any(
            self._roles.get(node) == "simulator" for wire, node in self.influence.of(key, before).arrived if wire == key
        )

    def matters(self, key: str, before: str = "") -> bool:
        """Whether an estimate, or the world, depends on messages on a wire."""
        sent, arrived = self.influence.of(key, before)
        return (
            not self._estimates.isdisjoint(sent)
            or any(place in arrived for places in self.received.values() for place in places.items())
            or any(self._roles.get(node) == "simulator" for _, node in arrived)
        )

    def tracks_on(self, key: str) -> frozenset[str]:
        """The agents whose own tracks are on a wire, fused with nobody's."""
        if self._tracks_on is None:
            agents: defaultdict[str, set[str]] = defaultdict(set)
            for (agent, estimate), wires in self.sent.items():
                for wire in wires if estimate == LOCAL else ():
                    for other in (wire.key, *self.influence.of(wire.key, fused=False).sent):
                        if self.influence.wires[other].message in TRACKS:
                            agents[other].add(agent)
            self._tracks_on = {other: frozenset(names) for other, names in agents.items()}
        return self._tracks_on.get(key, frozenset())

    def speaker(self, key: str) -> str:
        """The agent whose word the messages of a wire are; empty: nobody's.

        That is what it says of the world, or what that depends on, as far as an estimate depends on it in turn; no
        opinions about others.
        """
        if key not in self._speakers:
            wire = self.influence.wires[key]
            agent = agent_of(wire.subject)
            says = wire.message not in _OPINIONS and wire.traits.direction in (SENSOR, UP) and agent in self._agents
            used = says and not self._estimates.isdisjoint(self.influence.of(key).sent)
            self._speakers[key] = agent if used else ""
        return self._speakers[key]


def _as_received(series: tuple[str, str]) -> tuple[str, str]:
    """The estimate as it is received, for what an agent holds of it later."""
    agent, estimator = series
    return (agent, PICTURE_RECEIVED) if estimator == PICTURE_ON_ARRIVAL else (agent, estimator)


class Influences:
    """What the passages of a run can affect, by the wirings that it had.

    agents: of the run
    """

    def __init__(self, agents: Collection[str]) -> None:
        self._agents = agents
        self._of_wire: dict[str, EstimateWires] = {}

    def follow(self, wiring: Wiring) -> None:
        """Use a wiring from now on; wires that it does not have are as before."""
        self._of_wire |= dict.fromkeys((wire.key for wire in wiring.wires), EstimateWires(wiring, self._agents))

    def of(self, passage: InterposedWire) -> EstimateWires | None:
        """What is known of the wire of a passage; None: nothing, so its messages can affect nothing."""
        return self._of_wire.get(passage.wire)

    def reach(
        self, passages: Sequence[InterposedWire], series: Sequence[tuple[str, str]], alone: Bools
    ) -> tuple[Bools, Ints]:
        """Whether messages of p passages can affect s estimates, and after how many frames: (p, s).

        alone: (p,) passages of which only those effects count that come before the messages are fused with what others
               say, unless they are from an agent's sensors
        """
        shape = len(passages), len(series)
        reached, delay = np.zeros(shape, bool), np.zeros(shape, np.int64)
        for row, passage in enumerate(passages):
            if (known := self.of(passage)) is None:
                continue
            fused = not alone[row] or known.influence.wires[passage.wire].traits.direction == SENSOR
            for column, each in enumerate(series):
                frames = known.frames(passage.wire, passage.before, each, fused)
                if frames is not None:
                    reached[row, column], delay[row, column] = True, frames
        return reached, delay

"""A peer: the fusion on board of one agent, without a centre.

It broadcasts its agent's own tracks to the peers of all other agents, and fuses them with those that it hears. Its
picture goes to its agent, as a command centre's would. What it hears in a frame is used from the next one on: a message
takes that long on the air, and the result does not depend on the order of arrival.

Only own perception is broadcast, as the standard intends (ETSI TS 103 324). Where a map has a wire for it
(keyexpr_maps/relays.toml), a peer relays its picture, too, each object with the agents whose tracks are in it. A
receiver leaves out objects that have its own tracks in them; others it may count twice: rumours.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.arrays.geometry import states_to_world
from mast_zenoh.arrays.states import Bools, ObjectStates, concatenate
from mast_zenoh.gather import MAX_AGE_S, Gather, LatestBefore, plausible_rows
from mast_zenoh.integrity.views import SweptView, check_view, view_of
from mast_zenoh.messages.schemas import Body, text
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.pipelines import Pipeline, trust_body
from mast_zenoh.pipelines.heard import HeardTracks
from mast_zenoh.pipelines.origins import Origins
from mast_zenoh.runtime.mesh.hosting import main
from mast_zenoh.tracking.kalman import predicted

#: Ending of the name under which what an agent relays is fused, beside what it broadcasts.
RELAY = "/relay"


class Relay(NamedTuple):
    """Objects of another agent's picture.

    states: n objects at `time_ns`, world frame; origin: (n, a) whether each of `agents` is among their origins
    """

    time_ns: int
    states: ObjectStates
    agents: tuple[str, ...]
    origin: Bools

    def without(self, agent: str) -> Relay:
        """The objects that have none of an agent's tracks in them."""
        if agent not in self.agents:
            return self
        kept = ~self.origin[:, self.agents.index(agent)]
        return self._replace(states=self.states.select(kept), origin=self.origin[kept])


class Peer(Node):
    """Fuses the tracks of its agent with those that it hears.

    agent: whose peer it is
    pipeline: from the tracks of all to the picture, as in a command centre
    memory_s: how long an object is kept that a newer message of its sender left out; 0: not at all
    max_age_s: the greatest age of a track that is used
    """

    role = "peer"
    inputs = {
        "clock": "clock",
        "own": "tracks",
        "heard": "tracks",
        "own_view": "view",
        "heard_view": "view",
        "relayed": "relayed",
    }
    outputs = {"broadcast": "tracks", "relay": "relayed", "picture": "picture", "trust": "trust"}

    def __init__(self, agent: str, pipeline: Pipeline, memory_s: float = 0.0, max_age_s: float = MAX_AGE_S) -> None:
        self.agent = agent
        self.pipeline = pipeline
        self.heard = HeardTracks(memory_s, max_age_s)
        self.relays: dict[str, LatestBefore[Relay]] = {}
        self.origins = Origins()
        self.max_age_ns = round(max_age_s * 1e9)
        self.sensed: Gather[str, Received] = Gather({"clock", "own"})
        self.own: tuple[int, ObjectStates] | None = None  # time, ns, and tracks
        self.views: dict[str, LatestBefore[tuple[int, Body]]] = {}
        self.newest_ns = 0
        self.received: Counter[str] = Counter()
        self.absurd = 0

    def start(self, context: Context) -> None:
        """Wait for the agent's view in each frame, if agents send any."""
        self.pipeline.bind(context.seed, context.name)
        if any(source.port == "own_view" for source in context.subscriptions.values()):
            self.sensed.expected.add("own_view")

    def on_clock(self, received: Received, context: Context) -> None:
        """Fuse what there is for frames for which the agent sent nothing."""
        for frame, items in self.sensed.expired(received.frame):
            self.fuse(frame, items, context)
        self.sense("clock", received, context)

    def on_own(self, received: Received, context: Context) -> None:
        """The tracks of its own agent: broadcast them."""
        context.publish("broadcast", received.body, frame=received.frame, time_ns=received.time_ns)
        self.sense("own", received, context)

    def on_own_view(self, received: Received, context: Context) -> None:
        """What the sensor of its own agent covers."""
        self.sense("own_view", received, context)

    def on_heard(self, received: Received, context: Context) -> None:
        """The tracks of another agent."""
        self.received[received.subject] += 1
        self.heard.add(received.subject, context.frame, received.time_ns, self.tracks_of(received))

    def on_relayed(self, received: Received, context: Context) -> None:
        """The picture of another agent."""
        body = received.body
        states = ObjectStates.from_columns(body)
        plausible = plausible_rows(states)
        self.absurd += len(states) - len(plausible)
        names, origin = tuple(body["agents"]), body["origin"][plausible] > 0
        relay = Relay(received.time_ns, states.select(plausible), names, origin).without(self.agent)
        self.relays.setdefault(received.subject, LatestBefore()).add(context.frame, relay, received.frame)

    def on_heard_view(self, received: Received, context: Context) -> None:
        """What the sensor of another agent covers."""
        try:
            check_view(received.body)
        except ValueError as error:
            context.reject(f"implausible: view: {error}")
            return
        views = self.views.setdefault(received.subject, LatestBefore())
        views.add(context.frame, (received.time_ns, received.body), received.frame)

    def sense(self, port: str, received: Received, context: Context) -> None:
        """Fuse a frame once all has arrived that its agent sends."""
        items = self.sensed.add(received.frame, port, received)
        if items is not None:
            self.fuse(received.frame, items, context)

    def fuse(self, frame: int, items: Mapping[str, Received], context: Context) -> None:
        """Publish the picture of a frame, and the trust in agents and objects."""
        time_ns = items.get("clock", next(iter(items.values()))).time_ns
        if time_ns < self.newest_ns:
            context.reject(f"old: frame {frame}: time_ns is {time_ns}, expected at least {self.newest_ns}")
            return
        self.newest_ns = time_ns
        if "own" in items:
            self.own = items["own"].time_ns, self.tracks_of(items["own"])
        tracks = self.heard.at(frame, time_ns)
        if self.own is not None and abs(time_ns - self.own[0]) <= self.max_age_ns:
            tracks[self.agent] = predicted(self.own[1], (time_ns - self.own[0]) * 1e-9)
        if views := self.views_at(frame, time_ns, items):
            self.pipeline.look(views)
        relays = self.relays_at(frame, time_ns) if context.connected("relay") else {}
        tracks |= {f"{name}{RELAY}": relay.states for name, relay in relays.items()}
        names = tuple(sorted(tracks))
        parts = [tracks[name] for name in names]
        agent = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        picture, support = self.pipeline.step(time_ns, concatenate(parts), agent, names)
        context.publish("picture", picture.columns() | {"support": support}, frame=frame, time_ns=time_ns)
        if context.connected("relay"):
            agents, origin = self.origins_of(picture, names, parts, relays)
            body = picture.columns() | {"agents": text(agents), "origin": origin.astype(np.uint8)}
            context.publish("relay", body, frame=frame, time_ns=time_ns)
        if self.pipeline.trust is not None:
            context.publish("trust", trust_body(self.pipeline.trust), frame=frame, time_ns=time_ns)

    def relays_at(self, frame: int, time_ns: int) -> dict[str, Relay]:
        """The pictures of the other agents, predicted to a time; by name."""
        relays = {}
        for name, relay in self.relays.items():
            latest = relay.get(frame)
            if latest is not None and abs(time_ns - latest[1].time_ns) <= self.max_age_ns:
                age_s = (time_ns - latest[1].time_ns) * 1e-9
                relays[name] = latest[1]._replace(states=predicted(latest[1].states, age_s))
        return relays

    def origins_of(
        self, picture: ObjectStates, names: Sequence[str], parts: Sequence[ObjectStates], relays: Mapping[str, Relay]
    ) -> tuple[list[str], Bools]:
        """Names of a agents, sorted, and whether each is among the origins of each object of the picture: (n, a).

        names, parts: the members of the step and their tracks, in the order of the pipeline's input
        """
        direct = {name for name in names if not name.endswith(RELAY)}
        agents = sorted(direct.union(*(relay.agents for relay in relays.values())))
        origins = []
        for name, part in zip(names, parts, strict=True):
            rows = np.zeros((len(part), len(agents)), np.bool_)
            if name in direct:
                rows[:, agents.index(name)] = True
            else:
                relay = relays[name.removesuffix(RELAY)]
                rows[:, [agents.index(each) for each in relay.agents]] = relay.origin
            origins.append(rows)
        of_members = np.concatenate([np.zeros((0, len(agents)), np.bool_), *origins])
        return agents, self.origins.update(picture.id, self.pipeline.members, of_members, agents)

    def views_at(self, frame: int, time_ns: int, items: Mapping[str, Received]) -> dict[str, SweptView]:
        """What the sensors of the agents cover, as far as it is known; by name."""
        views = {}
        for name, heard in self.views.items():
            latest = heard.get(frame)
            if latest is not None and abs(time_ns - latest[1][0]) <= self.max_age_ns:
                views[name] = view_of(latest[1][1], (time_ns - latest[1][0]) * 1e-9)
        if "own_view" in items:
            views[self.agent] = view_of(items["own_view"].body)
        return views

    def tracks_of(self, received: Received) -> ObjectStates:
        """The tracks in a message, world frame, without absurd ones."""
        body = received.body
        states = states_to_world(ObjectStates.from_columns(body), body["origin"], body["rotation"])
        plausible = plausible_rows(states)
        self.absurd += len(states) - len(plausible)
        return states if len(plausible) == len(states) else states.select(plausible)

    def finish(self, context: Context) -> dict[str, Any]:
        """Numbers of messages heard from each agent, of absurd tracks, and what the pipeline counted."""
        innovations = self.pipeline.innovations
        facts = self.pipeline.facts() | {"heard": dict(sorted(self.received.items())), "absurd": self.absurd}
        return facts | ({} if innovations is None else {"innovations": innovations.summary()})


if __name__ == "__main__":
    main(Peer)

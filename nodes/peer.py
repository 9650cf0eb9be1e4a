"""A peer: the fusion on board of one agent, without a centre.

It broadcasts its agent's own tracks to the peers of all other agents, and fuses them with those that it hears. Its
picture goes to its agent, as a command centre's would. What it hears in a frame is used from the next one on: a message
takes that long on the air, and the result does not depend on the order of arrival.

Only own perception is broadcast, as the standard intends (ETSI TS 103 324). With `relays`, the objects of its last
picture follow, each with the agents whose tracks it comes from: rumours, which a receiver may count twice.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from mast_zenoh.arrays.geometry import states_to_world
from mast_zenoh.arrays.states import ObjectStates, concatenate
from mast_zenoh.gather import MAX_AGE_S, Gather, LatestBefore, plausible_rows
from mast_zenoh.integrity.views import SweptView, check_view, view_of
from mast_zenoh.messages.schemas import Body
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.pipelines import Pipeline, trust_body
from mast_zenoh.pipelines.heard import HeardTracks
from mast_zenoh.runtime.mesh.hosting import main
from mast_zenoh.tracking.kalman import predicted


class Peer(Node):
    """Fuses the tracks of its agent with those that it hears.

    agent: whose peer it is
    pipeline: from the tracks of all to the picture, as in a command centre
    memory_s: how long an object is kept that a newer message of its sender left out; 0: not at all
    max_age_s: the greatest age of a track that is used
    """

    role = "peer"
    inputs = {"clock": "clock", "own": "tracks", "heard": "tracks", "own_view": "view", "heard_view": "view"}
    outputs = {"broadcast": "tracks", "picture": "picture", "trust": "trust"}

    def __init__(self, agent: str, pipeline: Pipeline, memory_s: float = 0.0, max_age_s: float = MAX_AGE_S) -> None:
        self.agent = agent
        self.pipeline = pipeline
        self.heard = HeardTracks(memory_s, max_age_s)
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
        names = tuple(sorted(tracks))
        parts = [tracks[name] for name in names]
        agent = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        picture, support = self.pipeline.step(time_ns, concatenate(parts), agent, names)
        context.publish("picture", picture.columns() | {"support": support}, frame=frame, time_ns=time_ns)
        if self.pipeline.trust is not None:
            context.publish("trust", trust_body(self.pipeline.trust), frame=frame, time_ns=time_ns)

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

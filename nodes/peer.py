"""A peer: the fusion on board of one agent, without a centre.

It broadcasts its agent's own tracks to the peers of all other agents, and fuses them with those that it hears. Its
picture goes to its agent, as a command centre's would. What it hears in a frame is used from the next one on: a message
takes that long on the air, and the result does not depend on the order of arrival. Where there is a channel node, that
tells it which messages arrived.

Only own perception is broadcast, as the standard intends (ETSI TS 103 324). Where a map has a wire for it
(keyexpr_maps/relays.toml), a peer relays its picture, too, each object with the agents whose tracks are in it. A
receiver leaves out objects that have its own tracks in them; others it may count twice: rumours. With
keyexpr_maps/gossip.toml, it tells others its trust in agents: its own judgement, without what it heard.

Where a map has a wire for it (keyexpr_maps/awareness.toml), the peer of a vehicle also says where its agent is itself,
by Cooperative Awareness Messages. For a receiver, the sender is one more of the sender's tracks.

A map may lead any other wire to peers, too. They fuse its tracks, if the wire has `use = "fuse"`, as those of one more
reporter beside its sender; of all else they only count the messages.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from mast_zenoh.arrays.geometry import heading, rotation_from_quaternion, tracks_in_world
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.fusion.input_limit import InputLimit
from mast_zenoh.gather import MAX_AGE_S, Gather, plausible_rows
from mast_zenoh.integrity.views import SweptView, check_view, view_of
from mast_zenoh.messages.limits import RowChoice
from mast_zenoh.messages.schemas import Body, text
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.pipelines import Pipeline, trust_body
from mast_zenoh.pipelines.admission import Admission
from mast_zenoh.pipelines.heard import AgentTracks, HeardTracks
from mast_zenoh.pipelines.inbox import MAX_WAITING, Heard, Inbox
from mast_zenoh.pipelines.relays import Relay, Relays
from mast_zenoh.runtime.mesh.hosting import main
from mast_zenoh.tracking.kalman import predicted
from mast_zenoh.v2x import CamGeneration, CongestionControl, GenerationRules, Vehicle
from mast_zenoh.v2x.station import Station
from mast_zenoh.wiring.model import ANY, FUSE

#: How long what a vehicle says of itself is used, s: until its next message, after 1 s at the latest, is overdue.
AWARENESS_AGE_S = 1.2
#: Id of a sender among its own tracks.
ITSELF = 1 << 62
#: Frame of reference of what a vehicle says of itself.
WORLD = {"origin": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}


class Peer(Node):
    """Fuses the tracks of its agent with those that it hears.

    agent: whose peer it is
    pipeline: from the tracks of all to the picture, as in a command centre
    rules: when it broadcasts which tracks; None: all in every frame
    congestion: how often it may broadcast, by the load of the channel; None: always
    memory_s: how long an object is kept that a newer message of its sender left out, as generation rules do; 0: not at
        all
    max_age_s: the greatest age of a track that is used
    correlations: whether broadcast covariances have correlations; standard messages have variances alone
    awareness: when it says where its agent is itself; None: never
    vehicle: what its agent knows of itself; None: it is no vehicle, and says nothing of itself
    input_limit: which tracks are fused, if there are too many; None: FairInput, with as many as the scene needs
    """

    role = "peer"
    inputs = {
        "clock": "clock",
        "pose": "pose",
        "own": "tracks",
        "own_view": "view",
        "heard": "tracks",
        "heard_view": "view",
        "heard_awareness": "tracks",
        "relayed": "relayed",
        "heard_gossip": "gossip",
        "reception": "reception",
    }
    outputs = {
        "broadcast": "tracks",
        "broadcast_view": "view",
        "awareness": "tracks",
        "relay": "relayed",
        "gossip": "gossip",
        "picture": "picture",
        "trust": "trust",
    }
    takes = (ANY,)
    fuses = ("relay", "gossip", "picture", "trust")
    affects = {
        "clock": dict.fromkeys(outputs, 0),
        "reception": dict.fromkeys(outputs, 0),
        "pose": {"awareness": 0, "broadcast": 0},
        "own": dict.fromkeys(("broadcast", *fuses), 0),
        "own_view": dict.fromkeys(("broadcast_view", *fuses), 0),
        # That others' trust in a sender follows from what it said is not counted as its influence: no `gossip`.
        **{
            port: {"relay": 1, "picture": 1, "trust": 1}
            for port in ("heard", "heard_view", "heard_awareness", "relayed", "heard_gossip", "")
        },
    }

    def __init__(
        self,
        agent: str,
        pipeline: Pipeline,
        rules: GenerationRules | None = None,
        congestion: CongestionControl | None = None,
        memory_s: float = 0.0,
        max_age_s: float = MAX_AGE_S,
        correlations: bool = True,
        awareness: CamGeneration | None = None,
        vehicle: Vehicle | None = None,
        input_limit: InputLimit | None = None,
    ) -> None:
        self.agent = agent
        self.correlations = correlations
        self.pipeline = pipeline
        self.station = Station(rules, congestion, awareness)
        self.vehicle = vehicle
        self.max_age_ns = round(max_age_s * 1e9)
        self.sensed: Gather[str, Received] = Gather({"clock", "own"})
        self.inbox = Inbox()
        self.heard = HeardTracks(memory_s, max_age_s)
        self.aware = HeardTracks(0.0, AWARENESS_AGE_S)
        self.admission = Admission(input_limit)
        self.beyond: dict[str, int] = {}  # rows that the newest message of each agent had besides those that are used
        self.views: dict[str, tuple[int, Body]] = {}  # their times, ns, and columns
        self.relays = Relays(agent, max_age_s)
        self.relaying: set[str] = set()  # agents that can be origins of what others relay
        self.trusts: dict[str, tuple[int, dict[str, float]]] = {}  # by teller, time, ns, and trust in agents
        self.own: tuple[int, ObjectStates] | None = None  # time, ns, and tracks
        self.place = np.zeros(3)
        self.newest_ns = 0
        self.counts: Counter[str] = Counter()
        self.fused_ports: set[str] = set()  # further ports whose tracks are fused

    def start(self, context: Context) -> None:
        """Wait in each frame for all that the agent and the channel send."""
        self.pipeline.bind(context.seed, context.name)
        self.station.switch_on(float(context.rng("switched on").random()))
        sources = context.subscriptions.values()
        ports = {source.port for source in sources}
        self.fused_ports = {
            source.port for source in sources if source.traits.use == FUSE and source.message == "tracks"
        }
        self.relaying = {self.agent, *(source.subject for source in sources if source.port == "relayed")}
        self.sensed.expected |= ports & {"pose", "own_view", "reception"}

    def choice(self, port: str, subject: str, step: int) -> RowChoice | None:
        """Of too many tracks, those that the input limit keeps."""
        return self.admission.choice(subject, step) if port in ("own", "heard") else None

    def on_clock(self, received: Received, context: Context) -> None:
        """Fuse what there is for frames for which the agent sent nothing."""
        self.admission.begin(received.frame)
        for frame, items in self.sensed.expired(received.frame):
            self.process(frame, items, context)
        self.sense("clock", received, context)

    def on_pose(self, received: Received, context: Context) -> None:
        """The pose of its agent."""
        self.sense("pose", received, context)

    def on_own(self, received: Received, context: Context) -> None:
        """The tracks of its agent."""
        self.sense("own", received, context)

    def on_own_view(self, received: Received, context: Context) -> None:
        """What the sensor of its agent covers, which the others are told too, in every frame."""
        if context.connected("broadcast_view"):
            context.publish("broadcast_view", received.body, frame=received.frame, time_ns=received.time_ns)
        self.sense("own_view", received, context)

    def on_reception(self, received: Received, context: Context) -> None:
        """Which messages of the frame before arrived, and how busy the channel was."""
        self.sense("reception", received, context)

    def on_heard(self, received: Received, context: Context) -> None:
        """The tracks of another agent."""
        self.hear("heard", received, context)

    def on_heard_view(self, received: Received, context: Context) -> None:
        """What the sensor of another agent covers."""
        try:
            check_view(received.body)
        except ValueError as error:
            context.reject(f"implausible: view: {error}")
            return
        self.hear("heard_view", received, context)

    def on_heard_awareness(self, received: Received, context: Context) -> None:
        """Where another agent says that it is."""
        if len(received.body["id"]):  # otherwise nothing is on the air
            self.hear("heard_awareness", received, context)

    def on_relayed(self, received: Received, context: Context) -> None:
        """The picture of another agent. Origins that are no agents would go round among peers for ever."""
        if unknown := sorted(set(received.body["agents"]) - self.relaying):
            context.reject(f"implausible: relayed: agents: {len(unknown)} unknown, such as {unknown[0]!r}")
            return
        self.hear("relayed", received, context)

    def on_heard_gossip(self, received: Received, context: Context) -> None:
        """The trust of another agent in agents."""
        self.hear("heard_gossip", received, context)

    def on_message(self, received: Received, context: Context) -> None:
        """A message on a further wire."""
        if received.port in self.fused_ports:
            self.hear(received.port, received, context)
        else:
            self.counts[f"{received.port}/{received.subject}"] += 1

    def hear(self, port: str, received: Received, context: Context) -> None:
        """Keep a message of another agent for the next frame."""
        if not self.inbox.add(Heard(context.frame, port, received.subject, received.message)):
            context.reject(f"overflow: more than {MAX_WAITING} messages of {received.subject} on {port} in a frame")

    def sense(self, port: str, received: Received, context: Context) -> None:
        """Process a frame once all has arrived that its agent and the channel send."""
        items = self.sensed.add(received.frame, port, received)
        if items is not None:
            self.process(received.frame, items, context)

    def process(self, frame: int, items: Mapping[str, Received], context: Context) -> None:
        """Publish what the agent broadcasts in a frame, and its picture."""
        time_ns = items.get("clock", next(iter(items.values()))).time_ns
        if time_ns < self.newest_ns:
            context.reject(f"old: frame {frame}: time_ns is {time_ns}, expected at least {self.newest_ns}")
            return
        before_ns, self.newest_ns = self.newest_ns, time_ns
        self.open_inbox(frame, items.get("reception"), before_ns)
        if "pose" in items:
            self.place = items["pose"].body["position"]
            self.announce(time_ns, items["pose"], context)
        if own := items.get("own"):
            self.beyond[self.agent] = self.admission.note(self.agent, own.body)
            states = tracks_in_world(own.body)
            self.own = own.time_ns, self.plausible(states)
            self.broadcast(time_ns, own, states, context)
        self.fuse(frame, time_ns, items, context)

    def open_inbox(self, frame: int, reception: Received | None, before_ns: int) -> None:
        """Use the messages that arrived before a frame. before_ns: time of the frame before"""
        if reception is not None:
            busy, airtime_ns = float(reception.body["busy_ratio"][0]), int(reception.body["airtime_ns"][0])
            self.station.measure(reception.time_ns, busy, before_ns, airtime_ns)
        lost = {name: set() if reception is None else set(reception.body[name]) for name in ("lost", "lost_awareness")}
        for _, port, sender, message in self.inbox.take(frame):
            time_ns, body = message.header.time_ns, message.body
            if sender in lost["lost_awareness" if port == "heard_awareness" else "lost"]:
                if port in ("heard", "heard_awareness"):
                    self.counts[f"lost/{sender}"] += 1
            elif port == "heard":
                self.counts[f"heard/{sender}"] += 1
                self.beyond[sender] = self.admission.note(sender, body)
                states = self.plausible(tracks_in_world(body))
                self.heard.add(sender, time_ns, states)
                self.station.hear(time_ns, states, body["origin"])
            elif port in self.fused_ports:
                self.counts[f"{port}/{sender}"] += 1
                self.heard.add(f"{sender}/{port}", time_ns, self.plausible(tracks_in_world(body)))
            elif port == "heard_awareness":
                self.counts[f"aware/{sender}"] += 1
                states = self.plausible(tracks_in_world(body))
                self.aware.add(sender, time_ns, states.with_(id=np.full(len(states), ITSELF)))
                if len(states):
                    self.station.hear(time_ns, states, states.position[0])
            elif port == "heard_view":
                if time_ns >= self.views.get(sender, (0,))[0]:
                    self.views[sender] = time_ns, body
            elif port == "heard_gossip":
                if time_ns >= self.trusts.get(sender, (0,))[0]:
                    trust = zip(body["agents"].tolist(), body["trust"].tolist(), strict=True)
                    self.trusts[sender] = time_ns, dict(trust)
            else:
                self.relays.add(sender, self.relay_of(time_ns, body))

    def announce(self, time_ns: int, pose: Received, context: Context) -> None:
        """Say where the agent is, if that is due."""
        if self.vehicle is None:
            return
        body = pose.body
        yaw = float(heading(rotation_from_quaternion(body["rotation"])))
        itself = self.vehicle.state(body["position"], body["velocity"], yaw)
        if self.station.announce(time_ns, itself):
            context.publish("awareness", itself.columns() | WORLD, frame=pose.frame, time_ns=pose.time_ns)
            self.counts["announcements"] += 1

    def broadcast(self, time_ns: int, own: Received, states: ObjectStates, context: Context) -> None:
        """Broadcast the tracks of the agent that are due. states: those of the message, world frame"""
        if self.counts["broadcasts"] and not self.station.may_send(time_ns):
            self.counts["gate_closed"] += 1
        generation = self.station.transmit(time_ns, states, self.place)
        if generation.generated:
            reference = {name: own.body[name] for name in ("origin", "rotation")}
            sent = ObjectStates.from_columns(own.body).select(generation.rows)
            if not self.correlations:
                sent = sent.with_(covariance=sent.covariance * np.eye(9))
            body = sent.columns() | reference
            context.publish("broadcast", body, frame=own.frame, time_ns=own.time_ns, known=len(states))
            self.counts["broadcasts"] += 1

    def fuse(self, frame: int, time_ns: int, items: Mapping[str, Received], context: Context) -> None:
        """Publish the picture of a frame, and the trust in agents and objects."""
        tracks = self.heard.at(time_ns).joined(self.aware.at(time_ns), *self.own_at(time_ns))
        tracks = tracks.admitted(self.admission, self.beyond)
        relays = self.relays.at(time_ns)
        tracks = tracks.joined(*(AgentTracks.of(name, relay.states) for name, relay in relays.items()))
        if views := self.views_at(time_ns, items):
            self.pipeline.look(views)
        if trusts := self.trusts_at(time_ns):
            self.pipeline.hear(self.agent, trusts)
        picture, support = self.pipeline.step(time_ns, tracks.states, tracks.agent, tracks.names)
        context.publish("picture", picture.columns() | {"support": support}, frame=frame, time_ns=time_ns)
        if context.connected("relay"):
            origins, origin = self.relays.origins_of(picture.id, self.pipeline.members, tracks, relays)
            body = picture.columns() | {"agents": text(origins), "origin": origin.astype(np.uint8)}
            context.publish("relay", body, frame=frame, time_ns=time_ns)
        if self.pipeline.trust is not None:
            body = trust_body(self.pipeline.trust)
            context.publish("trust", body, frame=frame, time_ns=time_ns)
            if context.connected("gossip"):
                told = {"agents": body["agents"], "trust": body["mean"]}
                context.publish("gossip", told, frame=frame, time_ns=time_ns)

    def own_at(self, time_ns: int) -> list[AgentTracks]:
        """The tracks of its agent, predicted to a time; none if they are too old."""
        if self.own is None or abs(time_ns - self.own[0]) > self.max_age_ns:
            return []
        at_ns, states = self.own
        return [AgentTracks.of(self.agent, predicted(states, (time_ns - at_ns) * 1e-9))]

    def views_at(self, time_ns: int, items: Mapping[str, Received]) -> dict[str, SweptView]:
        """What the sensors of the agents cover, as far as it is known; by name."""
        self.views = {name: each for name, each in self.views.items() if abs(time_ns - each[0]) <= self.max_age_ns}
        views = {name: view_of(body, (time_ns - at_ns) * 1e-9) for name, (at_ns, body) in self.views.items()}
        if "own_view" in items:
            views[self.agent] = view_of(items["own_view"].body)
        return views

    def trusts_at(self, time_ns: int) -> dict[str, dict[str, float]]:
        """The trust of other agents in agents, as far as it is known; by teller."""
        self.trusts = {name: each for name, each in self.trusts.items() if abs(time_ns - each[0]) <= self.max_age_ns}
        return {name: trust for name, (_, trust) in self.trusts.items()}

    def relay_of(self, time_ns: int, body: Body) -> Relay:
        """The objects in a message about a picture, without absurd ones."""
        states = ObjectStates.from_columns(body)
        plausible = plausible_rows(states)
        self.counts["absurd"] += len(states) - len(plausible)
        return Relay(time_ns, states.select(plausible), tuple(body["agents"]), body["origin"][plausible] > 0)

    def plausible(self, states: ObjectStates) -> ObjectStates:
        """The states without absurd ones, which are counted."""
        rows = plausible_rows(states)
        self.counts["absurd"] += len(states) - len(rows)
        return states if len(rows) == len(states) else states.select(rows)

    def finish(self, context: Context) -> dict[str, Any]:
        """Counts of the radio, of tracks left out, and what the pipeline counted.

        Counts of the radio: broadcasts and announcements; `gate_closed`, frames after the first broadcast in which
        congestion control let it send nothing; messages heard and lost, by sender; and absurd tracks.
        """
        counts = {"radio": dict(sorted(self.counts.items())), "left_out": self.admission.counts()}
        return self.pipeline.results() | counts


if __name__ == "__main__":
    main(Peer)

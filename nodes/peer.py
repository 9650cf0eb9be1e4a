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

A map may lead any other wire to peers, too. They fuse its tracks, if the wire has `fuse = true`, as those of one more
reporter beside its sender; of all else they only count the messages.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from mast_zenoh.arrays.geometry import NO_OFFSET, NO_TURN, heading, rotation_from_quaternion, tracks_in_world
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.fusion.input_limit import InputLimit
from mast_zenoh.fusion.pipelines import Pipeline
from mast_zenoh.fusion.pipelines.collation import MAX_WAITING, Admission, Inbox
from mast_zenoh.fusion.pipelines.command_center import FusingNode, is_view
from mast_zenoh.fusion.pipelines.heard import AgentTracks, HeardTracks, Relay, Relays
from mast_zenoh.gather import MAX_AGE_S, Gather, Newest, plausible, plausible_rows
from mast_zenoh.integrity.views import view_of
from mast_zenoh.mesh.hosting import main
from mast_zenoh.messages.limits import RowChoice
from mast_zenoh.messages.schemas import Body, text
from mast_zenoh.node import Context, Received
from mast_zenoh.tracking.kalman import predicted
from mast_zenoh.v2x import CamGeneration, CongestionControl, GenerationRules, Vehicle
from mast_zenoh.v2x.station import Station
from mast_zenoh.wiring.model import ANY

#: How long what a vehicle says of itself is used, s: until its next message, after 1 s at the latest, is overdue.
AWARENESS_AGE_S = 1.2
#: Id of a sender among its own tracks.
ITSELF = 1 << 62
#: Ports of tracks that others send by radio, and under which name their messages are counted.
COUNTED = {"heard": "heard", "heard_awareness": "aware"}
#: Frame of reference of what a vehicle says of itself.
WORLD = {"origin": NO_OFFSET, "rotation": NO_TURN}


def reporter_of(sender: str, port: str) -> str:
    """The name of a sender's tracks on a further wire, beside those that it broadcasts."""
    return f"{sender}:{port}"


class Peer(FusingNode):
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
        self.views: Newest[Body] = Newest(max_age_s)  # columns
        self.relays = Relays(agent, max_age_s)
        self.relaying: set[str] = set()  # agents that can be origins of what others relay
        self.trusts: Newest[dict[str, float]] = Newest(max_age_s)  # by teller, trust in agents
        self.own: tuple[int, ObjectStates] | None = None  # time, ns, and tracks
        self.place = np.zeros(3)
        self.counts: Counter[str] = Counter()
        self.fused_ports: set[str] = set()  # further ports whose tracks are fused

    def start(self, context: Context) -> None:
        """Wait in each frame for all that the agent and the channel send."""
        super().start(context)
        self.station.switch_on(float(context.rng("switched on").random()))
        sources = context.subscriptions.values()
        ports = {source.port for source in sources}
        self.fused_ports = {source.port for source in sources if source.traits.fuse and source.message == "tracks"}
        self.relaying = {self.agent, *(source.subject for source in sources if source.port == "relayed")}
        self.sensed.expected |= ports & {"pose", "own_view", "reception"}

    def choice(self, port: str, subject: str, step: int) -> RowChoice | None:
        """Of too many tracks, those that the input limit keeps."""
        if port in self.fused_ports:
            return self.admission.choice(reporter_of(subject, port), step)
        return self.admission.choice(subject, step) if port in ("own", "heard") else None

    def on_clock(self, received: Received, context: Context) -> None:
        """Fuse what there is for frames for which the agent sent nothing."""
        self.admission.begin(received.frame)
        for frame, items in self.sensed.expired(received.frame):
            self.process(frame, items, context)
        self.sense(received, context)

    def on_own(self, received: Received, context: Context) -> None:
        """The tracks and the pose of its agent, and of the channel what arrived in the frame before."""
        self.sense(received, context)

    on_pose = on_reception = on_own

    def on_own_view(self, received: Received, context: Context) -> None:
        """What the sensor of its agent covers, which the others are told too, in every frame."""
        if context.connected("broadcast_view"):
            context.publish("broadcast_view", received.body, frame=received.frame, time_ns=received.time_ns)
        self.sense(received, context)

    def on_heard(self, received: Received, context: Context) -> None:
        """The tracks of another agent, or its trust in agents, for the next frame."""
        if not self.inbox.add(context.frame, received):
            wire = f"{received.subject} on {received.port}"
            context.reject(f"overflow: more than {MAX_WAITING} messages of {wire} in a frame")

    on_heard_gossip = on_heard

    def on_heard_view(self, received: Received, context: Context) -> None:
        """What the sensor of another agent covers."""
        if is_view(received, context):
            self.on_heard(received, context)

    def on_heard_awareness(self, received: Received, context: Context) -> None:
        """Where another agent says that it is."""
        if len(received.body["id"]):  # otherwise nothing is on the air
            self.on_heard(received, context)

    def on_relayed(self, received: Received, context: Context) -> None:
        """The picture of another agent. Origins that are no agents would go round among peers for ever."""
        if unknown := sorted(set(received.body["agents"]) - self.relaying):
            context.reject(f"implausible: relayed: agents: {len(unknown)} unknown, such as {unknown[0]!r}")
        else:
            self.on_heard(received, context)

    def on_message(self, received: Received, context: Context) -> None:
        """A message on a further wire."""
        if received.port in self.fused_ports:
            self.on_heard(received, context)
        else:
            self.counts[f"{received.port}/{received.subject}"] += 1

    def sense(self, received: Received, context: Context) -> None:
        """Process a frame once all has arrived that its agent and the channel send."""
        items = self.sensed.add(received.frame, received.port, received)
        if items is not None:
            self.process(received.frame, items, context)

    def process(self, frame: int, items: Mapping[str, Received], context: Context) -> None:
        """Publish what the agent broadcasts in a frame, and its picture."""
        time_ns = items.get("clock", next(iter(items.values()))).time_ns
        before_ns = self.newest_ns
        if not self.advances(time_ns, context, f"frame {frame}", "at least {}"):
            return
        self.open_inbox(frame, items.get("reception"), before_ns)
        if "pose" in items:
            self.place = items["pose"].body["position"]
            self.announce(time_ns, items["pose"], context)
        if own := items.get("own"):
            self.beyond[self.agent] = self.admission.note(self.agent, own.body)
            states = tracks_in_world(own.body)
            self.own = own.time_ns, plausible(states, self.counts)
            self.broadcast(time_ns, own, states, context)
        self.fuse(frame, time_ns, items, context)

    def open_inbox(self, frame: int, reception: Received | None, before_ns: int) -> None:
        """Use the messages that arrived before a frame. before_ns: time of the frame before"""
        lost: dict[str, set[str]] = {"lost": set(), "lost_awareness": set()}
        if reception is not None:
            busy, airtime_ns = float(reception.body["busy_ratio"][0]), int(reception.body["airtime_ns"][0])
            self.station.measure(reception.time_ns, busy, before_ns, airtime_ns)
            lost = {name: set(reception.body[name]) for name in lost}
        for received in self.inbox.take(frame):
            port, sender, time_ns, body = received.port, received.subject, received.time_ns, received.body
            if sender in lost["lost_awareness" if port == "heard_awareness" else "lost"]:
                if port in COUNTED:
                    self.counts[f"lost/{sender}"] += 1
            elif port in COUNTED or port in self.fused_ports:
                self.hear_tracks(port, sender, time_ns, body)
            elif port == "heard_view":
                self.views.add(sender, time_ns, body)
            elif port == "heard_gossip":
                trust = zip(body["agents"].tolist(), body["trust"].tolist(), strict=True)
                self.trusts.add(sender, time_ns, dict(trust))
            else:
                self.relays.add(sender, self.relay_of(time_ns, body))

    def hear_tracks(self, port: str, sender: str, time_ns: int, body: Body) -> None:
        """Keep what another agent says of objects or of itself."""
        self.counts[f"{COUNTED.get(port, port)}/{sender}"] += 1
        states = plausible(tracks_in_world(body), self.counts)
        if port == "heard":
            self.beyond[sender] = self.admission.note(sender, body)
            self.heard.add(sender, time_ns, states)
            self.station.hear(time_ns, states, body["origin"])
        elif port == "heard_awareness":
            self.aware.add(sender, time_ns, states.with_(id=np.full(len(states), ITSELF)))
            if len(states):
                self.station.hear(time_ns, states, states.position[0])
        else:
            reporter = reporter_of(sender, port)
            self.beyond[reporter] = self.admission.note(reporter, body)
            self.heard.add(reporter, time_ns, states)

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
        views = {name: view_of(body, age_ns * 1e-9) for name, (age_ns, body) in self.views.at(time_ns).items()}
        if "own_view" in items:
            views[self.agent] = view_of(items["own_view"].body)
        if views:
            self.pipeline.look(views)
        if trusts := {name: trust for name, (_, trust) in self.trusts.at(time_ns).items()}:
            self.pipeline.hear(self.agent, trusts)
        picture, support = self.pipeline.step(time_ns, tracks.states, tracks.agent, tracks.names)
        context.publish("picture", picture.columns() | {"support": support}, frame=frame, time_ns=time_ns)
        if context.connected("relay"):
            origins, origin = self.relays.origins_of(picture.id, self.pipeline.members, tracks, relays)
            body = picture.columns() | {"agents": text(origins), "origin": origin.astype(np.uint8)}
            context.publish("relay", body, frame=frame, time_ns=time_ns)
        trust = self.publish_trust(frame, time_ns, context)
        if trust is not None and context.connected("gossip"):
            told = {"agents": trust["agents"], "trust": trust["mean"]}
            context.publish("gossip", told, frame=frame, time_ns=time_ns)

    def own_at(self, time_ns: int) -> list[AgentTracks]:
        """The tracks of its agent, predicted to a time; none if they are too old."""
        if self.own is None or abs(time_ns - self.own[0]) > self.max_age_ns:
            return []
        at_ns, states = self.own
        return [AgentTracks.of(self.agent, predicted(states, (time_ns - at_ns) * 1e-9))]

    def relay_of(self, time_ns: int, body: Body) -> Relay:
        """The objects in a message about a picture, without absurd ones."""
        states = ObjectStates.from_columns(body)
        rows = plausible_rows(states)
        self.counts["absurd"] += len(states) - len(rows)
        return Relay(time_ns, states.select(rows), tuple(body["agents"]), body["origin"][rows] > 0)

    def finish(self, context: Context) -> dict[str, Any]:
        """Counts of the radio, of tracks left out, and what the pipeline counted.

        Counts of the radio: broadcasts and announcements; `gate_closed`, frames after the first broadcast in which
        congestion control let it send nothing; messages heard and lost, by sender; and absurd tracks.
        """
        counts = {"radio": dict(sorted(self.counts.items())), "left_out": self.admission.counts()}
        return super().finish(context) | counts


if __name__ == "__main__":
    main(Peer)

"""An adversary on a wire: receives messages and forwards manipulated ones.

It sits where the key-expression map puts it: on `points` (between an agent's lidar and its detector), on `detections`
(between its sensors and its perception), on `pose` (between its positioning and the agent), on tracks or views (between
the agent and the command centre, or between peers), on any other wire; also on several of them, and on those of several
agents. What it does follows from the type of a message. Neither end can detect it: keys, headers and untouched rows are
forwarded unchanged.
"""

from __future__ import annotations

import copy
from collections import Counter, deque

import numpy as np

from mast_zenoh.arrays.geometry import states_to_world
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.attacks import Attack, PassThrough, Surroundings, Tampering, Targets
from mast_zenoh.attacks.attack import (
    Victim,
    claimed_view,
    directed_targets,
    forged_detections,
    forged_states,
    observed_pose,
    observed_view,
    seen_detections,
    sensor_of,
)
from mast_zenoh.attacks.campaign import shortfall
from mast_zenoh.attacks.knowledge import CentreMessages
from mast_zenoh.attacks.surroundings import UNKNOWN
from mast_zenoh.attacks.targets import Changes
from mast_zenoh.gather import LatestBefore
from mast_zenoh.integrity.views import view_columns
from mast_zenoh.mesh.hosting import main
from mast_zenoh.messages.schemas import Body
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.sensing.points import Points
from mast_zenoh.wiring.model import ANY, Input, agent_of, part_of

#: Types of messages with objects.
OBJECTS = ("detections", "tracks", "picture")


class Adversary(Node):
    """Manipulates the messages of one or more wires.

    attack: the manipulation; agent: the compromised agent, whose wires it is on, or several of them (those behind a
    compromised access point): each is attacked by itself, and so is each further sensor whose wire it is on
    peer: on broadcasts, the only peer before which it is, where a map inserts it there (keyexpr_maps/on_pair.toml)
    surroundings: the attacker's prior knowledge of the scene
    """

    role = "adversary"
    inputs = {
        "clock": "clock",
        "pose": "pose",
        "overheard_picture": "picture",
        "trust": "trust",
        "directive": "directive",
    }
    listening = ("overheard_picture", "trust")
    outputs = {"pose_out": "pose", "observation": "observation", "report": "attack_report"}
    forwards = (ANY,)  # to be forwarded, from `x` to `x_out`

    def __init__(
        self, attack: Attack, agent: str | tuple[str, ...], surroundings: Surroundings = UNKNOWN, peer: str = ""
    ) -> None:
        names = (agent,) if isinstance(agent, str) else agent
        if not names or len(set(names)) < len(names):
            raise ValueError(f"agent: found {agent!r}, expected the name of an agent, or several different ones")
        self.attack = attack
        self.peer = peer
        self.surroundings = surroundings
        self.victims = {name: Victim(name, copy.deepcopy(attack) if i else attack) for i, name in enumerate(names)}
        self.of_wire: dict[tuple[str, str], Victim] = {}  # by port and subject, where an agent has several of a type
        self.directives: LatestBefore[Targets] = LatestBefore()
        self.overheard = CentreMessages()
        self.lie_type = ""  # type of the messages whose lies a view has to agree with

    def start(self, context: Context) -> None:
        """Initialise the random streams."""
        forwarded = [wire for wire in context.subscriptions.values() if wire.port not in self.inputs]
        sources: dict[str, set[str]] = {}
        for wire in forwarded:
            sources.setdefault(wire.message, set()).add(wire.source)
        if "view" in sources and sources["view"].isdisjoint(sources.get("tracks", ())):
            sources.pop("tracks", None)  # a peer sends no tracks before it has its agent's view
        self.lie_type = next((kind for kind in ("tracks", "detections") if kind in sources), "")
        self.add_sensors(forwarded, context)
        self.add_wires(forwarded)
        for name, victim in self.victims.items():
            victim.attack.inform(self.surroundings)
            victim.attack.bind(context.seed, context.name if len(self.victims) == 1 else f"{context.name}/{name}")

    def add_sensors(self, forwarded: list[Input], context: Context) -> None:
        """Attack each further sensor by itself; an agent of which no other wire is attacked is no victim then."""
        wires = {(source.message, source.subject) for source in forwarded}
        subjects = sorted(subject for kind, subject in wires if kind == "detections" and part_of(subject))
        self.victims |= {subject: Victim(subject, copy.deepcopy(self.attack)) for subject in subjects}
        if subjects and not any(kind == "picture" for kind, _ in wires):
            for name in {agent_of(subject) for subject in subjects}:
                attacked = {(kind, name) for kind in ("detections", "tracks", "view")} & wires
                if not attacked and not context.connected("pose_out", name):
                    self.victims.pop(name, None)

    def add_wires(self, forwarded: list[Input]) -> None:
        """Attack each further wire with objects of one type and agent by itself: their messages come in any order."""
        first: dict[tuple[str, str], str] = {}
        for wire in sorted(forwarded, key=lambda wire: wire.port):
            port = first.setdefault((wire.message, wire.subject), wire.port)
            if port != wire.port and wire.message in OBJECTS:
                name = f"{wire.subject or next(iter(self.victims))}/{wire.port}"
                victim = Victim(name, copy.deepcopy(self.attack), sensor=agent_of(name))
                self.victims[name] = self.of_wire[wire.port, wire.subject] = victim

    def finish(self, context: Context) -> dict[str, int]:
        """The number of chosen targets, or of scans; logs a warning if fewer targets were found than wanted."""
        counts: Counter[str] = Counter()
        for victim in self.victims.values():
            counts.update(victim.attack.counts())
        if missing := shortfall(counts):
            context.log.warning("%s", missing)
        return dict(counts)

    def victim_of(self, received: Received) -> Victim:
        """The agent that a message comes from or goes to."""
        of_wire = self.of_wire.get((received.port, received.subject)) if self.of_wire else None
        return of_wire or self.victims.get(received.subject) or next(iter(self.victims.values()))

    def on_clock(self, received: Received, context: Context) -> None:
        """Forward messages without a pose unchanged: more delay could be noticed."""
        for victim in self.victims.values():
            for queue in victim.waiting.values():
                while queue:
                    self.forward(victim, queue.popleft(), context)
            while victim.views:
                self.attack_view(victim, victim.views.popleft(), context)
        self.publish_reports(context)

    def on_pose(self, received: Received, context: Context) -> None:
        """Store the victim's pose, forward it if it is on its way, and attack the messages that waited for it."""
        if context.connected("pose_out", received.subject):
            self.attack_pose(self.victim_of(received), received, context)
        for victim in self.victims.values():
            if victim.agent == received.subject:
                victim.store_pose(received.frame, received.body)
                for queue in victim.waiting.values():
                    self.proceed(victim, queue, context)

    def on_view(self, received: Received, context: Context) -> None:
        """What the victim's sensor covers, on its way to the command centre; waits for the lies that it agrees with."""
        victim = self.victim_of(received)
        if isinstance(self.attack, PassThrough):
            forward(received, context)
        else:
            victim.views.append(received)
            self.proceed_views(victim, context)

    def on_gossip(self, received: Received, context: Context) -> None:
        """Forge or forward the victim's trust in agents, on its way to others."""
        victim, told = self.victim_of(received), received.body["trust"]
        forged = victim.attack.forge_trust(received.time_ns, victim.agent, tuple(received.body["agents"]), told)
        if np.array_equal(forged, told):
            forward(received, context)
        else:
            self.forward_changed(victim, received, {**received.body, "trust": forged}, context)

    def on_command(self, received: Received, context: Context) -> None:
        """Forge or forward what the victim's driver wants, on its way to the car."""
        victim, body = self.victim_of(received), received.body
        told = float(body["acceleration"][0]), float(body["curvature"][0])
        forged = victim.attack.forge_command(received.time_ns, *told)
        if forged == told:
            forward(received, context)
        else:
            columns = {"acceleration": np.array([forged[0]]), "curvature": np.array([forged[1]])}
            self.forward_changed(victim, received, columns, context)

    def on_message(self, received: Received, context: Context) -> None:
        """A message of any other type."""
        victim, body = self.victim_of(received), received.body
        forged = victim.attack.forge(received.schema, received.frame, received.time_ns, body)
        if forged is body:
            forward(received, context)
        else:
            self.forward_changed(victim, received, forged, context)

    def forward_changed(self, victim: Victim, received: Received, body: Body, context: Context) -> None:
        """Forward a message without objects with another body, and report that."""
        forward(received, context, body)
        self.report(victim, Changes.of_message(np.zeros(3), np.zeros(3)), received, context)

    def on_trust(self, received: Received, context: Context) -> None:
        """The command centre's trust or picture, which the attack knows from the next frame on."""
        self.overheard.add(context.frame, received)

    on_overheard_picture = on_trust

    def on_directive(self, received: Received, context: Context) -> None:
        """Store the coordinator's plan, which takes effect in the frame after its arrival."""
        self.directives.add(context.frame, directed_targets(received.body, received.time_ns))

    def on_tracks(self, received: Received, context: Context) -> None:
        """Queue a message with objects, to attack it in order as soon as the victim's pose is known."""
        if isinstance(self.attack, PassThrough):
            forward(received, context)
        else:
            victim = self.victim_of(received)
            queue = victim.waiting[received.schema]
            queue.append(received)
            self.proceed(victim, queue, context)

    on_detections = on_picture = on_points = on_tracks

    def proceed(self, victim: Victim, queue: deque[Received], context: Context) -> None:
        """Attack the first messages of a queue, up to one whose pose has not arrived."""
        while queue and queue[0].frame in victim.poses:
            self.forward(victim, queue.popleft(), context)

    def proceed_views(self, victim: Victim, context: Context) -> None:
        """Forward the first views that wait, up to one of a frame whose lies are not known."""
        # Detections have passed before the agent's view can arrive; its tracks have not.
        while victim.views and (self.lie_type != "tracks" or victim.views[0].frame in victim.attacked):
            self.attack_view(victim, victim.views.popleft(), context)

    def forward(self, victim: Victim, message: Received, context: Context) -> None:
        """Forward a message, attacked if the pose of its frame is known."""
        schema = message.schema
        pose = victim.poses.get(message.frame)
        if pose is None:
            forward(message, context)
        elif schema == "detections":
            self.attack_detections(victim, message, pose, context)
        elif schema == "points":
            self.attack_points(victim, message, pose, context)
        else:
            self.attack_states(victim, message, pose, context)
        if schema == self.lie_type:
            victim.attacked.append(message.frame)
            self.proceed_views(victim, context)

    def attack_pose(self, victim: Victim, received: Received, context: Context) -> None:
        """Forward a pose, with the position that the attack wants."""
        position = received.body["position"]
        forged = victim.attack.forge_pose(received.frame, received.time_ns, position)
        if forged is position:
            context.relay("pose_out", received)
        else:
            context.relay("pose_out", received, {**received.body, "position": forged})
            self.report(victim, Changes.of_message(position, forged), received, context)

    def attack_view(self, victim: Victim, received: Received, context: Context) -> None:
        """Forward a view as the attack wants it; an implausible one is forwarded unchanged."""
        swept = claimed_view(received.body)
        if swept is None:
            forward(received, context)
            return
        forged = victim.attack.forge_view(received.frame, received.time_ns, swept)
        body = received.body if forged.view is swept.view else view_columns(forged.view, forged.free)
        body = {**body, "free": forged.free}
        if all(np.array_equal(column, received.body[name]) for name, column in body.items()):
            forward(received, context)
        else:
            forward(received, context, body)
            self.report(victim, Changes.of_message(swept.view.position, forged.view.position), received, context)

    def attack_detections(self, victim: Victim, received: Received, pose: Body, context: Context) -> None:
        """Tamper with detections in the world frame; untouched rows keep their bytes."""
        sensor = sensor_of(received.body, pose)
        victim.attack.look(victim.view(self.surroundings, pose), fused=False)
        tampering = self.tamper(victim, received, seen_detections(received.body, sensor), pose, context)
        if len(tampering.report) == 0:
            forward(received, context)
        else:
            forward(received, context, forged_detections(received.body, sensor, tampering))

    def attack_points(self, victim: Victim, received: Received, pose: Body, context: Context) -> None:
        """Forward a scan with the points that the attack wants."""
        points = Points.from_columns(received.body)
        forged = victim.attack.forge_points(received.frame, received.time_ns, points, sensor_of(received.body, pose))
        columns, body = forged.columns(), received.body
        if forged is points or all(np.array_equal(body[k], np.asarray(v, body[k].dtype)) for k, v in columns.items()):
            forward(received, context)
        else:
            self.forward_changed(victim, received, {**body, **columns}, context)

    def attack_states(self, victim: Victim, received: Received, pose: Body, context: Context) -> None:
        """Send the coordinator an observation, then tamper with tracks or with a picture."""
        body = received.body
        states, view = ObjectStates.from_columns(body), victim.view(self.surroundings, pose)
        in_world = "origin" not in body
        objects = states if in_world else states_to_world(states, body["origin"], body["rotation"])
        if context.connected("observation"):
            context.publish(
                "observation",
                objects.columns() | observed_pose(pose) | observed_view(view),
                frame=received.frame,
                time_ns=received.time_ns,
            )
        victim.attack.look(view, fused=received.schema == "picture")
        tampering = self.tamper(victim, received, objects, pose, context)
        if len(tampering.report) == 0:
            forward(received, context)
        else:
            forward(received, context, forged_states(body, states, tampering))

    def tamper(
        self, victim: Victim, received: Received, objects: ObjectStates, pose: Body, context: Context
    ) -> Tampering:
        """Apply the attack to one message, and publish a report of it."""
        self.overheard.tell(victim.attack, victim.heard, context.frame)
        latest = self.directives.get(context.frame)
        directive = latest[1] if latest else None
        tampering = victim.attack.step(received.frame, received.time_ns, objects, pose["position"], directive)
        if not isinstance(tampering, Tampering):
            name, returned = type(victim.attack).__name__, type(tampering).__name__
            raise TypeError(f"{name}.step returned {returned}, expected a Tampering")
        if len(tampering.report):
            self.report(victim, tampering.report, received, context)
        return tampering

    def report(self, victim: Victim, changes: Changes, received: Received, context: Context) -> None:
        """Tell the evaluator what was changed in a message.

        Messages of several agents arrive in any order: their reports wait for the next clock, to be sent in one order.
        """
        victim.reports.append((received, changes))
        if len(self.victims) == 1:
            self.publish_reports(context)

    def publish_reports(self, context: Context) -> None:
        """Publish the reports that wait, agent by agent."""
        for victim in self.victims.values():
            for received, changes in victim.reports:
                context.publish("report", changes.columns(), frame=received.frame, time_ns=received.time_ns)
            victim.reports.clear()


def forward(received: Received, context: Context, body: Body | None = None) -> None:
    """Forward a message on its wire, with its own or another body."""
    context.relay(f"{received.port}_out", received, body)


if __name__ == "__main__":
    main(Adversary)

"""An adversary on a wire: receives messages and forwards manipulated ones.

It sits on `detections` (between an agent's sensors and its perception), on `tracks` (between the agent and the
command centre) or on `picture` (between the command centre and the agent), as the key-expression map specifies.
Neither end can detect it: keys, headers and untouched rows are forwarded unchanged.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion, states_to_local, states_to_world
from mast_zenoh.arrays.states import Detections, ObjectStates
from mast_zenoh.attacks import Attack, PassThrough, Surroundings, Tampering, Targets
from mast_zenoh.attacks.campaign import shortfall
from mast_zenoh.attacks.surroundings import UNKNOWN
from mast_zenoh.gather import LatestBefore
from mast_zenoh.messages.schemas import Body
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.runtime.mesh.main import main
from mast_zenoh.sensing import sensor_pose, to_sensor, to_world
from mast_zenoh.tracking.view import SensorView

POSES_KEPT = 16  #: frames by which a message may be late and still be attacked


class Adversary(Node):
    """Manipulates the messages of one wire.

    attack: the manipulation; agent: the compromised agent, whose wire it is on
    surroundings: the attacker's prior knowledge of the scene
    """

    role = "adversary"
    inputs = {
        "clock": "clock",
        "pose": "pose",
        "detections": "detections",
        "tracks": "tracks",
        "picture": "picture",
        "directive": "directive",
    }
    outputs = {
        "detections_out": "detections",
        "tracks_out": "tracks",
        "picture_out": "picture",
        "observation": "observation",
        "report": "attack_report",
    }

    def __init__(self, attack: Attack, agent: str, surroundings: Surroundings = UNKNOWN) -> None:
        self.attack = attack
        self.agent = agent
        self.surroundings = surroundings
        self.poses: dict[int, Body] = {}
        self.last_view: tuple[bytes, SensorView] | None = None  # latest pose, and the view from it
        self.waiting: dict[str, deque[Received]] = {"detections": deque(), "tracks": deque(), "picture": deque()}
        self.directives: LatestBefore[Targets] = LatestBefore()

    def start(self, context: Context) -> None:
        """Initialise the random streams."""
        self.attack.inform(self.surroundings)
        self.attack.bind(context.seed, context.name)

    def finish(self, context: Context) -> dict[str, int]:
        """The number of chosen targets; logs a warning if fewer were found than wanted."""
        counts = self.attack.counts()
        if missing := shortfall(counts):
            context.log.warning("%s", missing)
        return counts

    def on_clock(self, received: Received, context: Context) -> None:
        """Forward messages without a pose unchanged: more delay could be noticed."""
        for queue in self.waiting.values():
            while queue:
                self.forward(queue.popleft(), context)

    def on_pose(self, received: Received, context: Context) -> None:
        """Store the victim's pose, and attack the messages that waited for it."""
        self.poses.setdefault(received.frame, received.body)
        if len(self.poses) > POSES_KEPT:
            del self.poses[min(self.poses)]
        for queue in self.waiting.values():
            self.proceed(queue, context)

    def on_detections(self, received: Received, context: Context) -> None:
        """The victim's detections, in transit to it."""
        self.on_message(received, context)

    def on_tracks(self, received: Received, context: Context) -> None:
        """The victim's tracks, in transit to the command centre."""
        self.on_message(received, context)

    def on_picture(self, received: Received, context: Context) -> None:
        """The command centre's picture, in transit to the agent."""
        self.on_message(received, context)

    def on_directive(self, received: Received, context: Context) -> None:
        """Store the coordinator's plan, which takes effect in the frame after its arrival."""
        self.directives.add(context.frame, targets_of(received))

    def on_message(self, received: Received, context: Context) -> None:
        """Queue a message, to attack it in order as soon as the victim's pose is known."""
        schema = received.message.header.schema
        if isinstance(self.attack, PassThrough):
            context.relay(f"{schema}_out", received)
        else:
            self.waiting[schema].append(received)
            self.proceed(self.waiting[schema], context)

    def proceed(self, queue: deque[Received], context: Context) -> None:
        """Attack the first messages of a queue, up to one whose pose has not arrived."""
        while queue and queue[0].frame in self.poses:
            self.forward(queue.popleft(), context)

    def forward(self, message: Received, context: Context) -> None:
        """Forward a message, attacked if the pose of its frame is known."""
        schema = message.message.header.schema
        pose = self.poses.get(message.frame)
        if pose is None:
            context.relay(f"{schema}_out", message)
        elif schema == "detections":
            self.attack_detections(message, pose, context)
        else:
            self.attack_states(schema, message, pose, context)

    def attack_detections(self, received: Received, pose: Body, context: Context) -> None:
        """Tamper with detections in the world frame; untouched rows keep their bytes."""
        body = received.body
        sensor = sensor_pose(
            pose["position"],
            rotation_from_quaternion(pose["rotation"]),
            body["mount_position"],
            rotation_from_quaternion(body["mount_rotation"]),
        )
        last_view = to_world(Detections.from_columns(body), *sensor)
        covariance = np.zeros((len(last_view), 9, 9))
        covariance[:, :3, :3] = last_view.covariance
        objects = ObjectStates.of(
            last_view.position,
            id=np.full(len(last_view), -1),  # detections have no identity
            size=last_view.size,
            yaw=last_view.yaw,
            score=last_view.score,
            class_id=last_view.class_id,
            covariance=covariance,
        )
        self.attack.look(self.view(pose), fused=False)
        tampering = self.tamper(received, objects, pose, context)
        if len(tampering.report) == 0:
            context.relay("detections_out", received)
            return

        def local(states: ObjectStates) -> Detections:
            position_covariance = states.covariance[:, :3, :3]
            world = Detections(
                states.position, states.size, states.yaw, states.score, states.class_id, position_covariance
            )
            return to_sensor(world, *sensor)

        columns = Detections.from_columns(body).columns()
        if len(tampering.moved):
            for name, moved in local(tampering.moved).columns().items():
                columns[name] = columns[name].copy()
                columns[name][tampering.moved_index] = moved
        kept = tampering.keep.nonzero()[0]
        for name, added in local(tampering.added).columns().items():
            columns[name] = np.concatenate([columns[name].take(kept, 0), added])
        mount = {name: body[name] for name in ("mount_position", "mount_rotation")}
        context.relay("detections_out", received, columns | mount)

    def attack_states(self, schema: str, received: Received, pose: Body, context: Context) -> None:
        """Send the coordinator an observation, then tamper with tracks or with a picture."""
        body = received.body
        states, view = ObjectStates.from_columns(body), self.view(pose)
        in_world = "origin" not in body
        objects = states if in_world else states_to_world(states, body["origin"], body["rotation"])
        if context.connected("observation"):
            context.publish(
                "observation",
                objects.columns() | {"agent_position": pose["position"]} | view_columns(view),
                frame=received.frame,
                time_ns=received.time_ns,
            )
        self.attack.look(view, fused=schema == "picture")
        tampering = self.tamper(received, objects, pose, context)
        if len(tampering.report) == 0:
            context.relay(f"{schema}_out", received)
        elif in_world:
            columns = tampering.applied_to(states).columns()
            context.relay(f"{schema}_out", received, columns | {"support": self.support(body["support"], tampering)})
        else:
            reference = {name: body[name] for name in ("origin", "rotation")}
            forged = replace(
                tampering,
                moved=states_to_local(tampering.moved, **reference),
                added=states_to_local(tampering.added, **reference),
            )
            context.relay(f"{schema}_out", received, forged.applied_to(states).columns() | reference)

    def view(self, pose: Body) -> SensorView:
        """The view of the victim's sensor; cached, because most agents are static."""
        key = pose["position"].tobytes() + pose["rotation"].tobytes()
        if self.last_view is None or self.last_view[0] != key:
            rotation = rotation_from_quaternion(pose["rotation"])
            self.last_view = (key, self.surroundings.view(self.agent, pose["position"], rotation))
        return self.last_view[1]

    def support(self, support: np.ndarray, tampering: Tampering) -> np.ndarray:
        """The support of each object in a forged picture: false objects get the median."""
        usual = int(np.median(support)) if len(support) else 1
        return np.concatenate([support[tampering.keep], np.full(len(tampering.added), usual, np.int64)])

    def tamper(self, received: Received, objects: ObjectStates, pose: Body, context: Context) -> Tampering:
        """Apply the attack to one message, and publish a report of it."""
        latest = self.directives.get(context.frame)
        directive = latest[1] if latest else None
        tampering = self.attack.step(received.frame, received.time_ns, objects, pose["position"], directive)
        if len(tampering.report):
            context.publish("report", tampering.report.columns(), frame=received.frame, time_ns=received.time_ns)
        return tampering


def view_columns(view: SensorView) -> dict[str, np.ndarray]:
    """A view as columns of an observation."""
    return {
        "sensor_position": view.position,
        "sensor_rotation": view.rotation,
        "azimuth": np.array([view.azimuth_min, view.azimuth_max]),
        "elevation": np.array([view.elevation_min, view.elevation_max]),
        "max_range": np.array([view.max_range]),
    }


def targets_of(received: Received) -> Targets:
    """The targets in a directive."""
    body = received.body

    def states(prefix: str) -> ObjectStates:
        if len(body[f"{prefix}_id"]) == 0:
            return ObjectStates.empty()
        names = ("id", "velocity", "size", "yaw", "class_id")
        return ObjectStates.of(body[f"{prefix}_position"], **{name: body[f"{prefix}_{name}"] for name in names})

    return Targets(states("add"), states("remove"), states("move"), body["move_offset"], received.time_ns)


if __name__ == "__main__":
    main(Adversary)

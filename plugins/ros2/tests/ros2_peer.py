"""A process of its own that takes part in a mesh of ROS 2 by zenoh-ros2-sdk: only the texts of some types are ours.

    python ros2_peer.py BEHAVIOUR HOST:PORT RECEIVED TYPE SENT TYPE [RECEIVED TYPE SENT TYPE ...]

It prints `ready` once all is declared, and ends when its standard input closes. Behaviours, for each message that it
receives: `echo` sends it back as it is; `tracks` sends what it detects as objects with ids and velocities; `mute` sends
nothing; `raise` lifts all objects by 1 m and sends them back; `drop` sends the message back without its first object;
`dies` is `tracks` for five messages, then kills itself; `interrupts` sends SIGINT to its parent, once.
"""

import copy
import os
import signal
import sys
from typing import Any

import numpy as np
from mast_ros2.type_store import DEFINITIONS
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber, ZenohSession

VISION, AUTOWARE = "vision_msgs/msg/Detection3DArray", "autoware_perception_msgs/msg/TrackedObjects"


class Peer:
    """One node: its session and types."""

    def __init__(self, address: str, definitions: dict[str, str]) -> None:
        host, _, port = address.rpartition(":")
        self.where: dict[str, Any] = {"router_ip": host, "router_port": int(port)}
        self.session = ZenohSession.get_instance(**self.where)
        store = get_typestore(Stores.ROS2_JAZZY)
        for name, text in definitions.items():
            store.register(get_types_from_msg(text, name))
        self.session.store = store
        self.session._registered_types = {name: name for name in store.types}

    def publisher(self, topic: str, type_name: str) -> ROS2Publisher:
        kind = self.session.store.hash_rihs01(type_name)
        return ROS2Publisher(topic, type_name, type_hash=kind, **self.where)

    def subscribe(self, topic: str, type_name: str, callback: Any) -> ROS2Subscriber:
        kind = self.session.store.hash_rihs01(type_name)
        return ROS2Subscriber(topic, type_name, callback, type_hash=kind, **self.where)


class Tracker:
    """Nearest neighbours from one message to the next, in plain Python."""

    def __init__(self, types: Any) -> None:
        self.types = types
        self.known: dict[int, tuple[float, float, float]] = {}
        self.time = 0.0
        self.next = 1

    def __call__(self, message: Any) -> Any:
        stamp = message.header.stamp
        time = stamp.sec + stamp.nanosec * 1e-9
        if time < self.time:  # another run
            self.known, self.next = {}, 1
        elapsed, left, known, objects = time - self.time, dict(self.known), {}, []
        for detection in message.detections:
            place = detection.bbox.center.position
            here = place.x, place.y, place.z
            near = min(left, key=lambda number: distance(left[number], here), default=None)
            if near is not None and distance(left[near], here) < 3.0:
                before = left.pop(near)
                velocity = [(a - b) / elapsed for a, b in zip(here, before, strict=True)] if elapsed > 0 else [0.0] * 3
            else:
                near, self.next, velocity = self.next, self.next + 1, [0.0, 0.0, 0.0]
            known[near] = here
            objects.append(self.tracked(near, detection, velocity))
        self.known, self.time = known, time
        return self.types[AUTOWARE](message.header, objects)

    def tracked(self, number: int, detection: Any, velocity: list[float]) -> Any:
        """An object of Autoware; without an orientation, its velocity is in the axes of the header's frame."""
        types = self.types
        zero = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
        covariance = np.zeros(36)
        covariance[[0, 7, 14]] = 0.05
        pose = types["geometry_msgs/msg/PoseWithCovariance"](detection.bbox.center, covariance)
        linear = types["geometry_msgs/msg/Vector3"](*velocity)
        twist = types["geometry_msgs/msg/TwistWithCovariance"](
            types["geometry_msgs/msg/Twist"](linear, zero), covariance
        )
        no = types["geometry_msgs/msg/AccelWithCovariance"](types["geometry_msgs/msg/Accel"](zero, zero), np.zeros(36))
        prefix = "autoware_perception_msgs/msg/"
        motion = types[f"{prefix}TrackedObjectKinematics"](pose, twist, no, 0, False)
        shape = types[f"{prefix}Shape"](0, types["geometry_msgs/msg/Polygon"]([]), detection.bbox.size)
        uuid = types["unique_identifier_msgs/msg/UUID"](np.array([0] * 8 + list(number.to_bytes(8, "big")), np.uint8))
        kind = types[f"{prefix}ObjectClassification"](1, 1.0)
        return types[f"{prefix}TrackedObject"](uuid, 0.9, [kind], motion, shape)


def distance(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    return sum((a - b) ** 2 for a, b in zip(one, other, strict=True)) ** 0.5


def lifted(message: Any) -> Any:
    for each in message.objects:
        each.kinematics.pose_with_covariance.pose.position.z += 1.0
    return message


def dropped(message: Any) -> Any:
    objects = message.objects if message.__msgtype__ == AUTOWARE else message.detections
    del objects[:1]
    return message


def dying(tracker: Tracker) -> Any:
    left = [5]

    def answer(message: Any) -> Any:
        left[0] -= 1
        if left[0] < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return tracker(message)

    return answer


def interrupting() -> Any:
    sent: list[int] = []

    def answer(message: Any) -> None:
        if not sent:
            sent.append(1)
            os.kill(os.getppid(), signal.SIGINT)

    return answer


def main() -> None:
    behaviour, address, *topics = sys.argv[1:]
    peer = Peer(address, dict(DEFINITIONS))
    kept: list[Any] = []
    for received, received_type, sent, sent_type in zip(*(topics[i::4] for i in range(4)), strict=True):
        answers: dict[str, Any] = {
            "echo": copy.copy,
            "tracks": Tracker(peer.session.store.types),
            "raise": lifted,
            "drop": dropped,
            "dies": dying(Tracker(peer.session.store.types)),
            "interrupts": interrupting(),
        }
        publisher, make = peer.publisher(sent, sent_type), answers.get(behaviour)

        def answer(message: Any, publisher: Any = publisher, make: Any = make) -> None:
            if make is not None:
                result = make(message)
                if result is None:
                    return
                publisher.publish(**{name: getattr(result, name) for name in vars(result) if name != "__msgtype__"})

        kept += [publisher, peer.subscribe(received, received_type, answer)]
    print("ready", flush=True)
    sys.stdin.read()
    os._exit(0)  # a session with subscribers would keep the process


if __name__ == "__main__":
    main()

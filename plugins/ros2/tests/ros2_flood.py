"""A process that floods topics of ROS 2 with everything that a peer can send, until its standard input closes.

    python ros2_flood.py SEED ROUTER TOPIC TYPE [TOPIC TYPE ...]

Bytes that are no CDR, truncated and random messages, attachments of all kinds, absurd stamps and frames, thousands of
objects, duplicates, tokens that are none.
"""

import os
import sys
import threading
from typing import Any

import numpy as np
from mast_ros2 import type_store
from mast_ros2.attachments import MessageAttachment
from mast_ros2.liveliness_tokens import DataKey, EndpointToken, NodeToken
from mast_ros2.object_messages import detection_array, tracked_objects
from mast_ros2.received_objects import MOST_OBJECTS
from mast_ros2.spatial import Transform, transform_message
from ros2_messages import random_message, random_states

from mast_zenoh.mesh.session import open_client

FRAMES = ("map", "intercepted", "infra_1", "nowhere", "", "x" * 300, "/map", "a", "b")
TIMES = (0, 100_000_000, 4_000_000_000_000_000_000, -1, 50_000_000)


EXTREMES = (np.nan, np.inf, -np.inf, 1e308, -1.0, 0.0, 1e9, 5e-324)


def plausible(type_name: str, random: np.random.Generator) -> Any:
    """A message that a node of ROS could mean, some values of which are extreme."""
    states = random_states(random, int(random.integers(4)))
    if type_name == type_store.TF_MESSAGE:
        names = random.choice(FRAMES, (len(states), 2)).tolist()
        turn = np.array([1.0, 0.0, 0.0, 0.0])
        pairs = zip(names, states.position, strict=True)
        message = transform_message([Transform(*pair, 0, place, turn) for pair, place in pairs])
        places = [each.transform.translation for each in message.transforms]
    elif type_name == type_store.TRACKED_OBJECTS:
        message = tracked_objects(states, 0, "map")
        motions = [each.kinematics for each in message.objects]
        places = [motion.pose_with_covariance.pose.position for motion in motions]
        places += [motion.twist_with_covariance.twist.linear for motion in motions]
        places += [each.shape.dimensions for each in message.objects]
    elif type_name == type_store.DETECTIONS:
        message = detection_array(states, 0, "map")
        places = [each.bbox.center.position for each in message.detections]
        places += [each.bbox.size for each in message.detections]
    else:
        return random_message(type_name, random)
    for place in places:
        if random.random() < 0.2:
            setattr(place, str(random.choice(["x", "y", "z"])), float(random.choice(EXTREMES)))
    return message


def hostile(type_name: str, random: np.random.Generator) -> Any:
    """A valid message of a type with values of any kind, often with a plausible header."""
    message = (plausible if random.random() < 0.7 else random_message)(type_name, random)
    header = getattr(message, "header", None)
    if header is not None and random.random() < 0.8:
        header.frame_id = str(random.choice(FRAMES))
        time_ns = int(random.choice(TIMES)) if random.random() < 0.5 else int(random.integers(12)) * 100_000_000
        header.stamp.sec, header.stamp.nanosec = max(-1, min(time_ns // 10**9, 2**31 - 1)), time_ns % 10**9
    for name in ("objects", "detections", "transforms"):
        if hasattr(message, name) and random.random() < 0.02:
            few = getattr(message, name)
            setattr(message, name, few * (1 + MOST_OBJECTS // max(1, len(few))))
    return message


def payload_of(type_name: str, random: np.random.Generator) -> bytes:
    """Bytes of a message, or of something else."""
    kind = int(random.integers(4))
    if kind == 0:
        return random.bytes(int(random.integers(300)))
    payload = type_store.encode(hostile(type_name, random))
    if kind == 1:
        return payload[: int(random.integers(len(payload)))]
    if kind == 2:
        row = int(random.integers(len(payload)))
        return payload[:row] + random.bytes(1) + payload[row + 1 :]
    return payload


def attachment_of(random: np.random.Generator) -> bytes | None:
    kind = int(random.integers(6))
    if kind == 0:
        return None
    if kind == 1:
        return b"\x0fsequence_number" + random.bytes(40)
    if kind == 2:
        return random.bytes(int(random.integers(60)))
    return MessageAttachment(int(random.integers(5)), int(random.integers(2**62)), random.bytes(16)).write()


def main() -> None:
    seed, router, *topics = sys.argv[1:]
    random = np.random.default_rng(int(seed))
    session = open_client(router)
    liveliness, tokens = session.liveliness(), []
    publishers = []
    for number, (topic, type_name) in enumerate(zip(topics[::2], topics[1::2], strict=True), 1):
        key = DataKey.of(0, topic, type_name)
        node = NodeToken(0, str(session.zid()), 0, "flood")
        for type_hash in (key.type_hash, "RIHS01_" + "0" * 64):
            token = EndpointToken(node, number, "publisher", topic, type_name, type_hash)
            tokens.append(liveliness.declare_token(token.write()))
        publishers.append((session.declare_publisher(key.write()), type_name))
    tokens += [liveliness.declare_token(f"@ros2_lv/0/abc/{n}/nonsense") for n in range(50)]
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    pool = [
        (publisher, payload_of(type_name, random), attachment_of(random))
        for publisher, type_name in publishers
        for _ in range(300)
    ]
    print("ready", flush=True)
    while not ended.is_set():
        publisher, payload, attachment = pool[int(random.integers(len(pool)))]
        publisher.put(payload, attachment=attachment)
    os._exit(0)


if __name__ == "__main__":
    main()

"""Random ROS 2 messages of any type, as objects of rosbags and as dicts."""

from collections.abc import Callable
from typing import Any

import numpy as np
from mast_ros2 import type_store
from mast_ros2.type_store import STORE, TYPES, decode, encode
from rosbags.interfaces import Nodetype

from mast_zenoh.arrays.states import CLASSES, ObjectStates
from mast_zenoh.testing.scenarios import FakeLink

#: What the conversions write and read.
CONVERTED = (
    *(type_store.TF_MESSAGE, type_store.CLOCK, type_store.ODOMETRY, type_store.MARKER_ARRAY),
    *(type_store.DIAGNOSTIC_ARRAY, type_store.DETECTIONS, type_store.DETECTED_OBJECTS),
    *(type_store.TRACKED_OBJECTS, type_store.PREDICTED_OBJECTS),
)

TEXTS = ("", "a", "world", "über", "中文", "x" * 300)
#: rosbags has a byte for a signed number: those that are used are small.
INTEGERS = {"byte": np.int8, "char": np.uint8} | {
    f"{sign}int{bits}": np.dtype(f"{sign}int{bits}").type for sign in ("", "u") for bits in (8, 16, 32, 64)
}


class RosLink(FakeLink):
    """A link on which each message has the type that was announced."""

    def send(self, topic: str, message: Any) -> None:
        assert message.__msgtype__ == self.announced[topic], f"{topic}: another type than was announced"
        super().send(topic, message)


def through(message: Any) -> Any:
    """A message after the way through its bytes."""
    return decode(message.__msgtype__, encode(message))


def set_to(path: str, *values: Any) -> Callable[[Any], None]:
    """Sets a field of an object, or the fields x, y, z... of a field."""

    def change(each: Any) -> None:
        *parents, name = path.split(".")
        for parent in parents:
            each = getattr(each, parent)
        if len(values) == 1:
            setattr(each, name, values[0])
        else:
            for axis, value in zip("xyzw", values, strict=False):
                setattr(getattr(each, name), axis, value)

    return change


def random_message(type_name: str, random: np.random.Generator) -> Any:
    """A message with random values, texts and lengths of sequences."""
    names = STORE.fielddefs[type_name][1]
    return TYPES[type_name](*[random_value(description, random) for _, description in names])


def random_value(description: Any, random: np.random.Generator) -> Any:
    """A value of a field, as rosbags describes it."""
    node, of = description
    if node == Nodetype.NAME:
        return random_message(of, random)
    if node == Nodetype.BASE:
        return random_base(of[0], random)
    element, length = of
    count = length if node == Nodetype.ARRAY else int(random.integers(4))
    values = [random_value(element, random) for _ in range(count)]
    if element[0] == Nodetype.BASE and element[1][0] != "string":
        return np.array(values, {"byte": "uint8", "char": "uint8"}.get(element[1][0], element[1][0]))
    return values


def random_base(kind: str, random: np.random.Generator) -> Any:
    """A number, a text or a bool, often an extreme one."""
    if kind == "string":
        return str(random.choice(TEXTS))
    if kind == "bool":
        return bool(random.integers(2))
    if kind == "float32":
        return float(np.float32(random.normal() * 1e3))
    if kind == "float64":
        return float(random.choice([0.0, -0.0, np.inf, 1e308, random.normal()]))
    limits = np.iinfo(INTEGERS[kind])
    if kind == "byte":
        return int(random.integers(limits.max))
    return int(random.choice([0, 1, limits.min, limits.max, int(random.integers(limits.max))]))


def plain(value: Any) -> Any:
    """A message as a dict of its fields; sequences as lists."""
    if hasattr(value, "__msgtype__"):
        names = [name for name, _ in STORE.fielddefs[value.__msgtype__][1]]
        content = {name: plain(getattr(value, name)) for name in names}
        return {"__typename": value.__msgtype__} | content
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [plain(each) for each in value] if isinstance(value, list) else value


def random_states(random: np.random.Generator, n: int) -> ObjectStates:
    """n plausible objects with different ids, some of them negative."""
    factor = random.normal(size=(n, 9, 9))
    return ObjectStates.of(
        random.normal(size=(n, 3)) * 50.0,
        id=random.permutation(3 * n)[:n] - n,
        velocity=random.normal(size=(n, 3)) * 5.0,
        size=random.uniform(0.3, 12.0, (n, 3)),
        yaw=random.uniform(-np.pi, np.pi, n),
        covariance=factor @ factor.transpose(0, 2, 1),
        score=random.uniform(size=n),
        class_id=random.integers(len(CLASSES), size=n).astype(np.uint8),
    )

"""Bytes and hashes of ROS 2 message types are those of other libraries, and of ROS where its hash is known."""

from typing import Any

import numpy as np
import pytest
from mast_ros2 import type_store
from mast_ros2.type_store import DEFINITIONS
from ros2_messages import CONVERTED, plain, random_message
from rosbags.typesys import Stores, get_typestore

from mast_zenoh.errors import MessageError

STRING = "std_msgs/msg/String"
TYPES = (STRING, *CONVERTED)
of_all = pytest.mark.parametrize("type_name", TYPES)

#: Of ROS (the first four are in rmw_zenoh's documents and in programs that speak with it), and of Autoware's
#: definitions of April 2026.
KNOWN_HASHES = {
    STRING: "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    type_store.TF_MESSAGE: "e369d0f0",
    type_store.MARKER_ARRAY: "86cb8800",
    type_store.DETECTIONS: "793f5eab9595ac1c0da07873cc859db42eae51f0ee76056db8562515d830e018",
    type_store.TRACKED_OBJECTS: "3559bd4e62ce8a4d96e32720c02bbe656cc090bb2b3f3f91f52a7c3ab095417a",
    type_store.DETECTED_OBJECTS: "2facd6b1",
    type_store.PREDICTED_OBJECTS: "b6315130",
}


@pytest.fixture(scope="module")
def oracle() -> Any:
    """The second encoder."""
    reason = "ros2-pyterfaces or cyclonedds-idl is not installed"
    return pytest.importorskip("ros2_oracle", reason=reason, exc_type=ImportError)


@pytest.mark.parametrize("type_name", KNOWN_HASHES)
def test_a_hash_is_the_known_one(type_name: str) -> None:
    assert type_store.type_hash(type_name).startswith(f"RIHS01_{KNOWN_HASHES[type_name]}")


@of_all
def test_a_hash_is_that_of_a_second_library(type_name: str, oracle: Any) -> None:
    assert type_store.type_hash(type_name) == oracle.CLASSES[type_name].hash_rihs01()


@of_all
def test_a_hash_is_that_of_zenoh_ros2_sdk(type_name: str) -> None:
    sdk = pytest.importorskip("zenoh_ros2_sdk.utils", reason="zenoh-ros2-sdk is not installed", exc_type=ImportError)
    texts = {name: text for name in type_store.TYPES if (text := definition(name))}
    assert sdk.compute_type_hash_from_msg(type_name, texts[type_name], texts) == type_store.type_hash(type_name)


def definition(type_name: str) -> str:
    """The text of a type: ours, or rosbags'."""
    if type_name in DEFINITIONS:
        return DEFINITIONS[type_name]
    text, _ = type_store.STORE.generate_msgdef(type_name, ros_version=2)
    return text.partition("\n====")[0]


@pytest.mark.parametrize("version", ["HUMBLE", "IRON", "JAZZY", "KILTED", "LYRICAL"])
def test_all_versions_of_ros_have_the_same_types(version: str) -> None:
    store = get_typestore(Stores[f"ROS2_{version}"])
    for type_name in set(TYPES) & set(store.types):
        assert store.hash_rihs01(type_name) == type_store.type_hash(type_name)


@of_all
def test_bytes_of_random_messages_are_those_of_a_second_encoder(type_name: str, oracle: Any) -> None:
    random = np.random.default_rng(1)
    for _ in range(8):
        message = random_message(type_name, random)
        payload = type_store.encode(message)
        assert payload[:4] == b"\x00\x01\x00\x00"
        assert oracle.encode(type_name, plain(message)) == payload
        assert oracle.decode(type_name, payload) == plain(message)


@of_all
def test_random_messages_survive_in_bytes_of_either_byte_order(type_name: str) -> None:
    random = np.random.default_rng(2)
    for _ in range(8):
        message = random_message(type_name, random)
        big_endian = bytes(type_store.STORE.serialize_cdr(message, type_name, little_endian=False))
        for payload in (type_store.encode(message), big_endian):
            assert plain(type_store.decode(type_name, payload)) == plain(message)


@of_all
def test_damaged_bytes_are_refused_or_are_another_message_of_that_type(type_name: str) -> None:
    random = np.random.default_rng(3)
    refused = 0
    for _ in range(60):
        damaged = bytearray(type_store.encode(random_message(type_name, random)))
        for place in random.integers(len(damaged), size=random.integers(1, 4)):
            damaged[place] = random.choice([0, 1, 0x7F, 0xFF, random.integers(256)])
        if random.integers(3) == 0:
            del damaged[random.integers(len(damaged)) :]
        try:
            message = type_store.decode(type_name, bytes(damaged))
        except MessageError:
            refused += 1
        else:
            assert 0 <= len(damaged) - len(type_store.encode(message)) <= 3  # padding
    assert refused


@of_all
def test_a_message_that_ends_early_is_refused_at_every_length(type_name: str) -> None:
    payload = type_store.encode(random_message(type_name, np.random.default_rng(4)))
    for n in range(0, len(payload), 1 + len(payload) // 200):
        with pytest.raises(MessageError, match=type_name):
            type_store.decode(type_name, payload[:n])


@pytest.mark.parametrize(
    "header", [b"", b"\x00\x01\x00", b"\x00\x03\x00\x00", b"\x00\x07\x00\x00", b"\x01\x01\x00\x00"]
)
def test_a_payload_in_another_encoding_is_refused(header: bytes) -> None:
    with pytest.raises(MessageError, match="CDR encapsulation"):
        type_store.decode(type_store.CLOCK, header + bytes(8 if len(header) == 4 else 0))


def test_a_count_beyond_the_limit_is_refused_before_it_costs_anything(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type_store.STORE, "max_sequence_length", 2)
    transform = type_store.TYPES[type_store.TF_MESSAGE]
    one = random_message("geometry_msgs/msg/TransformStamped", np.random.default_rng(5))
    two, three = (type_store.encode(transform([one] * n)) for n in (2, 3))
    assert len(type_store.decode(type_store.TF_MESSAGE, two).transforms) == 2
    with pytest.raises(MessageError, match="Invalid sequence length 3"):
        type_store.decode(type_store.TF_MESSAGE, three)


def test_a_type_that_is_not_known_is_refused() -> None:
    with pytest.raises(MessageError, match=r"unknown message type 'a/msg/B'.*Detection3DArray"):
        type_store.decode("a/msg/B", b"\x00\x01\x00\x00")

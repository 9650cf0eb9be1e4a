"""ROS 2 Jazzy itself reads our bytes, writes the same ones, and has the same hashes for all types."""

import json
import subprocess
import zlib
from base64 import b64decode
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mast_ros2 import type_store
from mast_ros2.type_store import DEFINITIONS
from ros2_keys import parse_data_key
from ros2_messages import random_message

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
PYTHON = ROOT / ".venv/ros2/bin/python"

#: What the wheels of ROS 2 have, of the types that are used here.
OF_ROS = (type_store.CLOCK, type_store.ODOMETRY, type_store.MARKER_ARRAY, type_store.DIAGNOSTIC_ARRAY)
#: What they do not have: their generators know the hash of any definition.
DEFINED = {**DEFINITIONS, type_store.TF_MESSAGE: "geometry_msgs/TransformStamped[] transforms\n"}

pytestmark = [
    pytest.mark.heavy,
    pytest.mark.skipif(
        not any((ROOT / ".venv/ros2").glob("lib/python*/site-packages/rclpy")),
        reason="ROS 2 is not installed in .venv/ros2: `make .venv/ros2/ready`, for a Python that has its wheels",
    ),
]


def payloads(type_name: str) -> list[bytes]:
    """Random messages of a type."""
    random = np.random.default_rng(6)
    return [type_store.encode(random_message(type_name, random)) for _ in range(25)]


def of_session() -> list[tuple[str, bytes]]:
    """Type and payload of the messages that the bridge sent in the recorded session, of these types."""
    sent = json.loads((HERE / "ros2_golden_session.json").read_text())["messages"]
    typed = [(parse_data_key(each["key"]).type_name, zlib.decompress(b64decode(each["payload"]))) for each in sent]
    return [(name, payload) for name, payload in typed if name in OF_ROS]


@pytest.fixture(scope="module")
def answer() -> dict[str, Any]:
    """What ROS 2 says about all of them."""
    request = {
        "payloads": [
            *([name, payload.hex()] for name in OF_ROS for payload in payloads(name)),
            *([name, payload.hex()] for name, payload in of_session()),
        ],
        "hashes": list(OF_ROS),
        "definitions": DEFINED,
    }
    command = [str(PYTHON), str(HERE / "ros2_itself.py")]
    done = subprocess.run(command, input=json.dumps(request), capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    result: dict[str, Any] = json.loads(done.stdout)
    return result


@pytest.mark.parametrize("row", range(len(OF_ROS)), ids=OF_ROS)
def test_ros_reads_our_bytes_and_writes_the_same_but_for_padding(row: int, answer: dict[str, Any]) -> None:
    ours = payloads(OF_ROS[row])
    theirs = [bytes.fromhex(payload) for payload in answer["payloads"][row * len(ours) : (row + 1) * len(ours)]]
    assert list(map(len, theirs)) == list(map(len, ours))
    # Fast CDR leaves in padding what was in memory.
    assert [type_store.encode(type_store.decode(OF_ROS[row], payload)) for payload in theirs] == ours


def test_ros_reads_what_the_bridge_sends(answer: dict[str, Any]) -> None:
    sent = of_session()
    read = [bytes.fromhex(payload) for payload in answer["payloads"][-len(sent) :]]
    assert {name for name, _ in sent} == set(OF_ROS)
    for (name, ours), theirs in zip(sent, read, strict=True):
        assert type_store.encode(type_store.decode(name, theirs)) == ours


@pytest.mark.parametrize("type_name", OF_ROS)
def test_a_running_node_announces_our_hash(type_name: str, answer: dict[str, Any]) -> None:
    assert answer["hashes"][type_name] == type_store.type_hash(type_name)


@pytest.mark.parametrize("type_name", DEFINED)
def test_the_generators_of_ros_give_our_hash_to_our_definitions(type_name: str, answer: dict[str, Any]) -> None:
    assert answer["definitions"][type_name] == type_store.type_hash(type_name)

"""Between two ROS 2 nodes, a node of this testbed changes what it attacks and nothing else, and loses no message."""

from __future__ import annotations

import queue
import signal
import subprocess
import threading
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mast_ros2 import interception as ros2_interception
from mast_ros2 import type_store
from mast_ros2.interception import ObjectsInterposer, interposer_of, launch_fragment
from mast_ros2.mesh import Connection
from mast_ros2.object_messages import detection_array, tracked_objects
from mast_ros2.participant import Participant, Publisher
from mast_ros2.received_objects import received_tracks
from mast_ros2.received_poses import ReceivedPose
from mast_ros2.spatial import clock, odometry
from ros2_messages import plain, random_states

from mast_zenoh.errors import MessageError, NodeFileError
from mast_zenoh.mesh.session import open_router
from tests.support import commands_in_process
from tests.support.launched import MAST, eventually

TOPIC = "/car/perception/objects"
SEED = 5
WALL_NS = 1_700_000_000 * 10**9  # as a robot's clock says it

SHIFT = """
import numpy as np

from mast_zenoh.arrays.states import canonical_order
from mast_zenoh.attacks import Attack, alter


class Shift(Attack):
    def step(self, frame, time_ns, objects, agent_position, directive=None):
        self.at = frame, time_ns, agent_position
        rows = canonical_order(objects)[:1]
        return alter(objects, move=rows, offset=np.array([[1.0, 0.0, 0.0]]))
"""
HALF = """
from mast_zenoh.node import Node


class Half(Node):
    role = "adversary"
    inputs = {"tracks": "tracks"}
    outputs = {"tracks_out": "tracks"}

    def on_tracks(self, received, context):
        if received.frame == 1:
            raise RuntimeError("no idea")
        if received.frame != 2:
            context.relay("tracks_out", received)
"""


def messages(n: int) -> list[Any]:
    """Messages of a tracker: six objects that stand still."""
    states = random_states(np.random.default_rng(1), 6)
    return [tracked_objects(states, WALL_NS + k * 10**8, "map") for k in range(n)]


def interposer(folder: Path, text: str, *settings: str) -> ObjectsInterposer:
    file = folder / "own.py"
    file.write_text(text)
    return interposer_of(str(file), TOPIC, list(settings), SEED)


def test_an_attack_changes_its_object_in_each_message_and_knows_its_agents_pose(tmp_path: Path) -> None:
    node = interposer(tmp_path, SHIFT)
    node.follow_poses()
    node.add_pose(pose_at([4.0, 5.0, 6.0], WALL_NS))
    for k, message in enumerate(messages(3)):
        (result,) = node.through(message)
        before, after = received_tracks(message).objects, received_tracks(result).objects
        moved = np.flatnonzero((before.position != after.position).any(axis=1))
        assert len(moved) == 1
        np.testing.assert_allclose((after.position - before.position)[moved[0]], [1.0, 0.0, 0.0], atol=1e-12)
        untouched = [plain(each) for row, each in enumerate(message.objects) if row != moved[0]]
        assert [plain(each) for row, each in enumerate(result.objects) if row != moved[0]] == untouched
        assert plain(result.header) == plain(message.header)
        victim = next(iter(node._host.node.victims.values()))  # type: ignore[attr-defined]
        frame, time_ns, position = victim.attack.at
        assert (frame, time_ns, position.tolist()) == (k, k * 10**8, [4.0, 5.0, 6.0])
    assert (node.messages, node.changed) == (3, 3)


def pose_at(position: list[float], time_ns: int, frame: str = "map") -> ReceivedPose:
    columns = {"position": np.array(position), "rotation": np.array([1.0, 0, 0, 0]), "velocity": np.zeros(3)}
    return ReceivedPose(frame, "base_link", time_ns, columns)


def test_the_pose_that_is_nearest_in_time_and_in_the_objects_frame_counts(tmp_path: Path) -> None:
    node = interposer(tmp_path, SHIFT)
    node.follow_poses()
    (message,) = messages(1)
    with pytest.raises(MessageError, match="no odometry: none has arrived yet"):
        node.through(message)
    node.add_pose(pose_at([1.0, 0.0, 0.0], WALL_NS, "odom"))
    with pytest.raises(MessageError, match="another frame of reference: it is in 'odom', the objects are in 'map'"):
        node.through(message)
    node.add_pose(pose_at([2.0, 0.0, 0.0], WALL_NS - 510_000_000))
    with pytest.raises(MessageError, match=r"another time: 0.51 s older than the objects, expected at most 0.5 s"):
        node.through(message)
    node.add_pose(pose_at([3.0, 0.0, 0.0], WALL_NS + 2 * 10**8))
    node.add_pose(pose_at([4.0, 0.0, 0.0], WALL_NS + 4 * 10**8))
    node.add_pose(pose_at([5.0, 0.0, 0.0], WALL_NS + 10**12))
    node.through(message)
    assert next(iter(node._host.node.victims.values())).attack.at[2].tolist() == [3.0, 0.0, 0.0]  # type: ignore[attr-defined]
    assert (node.messages, node.placed) == (1, 1)


def test_a_shipped_attack_needs_only_its_name() -> None:
    node = interposer_of("UncoordinatedAttack", TOPIC, ["attack.start_s=0"], SEED)
    results = [result for message in messages(30) for result in node.through(message)]
    assert len(results) == 30
    assert node.changed > 0


def test_detections_of_vision_msgs_can_be_attacked_too(tmp_path: Path) -> None:
    states = random_states(np.random.default_rng(1), 4)
    (result,) = interposer(tmp_path, SHIFT).through(detection_array(states, WALL_NS, "base_link"))
    assert (received_tracks(result).objects.position != states.position).any(axis=1).sum() == 1


def test_a_node_may_drop_messages_and_one_on_which_it_fails_passes_unchanged(tmp_path: Path) -> None:
    node = interposer(tmp_path, HALF)
    sent = messages(4)
    results = [node.through(message) for message in sent]
    assert [[plain(each) for each in result] for result in results] == [
        [plain(sent[0])],
        [plain(sent[1])],
        [],
        [plain(sent[3])],
    ]
    assert "RuntimeError: no idea" in node.failed
    assert node.changed == 0


#: Also receives the pose, and fails on every message.
NO_IDEA = HALF.replace('"tracks": "tracks"}', '"pose": "pose", "tracks": "tracks"}', 1).replace(
    "received.frame == 1", "True"
)
NO_IDEA += """
    def on_pose(self, received, context):
        pass
"""
LATE = """
from mast_zenoh.node import Node


class Late(Node):
    role = "adversary"
    inputs = {"clock": "clock", "tracks": "tracks"}
    outputs = {"tracks_out": "tracks"}

    def __init__(self):
        self.waiting = []

    def on_clock(self, received, context):
        while self.waiting:
            context.relay("tracks_out", self.waiting.pop())

    def on_tracks(self, received, context):
        if received.frame == 2:
            raise RuntimeError("no idea")
        self.waiting.append(received)
"""


def test_a_failing_node_loses_none_of_the_messages_that_it_had_kept_back(tmp_path: Path) -> None:
    node = interposer(tmp_path, LATE)
    sent = messages(5)
    results = [node.through(message) for message in sent]
    stamps = [[each.header.stamp.nanosec // 10**8 for each in result] for result in results]
    assert stamps == [[], [0], [1, 2], [], [3]]


@pytest.mark.parametrize("first_s", [0, 2**31 - 1])
def test_a_stamp_of_another_clock_neither_starts_nor_stops_an_attack(first_s: int, tmp_path: Path) -> None:
    node = interposer(tmp_path, SHIFT)
    states = random_states(np.random.default_rng(1), 6)
    node.through(tracked_objects(states, first_s * 10**9, "map"))
    times = []
    for message in messages(3):
        node.through(message)
        times.append(next(iter(node._host.node.victims.values())).attack.at[1])  # type: ignore[attr-defined]
    assert times == [0, 10**8, 2 * 10**8]
    assert node.jumps == 1


def test_what_a_node_keeps_back_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros2_interception, "_MOST_KEPT", 3)
    node = interposer(tmp_path, HALF.replace("received.frame == 1", "False").replace("received.frame != 2", "False"))
    for message in messages(10):
        assert node.through(message) == []
    assert len(node._kept) == 3


def test_a_node_without_ports_for_objects_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(NodeFileError, match=r"Half: no input for 'tracks' messages, which the topic carries"):
        interposer(tmp_path, HALF.replace('"tracks": "tracks"', '"pose": "pose"').replace("on_tracks", "on_pose"))
    with pytest.raises(NodeFileError, match="no node file or attack 'UncoordinatedAttac'"):
        interposer_of("UncoordinatedAttac", TOPIC, [], SEED)


def test_what_is_no_message_of_objects_raises(tmp_path: Path) -> None:
    with pytest.raises(MessageError, match="Clock: expected"):
        interposer(tmp_path, SHIFT).through(clock(1))


def test_the_launch_file_remaps_the_topic_of_the_file_that_it_includes() -> None:
    root = ElementTree.fromstring(launch_fragment(TOPIC))
    group = root.find("group")
    assert group is not None
    assert [each.tag for each in group] == ["set_remap", "include"]
    assert group[0].attrib == {"from": TOPIC, "to": TOPIC + "/before"}
    assert group[1].attrib == {"file": "$(var file)"}


@pytest.fixture
def router() -> Iterator[str]:
    session, endpoint = open_router()
    yield endpoint
    session.close()


class Between:
    """An interposer between a tracker and a planner on a router, until `end`. arrived: what the planner has received"""

    def __init__(self, router: str, node: ObjectsInterposer, odometry: str = "") -> None:
        self.counts: dict[str, Any] = {}
        self._stop, self._ready = threading.Event(), threading.Event()
        self.warnings: list[str] = []
        arguments = Connection(router), TOPIC, type_store.TRACKED_OBJECTS, node, self._stop

        def run() -> None:
            self.counts = ros2_interception.intercept_topic(
                *arguments, odometry=odometry, ready=self._ready.set, warn=self.warnings.append
            )

        self._thread = threading.Thread(target=run)
        self._thread.start()
        assert self._ready.wait(20.0)
        self.tracker, self._planner = (Participant(Connection(router), name) for name in ("tracker", "planner"))

    def __enter__(self) -> Between:
        return self

    def __exit__(self, *_: object) -> None:
        self.tracker.close()
        self._planner.close()
        self.end()

    def join(self) -> Publisher:
        """Have the planner listen, and the tracker ready to publish where the interposer listens."""
        self.arrived: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._planner.subscribe_bytes(TOPIC, type_store.TRACKED_OBJECTS, lambda payload, _: self.arrived.put(payload))
        own = self.tracker.publisher(TOPIC + "/before", type_store.TRACKED_OBJECTS)
        eventually(lambda: own.is_wanted, "the interposer")
        eventually(lambda: self._planner.publishers_of(TOPIC), "its publisher")
        return own

    def place(self) -> Publisher:
        """What publishes the odometry."""
        publisher = self.tracker.publisher("/car/odometry", type_store.ODOMETRY)
        eventually(lambda: publisher.is_wanted, "the interposer")
        return publisher

    def end(self) -> None:
        """Stop it, and wait until it has."""
        self._stop.set()
        self._thread.join(20.0)
        assert not self._thread.is_alive()


POSE = {"position": np.array([7.0, 0, 0]), "rotation": np.array([1.0, 0, 0, 0]), "velocity": np.zeros(3)}


def test_all_messages_between_two_nodes_arrive_in_order_attacked(router: str, tmp_path: Path) -> None:
    node = interposer(tmp_path, SHIFT)
    with Between(router, node, "/car/odometry") as between:
        own, place = between.join(), between.place()
        sent = messages(50)
        for k in range(len(sent)):
            place.publish(odometry(POSE, WALL_NS + k * 10**8, "map", "base_link"))
        eventually(lambda: len(node._poses or ()) == len(sent), "the odometry")
        for message in sent:
            own.publish(message)
        received = [type_store.decode(type_store.TRACKED_OBJECTS, between.arrived.get(timeout=20.0)) for _ in sent]
        between.end()
    assert [message.header.stamp.nanosec for message in received] == [m.header.stamp.nanosec for m in sent]
    assert all(len(message.objects) == 6 for message in received)
    expected = {"messages": 50, "changed": 50, "published": 50, "unattacked": {}, "refused": {}, "failed": ""}
    assert between.counts == expected
    assert not between.warnings


def test_without_odometry_of_their_frame_messages_pass_unchanged_and_that_is_said(router: str, tmp_path: Path) -> None:
    node = interposer(tmp_path, SHIFT)
    with Between(router, node, "/car/odometry") as between:
        own, place = between.join(), between.place()
        place.publish_bytes(b"no odometry")
        place.publish(odometry(POSE, WALL_NS, "odom", "base_link"))
        eventually(lambda: node._poses, "the odometry")
        sent = [type_store.encode(message) for message in messages(3)]
        for payload in sent:
            own.publish_bytes(payload)
        assert [between.arrived.get(timeout=20.0) for _ in sent] == sent
        between.end()
    reason = "odometry in another frame of reference"
    assert between.counts["unattacked"] == {reason: 3}
    assert between.counts["refused"] == {"odometry that cannot be read": 1}
    told, unused = between.warnings
    assert reason in told
    assert unused == "/car/odometry: no odometry was used"


def test_bytes_that_are_no_message_are_passed_on_as_they_are(router: str, tmp_path: Path) -> None:
    (message,) = messages(1)
    sound = type_store.encode(message)
    foreign = [sound.replace(b"\4\0\0\0map\0", b"\4\0\0\0ma\xe9\0"), sound + bytes(64), sound[:-9], b""]
    nameless = type_store.encode(replace(message, header=replace(message.header, frame_id="")))
    assert foreign[0] != sound
    with Between(router, interposer(tmp_path, SHIFT)) as between:
        own = between.join()
        for payload in (*foreign, nameless):
            own.publish_bytes(payload)
        assert [between.arrived.get(timeout=20.0) for _ in (*foreign, nameless)] == [*foreign, nameless]
        between.end()
    assert between.counts["unattacked"] == {f"cannot be read as {type_store.TRACKED_OBJECTS}": 4, "frame_id": 1}
    assert (between.counts["messages"], between.counts["published"]) == (5, 5)
    assert "utf-8" in between.warnings[0]


def test_a_publisher_that_was_not_remapped_is_named(router: str, tmp_path: Path) -> None:
    with Between(router, interposer(tmp_path, SHIFT)) as between:
        between.tracker.publisher(TOPIC, type_store.TRACKED_OBJECTS)
        eventually(lambda: between.warnings, "a warning")
    between.end()
    assert between.warnings == [
        f"/tracker publishes on {TOPIC} itself: what it says is not attacked; start it with the topic remapped",
        f"nothing has arrived on {TOPIC}/before: nothing was attacked",
    ]


def command(*words: str, folder: Path) -> subprocess.Popen[str]:
    """`mast intercept`; its output is in folder / output."""
    with (folder / "output").open("w") as output:
        return subprocess.Popen([*MAST, "intercept", *words], cwd=folder, stdout=output, stderr=output, text=True)


def test_the_command_writes_the_launch_file_attacks_until_it_is_interrupted_and_says_what_it_did(
    router: str, tmp_path: Path
) -> None:
    (tmp_path / "shift.py").write_text(SHIFT)
    words = ("--ros2", TOPIC, "--with", "shift.py", "--launch", "before.launch.xml", "--router", router)
    process = command(*words, folder=tmp_path)
    arrived: queue.SimpleQueue[Any] = queue.SimpleQueue()
    with Participant(Connection(router), "tracker") as tracker, Participant(Connection(router), "planner") as planner:
        planner.subscribe(TOPIC, type_store.TRACKED_OBJECTS, lambda message, _: arrived.put(message))
        own = tracker.publisher(TOPIC + "/before", type_store.TRACKED_OBJECTS)
        eventually(lambda: own.is_wanted, "the interposer")
        eventually(lambda: planner.publishers_of(TOPIC), "its publisher")
        for message in messages(5):
            own.publish(message)
            arrived.get(timeout=20.0)
    process.send_signal(signal.SIGINT)
    code, output = process.wait(30.0), (tmp_path / "output").read_text()
    assert code == 0, output
    assert "publisher: ros2 launch before.launch.xml file:=ITS_LAUNCH_FILE" in output
    assert f"publisher: ros2 run PACKAGE NODE --ros-args -r {TOPIC}:={TOPIC}/before" in output
    assert "messages: 5, changed: 5, published: 5" in output
    assert (tmp_path / "before.launch.xml").read_text() == launch_fragment(TOPIC)


def test_the_command_says_what_makes_it_ineffective_and_the_numbers_also_of_a_node_that_failed(tmp_path: Path) -> None:
    session, router = open_router()
    (tmp_path / "no_idea.py").write_text(NO_IDEA)
    process = command("--ros2", TOPIC, "--with", "no_idea.py", "--router", router, folder=tmp_path)
    arrived: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def says(*sentences: str) -> None:
        eventually(lambda: all(each in (tmp_path / "output").read_text() for each in sentences), f"{sentences}")

    with (
        process,
        Participant(Connection(router), "tracker") as tracker,
        Participant(Connection(router), "planner") as planner,
    ):
        planner.subscribe_bytes(TOPIC, type_store.TRACKED_OBJECTS, lambda payload, _: arrived.put(payload))
        own = tracker.publisher(TOPIC + "/before", type_store.TRACKED_OBJECTS)
        tracker.publisher(TOPIC, type_store.TRACKED_OBJECTS)
        eventually(lambda: own.is_wanted, "the interposer")
        eventually(lambda: len(planner.publishers_of(TOPIC)) == 2, "its publisher")
        later, earlier = reversed(messages(2))
        for message in (later, earlier):
            own.publish(message)
        own.publish_bytes(b"no message")
        for _ in range(3):
            arrived.get(timeout=20.0)
        says(f"warning: /tracker publishes on {TOPIC} itself", "warning: a message was passed on unchanged")
        session.close()
        says("warning: there is no link to the router: meanwhile messages are lost")
        process.send_signal(signal.SIGINT)
        code, output = process.wait(30.0), (tmp_path / "output").read_text()
        assert code == 30, output
    assert "warning: no --odometry: to the node, the publisher is at the origin of 'map'" in output
    assert f"warning: {TOPIC}: the stamps have jumped 1 times" in output
    assert "messages: 3, changed: 0, published: 3" in output
    assert f"warning: 1 messages were passed on unchanged: cannot be read as {type_store.TRACKED_OBJECTS}" in output
    assert "RuntimeError: no idea: it was on" in output


@pytest.mark.parametrize(
    ("words", "code", "problem"),
    [
        ([], 2, "expected a node or an attack"),
        (["--with", "UncoordinatedAttack"], 2, "expected the folder of a running run and --wire, or --ros2 TOPIC"),
        (["run", "--with", "x.py", "--ros2", TOPIC], 2, "found RUN and --ros2"),
        (["--with", "UncoordinatedAttack", "--ros2", "objects"], 10, "--ros2: topic 'objects/before'"),
        (["--with", "UncoordinatedAttack", "--ros2", TOPIC, "--type", "Odometry"], 10, "--type: found 'Odometry'"),
        (["--with", "UncoordinatedAttack", "--ros2", TOPIC, "--odometry", "o d"], 10, "--odometry: topic 'o d'"),
        (["--with", "missing.py", "--ros2", TOPIC], 12, "no node file or attack 'missing.py'"),
        (["--with", "UncoordinatedAttack", "--ros2", TOPIC, "--set", "attack.no=1"], 10, "no"),
        (["--with", "UncoordinatedAttack", "--ros2", TOPIC, "--router", "here"], 10, "ros2.router: found 'here'"),
    ],
)
def test_a_wrong_command_says_what_is_wrong(words: list[str], code: int, problem: str) -> None:
    ended = commands_in_process.command("intercept", *words)
    assert ended.code == code
    assert problem in " ".join((ended.out + ended.err).replace("│", " ").split())

"""A foreign client of ROS 2 sees the bridge and receives a finished run; RViz and Foxglove get layouts of it."""

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from launched import eventually
from mast_ros2.bridge import Ros2Bridge, frames_to_the_end, played
from mast_ros2.layouts import write_layouts
from mast_ros2.run_messages import RunMessages
from ros2_client import ForeignClient, ros2_router

import mast_zenoh as mast_package
from mast_zenoh.errors import PluginError
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.recorded import frames_of, open_recorded
from mast_zenoh.runs.run import Run

FAST = ("--rate", "10")


@pytest.fixture(scope="module")
def run(recorded: mast_package.Run) -> Run:
    return open_recorded(recorded.path)


@pytest.fixture(scope="module")
def topics(run: Run) -> dict[str, str]:
    """All topics of the run, and their types."""
    return {topic.name: topic.type_name for topic in RunMessages(run).topics}


def test_what_nodes_of_ros_2_in_the_run_send_themselves_is_left_to_them(run: Run) -> None:
    """Two senders of a clock, one of them behind, would make it go back; a frame has one parent."""
    partners = {"infra_1": {"clock": "/clock"}, "infra_2": {"clock": ""}}
    alone, beside = RunMessages(run), RunMessages(run, partners=partners)
    assert {topic.name for topic in alone.topics} - {topic.name for topic in beside.topics} == {"/clock"}
    frame = next(iter(frames_of(run)))
    placed = [
        {each.child_frame_id for each in dict(messages.of(frame))["/tf"].transforms} for messages in (alone, beside)
    ]
    assert placed[0] - placed[1] == {"infra_1", "infra_2"}
    assert "/clock" not in dict(beside.of(frame))


def test_a_finished_run_is_played_in_order_at_the_pace_of_its_scene_once_or_again_and_again(run, monkeypatch) -> None:
    now, order = [100.0], [frame.index for frame in frames_of(run)]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(time, "sleep", lambda duration_s: now.__setitem__(0, now[0] + duration_s))
    scene_s = [frame.time_ns / 1e9 for frame in frames_of(run)]
    paced = [(frame.index, now[0] - 100.0) for frame in played(run, rate=2.0)]
    assert [index for index, _ in paced] == order
    assert [at for _, at in paced] == pytest.approx([(time_s - scene_s[0]) / 2.0 for time_s in scene_s])
    again = islice(played(run, rate=1e6, loop=True), 2 * len(order))
    assert [frame.index for frame in again] == 2 * order


class Bridge:
    """`mast ros2` in a process of its own."""

    def __init__(self, target: object, *words: str) -> None:
        command = [sys.executable, "-m", "mast_zenoh", "ros2", str(target), *words]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.lines: dict[str, str] = {}
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if line.startswith("Ctrl-C"):
                break
            name, _, value = line.strip().partition(": ")
            self.lines[name] = value

    def ended(self) -> str:
        """What it has printed after it was ready; it has succeeded without a warning."""
        output, errors = self.process.communicate(timeout=60)
        assert (self.process.returncode, errors) == (0, "")
        return output


def test_what_a_client_receives_is_what_was_recorded(recorded, record, tmp_path) -> None:
    topics = {
        "/clock": "rosgraph_msgs/msg/Clock",
        "/fleet/cc/picture": "vision_msgs/msg/Detection3DArray",
        "/fleet/agent/ego/odometry": "nav_msgs/msg/Odometry",
    }
    with ros2_router() as router, ForeignClient(router, topics, tmp_path / "received.json", domain=7) as client:
        bridge = Bridge(recorded.path, f"--router={router}", "--domain=7", "--namespace=/fleet", *FAST)
        bridge.ended()
        eventually(lambda: set(client.counts().values()) == {len(record.frames)}, "every frame")
        received = client.messages()
    for frame, (clock, picture, odometry) in enumerate(zip(*received.values(), strict=True)):
        assert clock["clock"]["sec"] * 10**9 + clock["clock"]["nanosec"] == record.times_ns[frame]
        assert picture["header"] == {"stamp": clock["clock"], "frame_id": "world"}
        order = np.argsort([int(each["id"]) for each in picture["detections"]])
        places = [list(picture["detections"][k]["bbox"]["center"]["position"].values()) for k in order]
        np.testing.assert_array_equal(np.reshape(places, (-1, 3)), record.boxes["picture"][frame].box[:, :3])
        place = list(odometry["pose"]["pose"]["position"].values())
        np.testing.assert_array_equal(place, record.poses["ego"][frame][0])


def test_a_foreign_client_that_comes_late_lists_the_bridge_and_gets_the_mounts_of_sensors(
    recorded: mast_package.Run, topics: dict[str, str], tmp_path: Path
) -> None:
    with ros2_router() as router:
        bridge = Bridge(recorded.path, f"--router={router}", "--loop")
        try:
            with ForeignClient(router, {"/tf_static": "tf2_msgs/msg/TFMessage"}, tmp_path / "received.json") as client:
                eventually(lambda: client.counts()["/tf_static"], "the mounts")
                (message,) = client.messages()["/tf_static"]
                graph = client.graph()
        finally:
            bridge.process.send_signal(signal.SIGINT)
        assert bridge.process.wait(30) == 0
    assert {topic: each["types"] for topic, each in graph.items()} == {name: [kind] for name, kind in topics.items()}
    assert {node for each in graph.values() for node in each["nodes"]} == {"/mast_bridge"}
    frames = {each["child_frame_id"]: each["header"]["frame_id"] for each in message["transforms"]}
    assert frames["world"] == "map"
    assert frames["ego/lidar"] == frames["ego/camera_optical"] == "ego"
    assert not Path(bridge.lines["rviz"]).exists(), "layouts are there as long as the bridge"


def test_a_bridge_that_is_killed_leaves_no_layouts(recorded: mast_package.Run) -> None:
    with ros2_router() as router:
        bridge = Bridge(recorded.path, f"--router={router}", "--loop")
        folder = Path(bridge.lines["rviz"]).parent
        assert {each.name for each in folder.iterdir()} == {"mast.rviz", "mast.foxglove.json"}
        bridge.process.kill()
        bridge.process.communicate()
    eventually(lambda: not folder.exists(), f"{folder} is deleted", 20)


class Wanted:
    """A participant that keeps what is published; some topics are wanted."""

    def __init__(self, *wanted: str) -> None:
        self.published: list[tuple[str, Any]] = []
        self.wanted, self.warnings, self.router = {*wanted}, [], "1"

    def publisher(self, name: str, kind: str, qos: object) -> Any:
        outer = self

        class Kept:
            @property
            def is_wanted(self) -> bool:
                return name in outer.wanted

            def publish(self, message: Any) -> None:
                outer.published.append((name, message))

        return Kept()

    def settle(self) -> None:
        pass


def test_objects_are_converted_only_for_topics_that_are_subscribed_to(run: Run) -> None:
    participant: Any = Wanted("/cc/picture/markers", "/agent/ego/odometry")
    bridge = Ros2Bridge(run, participant)
    assert bridge.shows_outcomes
    bridge.publish(next(iter(frames_of(run))))
    topics = [name for name, _ in participant.published]
    assert topics == ["/tf_static", "/clock", "/tf", "/agent/ego/odometry", "/cc/picture/markers"]
    assert not Ros2Bridge(run, Wanted("/cc/picture")).shows_outcomes  # type: ignore[arg-type]


def test_a_frame_that_ros_cannot_express_is_counted_and_the_next_one_is_published(run: Run) -> None:
    participant: Any = Wanted()
    bridge = Ros2Bridge(run, participant)
    frame = next(iter(frames_of(run)))
    for time_ns in (-1, 2**31 * 10**9, 5):
        bridge.publish(Frame(run, 0, time_ns, frame.bodies))
    assert [message.clock.nanosec for name, message in participant.published if name == "/clock"] == [5]
    assert bridge.sentences() == ["2 frames were incomplete: something in them cannot be expressed in ROS"]


BOTH = {"/tf", "/cc/picture"}


@pytest.mark.parametrize(
    ("states", "unheard"),
    [
        ([("1", set()), ("", set()), ("", set()), ("1", set())], 2),
        ([("1", BOTH), ("", set()), ("2", set()), ("2", {"/tf"}), ("2", BOTH), ("2", BOTH)], 3),
        ([("1", BOTH), ("2", set()), ("2", BOTH)], 1),
        ([("1", BOTH), ("1", set()), ("", set()), ("2", {"/tf"}), ("2", BOTH)], 2),
        ([("1", {"/tf"}), ("1", set()), ("1", set())], 0),
    ],
    ids=["no link", "until all are back", "lost between two frames", "subscriptions end first", "it ends by itself"],
)
def test_frames_are_counted_until_what_subscribed_before_a_loss_of_the_link_does_so_again(states, unheard, run) -> None:
    """Of each frame: the router ("": none), and the topics that are wanted."""
    participant: Any = Wanted()
    bridge, frame = Ros2Bridge(run, participant), next(iter(frames_of(run)))
    for participant.router, participant.wanted in states:
        bridge.publish(frame)
    assert (bridge.unheard, len(bridge.sentences())) == (unheard, bool(unheard))


@pytest.mark.parametrize(("frames", "is_stopped", "expected"), [(10, False, [4, 9]), (5, False, [4]), (10, True, [4])])
def test_the_last_frame_of_a_run_comes_from_its_recording_if_it_did_not_arrive(
    frames: int, is_stopped: bool, expected: list[int], run: Run, recorded: mast_package.Run
) -> None:
    stop, participant = threading.Event(), Wanted()
    observer: Any = SimpleNamespace(
        frames=lambda stop, ended: (frame for frame in frames_of(run) if frame.index == 4),
        address=SimpleNamespace(folder=recorded.path, resolved=SimpleNamespace(frames=frames)),
    )
    bridge = Ros2Bridge(run, participant)  # type: ignore[arg-type]
    for frame in frames_to_the_end(bridge, observer, stop, lambda: None):
        bridge.publish(frame)
        if is_stopped:
            stop.set()
    clocks = [message.clock for name, message in participant.published if name == "/clock"]
    assert [round((clock.sec + clock.nanosec * 1e-9) / run.period_s) for clock in clocks] == expected
    assert bridge.newest == expected[-1]


def test_the_rviz_file_has_a_display_for_every_topic_that_rviz_can_show(run, topics, tmp_path) -> None:
    layouts = write_layouts(RunMessages(run), tmp_path)
    text = layouts.rviz.read_text()
    assert text.startswith(f"# rviz2 -d {layouts.rviz} --ros-args -p use_sim_time:=true\n")
    manager = yaml.safe_load(text)["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "map"
    assert manager["Views"]["Current"]["Class"] == "rviz_default_plugins/TopDownOrtho"
    by_topic = {each["Topic"]["Value"]: each for each in manager["Displays"] if "Topic" in each}
    of_displays = {
        "visualization_msgs/msg/MarkerArray": "rviz_default_plugins/MarkerArray",
        "nav_msgs/msg/Odometry": "rviz_default_plugins/Odometry",
        "vision_msgs/msg/Detection3DArray": "vision_msgs_rviz_plugins/Detection3DArray",
        "autoware_perception_msgs/msg/TrackedObjects": "autoware_perception_rviz_plugin/TrackedObjects",
        "autoware_perception_msgs/msg/PredictedObjects": "autoware_perception_rviz_plugin/PredictedObjects",
    }
    shown = {name: kind for name, kind in topics.items() if kind in of_displays}
    assert {name: each["Class"] for name, each in by_topic.items()} == {
        name: of_displays[kind] for name, kind in shown.items()
    }
    enabled = {name for name, each in by_topic.items() if each["Enabled"]}
    assert enabled == {"/scene/truth/markers", "/cc/picture/markers"}
    assert all(each["Enabled"] is each["Value"] for each in manager["Displays"])
    assert all(each["Topic"]["Reliability Policy"] == "Reliable" for each in by_topic.values())
    classes = [each["Class"] for each in manager["Displays"]]
    assert classes[:2] == ["rviz_default_plugins/Grid", "rviz_default_plugins/TF"]


def test_the_foxglove_layout_shows_markers_on_the_map(run: Run, tmp_path: Path) -> None:
    layout = json.loads(write_layouts(RunMessages(run), tmp_path).foxglove.read_text())
    (panel,) = layout["configById"].values()
    assert layout["layout"] in layout["configById"]
    assert panel["followTf"] == "map"
    visible = {topic for topic, each in panel["topics"].items() if each["visible"]}
    assert visible == {"/scene/truth/markers", "/cc/picture/markers"}


@pytest.fixture
def without_rosbags(monkeypatch: pytest.MonkeyPatch) -> None:
    """An installation without what the plugin requires, whatever the tests before have imported."""
    for name in sorted(sys.modules):
        package, _, module = name.partition(".")
        if package == "rosbags" or (package == "mast_ros2" and module not in ("", "mesh", "commands")):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rosbags", None)


Command = Callable[..., tuple[int, str, str]]


@pytest.mark.heavy
def test_what_cannot_be_published_is_refused_with_the_reason_and_its_own_exit_code(mast, recorded, tmp_path) -> None:
    def refused(code: int, message: str, *words: str) -> None:
        found, _, errors = mast("ros2", *words)
        assert (found, message in errors) == (code, True), (found, errors)

    run = str(recorded.path)
    refused(26, "tcp/127.0.0.1:9: nothing answers there (Connection refused)", run, "--router=tcp/127.0.0.1:9")
    refused(15, "no such folder", "nosuch")
    refused(15, "found no run.json: the run has not begun", str(tmp_path))
    refused(10, "domain -1: expected 0 to", run, "--domain=-1")
    refused(10, "router: found 'localhost', expected a form such as", run, "--router=localhost")
    refused(10, "expected certificates in `tls`", run, "--router=tls/127.0.0.1:9")
    refused(10, "found 'nosuch.pem', expected a file", run, "--router=tls/127.0.0.1:9", "--tls-ca=nosuch.pem")
    refused(2, "--every-frame is for running runs", run, "--every-frame")
    refused(2, "tcp/HOST:7447, for --run", run, "--run=x")
    with ros2_router() as router:
        refused(10, "namespace: topic '/a b'", run, f"--router={router}", "--namespace=/a b")
        refused(26, "", "tcp/127.0.0.1:9", f"--router={router}")


@pytest.mark.usefixtures("without_rosbags")
def test_without_what_the_plugin_requires_the_command_names_it(mast: Command, recorded: mast_package.Run) -> None:
    for words in (["ros2", str(recorded.path)], ["export", str(recorded.path), "--to", "rosbag2", "-o", "bag"]):
        code, _, errors = mast(*words)
        needed = "rosbags is not installed: this needs the plugin mast-zenoh-ros2, expected: pip install"
        assert (code, needed in errors) == (PluginError.exit_code, True), errors

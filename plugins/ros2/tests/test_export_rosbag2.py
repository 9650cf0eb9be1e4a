"""The ROS 2 bag, read back by rosbags."""

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mast_ros2.layouts import rviz_layout
from mast_ros2.run_messages import RunMessages
from plain_record import CLASSES, PlainRecord, assert_same_boxes
from rosbags.highlevel import AnyReader

import mast_zenoh as mast
from mast_zenoh.runs.messages import messages as messages_of
from mast_zenoh.runs.recorded import open_recorded
from mast_zenoh.show.export import export


@pytest.fixture(scope="module")
def messages(exported_to: Callable[[str], Path]) -> dict[str, list[tuple[str, int, Any]]]:
    """By topic: type, time and content of each message."""
    result: dict[str, list[tuple[str, int, Any]]] = defaultdict(list)
    with AnyReader([exported_to("rosbag2")]) as reader:
        for connection, time, raw in reader.messages():
            content = reader.deserialize(raw, connection.msgtype)
            result[connection.topic].append((connection.msgtype, time, content))
    return result


def box_of(pose: Any, size: Any) -> list[float]:
    """x y z l w h yaw"""
    turn = pose.orientation
    assert turn.x == turn.y == 0
    axes = [getattr(of, axis) for of in (pose.position, size) for axis in "xyz"]
    return [*axes, float(2 * np.arctan2(turn.z, turn.w))]


def test_detections_and_markers_are_the_recorded_boxes(messages: Any, record: PlainRecord) -> None:
    frame_of = {time: frame for frame, time in record.times_ns.items()}
    for name, topic in record.topics.items():
        detected, marked = {}, {}
        for kind, time, array in messages[f"/{topic}"]:
            assert kind == "vision_msgs/msg/Detection3DArray"
            assert array.header.frame_id == "world"
            assert array.header.stamp.sec * 10**9 + array.header.stamp.nanosec == time
            boxes = [box_of(each.bbox.center, each.bbox.size) for each in array.detections]
            detected[frame_of[time]] = [int(each.id) for each in array.detections], boxes
        for kind, time, array in messages[f"/{topic}/markers"]:
            assert kind == "visualization_msgs/msg/MarkerArray"
            first, *markers = array.markers
            assert first.action == 3  # removes those of the frame before
            boxes = [box_of(marker.pose, marker.scale) for marker in markers]
            marked[frame_of[time]] = [marker.id for marker in markers], boxes
        for found in (detected, marked):
            assert set(found) == set(record.frames)
            assert_same_boxes(found, record.boxes[name], 1e-9)


def test_detections_have_class_score_and_covariance(messages: Any, record: PlainRecord) -> None:
    for _, time, array in messages["/cc/picture"]:
        frame = next(frame for frame, time_ns in record.times_ns.items() if time_ns == time)
        columns = record.boxes["picture"][frame].columns
        results = [detection.results for detection in sorted(array.detections, key=lambda each: int(each.id))]
        assert [each[0].hypothesis.class_id for each in results] == [CLASSES[k] for k in columns["class_id"]]
        assert [each[0].hypothesis.score for each in results] == columns["score"].tolist()
        for (result,), covariance in zip(results, columns["covariance"], strict=True):
            assert np.array_equal(np.reshape(result.pose.covariance, (6, 6))[:3, :3], covariance[:3, :3])


def test_transforms_are_the_recorded_poses(messages: Any, record: PlainRecord) -> None:
    assert len(messages["/tf"]) == len(record.frames)
    for frame, (_, _, update) in enumerate(messages["/tf"]):
        by_child = {each.child_frame_id: each for each in update.transforms}
        for agent, poses in record.poses.items():
            position, (w, x, y, z) = poses[frame]
            transform = by_child[agent].transform
            place, turn = transform.translation, transform.rotation
            np.testing.assert_allclose([place.x, place.y, place.z], position, atol=1e-9)
            same = abs(np.dot([turn.w, turn.x, turn.y, turn.z], [w, x, y, z]) / np.linalg.norm([w, x, y, z]))
            assert same == pytest.approx(1.0, abs=1e-12)


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """A run whose scans are recorded."""
    folder = tmp_path_factory.mktemp("scanned")
    points = dict(lidar="VLP-16", recorded=True)
    sets = {"n_infrastructure": 1, "n_mobile": 0}
    path = folder / "scanned.py"
    shipped = Path(mast.__file__).parents[1] / "scenarios"
    path.write_text(
        f"import sys\n\nsys.path.insert(0, {str(shipped)!r})\nfrom baseline import scenario as baseline\n\n\n"
        f"def scenario():\n    return baseline(**{sets!r}) | dict(points={points!r})\n"
    )
    return mast.run(path, frames=3, out=folder / "run", runtime="inproc")


def test_scans_are_point_clouds_in_the_frame_of_a_mounted_lidar(scanned: mast.Run, tmp_path: Path) -> None:
    export(scanned.path, "rosbag2", tmp_path / "bag")
    clouds, mounts = defaultdict(list), {}
    with AnyReader([tmp_path / "bag"]) as reader:
        for connection, _, raw in reader.messages():
            content = reader.deserialize(raw, connection.msgtype)
            if connection.msgtype == "sensor_msgs/msg/PointCloud2":
                clouds[connection.topic].append(content)
            elif connection.topic == "/tf_static":
                mounts |= {each.child_frame_id: each for each in content.transforms}
    assert set(clouds) == {"/agent/ego/points", "/agent/infra_1/points"}
    for topic, of_agent in clouds.items():
        for cloud, scan in zip(of_agent, messages_of(scanned.path, topic[1:]), strict=True):
            names = [field.name for field in cloud.fields]
            kinds = [{7: "<f4", 4: "<u2"}[field.datatype] for field in cloud.fields]
            offsets = [field.offset for field in cloud.fields]
            kind = np.dtype(dict(names=names, formats=kinds, offsets=offsets, itemsize=cloud.point_step))
            points = np.frombuffer(cloud.data.tobytes(), kind)
            assert names == ["x", "y", "z", "intensity", "t", "ring"]
            assert (cloud.height, cloud.width, cloud.row_step) == (1, len(points), len(cloud.data))
            assert not cloud.is_bigendian
            columns = [*scan["position"].T, scan["intensity"], scan["time_s"], scan["channel"]]
            for name, values in zip(names, columns, strict=True):
                np.testing.assert_array_equal(points[name], values)
            assert len(points) > 1000
            mount = mounts[cloud.header.frame_id]
            assert mount.header.frame_id == topic.split("/")[2]
            place = mount.transform.translation
            np.testing.assert_allclose([place.x, place.y, place.z], scan["mount_position"], atol=1e-9)
    layout = rviz_layout(RunMessages(open_recorded(scanned.path)))
    shown = {each["Name"]: each["Enabled"] for each in layout["Visualization Manager"]["Displays"]}
    assert (shown["/agent/ego/points"], shown["/agent/infra_1/points"]) == (True, False)

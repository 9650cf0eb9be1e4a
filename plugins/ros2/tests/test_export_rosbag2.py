"""The ROS 2 bag, read back by rosbags."""

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plain_record import CLASSES, PlainRecord, assert_same_boxes
from rosbags.highlevel import AnyReader


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

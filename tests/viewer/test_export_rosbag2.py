"""The ROS 2 bag, read back by rosbags."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plain_record import CLASSES, PlainRecord, assert_same_boxes
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

import mast_zenoh as mast
from mast_zenoh.viewer.export import export


@pytest.fixture(scope="module")
def bag(recorded: mast.Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("ros") / "bag"
    export(recorded.path, "rosbag2", out)
    return out


@pytest.fixture(scope="module")
def messages(bag: Path) -> dict[str, list[tuple[str, int, Any]]]:
    """By topic: type, time and content of each message."""
    result: dict[str, list[tuple[str, int, Any]]] = defaultdict(list)
    with AnyReader([bag]) as reader:
        for connection, time, raw in reader.messages():
            content = reader.deserialize(raw, connection.msgtype)
            result[connection.topic].append((connection.msgtype, time, content))
    return result


def yaw_of(turn: Any) -> float:
    assert turn.x == turn.y == 0
    return float(2 * np.arctan2(turn.z, turn.w))


def test_detections_and_markers_are_the_recorded_boxes(messages: Any, record: PlainRecord) -> None:
    frame_of = {time: frame for frame, time in record.times_ns.items()}
    for name, topic in record.topics.items():
        detected, marked = {}, {}
        for kind, time, array in messages[f"/{topic}"]:
            assert kind == "vision_msgs/msg/Detection3DArray"
            assert array.header.frame_id == "world"
            assert array.header.stamp.sec * 10**9 + array.header.stamp.nanosec == time
            each = array.detections
            detected[frame_of[time]] = (
                [int(detection.id) for detection in each],
                [
                    [
                        *(getattr(detection.bbox.center.position, axis) for axis in "xyz"),
                        *(getattr(detection.bbox.size, axis) for axis in "xyz"),
                        yaw_of(detection.bbox.center.orientation),
                    ]
                    for detection in each
                ],
            )
        for kind, time, array in messages[f"/{topic}/markers"]:
            assert kind == "visualization_msgs/msg/MarkerArray"
            first, *markers = array.markers
            assert first.action == 3  # removes those of the frame before
            marked[frame_of[time]] = (
                [marker.id for marker in markers],
                [
                    [
                        *(getattr(marker.pose.position, axis) for axis in "xyz"),
                        *(getattr(marker.scale, axis) for axis in "xyz"),
                        yaw_of(marker.pose.orientation),
                    ]
                    for marker in markers
                ],
            )
        assert set(detected) == set(marked) == set(record.frames)
        assert_same_boxes(detected, record.boxes[name], 1e-9)
        assert_same_boxes(marked, record.boxes[name], 1e-9)


def test_detections_have_class_score_and_covariance(messages: Any, record: PlainRecord) -> None:
    for _, time, array in messages["/cc/picture"]:
        frame = next(frame for frame, time_ns in record.times_ns.items() if time_ns == time)
        columns = record.boxes["picture"][frame].columns
        results = [detection.results for detection in sorted(array.detections, key=lambda each: int(each.id))]
        assert [each[0].hypothesis.class_id for each in results] == [CLASSES[k] for k in columns["class_id"]]
        assert [each[0].hypothesis.score for each in results] == columns["score"].tolist()
        for (result,), covariance in zip(results, columns["covariance"], strict=True):
            assert np.array_equal(np.reshape(result.pose.covariance, (6, 6))[:3, :3], covariance[:3, :3])


def test_colours_of_markers_are_the_papers_key(messages: Any, recorded: mast.Run) -> None:
    false = [
        (frame, marker.id)
        for frame, (_, _, array) in enumerate(messages["/cc/picture/markers"])
        for marker in array.markers[1:]
        if np.round(np.multiply((marker.color.r, marker.color.g, marker.color.b), 255)).tolist() == [255, 59, 59]
    ]
    rows = [row for row in recorded.objects.to_pylist() if (row["agent"], row["estimator"]) == ("ego", "picture")]
    assert sorted(false) == sorted((row["frame"], row["id"]) for row in rows if row["outcome"] == "false")
    assert false


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


def test_the_bag_is_compressed(bag: Path) -> None:
    with Reader(bag) as reader:
        size = sum(len(raw) for _, _, raw in reader.messages())
    assert (bag / "bag.mcap").stat().st_size < size / 2

"""The MCAP file for Foxglove, read back by mcap and protobuf, and its layout."""

import io
import json
from collections import Counter, defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image
from plain_record import PlainRecord, assert_same_boxes

import mast_zenoh as mast


@pytest.fixture(scope="module")
def messages(exported_to: Callable[[str], Path]) -> dict[str, list[tuple[str, int, Any]]]:
    """By topic: schema, log time and decoded content of each message."""
    result: dict[str, list[tuple[str, int, Any]]] = defaultdict(list)
    with exported_to("foxglove").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message in reader.iter_messages():
            if schema.encoding == "protobuf":
                decoded = DecoderFactory().decoder_for(channel.message_encoding, schema)(message.data)
            else:
                decoded = json.loads(message.data)
            result[channel.topic].append((schema.name, message.log_time, decoded))
    return result


def colour_of(entity: Any) -> tuple[int, int, int]:
    colour = entity.cubes[0].color
    return round(colour.r * 255), round(colour.g * 255), round(colour.b * 255)


def test_every_estimate_is_a_scene_with_the_recorded_boxes(messages: Any, record: PlainRecord) -> None:
    frame_of = {time: frame for frame, time in record.times_ns.items()}
    for name, topic in record.topics.items():
        found = {}
        for schema, time, update in messages[f"/{topic}"]:
            assert schema == "foxglove.SceneUpdate"
            assert [deletion.type for deletion in update.deletions] == [1]  # all entities of the frame before
            numbers, boxes = [], []
            for entity in update.entities:
                assert entity.frame_id == "world"
                assert entity.timestamp.seconds * 10**9 + entity.timestamp.nanos == time
                (cube,) = entity.cubes
                place, turn, size = cube.pose.position, cube.pose.orientation, cube.size
                assert turn.x == turn.y == 0
                numbers.append(int(entity.id))
                yaw = 2 * np.arctan2(turn.z, turn.w)
                boxes.append([place.x, place.y, place.z, size.x, size.y, size.z, yaw])
            found[frame_of[time]] = numbers, boxes
        assert set(found) == set(record.frames)
        assert_same_boxes(found, record.boxes[name], 1e-9)


def test_colours_are_the_papers_key(messages: Any, recorded: mast.Run) -> None:
    key = {"matched": (63, 140, 255), "false": (255, 59, 59), "unevaluated": (63, 212, 95)}
    judged = recorded.objects.to_pylist()
    rows = [row for row in judged if (row["agent"], row["estimator"]) == ("ego", "picture")]
    for kind, topic, outcome, colour in (
        ("track", "/cc/picture", "matched", key["matched"]),
        ("track", "/cc/picture", "false", key["false"]),
        ("truth", "/scene/truth", "matched", (255, 255, 255)),
        ("truth", "/scene/truth", "missed", (255, 214, 10)),
        ("truth", "/cc/picture/missed", "missed", (255, 214, 10)),
    ):
        drawn = [
            (number, int(entity.id))
            for number, (_, _, update) in enumerate(messages[topic])
            for entity in update.entities
            if colour_of(entity) == colour
        ]
        expected = [(r["frame"], r["id"]) for r in rows if (r["kind"], r["outcome"]) == (kind, outcome)]
        assert sorted(drawn) == sorted(expected)
        assert drawn, (topic, outcome)
    colours = {colour_of(entity) for _, _, update in messages["/cc/picture"] for entity in update.entities}
    assert colours <= set(key.values())


def test_one_message_a_frame_has_the_poses_of_all_agents_and_cameras(messages: Any, record: PlainRecord) -> None:
    frame_of = {time: frame for frame, time in record.times_ns.items()}
    assert Counter(frame_of[time] for _, time, _ in messages["/tf"]) == dict.fromkeys(record.frames, 1)
    for _, time, update in messages["/tf"]:
        by_child = {each.child_frame_id: each for each in update.transforms}
        assert set(by_child) == {name for agent in record.poses for name in (agent, f"{agent}/camera")}
        for agent, poses in record.poses.items():
            position, (w, x, y, z) = poses[frame_of[time]]
            transform = by_child[agent]
            assert transform.parent_frame_id == "world"
            place, turn = transform.translation, transform.rotation
            np.testing.assert_allclose([place.x, place.y, place.z], position, atol=1e-9)
            same = abs(np.dot([turn.w, turn.x, turn.y, turn.z], [w, x, y, z]) / np.linalg.norm([w, x, y, z]))
            assert same == pytest.approx(1.0, abs=1e-12)
            assert by_child[f"{agent}/camera"].parent_frame_id == agent


def test_the_camera_projects_as_mast_does(messages: Any, recorded: mast.Run, record: PlainRecord) -> None:
    """An object ahead of the ego: by the transforms and the calibration of the file, and by mast's camera model."""
    from mast_zenoh.arrays.geometry import rotation_from_quaternion
    from mast_zenoh.scenes.recording import Recording

    schema, _, calibration = messages["/agent/ego/camera"][0]
    assert schema == "foxglove.CameraCalibration"
    transforms = {each.child_frame_id: each for each in messages["/tf"][0][2].transforms}
    agent = Recording.load(recorded.path / "scene.npz").agents[0]
    position, rotation = record.poses["ego"][0][0], rotation_from_quaternion(record.poses["ego"][0][1])
    point = position + rotation @ [30.0, 4.0, 1.0]
    local = point
    for name in ("ego", "ego/camera"):
        place, turn = transforms[name].translation, transforms[name].rotation
        matrix = rotation_from_quaternion(np.array([turn.w, turn.x, turn.y, turn.z]))
        local = matrix.T @ (local - [place.x, place.y, place.z])
    pixel = np.reshape(calibration.K, (3, 3)) @ local
    expected, _ = agent.camera.project(point[None], position, rotation)
    np.testing.assert_allclose(pixel[:2] / pixel[2], expected[0], atol=1e-6)
    assert (calibration.width, calibration.height) == (agent.camera.width, agent.camera.height)
    for _, _, image in messages["/agent/ego/camera/image"]:
        assert Image.open(io.BytesIO(image.data)).size == (calibration.width, calibration.height)


def test_inserted_objects_are_marked_and_logged(messages: Any, recorded: mast.Run) -> None:
    rows = [row for row in recorded.attacks.to_pylist() if row["effect"] == "inserted"]
    assert len(rows) > 20
    marks = [
        (number, round(sphere.pose.position.x, 6), round(sphere.pose.position.y, 6))
        for number, (_, _, update) in enumerate(messages["/changes"])
        for entity in update.entities
        for sphere in entity.spheres
        if {each.key: each.value for each in entity.metadata}["effect"] == "inserted"
    ]
    assert sorted(marks) == sorted((row["frame"], round(row["after_x"], 6), round(row["after_y"], 6)) for row in rows)
    lines = [content.message for _, _, content in messages["/log"] if ": inserted" in content.message]
    assert len(lines) == len(rows)
    assert all(line.startswith(("adversary_1 on agent/infra_1/tracks", "adversary_2 on")) for line in lines)


def test_scores_are_series(messages: Any, recorded: mast.Run) -> None:
    rows = [row for row in recorded.metrics.to_pylist() if (row["agent"], row["estimator"]) == ("ego", "picture")]
    series = [content for _, _, content in messages["/scores/ego/picture"]]
    names = ("fn", "fp", "tp", "rmse_m", "id_switches")
    assert [[each[name] for name in names] for each in series] == [[row[name] for name in names] for row in rows]


def test_the_layout_shows_topics_of_the_file(exported_to: Callable[[str], Path], messages: Any) -> None:
    layout = json.loads(exported_to("foxglove").with_name("run.layout.json").read_text())

    def panels(node: Any) -> list[str]:
        return [node] if isinstance(node, str) else [*panels(node["first"]), *panels(node["second"])]

    configs = layout["configById"]
    assert sorted(panels(layout["layout"])) == sorted(configs)
    assert {name.split("!")[0] for name in configs} == {"3D", "Image", "Plot", "RosOut"}
    for name, config in configs.items():
        topics = [*config.get("topics", {}), *(path["value"].split(".")[0] for path in config.get("paths", ()))]
        topics += [config[key] for key in ("topicToRender",) if key in config]
        topics += config.get("imageMode", {}).values()
        assert topics, name
        assert set(topics) <= set(messages), name
    visible = {topic for topic, settings in configs["3D!objects"]["topics"].items() if settings["visible"]}
    assert {"/scene/truth", "/cc/picture", "/cc/picture/missed"} <= visible

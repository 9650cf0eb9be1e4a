"""A scene in UTM coordinates is driven, sent by radio and exported as if it were at the origin of the world."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from mast_datasets.kitti import read_poses
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

import mast_zenoh as mast
from mast_zenoh.scenes import Recording
from mast_zenoh.show.export import export

#: East and north, m: Munich; Nairobi, south of the equator; the origin.
PLACES = {"munich": (691_000.0, 5_336_000.0), "nairobi": (257_000.0, 9_857_000.0), "origin": (0.0, 0.0)}
FRAMES = 15


def highway(place: tuple[float, float], far: int | None = None) -> Recording:
    """Cars on three lanes, with agents in three of them. far: the number of one that is 300 km to the east"""
    car, times = np.arange(23), np.arange(FRAMES) / 10
    x = -12.0 * (car // 3) + (22.0 + 4.0 * (car % 3)) * times[:, None]
    x = x + 300e3 * (car == far)
    y = np.broadcast_to(3.5 * (car % 3), x.shape)
    position = np.stack([x + place[0], y + place[1]], axis=2)
    return mast.scene(times_s=times, position=position, size=(4.5, 1.8, 1.5), agents=[9, 10, 14])


@pytest.fixture(scope="module")
def run_at(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], mast.Run]:
    """Peers that broadcast CPMs on the highway at a place, run once."""

    @cache
    def played(place: str) -> mast.Run:
        folder = tmp_path_factory.mktemp(place)
        highway(PLACES[place]).save(folder / "scene.npz")
        scene = f"recording:{folder / 'scene.npz'}"
        return mast.run("peers", codec="cpm", scene=scene, seed=3, out=folder / "run")

    return played


@pytest.mark.parametrize("place", ["munich", "nairobi"])
def test_standard_messages_are_received_as_at_the_origin_of_the_world(
    run_at: Callable[[str], mast.Run], place: str
) -> None:
    run, reference = run_at(place), run_at("origin")
    assert not [notice for notice in run.record["notices"] if notice["kind"] == "rejected"]
    ego, at_origin = (each.summary["agents"]["ego"]["picture"] for each in (run, reference))
    assert ego["fn"] == pytest.approx(at_origin["fn"], abs=0.2)
    assert ego["rmse_m"] == pytest.approx(at_origin["rmse_m"], abs=0.02)


@pytest.mark.parametrize("place", ["munich", "nairobi"])
def test_kitti_poses_are_read_back_undistorted(run_at: Callable[[str], mast.Run], place: str, tmp_path: Path) -> None:
    run = run_at(place)
    export(run.path, "kitti", tmp_path / "kitti")
    position, _ = read_poses(tmp_path / "kitti" / "oxts" / "0000.txt")
    expected = scene_of(run).agent_position[:, 0] - scene_of(run).agent_position[0, 0]
    np.testing.assert_allclose(position, expected, atol=1e-4)


def scene_of(run: mast.Run) -> Recording:
    return Recording.load(run.path / "scene.npz")


def truth(run: mast.Run, frame: int) -> np.ndarray:
    """(n, 3) m, centres of the objects of a frame by id, from the run's origin."""
    scene = scene_of(run)
    states = scene.truth_at(frame)
    return states.position[np.argsort(states.id)] - [*scene.origin, 0.0]


def test_rerun_has_the_centres_of_boxes_to_a_millimetre(run_at: Callable[[str], mast.Run], tmp_path: Path) -> None:
    from rerun.chunk import RrdReader  # slow, and seldom needed

    run = run_at("munich")
    export(run.path, "rrd", tmp_path / "run.rrd")
    rows = [
        row
        for chunk in RrdReader(tmp_path / "run.rrd").stream()
        if chunk.entity_path.lstrip("/") == "scene/truth"
        for row in chunk.to_record_batch().to_pylist()
    ]
    centres = next(row["Boxes3D:centers"] for row in rows if row.get("frame") == 7)
    np.testing.assert_allclose(np.reshape(centres, (-1, 3)), truth(run, 7), atol=1e-3)


def test_foxglove_has_32_bits_for_what_is_drawn_and_a_transform_to_the_world(
    run_at: Callable[[str], mast.Run], tmp_path: Path
) -> None:
    run = run_at("munich")
    export(run.path, "foxglove", tmp_path / "run.mcap")
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        messages = list(reader.iter_decoded_messages(topics=["/scene/truth", "/tf"]))
    drawn = [update for _, channel, _, update in messages if channel.topic == "/scene/truth"][7].entities
    assert {entity.frame_id for entity in drawn} == {"scene"}
    centres = [[getattr(entity.cubes[0].pose.position, axis) for axis in "xyz"] for entity in drawn]
    np.testing.assert_allclose(np.float32(centres), truth(run, 7), atol=1e-3)
    moves = next(update for _, channel, _, update in messages if channel.topic == "/tf").transforms
    (scene,) = [move.translation for move in moves if move.child_frame_id == "scene"]
    assert (scene.x, scene.y, scene.z) == (*scene_of(run).origin, 0.0)


def test_the_map_of_ros_is_at_the_scene(run_at: Callable[[str], mast.Run], tmp_path: Path) -> None:
    run = run_at("munich")
    export(run.path, "rosbag2", tmp_path / "bag")
    with AnyReader([tmp_path / "bag"]) as reader:
        (fixed,) = [
            transform.transform.translation
            for connection, _, data in reader.messages()
            if connection.topic == "/tf_static"
            for transform in reader.deserialize(data, connection.msgtype).transforms
            if (transform.header.frame_id, transform.child_frame_id) == ("map", "world")
        ]
    assert (fixed.x, fixed.y) == (-690_000.0, -5_340_000.0)


def test_a_wire_that_delivered_nothing_but_rejected_messages_is_in_the_last_lines_with_the_reason(
    tmp_path: Path,
) -> None:
    highway(PLACES["origin"], far=14).save(tmp_path / "scene.npz")
    run = mast.run("peers", codec="cpm", scene=f"recording:{tmp_path / 'scene.npz'}", frames=3, out=tmp_path / "run")
    (notice,) = [notice for notice in run.record["notices"] if notice["kind"] == "undelivered"]
    assert notice["value"] == 1
    assert notice["text"].startswith("all messages were")
    assert "cpm: referencePosition: found" in notice["text"]

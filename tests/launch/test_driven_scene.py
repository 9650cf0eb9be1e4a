"""After a run with drivers, the scene in its folder is what happened; without a recording, that is told."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from driven import driven
from page_blocks import unpack
from recorded_observer import RecordedObserver

from mast_zenoh.launch import run, twin
from mast_zenoh.messages import codec
from mast_zenoh.run_folder.recording.reader import read
from mast_zenoh.runs.run import Run
from mast_zenoh.scenes import Recording
from mast_zenoh.show import comparison
from mast_zenoh.show.page.live_server import LiveBlocks

ATTACK = ("attack=GhostAhead", "wire=detections", "attack_start_s=0.6")


def test_the_scene_of_the_folder_is_what_happened(tmp_path: Path) -> None:
    ended = run.run(driven(*ATTACK, frames=12, record=True), tmp_path / "run", runtime="inproc")
    assert ended.error is None
    scene, prepared = Recording.load(ended.folder / "scene.npz"), driven(frames=12).recording
    sent = {(message.key, message.frame): message.payload for message in read(ended.folder)}
    for frame in range(12):
        truth = codec.decode(sent["scene/truth", frame], "truth").body
        assert np.array_equal(scene.truth_at(frame).position, truth["position"])
        assert np.array_equal(scene.points_at(frame), truth["points"])
        pose = codec.decode(sent["agent/ego/pose", frame], "pose").body
        assert np.array_equal(scene.agent_position[frame, 0], pose["position"])
        sensed = codec.decode(sent["agent/ego/detections/@tap/0", frame], "detections").body
        assert np.array_equal(scene.detections_at(frame, 0).position, sensed["position"]), "before the adversary"
    assert np.array_equal(scene.agent_rotation[:3].round(9), prepared.agent_rotation[:3].round(9))
    assert not np.array_equal(scene.agent_position, prepared.agent_position)
    metrics = json.loads((ended.folder / "metrics.json").read_text())
    way = np.hypot(*np.diff(scene.agent_position[:, 0, :2], axis=0).T).sum()
    assert metrics["driven"].keys() == {"ego"}
    assert metrics["driven"]["ego"]["progress_m"] == pytest.approx(way)
    assert metrics["driven"]["ego"]["collisions"] == []
    assert not [notice for notice in ended.record["notices"] if notice["kind"] == "scene"]


@pytest.mark.heavy
def test_the_scene_of_a_twin_is_what_happened_without_the_attack(tmp_path: Path) -> None:
    attacked = run.run(driven(*ATTACK, frames=30, record=True), tmp_path / "run", runtime="inproc")
    alone = run.run(driven(frames=30, record=True), tmp_path / "alone", runtime="inproc")
    scenario = json.loads((attacked.folder / "scenario.json").read_text())
    scenario["nodes"]["recorder"]["config"]["log"] = str(tmp_path / "escaped.mcap")
    (attacked.folder / "scenario.json").write_text(json.dumps(scenario))
    scenes = [Recording.load(folder / "scene.npz") for folder in (twin.of(attacked.folder), alone.folder)]
    assert np.array_equal(scenes[0].agent_position, scenes[1].agent_position)
    assert np.array_equal(scenes[0].truth.position, scenes[1].truth.position)
    assert not np.array_equal(scenes[0].agent_position, Recording.load(attacked.folder / "scene.npz").agent_position)
    assert not (tmp_path / "escaped.mcap").exists(), "a twin writes into its own folder alone"
    assert comparison.reference(Run(attacked.folder), attacked.folder / "twin").name == "unattacked"


@pytest.mark.heavy
def test_a_live_view_shows_the_truth_as_it_happens(tmp_path: Path) -> None:
    ended = run.run(driven(*ATTACK, frames=30, record=True), tmp_path / "run", runtime="inproc")
    happened, prepared = Recording.load(ended.folder / "scene.npz"), driven(*ATTACK, frames=30).recording
    observer: Any = RecordedObserver(ended.folder, numbers=(10, 29))
    observer.address.scene = prepared  # as it is while the run goes on
    observer.run = observer.run.with_(scene=prepared)
    blocks = LiveBlocks(observer)
    frames = [frame for _ in range(5) if (frame := observer.advance()) is not None]
    for frame in (replace(frame, run=frame.run.with_(scene=prepared)) for frame in frames):
        lasting, block = blocks.header_and_block(frame)
        _, columns = unpack(block)
        truth = happened.truth_at(frame.index)
        shown = np.flatnonzero(columns["box.truth"] > 0)
        shown = shown[np.argsort(columns["box.id"][shown])]
        place = np.column_stack([columns["box.x"][shown], columns["box.y"][shown]])
        np.testing.assert_allclose(place, truth.position[np.argsort(truth.id), :2], atol=0.006)
        assert columns["agents.x"][0] == pytest.approx(happened.agent_position[frame.index, 0, 0], abs=0.006)
        assert all("sectors" not in agent for agent in lasting["agents"]), "what was swept in another drive"
    assert [frame.index for frame in frames] == [10, 29]
    assert np.abs(happened.agent_position[29, 0] - prepared.agent_position[29, 0]).max() > 0.1


@pytest.mark.heavy
def test_without_a_recording_it_is_told_that_pictures_show_the_prepared_scene(tmp_path: Path) -> None:
    ended = run.run(driven(frames=6), tmp_path / "run", runtime="inproc")
    (told,) = [notice["text"] for notice in ended.record["notices"] if notice["kind"] == "scene"]
    assert told.startswith("figures, films and views of this run show its prepared scene")
    prepared = driven(frames=6).recording
    assert np.array_equal(Recording.load(ended.folder / "scene.npz").agent_position, prepared.agent_position)

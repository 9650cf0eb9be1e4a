"""What `mast scene` says about a scene, and what it writes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

import mast_zenoh as mast
from mast_zenoh.cli.app import app
from mast_zenoh.config.registry import recognised
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes import from_arrays, inspection
from mast_zenoh.scenes.inspection import contents, problems
from mast_zenoh.scenes.recording import Recording

TIMES = np.arange(6) / 10


def road(**changes) -> Recording:
    """Two cars 20 m apart, north at 10 m/s."""
    position = np.zeros((6, 2, 2))
    position[:, :, 1] = 10.0 * TIMES[:, None] + [0.0, 20.0]
    return from_arrays(**dict(times_s=TIMES, position=position, name="road") | changes)


def test_contents_count_objects_agents_and_detections() -> None:
    rows = dict(contents(road(poles=[(10.0, 0.0, np.pi)])))
    assert rows["frames"] == "6 at 10.0 Hz, 0.5 s"
    assert rows["agents"] == "2: ego (mobile), infra_1 (static)"
    assert rows["objects"] == "2: 2 car; 2 to 2 in a frame"
    assert rows["detections"].endswith("with covariances")


def test_a_sound_scene_has_no_problems() -> None:
    assert problems(road()) == []


def changed(field: str, rows: slice, value: object) -> Recording:
    recording = road()
    values = getattr(recording.truth, field).copy()
    values[rows] = value
    return replace(recording, truth=replace(recording.truth, **{field: values}))


def with_a_hole() -> Recording:
    """The second car is not there in two frames."""
    position = np.zeros((6, 2, 2))
    position[:, :, 1] = 10.0 * TIMES[:, None] + [0.0, 20.0]
    position[2:4, 1] = np.nan
    return road(position=position)


def shifted(late_s: float) -> Recording:
    """A pole's detections of forty cars that drive both ways, as they were some time before."""
    times, lane = np.arange(20) / 10, np.arange(40)
    speed = np.where(lane % 2, 8.0, -8.0)
    position = np.stack([np.tile(12.0 * lane, (20, 1)), 5.0 * (lane % 2) + speed * times[:, None]], axis=-1)
    scene = from_arrays(times_s=times, position=position, poles=[(240.0, -40.0, np.pi / 2)], name="street")
    assert not any("seem" in each for each in problems(scene))
    pole, column = scene.agents.index(next(a for a in scene.agents if a.kind == "static")), 1
    detections = scene.detections.position.copy()
    for frame in range(20):
        rows = scene._detection_rows(frame, column)
        turn = scene.mount_at(frame, pole)[1]
        back = np.zeros((rows.stop - rows.start, 3))
        back[:, 1] = -late_s * np.where(scene.detection_truth_id[rows] % 2, 8.0, -8.0)
        detections[rows] += back @ scene.agent_rotation[frame, pole] @ turn
    return replace(scene, detections=replace(scene.detections, position=detections))


@pytest.mark.parametrize(
    ("recording", "message"),
    [
        (lambda: road(times_s=[0, 0.1, 0.2, 0.3, 0.9, 1.0]), "6.0 periods before"),
        (lambda: changed("velocity", slice(4, 5), [90.0, 0, 0]), "m/s: 0 (frame"),
        (lambda: changed("position", slice(4, 5), [50.0, 0, 0]), "m from where"),
        (lambda: changed("position", slice(0, 1), [0.5, 20.0, 0.75]), "inside another object"),
        (lambda: changed("yaw", slice(6, 7), -np.pi / 2), "frame: 0"),
        (lambda: with_a_hole(), "frames without them"),
        (lambda: shifted(0.2), "late: shifted time"),
        (lambda: shifted(-0.2), "early: shifted time"),
        (lambda: road(points=np.zeros((6, 2, 1))), "ego never sees"),
    ],
)
def test_what_is_suspicious_is_named(recording, message: str) -> None:
    assert any(message in each for each in problems(recording())), problems(recording())


def test_a_check_lists_the_contents_and_draws_the_first_frame(tmp_path: Path) -> None:
    road().save(tmp_path / "road.npz")
    result = CliRunner().invoke(app, ["scene", "check", str(tmp_path / "road.npz"), "--draw", str(tmp_path / "x.png")])
    assert result.exit_code == 0, result.output
    assert "frames      6" in result.output
    with Image.open(tmp_path / "x.png") as image:
        assert image.width > 500
        assert len(image.convert("RGB").getcolors(10**6) or []) > 20


def test_notes_of_a_scene_last_and_are_listed(tmp_path: Path) -> None:
    notes = ("2 of 5 measurements left out", "poses end early")
    replace(road(), notes=notes).save(tmp_path / "road.npz")
    assert Recording.load(tmp_path / "road.npz").notes == notes
    result = CliRunner().invoke(app, ["scene", "check", str(tmp_path / "road.npz")])
    assert [f"note        {note}" for note in notes] == [
        line for line in result.output.splitlines() if "note  " in line
    ]


def test_a_converted_scene_plays_like_the_original(tmp_path: Path) -> None:
    target = tmp_path / "junction.npz"
    command = ["scene", "convert", "intersection:1", str(target), "--frames", "4", "--seed", "5"]
    result = CliRunner().invoke(app, [*command, "--set", "n_infrastructure=1"])
    assert result.exit_code == 0, result.output
    original = mast.scene("intersection:1", seed=5, frames=4, n_infrastructure=1)
    converted = mast.scene(target)
    assert converted.truth.equals(original.truth)
    assert converted.agent("infra_1").detections.equals(original.agent("infra_1").detections)


def test_written_detections_are_replayed(tmp_path: Path) -> None:
    folder = tmp_path / "detections"
    command = ["scene", "detections", "intersection:1", str(folder), "--frames", "4", "--set", "n_infrastructure=1"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    assert result.output.count(".txt") == 2
    again = mast.scene("intersection:1", frames=4, n_infrastructure=1, detections=str(folder))
    original = mast.scene("intersection:1", frames=4, n_infrastructure=1)
    ours, theirs = again.agent("ego").detections, original.agent("ego").detections
    np.testing.assert_allclose(ours["x"].to_numpy(), theirs["x"].to_numpy(), atol=2e-6)
    refused = CliRunner().invoke(app, command).exception
    assert isinstance(refused, SceneError)
    assert "empty folder" in str(refused)


def test_a_frame_that_is_not_there_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"frame.*6.*0"):
        mast.scene(times_s=TIMES, position=np.zeros((6, 1, 2))).birdseye(6)


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "city_SE3_egovehicle.feather").touch()
    assert recognised(str(tmp_path)) == f"av2:{tmp_path}"
    assert recognised("intersection:3") == "intersection:3"
    (tmp_path / "objects").mkdir()
    (tmp_path / "objects" / "objectstate-npcs-1-0.1.txt").touch()
    with pytest.raises(SceneError, match=r"av2.*avstack.*av2"):
        recognised(str(tmp_path))
    with pytest.raises(ConfigurationError, match=r"folder.*short.*'sumo'"):
        recognised("sumoo")
    with pytest.raises(SceneError, match=r"objectstate-npcs-1-0\.1\.txt.*files"):
        recognised(str(tmp_path / "objects"))
    (tmp_path / "x.txt").touch()
    with pytest.raises(SceneError, match=r"x\.txt.*files"):
        recognised(str(tmp_path / "x.txt"))


def test_settings_of_a_scene_may_be_written_as_those_of_a_run(tmp_path: Path) -> None:
    command = ["scene", "detections", "intersection:0", "--frames", "2", "--set", "n_infrastructure=0"]
    detector = "detector.type=LastingErrors"
    for folder, setting in (("own", detector), ("of_a_run", f"scene.{detector}")):
        result = CliRunner().invoke(app, [*command, str(tmp_path / folder), "--set", setting])
        assert result.exception is None, result.exception
    own, of_a_run = ((tmp_path / folder / "ego.txt").read_text() for folder in ("own", "of_a_run"))
    assert own == of_a_run != ""
    refused = CliRunner().invoke(app, [*command, str(tmp_path / "none"), "--set", "scene=intersection"]).exception
    assert isinstance(refused, ConfigurationError)
    assert "scene: found 'intersection'" in str(refused)


def test_a_run_says_at_its_start_and_in_its_notices_what_is_suspicious_about_its_scene(tmp_path: Path) -> None:
    broken = changed("position", slice(4, 5), [50.0, 0, 0])
    broken.save(tmp_path / "broken.npz")
    command = [
        "run",
        "baseline",
        "--set",
        f"scene=recording:{tmp_path / 'broken.npz'}",
        "--runtime",
        "inproc",
        "--no-report",
    ]
    result = CliRunner().invoke(app, [*command, "--out", str(tmp_path / "run")])
    line = "scene: suspicious: objects more than 2 m from where their velocity leads: 0 (frame 2)"
    assert result.output.count(line) == 2, result.output
    assert [notice for notice in mast.open(tmp_path / "run").record["notices"] if notice["kind"] == "scene"]


def test_a_generated_scene_is_not_looked_at(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(inspection, "problems", lambda *_: pytest.fail("looked at"))
    mast.run("baseline", frames=2, out=tmp_path / "run")


def test_of_a_long_scene_a_bounded_part_is_looked_at_when_a_run_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    times = np.arange(800) / 10
    position = np.zeros((800, 2, 2))
    position[:, :, 1] = times[:, None] + [0.0, 20.0]
    long, looked = from_arrays(times_s=times, position=position, name="long"), []
    monkeypatch.setattr(inspection, "problems", lambda scene, frames: looked.append(frames) or [])
    assert inspection.at_start(long) == ""
    assert looked == [150]

"""Lidars return points, and detectors find objects in them: wherever that is done, the tracks are the same."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_world import PERIOD_NS, Run, tiny

from mast_zenoh.arrays.states import Detections
from mast_zenoh.attacks import Attack
from mast_zenoh.attacks.attack import ObjectsUnchanged
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError, NodeDied
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.messages.schemas import Message
from mast_zenoh.run_folder.recording.reader import read
from mast_zenoh.scenario.points import DETECTED_BY
from mast_zenoh.sensing.beams import MODELS
from mast_zenoh.sensing.point_detector import PointDetector
from mast_zenoh.sensing.points import Points
from mast_zenoh.wiring.model import Wiring

FRAMES = 8
AGENTS = ("ego", "infra_1", "infra_2")


class Everything(PointDetector):
    """One box around all points above half a metre below the lidar of a car; keeps how many there were."""

    def detect(self, points: Points) -> Detections:
        raised = points.position[(points.position[:, 2] > -1.3) & (points.range_m() > 3.0)]
        if not len(raised):
            return Detections.empty()
        size = np.ptp(raised, axis=0)[None].astype(np.float64) + 0.1
        middle = raised.mean(axis=0)[None].astype(np.float64)
        return Detections(middle, size, np.zeros(1), np.ones(1), np.zeros(1, np.uint8), 0.1 * np.eye(3)[None])


class Rubbish(PointDetector):
    """Detections that cannot be."""

    def detect(self, points: Points) -> Detections:
        return Detections(*(np.full(shape, np.nan) for shape in ((1, 3), (1, 3), 1, 1, 1, (1, 3, 3))))


class Blinded(ObjectsUnchanged, Attack):
    """Takes all points of one scan in two."""

    def forge_points(self, frame: int, time_ns: int, points: Points, lidar: Any) -> Points:
        assert lidar[0].shape == (3,)
        assert lidar[1].shape == (3, 3)
        return points.select(slice(0, 0)) if frame % 2 else points


class Copied(ObjectsUnchanged, Attack):
    """Returns the same points in other arrays, of other types."""

    def forge_points(self, frame: int, time_ns: int, points: Points, lidar: Any) -> Points:
        return Points(*(column.astype(np.float64) for column in points.columns().values()))  # type: ignore[arg-type]


class Careless(PointDetector):
    """Writes into the points that it gets."""

    def detect(self, points: Points) -> Detections:
        points.intensity[:] = 0.0
        return Detections.empty()


def resolved(frames: int = FRAMES, name: str = "baseline", record: bool = False, **points: Any) -> Resolved:
    """The tiny world, whose lidars are scanned."""
    options = dict(detector=dict(type="Everything"), lidar="VLP-16", clutter=None) | points
    return tiny(name, frames=frames, record=record, edit=lambda content: content.update(points=options))


@cache
def played(place: str, late_frames: int = 0) -> Run:
    return Run(resolved(detected_by=place, late_frames=late_frames))


def tracks(run: Run, agent: str) -> list[Message]:
    return run.decoded(f"agent/{agent}/tracks", "tracks")


@pytest.mark.parametrize("place", DETECTED_BY)
def test_tracks_do_not_depend_on_where_objects_are_detected(place: str) -> None:
    for agent in AGENTS:
        assert [m.body["position"].tolist() for m in tracks(played(place), agent)] == [
            m.body["position"].tolist() for m in tracks(played("detector"), agent)
        ]
    assert not played(place).failures
    assert not played(place).rejected
    assert any(len(m.body["id"]) for m in tracks(played(place), "ego")), "otherwise nothing is compared"


@pytest.mark.parametrize(("place", "on_wire"), [("detector", True), ("agent", True), ("simulator", False)])
def test_points_leave_the_simulator_only_where_another_node_detects(place: str, on_wire: bool) -> None:
    sent = {key for key, messages in played(place).messages.items() if messages}
    assert {f"agent/{agent}/points" in sent for agent in AGENTS} == {on_wire}
    assert {f"agent/{agent}/detections" in sent for agent in AGENTS} == {place != "agent"}


def test_a_scan_has_returns_in_range_each_of_a_beam_of_its_own() -> None:
    for agent in AGENTS:
        for message in played("detector").decoded(f"agent/{agent}/points", "points"):
            points = Points.from_columns(message.body)
            assert 1000 < len(points) <= MODELS["VLP-16"].azimuths * 16
            assert len(np.unique(points.keys())) == len(points)
            assert points.range_m().max() <= 100.1
            assert np.abs(points.time_s).max() <= 0.0501


def test_the_truth_tells_how_many_points_each_object_returned() -> None:
    truth = played("detector").decoded("scene/truth", "truth")[0].body
    ego = truth["agents"].tolist().index("ego")
    assert truth["points"][truth["id"] == 0, ego].tolist() == [0], "a lidar does not meet its own car"
    assert truth["points"][truth["id"] == 1, ego].item() > 20
    assert truth["points"].sum() < len(played("detector").decoded("agent/ego/points", "points")[0].body["channel"]) * 3


@cache
def looking(place: str) -> Run:
    """The same with views of what lidars see."""

    def edit(content: dict[str, Any]) -> None:
        content["points"] = dict(detector=dict(type="Everything"), lidar="VLP-16", clutter=None, detected_by=place)
        content["keyexpr"] = dict(map="testbed.toml", rewrites=["views.toml"])

    return Run(tiny(frames=FRAMES, edit=edit))


@pytest.mark.parametrize("place", DETECTED_BY)
def test_views_show_the_free_space_of_scans_wherever_it_is_measured(place: str) -> None:
    for agent in AGENTS:
        views = [run.decoded(f"agent/{agent}/view", "view") for run in (looking(place), looking("detector"))]
        assert len(views[0]) == len(views[1]) == FRAMES
        scans = looking("detector").decoded(f"agent/{agent}/points", "points")
        for one, other, scan in zip(*views, scans, strict=True):
            np.testing.assert_array_equal(one.body["free"], other.body["free"])
            assert 0.0 < one.body["free"].max() <= Points.from_columns(scan.body).range_m().max() + 0.01
    assert not looking(place).failures


def test_late_detections_keep_the_time_of_their_scan() -> None:
    prompt, late = (played("detector", frames).decoded("agent/ego/detections", "detections") for frames in (0, 2))
    assert [message.header.frame for message in late] == list(range(FRAMES))
    assert [message.header.time_ns for message in late] == [0, 0, *(k * PERIOD_NS for k in range(FRAMES - 2))]
    assert [len(message.body["yaw"]) for message in late[:2]] == [0, 0], "nothing is known yet"
    for one, other in zip(prompt[: FRAMES - 2], late[2:], strict=True):
        np.testing.assert_array_equal(one.body["position"], other.body["position"])
    assert not played("detector", 2).rejected
    assert played("detector", 2).results["detector_ego"]["oldest_s"] == pytest.approx(0.2)


def test_late_detections_of_a_moving_agent_are_where_they_were_seen() -> None:
    """The ego drives 8 m/s: 1.6 m in two frames, by which a car that stands would seem nearer."""
    places = [tracks(played("detector", frames), "ego")[-1].body for frames in (0, 2)]
    assert len(places[0]["id"]) == len(places[1]["id"]) == 1
    apart = np.abs(places[0]["position"] - places[1]["position"])[0, :2]
    assert apart.max() < 1.2, "the box grows and wanders, as it is around all that is seen"


def test_an_adversary_sits_between_lidar_and_detector() -> None:
    def edit(content: dict[str, Any]) -> None:
        content["points"] = dict(detector=dict(type="Everything"), lidar="VLP-16")
        content["adversaries"] = dict(spoofer_1=dict(type="Adversary", agent="ego", attack=dict(type="Blinded")))
        content["keyexpr"] = dict(map="testbed.toml", rewrites=["on_points.toml"])

    run = Run(tiny(frames=FRAMES, edit=edit))
    arriving = [len(message.body["channel"]) for message in run.decoded("agent/ego/points", "points")]
    assert [count == 0 for count in arriving] == [bool(frame % 2) for frame in range(FRAMES)]
    counts = [len(message.body["yaw"]) for message in run.decoded("agent/ego/detections", "detections")]
    assert counts[1::2] == [0] * (FRAMES // 2)
    assert (
        run.messages["agent/infra_1/points"]
        == Run(resolved(clutter=dict(type="Clutter"))).messages["agent/infra_1/points"]
    )
    assert not run.failures


def test_an_attack_that_returns_equal_points_is_reported_as_no_change() -> None:
    def edit(content: dict[str, Any]) -> None:
        content["points"] = dict(detector=dict(type="Everything"), lidar="VLP-16", clutter=None)
        content["adversaries"] = dict(spoofer_1=dict(type="Adversary", agent="ego", attack=dict(type="Copied")))
        content["keyexpr"] = dict(map="testbed.toml", rewrites=["on_points.toml"])

    run = Run(tiny(frames=2, edit=edit))
    assert not run.failures
    assert not [key for key, sent in run.messages.items() if "report" in key and sent]
    assert run.messages["agent/ego/points"] == Run(resolved(frames=2)).messages["agent/ego/points"]


@pytest.mark.parametrize("place", DETECTED_BY)
def test_no_detector_can_write_into_the_points_that_it_gets(place: str) -> None:
    world = resolved(frames=1, detector=dict(type="Careless"), detected_by=place)
    if place == "simulator":
        with pytest.raises(NodeDied, match="read-only"):
            Run(world)
    else:
        failed = [failure["detect"].exception for failure in Run(world).failures.values()]
        assert len(failed) == len(AGENTS)
        assert all("read-only" in each for each in failed)


@pytest.mark.parametrize("place", ["detector", "agent"])
def test_a_detector_that_returns_rubbish_fails_loudly_and_the_run_goes_on(place: str) -> None:
    run = Run(resolved(detector=dict(type="Rubbish"), detected_by=place))
    nodes = AGENTS if place == "agent" else [f"detector_{agent}" for agent in AGENTS]
    assert {name: list(failed) for name, failed in run.failures.items()} == {name: ["detect"] for name in nodes}
    assert len(tracks(run, "ego")) == FRAMES


@pytest.mark.parametrize(
    ("wanted", "recorded"),
    [(None, {"agent/ego/points"}), (False, set()), (True, {f"agent/{a}/points" for a in AGENTS})],
)
def test_points_are_recorded_where_they_are_intercepted_or_as_asked(
    wanted: bool | None, recorded: set[str], tmp_path: Path
) -> None:
    def edit(content: dict[str, Any]) -> None:
        content["points"] = dict(detector=dict(type="Everything"), lidar="VLP-16", recorded=wanted)
        content["adversaries"] = dict(spoofer_1=dict(type="Adversary", agent="ego", attack=dict(type="Blinded")))
        content["keyexpr"] = dict(map="testbed.toml", rewrites=["on_points.toml"])

    InProcess(tiny(frames=2, record=True, edit=edit).in_folder(tmp_path)).run()
    wires = {message.wire for message in read(tmp_path / "messages.mcap") if message.message == "points"}
    assert wires == recorded


def test_agents_know_the_field_of_view_of_the_lidar_that_they_have() -> None:
    config = resolved(lidar={"infra_*": "OS1-128"}).nodes["infra_1"].config
    assert config["lidar"]["elevation_max_deg"] == pytest.approx(22.5)
    assert resolved(lidar={"infra_*": "OS1-128"}).nodes["ego"].config["lidar"]["elevation_max_deg"] == 2.4


def test_without_points_the_wires_are_as_before() -> None:
    keys = {wire.key for wire in Wiring.from_json(tiny(frames=2).wiring).wires}
    assert not any(key.endswith("points") for key in keys)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (dict(lidar="VLP-61"), r"points.*VLP-61.*did you mean 'VLP-16'"),
        (dict(lidar={"mobile_9": "VLP-16"}), r"points: lidar: no agent 'mobile_9'"),
        (dict(detected_by="broker"), r"points\.detected_by: found 'broker'"),
        (dict(detect="x"), r"points\.detect: unknown key; did you mean"),
        (dict(late_frames=-1), r"points\.late_frames: found -1, expected a whole number"),
        (dict(late_frames=1, detected_by="agent"), r"points\.late_frames: found 1, expected 0"),
        (dict(node=dict(on_exit="fail"), detected_by="agent"), r"points\.node: found"),
        (dict(recorded="yes"), r"points\.recorded: found 'yes'"),
        (dict(detector=dict(type="NoSuch")), r"NoSuch"),
        (dict(returns=dict(type="Returns", dropout=2.0)), r"dropout"),
    ],
)
def test_what_is_wrong_with_the_points_of_a_scenario_is_named(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        resolved(**options)


def test_a_sensor_that_measures_between_frames_has_no_points() -> None:
    def edit(content: dict[str, Any]) -> None:
        sensors = {"ego": [dict(type="Lidar", rate_hz=10.0, phase_s=0.03)]}
        content["scene"] = dict(type="Intersection", n_vehicles=2, n_infrastructure=1, sensors=sensors)
        content["points"] = {}

    with pytest.raises(ConfigurationError, match=r"points: ego: found the sensor 'lidar', expected first a lidar"):
        tiny(frames=2, edit=edit)

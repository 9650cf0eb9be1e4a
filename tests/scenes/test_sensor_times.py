"""Sensors of a scene measure at times of their own, and what they detect belongs to these times."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mast_zenoh as mast
from mast_zenoh.config import registry
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes import Intersection, Recording
from mast_zenoh.scenes.making.sensor_types import SensorSchedule, regular_times
from mast_zenoh.scenes.recording import NO_MEASUREMENT
from mast_zenoh.sensing import sensor_pose, to_world
from mast_zenoh.testing import check_scene

SPEED = 12.0
LATE = dict(type="Lidar", rate_hz=5.0, phase_s=0.07)
RADAR = dict(type="Radar", rate_hz=4.0)
CLEAN = dict(type="CleanDetector", min_points=1)


def road(**parameters: Any) -> Recording:
    """A connected car, one ahead of it that brakes, and a pole, detected without errors."""
    times = np.arange(12) / 10
    x = np.stack([SPEED * times, 25.0 + SPEED * times - 1.5 * times**2], axis=1)
    y = np.stack([2.0 * times**2, np.full(12, 1.0)], axis=1)  # the ego turns
    scene = dict(times_s=times, position=np.stack([x, y], axis=2), poles=[(20.0, -12.0, np.pi / 2)], detector=CLEAN)
    return mast.scene(**scene | parameters).recording


def junction(sensors: dict[str, Any], frames: int = 6) -> Recording:
    spec = dict(type="Intersection", n_infrastructure=1, n_vehicles=6, n_pedestrians=0, n_bicycles=0, sensors=sensors)
    return registry.build(spec, Intersection, "scene").record(0, frames)


@given(
    frame_ns=st.integers(1_000_000, 200_000_000),
    ratio=st.integers(1000, 7000),
    phase=st.floats(0.0, 0.999),
    frames=st.integers(1, 40),
    start_ns=st.integers(0, 10**12),
)
def test_every_measurement_is_new_in_the_one_frame_at_or_after_it(frame_ns, ratio, phase, frames, start_ns):
    period_ns = frame_ns * ratio // 1000
    times = start_ns + np.arange(frames, dtype=np.int64) * frame_ns
    schedule = SensorSchedule.regular(times, period_ns, int(phase * period_ns))
    new = np.flatnonzero(schedule.source >= 0)
    due = range(start_ns + int(phase * period_ns), int(times[-1]) + 1, period_ns)
    assert schedule.time_ns[new].tolist() == list(due)
    assert schedule.source[new].tolist() == new.tolist()
    age = times[new] - schedule.time_ns[new]
    assert ((age >= 0) & (age < frame_ns)).all()


def test_a_sensor_at_half_the_rate_of_the_frames_measures_in_every_second_one() -> None:
    frame_ns = round(1e9 / 30.0)
    times = np.arange(2000, dtype=np.int64) * frame_ns
    schedule = SensorSchedule.regular(times, *regular_times("scene", frame_ns, 15.0, 0.0))
    assert np.flatnonzero(schedule.source >= 0).tolist() == list(range(0, 2000, 2))
    assert schedule.time_ns[::2].tolist() == times[::2].tolist()


def test_of_several_recorded_measurements_before_a_frame_the_newest_is_new() -> None:
    times = np.array([100, 200, 300])
    schedule = SensorSchedule.recorded(times, np.array([90, 120, 180, 305]), np.array([0, 0, 1, 2]))
    assert schedule.source.tolist() == [-1, 1, -1]
    assert schedule.time_ns[1] == 180
    early = SensorSchedule.recorded(times, np.array([100, 190, 290]), np.array([0, 1, 2]))
    assert early.before(2).source.tolist() == [0, 1]
    ahead = SensorSchedule.recorded(times, np.array([100, 110, 195]), np.array([0, 1, 2]))
    assert ahead.source.tolist() == [0, 2, -1]
    assert ahead.before(2).source.tolist() == [0, -1], "frame 2 is not there"


@pytest.mark.parametrize(
    ("sensors", "message"),
    [
        ({"ego": [dict(LATE, rate_hz=20.0)]}, r"sensors\['ego'\]\[0\]: rate_hz.*20"),
        ({"ego": [dict(LATE, rate_hz=0.0)]}, r"rate_hz.*0.0.*number"),
        ({"ego": [dict(LATE, rate_hz=1e-300)]}, r"rate_hz.*1e-300.*1e-05"),
        ({"ego": [dict(LATE, phase_s=float("nan"))]}, r"phase_s.*nan.*less"),
        ({"ego": [dict(LATE, phase_s=-1e300)]}, r"phase_s.*-1e.300.*less"),
        ({"ego": [dict(LATE, detector=dict(type="DetectionModel", clutter_rate=float("nan")))]}, "expected 0 to 1000"),
        ({"ego": [dict(LATE, phase_s=0.2)]}, r"phase_s.*0.2.*less"),
        ({"ego": [dict(type="Lidar", phase_s=0.1)]}, r"phase_s.*0.1.*rate_hz"),
        ({"infra_9": [RADAR]}, r"agent 'infra_9'.*'infra_1'"),
        ({"ego": [RADAR, RADAR]}, r"sensors named.*different"),
        ({"ego": []}, "found no sensor"),
        ({"ego": [dict(type="Camera")]}, r"Sensor.*'Camera'.*'ObjectCamera'"),
        ({"ego": [dict(RADAR, azimuth_deg=(10.0, 5.0))]}, "azimuth_max_deg"),
        ({"ego": [dict(RADAR, range=5.0)]}, r"no.*parameter.*'range_m'"),
        ({"ego": [dict(RADAR, detection_probability=1.0)]}, r"between 0.*1"),
        ({"ego": RADAR}, "expected a list"),
    ],
)
def test_a_sensor_that_cannot_be_is_refused(sensors: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        road(sensors=sensors)


def test_detections_belong_to_the_time_of_the_measurement() -> None:
    """Also those of a car that turns: its sensor was elsewhere then."""
    recording = road(sensors={"ego": [dict(LATE, rate_hz=10.0)], "infra_1": [LATE]})
    assert recording.measurements is not None
    checked = 0
    for agent, target in ((0, 1), (1, 0), (1, 1)):
        for frame in range(len(recording)):
            age = recording.age_ns_at(frame, agent)
            ids = recording.detection_truth_id_at(frame, agent)
            if age == NO_MEASUREMENT:
                assert len(ids) == 0
            elif target in ids:
                pose = recording.agent_position[frame, agent], recording.agent_rotation[frame, agent]
                sensor = sensor_pose(*pose, *recording.mount_at(frame, agent))
                found = to_world(recording.detections_at(frame, agent), *sensor)
                seconds = recording.times_ns[frame] * 1e-9 - age * 1e-9
                x = SPEED * seconds if target == 0 else 25.0 + SPEED * seconds - 1.5 * seconds**2
                y = 2.0 * seconds**2 if target == 0 else 1.0
                np.testing.assert_allclose(found.position[ids == target, :2], [[x, y]], atol=0.01)
                checked += 1
    assert checked > 15
    ages = [[recording.age_ns_at(frame, agent) for frame in range(5)] for agent in (0, 1)]
    none, late = NO_MEASUREMENT, 30_000_000
    assert ages == [[none, late, late, late, late], [none, late, none, late, none]]


def test_the_truth_stays_at_the_times_of_the_frames() -> None:
    plain, timed = road(), road(sensors={"*": [LATE]})
    np.testing.assert_array_equal(timed.truth.position, plain.truth.position)
    np.testing.assert_array_equal(timed.points, plain.points)
    np.testing.assert_array_equal(timed.agent_position, plain.agent_position)


def test_a_further_sensor_changes_neither_the_first_nor_other_agents() -> None:
    one, two = junction({"infra_1": [LATE]}), junction({"infra_1": [LATE, RADAR]})
    seen = 0
    for frame in range(len(one)):
        for agent in range(2):
            ours, theirs = one.detections_at(frame, agent), two.detections_at(frame, agent)
            np.testing.assert_array_equal(ours.position, theirs.position)
        seen += len(two.detections_at(frame, 1, 1))
    assert seen > 0
    assert [sensor.name for sensor in two.agents[1].sensors] == ["lidar", "radar"]
    assert (two.points >= one.points).all()


def test_an_agents_lidar_by_name_is_the_one_it_has_anyway() -> None:
    plain, named = junction({}), junction({"*": [dict(type="Lidar", rate_hz=10.0)]})
    assert named.measurements is None
    for name, column in plain.detections.columns().items():
        np.testing.assert_array_equal(getattr(named.detections, name), column)


def test_a_scene_with_sensors_fulfils_the_contract_of_scenes() -> None:
    spec = dict(type="Intersection", n_vehicles=4, n_pedestrians=0, sensors={"*": [LATE, RADAR]})
    check_scene(registry.build(spec, Intersection, "scene"))


def test_sensors_and_their_times_survive_a_file(tmp_path: Path) -> None:
    recording = road(sensors={"ego": [dict(LATE, rate_hz=10.0)], "infra_1": [LATE, RADAR]})
    recording.save(tmp_path / "scene.npz")
    loaded = Recording.load(tmp_path / "scene.npz")
    assert loaded.measurements is not None
    assert recording.measurements is not None
    for name, values in recording.measurements.arrays().items():
        np.testing.assert_array_equal(loaded.measurements.arrays()[name], values)
    radar = loaded.agents[1].sensors[1]
    assert (radar.name, radar.kind, radar.detection_probability, radar.lidar.max_range_m) == (
        "radar",
        "radar",
        0.7,
        120.0,
    )
    part = mast.scene(f"recording:{tmp_path / 'scene.npz'}", frames=5, n_infrastructure=0).recording
    assert part.measurements is not None
    assert part.measurements.age_ns.shape == (5, 1)
    np.testing.assert_array_equal(part.detections_at(4, 0).position, recording.detections_at(4, 0).position)
    assert "infra_1/radar 4" in mast.scene(tmp_path / "scene.npz").description


@pytest.mark.parametrize(
    ("frame", "age_ns", "message"),
    [
        (3, 100_000_000, r"ego/lidar.*3.*100000000"),
        (3, -2, "found -2 ns"),
        (0, 1, r"frame 0.*1"),
    ],
)
def test_a_measurement_that_is_not_new_in_its_frame_is_refused(frame: int, age_ns: int, message: str) -> None:
    recording = road(sensors={"ego": [dict(LATE, rate_hz=10.0)]})
    assert recording.measurements is not None
    age = recording.measurements.age_ns.copy()
    age[frame, 0] = age_ns
    with pytest.raises(SceneError, match=message):
        replace(recording, measurements=replace(recording.measurements, age_ns=age)).validate()


def test_arrays_of_measurements_must_fit_the_sensors(tmp_path: Path) -> None:
    road(sensors={"infra_1": [LATE, RADAR]}).save(tmp_path / "scene.npz")
    with np.load(tmp_path / "scene.npz") as file:
        arrays = dict(file)
    damages = {
        "measurements.age_ns": arrays["measurements.age_ns"][:, :2],
        "measurements.position": arrays["measurements.position"] * np.nan,
        "measurements.rotation": np.zeros((2, 2)),
        "detection_start": arrays["detection_start"][:-1],
    }
    for name, damaged in damages.items():
        np.savez(tmp_path / "damaged.npz", **arrays | {name: damaged})
        with pytest.raises(SceneError, match=name.replace(".", r"\.")):
            Recording.load(tmp_path / "damaged.npz")

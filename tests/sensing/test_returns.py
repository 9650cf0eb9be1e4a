"""Returns: what a lidar reports of surfaces, by their range and light, in noise, rain and dust."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mast_zenoh import kernels
from mast_zenoh.arrays.states import CLASS_INDEX, CLASSES, Floats, Ints
from mast_zenoh.sensing import LidarSensor, returns, scan
from mast_zenoh.sensing.beams import MODELS, Beams, LidarModel
from mast_zenoh.sensing.points import Points
from mast_zenoh.sensing.raycast import Walls
from mast_zenoh.sensing.returns import DUST, RAIN, REFLECTIVITY, Returns
from mast_zenoh.sensing.shapes import Parts

LEVEL = np.eye(3)
#: Without anything random.
EXACT = Returns(range_std_m=0.0, fading=0.0, dark_range_m=1e4)
BEAMS = MODELS["VLP-16"].beams()


def lidar(speed: float = 0.0, turn: float = 0.0, height: float = 2.0) -> scan.Moving:
    return scan.Moving(np.array([[0.0, 0.0, height]]), np.array([[speed, 0.0, 0.0]]), np.zeros(1), np.array([turn]))


def boxes(*places: tuple[float, float], size: tuple[float, float, float] = (2.0, 4.0, 4.0)) -> scan.Moving:
    position = np.array([(x, y, size[2] / 2) for x, y in places]).reshape(-1, 3)
    return scan.Moving(position, np.zeros_like(position), np.zeros(len(places)), np.zeros(len(places)))


def measured(
    model: Returns,
    objects: scan.Moving,
    size: tuple[float, float, float] = (2.0, 4.0, 4.0),
    *,
    seed: int = 0,
    beams: Beams = BEAMS,
    by: scan.Moving | None = None,
    reflectivity: float = 0.3,
) -> tuple[Points, Ints, scan.Scan]:
    by = lidar() if by is None else by
    found = scan.cast(beams, by, LEVEL, objects, Parts.boxes(np.tile(size, (len(objects.yaw), 1))))
    shades = np.full(len(objects.yaw), reflectivity)
    return *model.measure(found, beams, by, LEVEL, shades, np.random.default_rng(seed)), found


def test_without_noise_points_are_where_beams_meet_surfaces() -> None:
    points, source, found = measured(EXACT, boxes((20.0, 3.0), (-15.0, 8.0)))
    met = np.isfinite(found.range_m) & (found.range_m >= BEAMS.min_range_m)
    expected = (BEAMS.directions() * np.where(met, found.range_m, 0.0)[..., None])[met]
    assert np.allclose(points.position, expected, atol=2e-5)
    assert np.array_equal(source, found.source[met])
    firing, channel = np.nonzero(met)
    assert np.array_equal(points.channel, channel)
    assert np.allclose(points.time_s, BEAMS.time_s[firing])
    assert points.position.dtype == points.intensity.dtype == points.time_s.dtype == np.float32


@settings(max_examples=20, deadline=None)
@given(speed=st.floats(-30.0, 30.0), turn=st.floats(-1.0, 1.0))
def test_the_motion_of_the_lidar_is_removed(speed: float, turn: float) -> None:
    """A wall and the ground stay flat, and where they are at the time of the scan."""
    by = lidar(speed, turn)
    points, source, _ = measured(EXACT, boxes((40.0, 0.0), size=(2.0, 200.0, 30.0)), (2.0, 200.0, 30.0), by=by)
    assert np.allclose(points.position[source == scan.GROUND, 2], -2.0, atol=1e-4)
    front = points.position[(source == 0) & (points.position[:, 0] < 39.9)]
    assert len(front)
    assert np.allclose(front[:, 0], 39.0, atol=1e-4)


def test_ranges_have_the_noise_that_is_asked_for() -> None:
    noisy = replace(EXACT, range_std_m=0.02)
    (points, *_), (exact, *_) = (measured(model, boxes((20.0, 3.0))) for model in (noisy, EXACT))
    error = points.range_m() - exact.range_m()
    assert np.std(error) == pytest.approx(0.02, rel=0.03)
    assert abs(np.mean(error)) < 0.001


def test_a_dark_surface_is_found_half_of_the_time_at_its_limit() -> None:
    model = Returns(dark_range_m=30.0, roughness_rad=0.0)
    beams = LidarModel((0.0,), 100_000, (0.5, 100.0), "test", sector_deg=1.0).beams()
    for distance, share in ((30.0, 0.5), (15.0, 1.0), (60.0, 0.0)):
        wall = boxes((distance + 1.0, 0.0), size=(2.0, 10.0, 8.0))
        _, source, found = measured(model, wall, (2.0, 10.0, 8.0), beams=beams, reflectivity=0.1)
        assert (source == 0).sum() / (found.source == 0).sum() == pytest.approx(share, abs=0.02)


def test_far_dark_and_grazing_surfaces_are_lost_first() -> None:
    def share(distance: float = 30.0, reflectivity: float = 0.1, yaw: float = 0.0) -> float:
        wall = replace(boxes((distance, 0.0), size=(0.2, 6.0, 8.0)), yaw=np.array([yaw]))
        model = Returns(dark_range_m=30.0)
        _, source, found = measured(model, wall, (0.2, 6.0, 8.0), reflectivity=reflectivity)
        return float((source == 0).sum() / (found.source == 0).sum())

    assert share() > share(distance=40.0) + 0.1
    assert share() > share(reflectivity=0.05) + 0.1
    assert share() > share(yaw=1.2) + 0.1


def test_dropout_loses_its_share_of_all_returns() -> None:
    near = boxes((8.0, 0.0))
    lost, kept = (len(measured(replace(EXACT, dropout=each), near)[0]) for each in (0.2, 0.0))
    assert lost / kept == pytest.approx(0.8, abs=0.01)


def test_returns_beyond_the_limits_of_the_model_are_not_reported() -> None:
    beams = replace(BEAMS, min_range_m=5.0, max_range_m=25.0)
    points, source, _ = measured(EXACT, boxes((3.0, 0.0), (27.0, 8.0), (-15.0, -8.0)), beams=beams)
    assert set(source.tolist()) == {scan.GROUND, 2}
    assert 5.0 <= points.range_m().min() <= points.range_m().max() <= 25.0


def test_intensity_is_the_reflectivity_of_what_faces_the_lidar() -> None:
    model = replace(EXACT, roughness_rad=0.0)
    points, source, _ = measured(model, boxes((20.0, 0.0), size=(2.0, 1.0, 8.0)), (2.0, 1.0, 8.0), reflectivity=0.6)
    on_it = points.intensity[source == 0]
    assert on_it.max() == pytest.approx(0.6, abs=0.01)
    assert points.intensity.min() > 0.0


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 1 << 20),
    model=st.sampled_from([Returns(), Returns(rain_mm_h=20.0), Returns(visibility_m=60.0, returns="last")]),
)
def test_equal_seeds_give_equal_points_and_an_object_more_changes_only_its_beams(seed: int, model: Returns) -> None:
    draw = np.random.default_rng(seed)
    places = [tuple(each) for each in draw.uniform(8.0, 40.0, (4, 2))]
    (one, source, _), (again, *_), (more, other_source, other) = (
        measured(model, boxes(*some), seed=seed) for some in (places[:3], places[:3], places)
    )
    for name, column in one.columns().items():
        assert np.array_equal(column, getattr(again, name))
    new = other.source == 3
    if model.returns == "last":  # a footprint may reach over its edges
        new = new | np.roll(new, 1, axis=0) | np.roll(new, -1, axis=0)
    time = BEAMS.time_s.astype(np.float32)
    changed = {(float(time[azimuth]), int(channel)) for azimuth, channel in zip(*np.nonzero(new), strict=True)}

    def elsewhere(points: Points, of: Ints) -> set[tuple[object, ...]]:
        rows = zip(points.time_s, points.channel, points.position, points.intensity, of, strict=True)
        return {
            (float(t), int(c), p.tobytes(), float(i), int(s))
            for t, c, p, i, s in rows
            if (float(t), int(c)) not in changed
        }

    assert elsewhere(one, source) == elsewhere(more, other_source)


def test_rain_returns_light_near_the_lidar_and_weakens_what_is_far() -> None:
    far = boxes((30.0, 0.0), (45.0, 10.0))
    counts = []
    for rate in (0.0, 5.0, 50.0):
        points, source, _ = measured(Returns(rain_mm_h=rate), far)
        drops = points.range_m()[source == RAIN]
        counts.append((len(drops), (source >= 0).sum()))
        assert (drops < 12.0).all()
    assert counts[0][0] == 0 < counts[1][0] < counts[2][0] < 0.2 * BEAMS.azimuth.size * 16
    assert counts[0][1] >= counts[1][1] > counts[2][1]


def test_extinction_by_rain_is_that_of_twice_the_area_of_its_drops() -> None:
    diameter_mm = np.linspace(0.0, 30.0, 300_001)
    drops = 8000.0 * np.exp(-4.1 * 10.0**-0.21 * diameter_mm) * (diameter_mm[1] - diameter_mm[0])
    area = np.sum(drops * np.pi / 4 * (diameter_mm * 1e-3) ** 2)
    assert Returns(rain_mm_h=10.0)._extinction == pytest.approx(2.0 * area, rel=1e-4)


def test_dust_hides_what_is_behind_it_unless_the_last_return_is_asked_for() -> None:
    strongest, last = (
        measured(Returns(visibility_m=40.0, returns=which), boxes((15.0, 0.0)))[1] for which in ("strongest", "last")
    )
    assert (strongest == DUST).sum() > (last == DUST).sum() > 0
    assert (strongest == 0).sum() < (last == 0).sum()


def test_the_last_return_of_a_beam_at_an_edge_is_behind_it() -> None:
    """Of a pole before a wall: some beams on it report the wall."""
    places = boxes((10.0, 0.0), (31.0, 0.0))
    parts = Parts.boxes(np.array([(0.3, 0.3, 6.0), (2.0, 40.0, 20.0)]))
    found = scan.cast(BEAMS, lidar(), LEVEL, places, parts)
    shades = np.array([0.5, 0.5])
    on_pole = []
    for which in ("strongest", "last"):
        model = replace(EXACT, returns=which)
        points, source = model.measure(found, BEAMS, lidar(), LEVEL, shades, np.random.default_rng(0))
        on_pole.append((source == 0).sum())
        assert len(points) == (found.source != scan.NOTHING).sum()
        wall = points.range_m()[source == 1]
        assert wall.min() > 29.0
    assert on_pole[1] < on_pole[0]


def test_a_scan_of_nothing_has_no_points() -> None:
    sky = LidarModel((10.0, 20.0), 100, (0.5, 50.0), "test").beams()
    points, source, _ = measured(Returns(), boxes(), beams=sky)
    assert len(points) == len(source) == 0
    assert points.position.shape == (0, 3)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"range_std_m": -1.0}, "range_std_m: found -1.0"),
        ({"dark_range_m": 0.0}, "dark_range_m: found 0.0"),
        ({"dropout": 2.0}, "dropout: found 2.0"),
        ({"returns": "first"}, "returns: found 'first'"),
        ({"rain_mm_h": float("nan")}, "rain_mm_h: found nan"),
        ({"rain_mm_h": 5.0, "visibility_m": 50.0}, "visibility_m: found 50.0 with rain_mm_h"),
    ],
)
def test_wrong_parameters_are_refused(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Returns(**wrong)  # type: ignore[arg-type]


def test_more_channels_than_a_point_can_say_are_refused() -> None:
    beams = Beams.of_sensor(LidarSensor(channels=300, azimuth_step_deg=10.0))
    with pytest.raises(ValueError, match="channels: found 300"):
        measured(Returns(), boxes(), beams=beams)


def test_every_class_has_a_reflectivity() -> None:
    assert len(REFLECTIVITY) == len(CLASSES)
    assert REFLECTIVITY[CLASS_INDEX["car"]] == 0.3


def test_the_beams_of_a_sensor_are_its_own() -> None:
    sensor = LidarSensor.infrastructure()
    beams = Beams.of_sensor(sensor, 0.1)
    assert np.array_equal(beams.azimuth, sensor.azimuths)
    assert np.array_equal(beams.elevation, sensor.elevations)
    assert beams.max_range_m == sensor.max_range_m
    assert beams.time_s == pytest.approx(sensor.azimuths / (2 * np.pi) * 0.1)
    assert (Beams.of_sensor(sensor, 0.0).time_s == 0.0).all()


@pytest.mark.parametrize("name", sorted(MODELS))
def test_a_model_on_a_mount_has_the_limits_of_its_beams(name: str) -> None:
    mount = np.array([0.5, 0.0, 2.0])
    sensor, beams = MODELS[name].sensor(mount, LEVEL), MODELS[name].beams()
    assert np.array_equal(sensor.mount_position, mount)
    assert sensor.azimuths == pytest.approx(beams.azimuth)
    assert (sensor.elevations[0], sensor.elevations[-1]) == pytest.approx((beams.elevation[0], beams.elevation[-1]))
    assert (len(sensor.elevations), sensor.max_range_m) == (len(beams.elevation), beams.max_range_m)


@pytest.mark.skipif(kernels.USED != "compiled", reason="kernels are not compiled")
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 1 << 20), rain=st.sampled_from([0.0, 25.0]))
def test_compiled_and_numpy_points_are_the_same_bit_for_bit(seed: int, rain: float) -> None:
    model, some = Returns(rain_mm_h=rain), boxes((20.0, 3.0), (-15.0, 8.0))
    points, source, _ = measured(model, some, seed=seed)
    with pytest.MonkeyPatch.context() as patch:
        for name in ("surface_echoes", "measured_points"):
            patch.setattr(returns, name, kernels.REFERENCES[name])
        reference, of, _ = measured(model, some, seed=seed)
    assert np.array_equal(source, of)
    for name, column in points.columns().items():
        assert np.array_equal(column, getattr(reference, name))


def test_walls_are_reported_as_walls() -> None:
    walls = Walls(np.array([[10.0, -5.0]]), np.array([[10.0, 5.0]]), np.array([5.0]))
    none: Floats = np.zeros((0, 3))
    nothing = scan.Moving(none, none, np.zeros(0), np.zeros(0))
    found = scan.cast(BEAMS, lidar(), LEVEL, nothing, Parts.boxes(none), walls=walls)
    points, source = Returns().measure(found, BEAMS, lidar(), LEVEL, np.zeros(0), np.random.default_rng(0))
    assert np.allclose(points.position[source == scan.WALL, 0], 10.0, atol=0.15)
    assert (source == scan.WALL).sum() > 100

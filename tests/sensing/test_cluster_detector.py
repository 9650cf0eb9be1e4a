"""The detector by clusters finds road users in scans, and nothing that is none; no points can break it."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mast_zenoh.arrays.geometry import quaternion_from_rotation, rotation_from_yaw_pitch
from mast_zenoh.arrays.states import CLASS_INDEX, CLASSES, Detections, Floats
from mast_zenoh.sensing import ClusterDetector, NoDetections, Walls, scan
from mast_zenoh.sensing.beams import MODELS
from mast_zenoh.sensing.point_detector import detected, problem_of
from mast_zenoh.sensing.points import Points
from mast_zenoh.sensing.shapes import Parts

#: m, length width height, by class.
SIZES = {
    "car": (4.5, 1.8, 1.5),
    "truck": (8.0, 2.4, 3.0),
    "bus": (11.5, 2.5, 3.1),
    "bicycle": (1.8, 0.65, 1.75),
    "pedestrian": (0.6, 0.6, 1.75),
}
LEVEL = np.eye(3)
Thing = tuple[str, float, float, float]


def scanned(
    *things: Thing,
    height: float = 1.8,
    model: str = "OS1-128",
    mount: Floats = LEVEL,
    walls: Walls | None = None,
    slope: float = 0.0,
) -> Points:
    """The points of (class, x, y, yaw) on a plane that rises along x, in the frame of a lidar at this height."""
    size = np.array([SIZES[name] for name, *_ in things]).reshape(-1, 3)
    plan = np.array([(x, y) for _, x, y, _ in things]).reshape(-1, 2)
    n, still = len(things), np.zeros((len(things), 3))
    objects = scan.Moving(
        np.column_stack([plan, size[:, 2] / 2]), still, np.array([yaw for *_, yaw in things]), np.zeros(n)
    )
    lidar = scan.Moving(np.array([[0.0, 0.0, height]]), np.zeros((1, 3)), np.zeros(1), np.zeros(1))
    parts = Parts.of(np.array([CLASS_INDEX[name] for name, *_ in things], np.int64), size)
    beams = MODELS[model].beams()
    cast = scan.cast(beams, lidar, mount, objects, parts, 0.0, walls)
    range_m = cast.range_m + np.random.default_rng(1).normal(0.0, 0.02, cast.range_m.shape)
    met = np.isfinite(range_m)
    position = beams.directions()[met] * range_m[met][:, None]
    position[:, 2] += slope * position[:, 0]
    return Points.of(position)


def names(detections: Detections) -> list[str]:
    return sorted(CLASSES[which] for which in detections.class_id)


def nearest(detections: Detections, x: float, y: float) -> tuple[int, float]:
    gap = np.hypot(detections.position[:, 0] - x, detections.position[:, 1] - y)
    return int(gap.argmin()), float(gap.min())


@pytest.mark.parametrize("yaw", [0.0, 0.5, 1.2, -0.8, np.pi / 2])
@pytest.mark.parametrize(("height", "model"), [(1.8, "OS1-128"), (1.8, "VLP-32C"), (5.0, "OS1-128")])
def test_car_at_20_m_is_found_where_it_is(yaw: float, height: float, model: str) -> None:
    detections = ClusterDetector().detect(scanned(("car", 20.0, 3.0, yaw), height=height, model=model))
    assert names(detections) == ["car"]
    assert nearest(detections, 20.0, 3.0)[1] < 0.35
    assert abs(detections.position[0, 2] + height - 0.75) < 0.15
    assert abs((detections.yaw[0] - yaw + np.pi / 2) % np.pi - np.pi / 2) < np.radians(5.0)
    assert np.allclose(detections.size[0], SIZES["car"], atol=(0.5, 0.25, 0.2))


@pytest.mark.parametrize("name", SIZES)
def test_class_follows_from_size_and_height(name: str) -> None:
    assert names(ClusterDetector().detect(scanned((name, 16.0, 4.0, 1.0)))) == [name]


def test_middle_of_a_car_seen_from_behind_is_not_drawn_towards_the_lidar() -> None:
    detections = ClusterDetector().detect(scanned(("car", 30.0, 0.0, 0.0), model="VLP-16"))
    assert abs(detections.position[0, 0] - 30.0) < 0.5
    assert detections.covariance[0, 0, 0] > 2.0 * detections.covariance[0, 1, 1]


def test_two_cars_that_are_one_and_a_half_metres_apart_are_two() -> None:
    points = scanned(("car", 15.0, 5.0, 0.0), ("car", 15.0, 8.3, 0.0), ("car", 21.0, 5.0, 0.0))
    assert names(ClusterDetector().detect(points)) == ["car"] * 3


def test_wall_is_no_object() -> None:
    outline = np.array([(12.0, -9.0), (20.0, -9.0), (20.0, 6.0), (12.0, 6.0)])
    walls = Walls.of_buildings((outline,), np.array([6.0]))
    assert len(ClusterDetector().detect(scanned(walls=walls))) == 0
    hedge = Walls.of_buildings((outline,), np.array([1.3]))
    assert len(ClusterDetector().detect(scanned(walls=hedge))) == 0


def test_bridge_over_a_car_is_left_out() -> None:
    bridge = np.column_stack([*(each.ravel() for each in np.mgrid[15:25:0.2, -8:8:0.2]), np.full(4000, 3.4)])
    points = Points.joined([scanned(("car", 20.0, 0.0, 0.0)), Points.of(bridge)])
    assert names(ClusterDetector().detect(points)) == ["car"]


@pytest.mark.parametrize("slope", [-0.05, 0.05])
@pytest.mark.parametrize("model", ["VLP-16", "OS1-128"])
def test_slope_is_ground(slope: float, model: str) -> None:
    detections = ClusterDetector().detect(scanned(("car", 25.0, 2.0, 0.3), slope=slope, model=model))
    assert names(detections) == ["car"]
    assert nearest(detections, 25.0, 2.0)[1] < 0.4


@pytest.mark.parametrize("slope", [-0.05, 0.0, 0.05])
def test_returns_from_below_the_road_are_none_of_it(slope: float) -> None:
    """As real scans have them, by way of glass and wet surfaces: deep ones, and some beside each other."""
    points = scanned(("car", 25.0, 2.0, 0.3), ("pedestrian", 9.0, -2.0, 0.0), slope=slope)
    random = np.random.default_rng(2)
    middles = np.array([(24.0, 0.0), (10.0, -3.0), (8.0, 4.0), (30.0, 9.0), (-12.0, 3.0), (40.0, 20.0)])
    plan = np.repeat(middles, 8, axis=0) + random.uniform(-2.0, 2.0, (48, 2))
    below = -1.8 + slope * plan[:, 0] - random.choice([0.4, 0.9, 2.5, 7.0], 48)
    detections = ClusterDetector().detect(Points.joined([points, Points.of(np.column_stack([plan, below]))]))
    assert names(detections) == ["car", "pedestrian"]
    assert nearest(detections, 25.0, 2.0)[1] < 0.4


def test_lidar_on_a_pole_that_looks_down_works_in_its_own_frame() -> None:
    mount = rotation_from_yaw_pitch(0.0, np.radians(30.0))
    points = scanned(("car", 20.0, 3.0, 0.5), ("pedestrian", 14.0, -3.0, 0.0), height=12.0, mount=mount)
    pose = {"level_rotation": quaternion_from_rotation(mount), "mount_position": np.zeros(3), "mount_rotation": LEVEL}
    detections = Detections.from_columns(detected(ClusterDetector(), points.columns() | pose))
    assert names(detections) == ["car", "pedestrian"]
    place = detections.position @ mount.T
    assert np.hypot(*(place[list(detections.class_id).index(CLASS_INDEX["car"]), :2] - (20.0, 3.0))) < 0.3


def test_order_of_points_makes_no_difference() -> None:
    points = scanned(("car", 12.0, 3.0, 0.3), ("truck", 25.0, -6.0, 1.0), ("pedestrian", 9.0, -2.0, 0.0))
    mixed = points.select(np.random.default_rng(0).permutation(len(points)))
    first, second = (ClusterDetector().detect(each).columns() for each in (points, mixed))
    assert len(first["yaw"]) == 3
    for name, column in first.items():
        np.testing.assert_array_equal(column, second[name])


@pytest.mark.parametrize(
    "position",
    [
        np.zeros((0, 3)),
        np.ones((1, 3)),
        np.ones((1000, 3)),
        np.full((50, 3), np.nan),
        np.array([(np.inf, 0, 0), (0, -np.inf, 0), (3e38, 3e38, -3e38), (1e9, 0, -1)]),
        np.random.default_rng(0).uniform(0.0, 0.3, (100_000, 3)) + np.array([5.0, 5.0, -1.0]),
        np.random.default_rng(0).normal(0.0, 1e5, (1000, 3)),
    ],
)
def test_no_points_break_it(position: Floats) -> None:
    for detector in (ClusterDetector(), ClusterDetector(min_points=1), NoDetections()):
        detections = detector.detect(Points.of(position.astype(np.float32)))
        assert not problem_of(detections)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.3, 3.0, 30.0]), st.integers(0, 400))
def test_random_clouds_give_valid_detections(seed: int, spread: float, count: int) -> None:
    draw = np.random.default_rng(seed)
    middles = draw.uniform(-40.0, 40.0, (8, 3)) * (1.0, 1.0, 0.05)
    cloud = middles[draw.integers(0, 8, count)] + draw.normal(0.0, spread, (count, 3)) * (1.0, 1.0, 0.2)
    cloud[draw.random(count) < 0.05] = np.nan
    detections = ClusterDetector(min_points=1).detect(Points.of(cloud))
    assert not problem_of(detections)
    assert (np.linalg.eigvalsh(detections.covariance) > 0.0).all()


def test_of_very_many_clusters_those_with_the_most_points_are_used() -> None:
    draw, height = np.random.default_rng(1), np.linspace(-1.8, -0.1, 18)
    spots = np.stack(np.meshgrid(np.arange(-26.0, 26.0, 1.3), np.arange(-26.0, 26.0, 1.3)), axis=-1).reshape(-1, 2)
    persons = [
        np.column_stack([spot + draw.uniform(-0.2, 0.2, (3 * 18, 2)), np.tile(height, 3)])
        for spot in spots[np.hypot(*spots.T) > 4.0]
    ]
    assert len(persons) > 1500
    dense = [np.concatenate([person, person + 0.01]) for person in persons[::30]]
    points = Points.of(np.concatenate([*persons, *dense]))
    detections = ClusterDetector().detect(points)
    assert 0 < len(detections) <= 1000
    alone = ClusterDetector().detect(Points.of(np.concatenate([*persons[::30], *dense])))
    assert len(alone) == len(dense)
    assert all(nearest(detections, *place)[1] < 0.05 for place in alone.position[:, :2])


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("position", 1e300, r"position has the number 1e\+300, expected at most 1e\+08"),
        ("position", -1e9, "position has the number -1e"),
        ("size", 1001.0, "size has the number 1001, expected at most 1000"),
        ("yaw", 1e9, "yaw has the number 1e"),
        ("covariance", -0.1, "covariance with the variance -0.1 m², expected 0 or more"),
        ("covariance", 1e12, "covariance has the number 1e"),
    ],
)
def test_detections_that_no_message_can_hold_are_named(column: str, value: float, message: str) -> None:
    detections = ClusterDetector().detect(scanned(("car", 12.0, 3.0, 0.3)))
    assert not problem_of(detections)
    getattr(detections, column)[:] = value
    assert re.match(message, problem_of(detections))


def test_points_that_are_not_numbers_are_left_out() -> None:
    points = scanned(("car", 12.0, 3.0, 0.3))
    bad = Points.of(np.full((100, 3), np.nan))
    first, second = (ClusterDetector().detect(each) for each in (points, Points.joined([bad, points, bad])))
    np.testing.assert_array_equal(first.position, second.position)


@pytest.mark.parametrize("settings_", [{"reach_m": 0.0}, {"cell_m": np.nan}, {"min_points": 0}, {"slope": 2.0}])
def test_parameters_are_checked(settings_: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(settings_))}: found"):
        ClusterDetector(**settings_)  # type: ignore[arg-type]

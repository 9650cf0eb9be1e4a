"""`Cad`: boxes in free space are spoofed, and occupied space under no box is a removal."""

import tracemalloc
from dataclasses import replace
from math import cos, hypot, inf, pi, sin

import numpy as np
import plain_boxes as plain
import pytest
import shapely
from hypothesis import assume, given
from hypothesis import strategies as st
from integrity_batches import Track, batch, view
from scipy.spatial import ConvexHull

from mast_zenoh.integrity import Batch, Cad, SweptView, cad
from mast_zenoh.integrity.base import ClusterBoxes
from mast_zenoh.integrity.cad import (
    MAX_RETURNS,
    SAMPLES,
    OccupiedArea,
    areas_of,
    diameter,
    free_m2,
    hull,
    occupied_areas,
    polygon_area,
    returns,
    uncovered_m2,
)
from mast_zenoh.tracking.view import SensorView

AGENTS = ("a", "b", "c")


def cell(sensor: SweptView, x: float, y: float, z: float) -> tuple[float, float]:
    """m from a sensor to a point, and the free distance in its direction; -inf outside the field of view."""
    v = sensor.view
    local = v.rotation.T @ (np.array([x, y, z]) - v.position)
    distance = float(np.linalg.norm(local))
    azimuth = float(np.arctan2(local[1], local[0]))
    elevation = float(np.arcsin(local[2] / distance))
    turned = (azimuth - v.azimuth_min) % (2.0 * pi)
    outside = not v.elevation_min <= elevation <= v.elevation_max or turned > v.azimuth_max - v.azimuth_min
    if outside or distance > v.max_range:
        return distance, -inf
    bands, sectors = sensor.free.shape
    band = int((elevation - v.elevation_min) / (v.elevation_max - v.elevation_min) * bands)
    sector = int(turned / (v.azimuth_max - v.azimuth_min) * sectors)
    return distance, float(sensor.free[min(band, bands - 1), min(sector, sectors - 1)])


def samples(box: plain.Box) -> list[tuple[float, float, float]]:
    """The centres of SAMPLES by SAMPLES equal parts of a box, at half its height."""
    x, y, z, length, width, _, yaw = box
    steps = [(k + 0.5) / SAMPLES - 0.5 for k in range(SAMPLES)]
    return [
        (x + a * length * cos(yaw) - b * width * sin(yaw), y + a * length * sin(yaw) + b * width * cos(yaw), z)
        for a in steps
        for b in steps
    ]


def is_free(sensor: SweptView | None, point: tuple[float, float, float], range_m: float) -> bool:
    """Whether a point is in the free space of a sensor."""
    if sensor is None:
        return False
    away = hypot(point[0] - sensor.view.position[0], point[1] - sensor.view.position[1])
    distance, free = cell(sensor, *point)
    return free > distance and 4.0 < away <= range_m


@given(
    number=st.integers(0, 10_000),
    agents=st.integers(1, 4),
    objects=st.integers(0, 5),
    range_m=st.sampled_from([20.0, 50.0]),
)
def test_the_spoofed_area_is_the_part_of_the_box_that_anybody_sees_free(number, agents, objects, range_m):
    each = plain.random_batch(number, agents, objects)
    found = free_m2(each, ClusterBoxes.of(each), range_m)
    for cluster in range(each.clusters):
        box = plain.median_box(each, cluster, range(agents))
        assert box is not None
        seen = [[is_free(sensor, point, range_m) for point in samples(box)] for sensor in each.views]
        areas = [sum(of) / SAMPLES**2 * box[3] * box[4] for of in seen]
        merged = sum(map(any, zip(*seen, strict=True))) / SAMPLES**2 * box[3] * box[4]
        # A point on the border of two directions may be in either of them.
        assert found[cluster] == pytest.approx([*areas, merged], abs=2.5 / SAMPLES**2 * box[3] * box[4])


points = st.lists(st.tuples(st.integers(-60, 60), st.integers(-60, 60)), max_size=40).map(
    lambda places: np.array(places, np.float64).reshape(-1, 2) / 10.0
)


@given(places=points)
def test_the_hull_has_the_area_of_another_hull_algorithm(places: np.ndarray) -> None:
    corners = hull(places)
    assert len(np.unique(places, axis=0)) >= len(corners)
    if len(corners) < 3:
        return
    assert polygon_area(corners) == pytest.approx(shapely.convex_hull(shapely.multipoints(places)).area)


@given(places=points, link_m=st.sampled_from([0.5, 1.0, 2.0]), seed=st.integers(0, 99))
def test_occupied_areas_are_the_hulls_of_linked_returns_within_the_limits(places, link_m, seed):
    group = list(range(len(places)))
    for _ in places:  # the least number of all linked ones spreads one step at least in each round
        for i, p in enumerate(places):
            for j, q in enumerate(places):
                if hypot(*(p - q)) <= link_m:
                    group[i] = group[j] = min(group[i], group[j])
    agent = np.random.default_rng(seed).integers(0, 3, len(places))
    expected = []
    for number in sorted(set(group)):
        rows = [row for row, of in enumerate(group) if of == number]
        across = max(hypot(*(places[i] - places[j])) for i in rows for j in rows)
        unique = np.unique(places[rows], axis=0)
        if len(unique) < 3 or np.linalg.matrix_rank(unique - unique[0]) < 2:
            continue
        size = ConvexHull(unique).volume
        assume(min(abs(size - 0.5), abs(size - 20.0)) > 1e-9)  # on a limit, rounding decides
        if across <= 8.0 and 0.5 <= size <= 20.0:
            expected.append((size, sorted({int(agent[row]) for row in rows})))
    found = [(a.area_m2, a.agents.tolist()) for a in occupied_areas(places, agent, link_m)]
    assert sorted(found) == [(pytest.approx(size), agents) for size, agents in sorted(expected)]


@pytest.mark.parametrize(("side_m", "vehicles"), [(0.6, 0), (0.8, 1), (4.0, 1), (4.6, 0), (7.0, 0)])
def test_only_areas_of_the_size_of_vehicles_count(side_m: float, vehicles: int) -> None:
    steps = np.linspace(0.0, side_m, 8)
    square = np.array([(x, y) for x in steps for y in steps])
    assert len(occupied_areas(square, np.zeros(64, np.int64), 1.1)) == vehicles
    line = np.column_stack([steps, np.zeros(8)])
    assert occupied_areas(line, np.zeros(8, np.int64), 1.1) == []


@given(boxes=st.lists(plain.boxes, max_size=4), seed=st.integers(0, 9999))
def test_the_removed_area_is_the_part_under_no_box(boxes: list[plain.Box], seed: int) -> None:
    corners = hull(np.random.default_rng(seed).uniform(-3.0, 3.0, (8, 2)))
    occupied = OccupiedArea(corners, polygon_area(corners), np.zeros(1, np.int64))
    found = uncovered_m2(occupied, plain.boxes_of(boxes))
    # Exactly: inclusion and exclusion of the parts of the polygon under the boxes, which are convex.
    covered = 0.0
    for chosen in range(1, 2 ** len(boxes)):
        part = [(float(x), float(y)) for x, y in corners]
        members = [box for k, box in enumerate(boxes) if chosen >> k & 1]
        for box in members:
            part = plain.clipped(part, plain.outline(box)) if part else []
        covered += (1 if len(members) % 2 else -1) * (plain.area(part) if part else 0.0)
    perimeter = sum(hypot(*(a - b)) for a, b in zip(corners, np.roll(corners, 1, axis=0), strict=True))
    step = np.ptp(corners, axis=0).max() / SAMPLES
    assert found == pytest.approx(occupied.area_m2 - covered, abs=0.5 * step * (perimeter + 8.0 * len(boxes)))


@given(number=st.integers(0, 10_000))
def test_returns_are_the_nearest_ends_of_rays_in_each_sector(number: int) -> None:
    random = np.random.default_rng(number)
    sensor = plain.random_view(number, random.uniform(-20.0, 20.0, 2))
    v, (bands, sectors) = sensor.view, sensor.free.shape
    expected = []
    for sector in range(sectors):
        ends = []
        for band in range(bands):
            free = float(sensor.free[band, sector])
            azimuth = v.azimuth_min + (sector + 0.5) / sectors * (v.azimuth_max - v.azimuth_min)
            elevation = v.elevation_min + (band + 0.5) / bands * (v.elevation_max - v.elevation_min)
            ray = [cos(elevation) * cos(azimuth), cos(elevation) * sin(azimuth), sin(elevation)]
            end = v.position + v.rotation @ np.array(ray) * free
            away = hypot(*(end[:2] - v.position[:2]))
            if free < v.max_range and -0.5 <= end[2] <= 3.0 and 4.0 < away <= 50.0:
                ends.append((away, *end[:2].tolist()))
        expected += [min(ends)[1:]] if ends else []
    assert returns(sensor, -0.5, 3.0, 50.0) == pytest.approx(np.array(expected).reshape(-1, 2))


def flooded(sectors: int, place: tuple[float, float], *, radius_m: float = 3.9) -> SweptView:
    """A view with a return in each of its sectors, all on a circle around a place 10 m ahead."""
    azimuth = (np.arange(sectors) + 0.5) * (0.6 / sectors) - 0.3
    # The nearer crossing of each ray with the circle, or its closest point if it misses.
    free = 10.0 * np.cos(azimuth) - np.sqrt(np.maximum(radius_m**2 - (10.0 * np.sin(azimuth)) ** 2, 0.0))
    return SweptView(SensorView(np.array([*place, 1.0]), np.eye(3), -0.3, 0.3, -0.01, 0.01, 80.0), free[None])


@pytest.mark.parametrize("sectors", [3, MAX_RETURNS, MAX_RETURNS + 1, 20_000])
def test_of_more_returns_than_any_sensor_has_as_many_count_evenly_spread(sectors: int) -> None:
    points = returns(flooded(sectors, (0.0, 0.0)), -0.5, 3.0, 50.0)
    assert len(points) == min(sectors, MAX_RETURNS)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    assert np.diff(azimuth).max() <= 2.0 * 0.6 / len(points), "no part of the view is left out"
    assert azimuth[[0, -1]] == pytest.approx([-0.3, 0.3], abs=0.6 / len(points) * 2)


def test_a_flood_of_returns_costs_little_memory() -> None:
    views = [flooded(20_000, (0.0, 0.01 * number)) for number in range(8)]
    points = np.concatenate([returns(view, -0.5, 3.0, 50.0) for view in views])
    agent = np.repeat(np.arange(len(views)), MAX_RETURNS)
    tracemalloc.start()
    areas = occupied_areas(points, agent, 1.0)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 150e6
    assert len(areas) == 1
    assert areas[0].agents.tolist() == list(range(len(views)))


@given(st.lists(st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0)), min_size=1, max_size=30))
def test_the_diameter_is_the_greatest_distance_of_two_corners(places: list[tuple[float, float]]) -> None:
    expected = max(hypot(x - u, y - v) for x, y in places for u, v in places)
    for block in (1, 7, 250_000):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(cad, "_BLOCK", block)
            assert diameter(np.array(places)) == pytest.approx(expected)


def hollow(*cars: tuple[float, float], place: tuple[float, float] = (0.0, 0.0)) -> SweptView:
    """A fine view that shows the outlines of cars along x: each ray ends where it meets the first one."""
    sectors, bands = 720, 40
    free = np.full((bands, sectors), 80.0)
    azimuth = -pi + (np.arange(sectors) + 0.5) * (2.0 * pi / sectors)
    elevation = -0.35 + (np.arange(bands) + 0.5) * (0.45 / bands)
    for x, y in cars:
        low, high = np.array([x - 2.25, y - 0.9]) - place, np.array([x + 2.25, y + 0.9]) - place
        ray = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
        with np.errstate(divide="ignore"):
            crossings = np.sort(np.stack([low / ray, high / ray]), axis=0)
        enters, leaves = crossings[0].max(axis=1), crossings[1].min(axis=1)
        hit = (enters <= leaves) & (enters > 0.0)
        bottom, top = -1.0 / enters, 0.5 / enters
        for band, e in enumerate(elevation):
            meets = hit & (np.tan(e) >= bottom) & (np.tan(e) <= top)
            free[band, meets] = np.minimum(free[band, meets], enters[meets] / cos(e))
    return SweptView(SensorView(np.array([*place, 1.0]), np.eye(3), -pi, pi, -0.35, 0.1, 80.0), free)


CAR, OTHER = (15.0, 8.0), (12.0, -10.0)


def scene(*tracks: Track, seen: tuple[tuple[float, float], ...] = (CAR, OTHER)) -> Batch:
    places = {"a": (0.0, 0.0), "b": (28.0, 12.0), "c": (18.0, -22.0)}
    return batch(tracks, AGENTS, {name: hollow(*seen, place=place) for name, place in places.items()})


def reports(*cars: tuple[float, float]) -> list[Track]:
    return [(name, number, car) for name in AGENTS for number, car in enumerate(cars)]


def test_cars_that_are_there_are_neither_spoofed_nor_removed() -> None:
    stage = Cad()
    found = stage.assess(scene(*reports(CAR, OTHER)))
    assert not found.objects.withheld.any()
    assert (stage.facts()["spoofed"], stage.facts()["removed"]) == (0, 0)
    assert stage.facts()["checks"] >= 3, "two boxes, and an occupied area at least"


def test_a_phantom_in_free_space_is_spoofed_though_two_agents_report_it() -> None:
    phantom: list[Track] = [("a", 2, (20.0, 0.0)), ("b", 2, (20.0, 0.0))]
    found = Cad().assess(scene(*reports(CAR, OTHER), *phantom))
    assert found.objects.withheld.tolist() == [False, False, True]


def test_a_car_that_nobody_reports_is_a_removal_and_counts_against_those_that_see_it() -> None:
    stage = Cad()
    for frame in range(20):
        found = stage.assess(replace(scene(*reports(CAR)), time_ns=frame * 10**8))
    facts = stage.facts()
    assert (facts["spoofed"], facts["removed"]) == (0, 20)
    assert not found.objects.withheld.any(), "an alarm brings no object back"
    honest = Cad()
    for frame in range(20):
        trusted = honest.assess(replace(scene(*reports(CAR, OTHER)), time_ns=frame * 10**8))
    assert (found.agents.mean < trusted.agents.mean).any()


def test_old_views_show_nothing() -> None:
    each = scene(("a", 0, (20.0, 0.0)), seen=(OTHER,))
    old = tuple(replace(sensor, age_s=0.2) for sensor in each.views)
    stage = Cad()
    assert not stage.assess(replace(each, views=old)).objects.withheld.any()
    assert (stage.facts()["batches"], stage.facts()["batches_without_reference"]) == (0, 1)
    assert Cad().assess(each).objects.withheld.all()


def test_the_ground_is_that_under_the_boxes() -> None:
    each = scene(*reports(CAR))
    lifted = each.states.position + np.array([0.0, 0.0, 5.0])
    raised = replace(each, states=each.states.with_(position=lifted))
    assert areas_of(each, ClusterBoxes.of(each), 50.0, 1.0)
    assert not areas_of(raised, ClusterBoxes.of(raised), 50.0, 1.0), "all returns are below the ground"


def test_without_tracks_there_is_no_ground_and_nothing_is_compared() -> None:
    stage = Cad()
    found = stage.assess(scene())
    assert len(found.objects.withheld) == 0
    assert stage.facts()["checks"] == 0


def test_views_without_free_space_know_nothing() -> None:
    wide = view((0.0, 0.0))
    unknown = replace(wide, free=np.zeros((0, 0)))
    assert not Cad().assess(batch([("a", 0, (20.0, 0.0))], ("a",), {"a": unknown})).objects.withheld.any()
    assert Cad().assess(batch([("a", 0, (20.0, 0.0))], ("a",), {"a": wide})).objects.withheld.all()

"""Components of trackers."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from mast_zenoh.arrays.geometry import rotation_from_yaw_pitch
from mast_zenoh.tracking import BipartiteAssignment, GreedyAssignment, SensorView
from mast_zenoh.tracking.box_tracker import FilterpyFilter
from mast_zenoh.tracking.classes import first_covariance
from mast_zenoh.tracking.kalman import BatchedFilter, inverse, make_positive_definite, process_noise
from mast_zenoh.tracking.tracks import CLASS, COVARIANCE, MEAN, ONE_OBJECT, covariances, empty, overlap

# -- assignment

costs = st.lists(
    st.tuples(st.integers(0, 4), st.integers(0, 4), st.integers(-9, 3).map(float)),
    max_size=12,
    unique_by=lambda p: p[:2],
)


def columns(pairs):
    row, column, cost = (np.array([pair[k] for pair in pairs]) for k in range(3))
    return row.astype(int), column.astype(int), cost.astype(float)


@given(costs, st.sampled_from([BipartiteAssignment(), GreedyAssignment()]))
def test_no_row_is_assigned_twice_or_at_positive_cost_and_the_bipartite_assignment_is_the_best(pairs, assignment):
    row, column, cost = columns(pairs)
    chosen = assignment.match(row, column, cost)
    assert len(set(row[chosen])) == len(chosen) == len(set(column[chosen]))
    assert (cost[chosen] < 0).all()
    assert (np.diff(chosen) > 0).all()
    if isinstance(assignment, BipartiteAssignment):
        table = np.zeros((5, 5))
        table[row, column] = np.minimum(cost, 0.0)
        assert cost[chosen].sum() == table[linear_sum_assignment(table)].sum(), "the least total cost"


def some_tracks(n: int, seed: int = 0):
    random = np.random.default_rng(seed)
    root = random.normal(size=(n, 9, 9))
    t = empty(n)
    t[:, MEAN] = random.normal(size=(n, 9))
    t[:, COVARIANCE] = (root @ root.transpose(0, 2, 1) + np.eye(9)).reshape(n, 81)
    t[:, CLASS] = random.integers(0, 7, n)
    return random, t


def test_the_batched_filter_equals_filterpy():
    random, t = some_tracks(20)
    Q = process_noise(0.1, random.uniform(0.5, 4, 7), 0.2, 1e-3)
    direction = np.exp(1j * random.uniform(0, 6, 20))
    direction = np.column_stack([direction.real, direction.imag])
    P = covariances(t)
    for step in (
        lambda one, t: one.predict(t, 0.1, Q),
        lambda one, t: one.correct(t, t[:, :6] + 1.0, P[:, :6, :6].copy()),
        lambda one, t: one.correct(t, t[:, :9] + 1.0, P.copy()),
        lambda one, t: one.correct_speed(t, direction, np.arange(1.0, 21.0)),
    ):
        batched, reference = t.copy(), t.copy()
        step(BatchedFilter(), batched)
        step(FilterpyFilter(), reference)
        np.testing.assert_allclose(batched, reference, rtol=0, atol=1e-9)


def test_a_thousand_steps_leave_covariances_symmetric_and_positive_definite():
    random, t = some_tracks(5)
    one = BatchedFilter()
    Q = process_noise(0.1, np.full(7, 3.0), 0.2, 4e-4)
    for _ in range(1000):
        one.predict(t, 0.1, Q)
        one.correct(t, random.normal(size=(5, 6)), np.tile(0.1 * np.eye(6), (5, 1, 1)))
        one.correct_speed(t, np.tile([0.6, 0.8], (5, 1)), np.full(5, 0.3))
    P = covariances(t)
    np.testing.assert_allclose(P, P.transpose(0, 2, 1), rtol=0, atol=1e-12)
    assert np.linalg.eigvalsh(P).min() > 0


def test_process_noise_adds_up_over_steps():
    acceleration = np.array([2.0])
    whole = process_noise(0.4, acceleration, 0.3, 1e-3)
    t = empty(1)
    for _ in range(4):
        BatchedFilter().predict(t, 0.1, process_noise(0.1, acceleration, 0.3, 1e-3))
    np.testing.assert_allclose(covariances(t), whole, atol=1e-12)


def test_a_new_cars_speed_is_uncertain_only_along_its_heading():
    covariance = first_covariance(np.eye(6)[None], np.array([np.pi / 6]), np.array([1]))[0]
    along, across = np.array([np.cos(np.pi / 6), 0.5]), np.array([-0.5, np.cos(np.pi / 6)])
    assert np.sqrt(along @ covariance[6:8, 6:8] @ along) == pytest.approx(12.0)
    assert np.sqrt(across @ covariance[6:8, 6:8] @ across) == pytest.approx(3.0)


def test_filterpy_and_stone_soup_are_imported_only_when_used():
    code = "import sys, mast_zenoh.tracking; sys.exit(bool({'filterpy', 'stonesoup'} & sys.modules.keys()))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@given(st.lists(st.floats(-1e300, 1e300, allow_nan=False), min_size=9, max_size=9))
def test_any_finite_matrix_is_repaired(values):
    result = make_positive_definite(np.array(values).reshape(1, 3, 3))
    assert np.isfinite(np.linalg.inv(result)).all()
    assert np.linalg.eigvalsh(result).min() > 0
    np.testing.assert_array_equal(result, result.transpose(0, 2, 1))


@pytest.mark.parametrize("coupled", [True, False])
def test_the_blockwise_inverse_equals_the_full_inverse(coupled):
    P = covariances(some_tracks(7)[1])
    if not coupled:
        block = np.array([0, 0, 1, 2, 3, 4, 0, 0, 1])
        P = P * (block[:, None] == block)
    np.testing.assert_allclose(inverse(P), np.linalg.inv(P), rtol=0, atol=1e-12)


CAR = [4.5, 1.8, 1.5]
NO_BOXES = np.zeros((0, 6))


def boxes(position, size) -> np.ndarray:
    """(n, 6) boxes of one size at positions (n, 3)."""
    return np.concatenate([np.asarray(position, float), np.tile(size, (len(position), 1))], axis=1)


def all_round(position) -> SensorView:
    """A sensor that sees in all directions."""
    return SensorView(np.asarray(position, float), np.eye(3), -np.pi, np.pi, -np.pi, np.pi, 1e4)


def test_an_object_is_expected_inside_the_field_of_view_and_half_at_its_edge():
    pole = SensorView(
        np.array([0.0, 0.0, 15.0]),
        rotation_from_yaw_pitch(0.0, np.deg2rad(30)),
        -np.pi / 4,
        np.pi / 4,
        np.deg2rad(-25),
        np.deg2rad(30),
        100.0,
    )
    points = np.array([[30.0, 0.0, 0.8], [-30.0, 0.0, 0.8], [120.0, 0.0, 0.8], [5.0, 0.0, 0.8], [0.0, 30.0, 0.8]])
    assert pole.visible_fraction(boxes(points, CAR), NO_BOXES).tolist() == [1.0, 0.0, 0.0, 0.0, 0.0]
    edge = np.sqrt(100.0**2 - 14.2**2)
    assert pole.visible_fraction(boxes([[edge, 0.0, 0.8]], CAR), NO_BOXES)[0] == pytest.approx(0.5)


def test_an_object_occludes_only_objects_behind_it():
    cars = boxes([[40.0, 0.0, 0.7], [40.0, 15.0, 0.7], [8.0, 0.0, 0.7], [-40.0, 0.0, 0.7]], CAR)
    lorry = boxes([[20.0, 0.0, 1.7]], [9.0, 2.5, 3.5])
    assert all_round([0.0, 0.0, 1.8]).visible_fraction(cars, lorry).tolist() == [0.0, 1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("offset", "yaw", "same"),
    [
        ((0.5, 0.3), 0.0, True),
        ((0.5, 0.3), np.pi, True),
        ((0.0, 3.2), 0.0, False),
        ((5.5, 0.0), 0.0, False),
        ((2.5, 2.5), np.pi / 2, False),
        ((1.0, 1.0), np.pi / 2, True),
    ],
)
def test_overlapping_cars_are_one_object(offset, yaw, same):
    size = np.array([[4.5, 1.8, 1.5]])
    assert overlap(np.array([offset]), size, np.zeros(1), size, np.array([yaw]), ONE_OBJECT)[0] == same

"""Columnar states: selected, concatenated and propagated without row objects."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays.states import (
    CLASS_INDEX,
    CLASSES,
    COVARIANCE_ORDER,
    DETECTION_COLUMNS,
    STATE_COLUMNS,
    Detections,
    ObjectStates,
    concatenate,
    propagate,
)
from mast_zenoh.messages.schemas import SCHEMAS

SHAPES = {"position": (3,), "velocity": (3,), "size": (3,), "covariance": (9, 9)}


def some(n: int, seed: int = 0) -> ObjectStates:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, 9, 9))
    return ObjectStates.of(
        rng.normal(size=(n, 3)) * 50,
        id=rng.permutation(100)[:n],
        velocity=rng.normal(size=(n, 3)) * 10,
        size=rng.uniform(1, 5, (n, 3)),
        yaw=rng.uniform(-3, 3, n),
        covariance=root @ np.swapaxes(root, 1, 2) + np.eye(9),
        score=rng.random(n),
        class_id=rng.integers(0, len(CLASSES), n).astype(np.uint8),
    )


def assert_equal(a: ObjectStates, b: ObjectStates) -> None:
    for name in STATE_COLUMNS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
        assert getattr(a, name).dtype == getattr(b, name).dtype


@pytest.mark.parametrize("n", [0, 1, 4])
def test_omitted_columns_are_zero_with_the_right_shape_and_dtype(n: int) -> None:
    states = ObjectStates.of(np.ones((n, 3)))
    assert len(states) == n
    assert states.id.tolist() == list(range(n))
    assert states.score.tolist() == [1.0] * n
    for name in STATE_COLUMNS:
        column = getattr(states, name)
        assert column.shape == (n, *SHAPES.get(name, ()))
        assert column.dtype == {"id": np.int64, "class_id": np.uint8}.get(name, np.float64)
    assert not states.velocity.any()
    assert not states.covariance.any()


def test_states_have_the_columns_of_the_messages_that_carry_them() -> None:
    assert set(STATE_COLUMNS) <= {column.name for column in SCHEMAS["tracks"].columns}
    assert set(DETECTION_COLUMNS) <= {column.name for column in SCHEMAS["detections"].columns}
    states = some(3)
    assert_equal(ObjectStates.from_columns(states.columns() | {"origin": np.zeros(3)}), states)
    detections = Detections.from_columns(Detections.empty().columns() | {"mount_position": np.zeros(3)})
    assert len(detections) == 0


def test_columns_are_shared_not_copied() -> None:
    states = some(3)
    assert all(states.columns()[name] is getattr(states, name) for name in STATE_COLUMNS)


@given(st.lists(st.booleans(), min_size=6, max_size=6))
def test_rows_are_selected_by_mask_index_or_slice(mask: list[bool]) -> None:
    states = some(6)
    rows = np.flatnonzero(mask)
    assert_equal(states.select(np.array(mask)), states.select(rows))
    assert states.select(rows).id.tolist() == states.id[rows].tolist()
    assert_equal(states.select(slice(2, 4)), states.select(np.array([2, 3])))


@given(st.lists(st.integers(0, 4), max_size=5))
def test_concatenating_the_parts_of_states_restores_them(sizes: list[int]) -> None:
    whole = some(sum(sizes))
    ends = np.cumsum([0, *sizes])
    parts = [whole.select(slice(a, b)) for a, b in pairwise(ends)]
    assert_equal(concatenate(parts), whole)


def test_concatenating_nothing_gives_no_states() -> None:
    assert_equal(concatenate([]), ObjectStates.empty())
    assert len(concatenate([ObjectStates.empty(), some(2)])) == 2


def test_a_column_can_be_replaced_in_a_copy() -> None:
    states = some(3)
    changed = states.with_(yaw=np.zeros(3))
    assert not changed.yaw.any()
    assert states.yaw.any()
    assert changed.position is states.position
    with pytest.raises(TypeError, match="colour"):
        states.with_(colour=np.zeros(3))


@given(st.floats(-5, 5), st.floats(-5, 5))
def test_propagating_twice_equals_propagating_once_by_the_sum(first: float, second: float) -> None:
    states = some(4)
    twice, once = propagate(propagate(states, first), second), propagate(states, first + second)
    np.testing.assert_allclose(twice.position, once.position, atol=1e-9)
    np.testing.assert_allclose(twice.covariance, once.covariance, atol=1e-6)
    np.testing.assert_array_equal(once.velocity, states.velocity)


@given(st.floats(-3, 3))
def test_a_propagated_covariance_equals_that_of_propagated_samples(dt: float) -> None:
    states = some(1)
    vx, x = COVARIANCE_ORDER.index("vx"), COVARIANCE_ORDER.index("x")
    before, after = states.covariance[0], propagate(states, dt).covariance[0]
    assert after[x, x] == pytest.approx(before[x, x] + 2 * dt * before[x, vx] + dt * dt * before[vx, vx])
    assert after[x, vx] == pytest.approx(before[x, vx] + dt * before[vx, vx])
    np.testing.assert_allclose(after, after.T)
    np.linalg.cholesky(after)


def test_propagating_stationary_objects_changes_nothing() -> None:
    states = some(3)
    assert propagate(states, 0.0) is states
    nothing = ObjectStates.empty()
    assert propagate(nothing, 1.0) is nothing


def test_classes_have_a_name_and_an_index() -> None:
    assert [CLASSES[CLASS_INDEX[name]] for name in CLASSES] == list(CLASSES)
    assert CLASSES[0] == "unknown", "index 0 is the unknown class"

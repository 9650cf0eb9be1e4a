"""4 x 4 matrices of data sets in every documented form."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mast_datasets.files import Element, read_listed_pose, read_pose

from mast_zenoh.errors import SceneError

#: 90 degrees to the left, at (5, 6, 7).
ROWS = [[0.0, -1.0, 0.0, 5.0], [1.0, 0.0, 0.0, 6.0], [0.0, 0.0, 1.0, 7.0], [0.0, 0.0, 0.0, 1.0]]
BY_ROWS = [0.0, -1.0, 0.0, 5.0, 1.0, 0.0, 0.0, 6.0, 0.0, 0.0, 1.0, 7.0, 0.0, 0.0, 0.0, 1.0]
BY_COLUMNS = [0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 5.0, 6.0, 7.0, 1.0]


def element(value: Any) -> Element:
    return Element(value, Path("labels.json"), "pose")


@pytest.mark.parametrize("value", [ROWS, BY_ROWS, BY_COLUMNS])
def test_rows_and_lists_in_either_order_are_the_same_pose(value: list[Any]) -> None:
    position, rotation = read_listed_pose(element(value))
    assert position.tolist() == [5.0, 6.0, 7.0]
    np.testing.assert_allclose(rotation @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)


def test_the_identity_may_be_a_list() -> None:
    position, rotation = read_listed_pose(element(np.eye(4).ravel().tolist()))
    assert position.tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_array_equal(rotation, np.eye(3))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (BY_ROWS[:15], "expected 4 rows of 4 numbers, or 16 numbers"),
        ("identity", "found 'identity', expected 4 rows"),
        ([*BY_ROWS[:12], 1.0, 2.0, 3.0, 1.0], "whose last row is 0, 0, 0, 1"),
        ([number if k % 4 < 3 else float(k == 15) for k, number in enumerate(BY_ROWS)], "order of 16 numbers cannot"),
        ([*BY_ROWS[:3], 1e9, *BY_ROWS[4:]], r"\[3\]: found 1000000000.0, expected a finite number from"),
        ([*BY_ROWS[:3], None, *BY_ROWS[4:]], r"\[3\]: found None, expected a finite number"),
        ([ROWS[0], ROWS[0], *ROWS[2:]], "expected an orthonormal, right-handed rotation matrix"),
    ],
)
def test_an_impossible_matrix_is_refused_with_its_place(value: Any, message: str) -> None:
    with pytest.raises(SceneError, match=rf"labels.json: pose.*{message}"):
        read_listed_pose(element(value))


def test_a_list_of_16_numbers_is_refused_where_rows_are_documented() -> None:
    with pytest.raises(SceneError, match=r"pose: found .*, expected a list of 4"):
        read_pose(element(BY_ROWS))

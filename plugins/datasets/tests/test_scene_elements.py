"""Values of JSON files are checked, among them 4 x 4 matrices in every documented form; messages say where they are."""

import contextlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mast_datasets.files import Coordinate, Element, Point, Size, read_json, read_listed_pose

from mast_zenoh.errors import SceneError

ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=12,
)


def element(value: object) -> Element:
    return Element(value, Path("labels.json"), "frames.3")


def test_values_are_found_by_key_and_index() -> None:
    root = element({"boxes": [{"xyz": [1, 2.5, -3]}]})
    (box,) = root["boxes"].elements()
    assert box["xyz"].read(Point) == (1.0, 2.5, -3.0)
    assert box.place == "frames.3.boxes[0]"
    assert root.get("absent") is None


@pytest.mark.parametrize(
    ("read", "value", "message"),
    [
        (lambda e: e["size"], {"sise": 1}, "frames.3: size is missing; did you mean 'sise'"),
        (lambda e: e["x"], [1], r"found \[1\], expected an object"),
        (lambda e: e.read(int), "--5", "found '--5', expected `int`, got `str`"),
        (lambda e: e.read(int), 1.5, "found 1.5, expected `int`, got `float`"),
        (lambda e: e.read(Coordinate), True, "found True, expected `float`, got `bool`"),
        (lambda e: e.read(Coordinate), 10**400, "number out of range"),
        (lambda e: e.read(Coordinate), float("nan"), "found nan, expected `float` >= -100000000"),
        (lambda e: e.read(Coordinate), "nan", "found 'nan', expected `float` >= -100000000"),
        (lambda e: e.text(), 3, "found 3, expected `str`"),
        (lambda e: e.text(["a", "b"]), "c", "expected one of a, b"),
        (lambda e: e.read(Point), [1, 2], "expected `array` of length 3"),
        (lambda e: e.read(Point), [1, 2, None], r"frames.3\[2\]: found \[1, 2, None\], expected `float`, got `null`"),
        (lambda e: e.read(Size), [1, 0, 2], r"frames.3\[1\]: found \[1, 0, 2\], expected `float` > 0"),
        (lambda e: e.rotation(), [[2, 0, 0], [0, 1, 0], [0, 0, 1]], "expected an orthonormal"),
        (lambda e: e.rotation(), [[-1, 0, 0], [0, 1, 0], [0, 0, 1]], "expected an orthonormal, right-handed"),
        (lambda e: e.rigid(), np.diag([1, 1, 1, 2]).tolist(), "whose last row is 0, 0, 0, 1"),
    ],
)
def test_a_wrong_value_is_refused_with_its_place(read, value: object, message: str) -> None:
    with pytest.raises(SceneError, match=rf"labels.json: .*{message}"):
        read(element(value))


def test_a_rounded_rotation_is_made_orthonormal() -> None:
    rounded = np.round(np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1.0]]) + 1e-4, 4)
    rotation = element(rounded.tolist()).rotation()
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation, rounded, atol=1e-3)


def test_huge_and_deeply_nested_values_are_refused() -> None:
    huge = [[1e8, 1e8, 0], [-1e8, 1e8, 0], [0, 0, 1]]
    with np.errstate(all="raise"), pytest.raises(SceneError, match="expected an orthonormal"):
        element(huge).rotation()
    value: list = []
    for _ in range(100_000):
        value = [value]
    with pytest.raises(SceneError, match=r"found \[\[.{,40}, expected `str`"):
        element(value).text()


@given(ANYTHING)
def test_any_value_is_read_or_refused(value: object) -> None:
    for read in (
        lambda e: e["a"],
        lambda e: list(e.members()),
        Element.elements,
        Element.text,
        lambda e: e.read(int),
        lambda e: e.read(Point),
        Element.rotation,
        Element.rigid,
    ):
        with contextlib.suppress(SceneError):
            read(element(value))


def test_a_missing_or_damaged_file_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "x.json"
    with pytest.raises(SceneError, match=r"x\.json.*No such file"):
        read_json(file)
    for content in (b'{"a": NaN}', b'{"a": 1', b"[" * 100_000, b"\xff\xfe\x00"):
        file.write_bytes(content)
        with pytest.raises(SceneError, match=r"x\.json: .*(not JSON|utf-8)"):
            read_json(file)


#: 90 degrees to the left, at (5, 6, 7).
ROWS = [[0.0, -1.0, 0.0, 5.0], [1.0, 0.0, 0.0, 6.0], [0.0, 0.0, 1.0, 7.0], [0.0, 0.0, 0.0, 1.0]]
BY_ROWS = [0.0, -1.0, 0.0, 5.0, 1.0, 0.0, 0.0, 6.0, 0.0, 0.0, 1.0, 7.0, 0.0, 0.0, 0.0, 1.0]
BY_COLUMNS = [0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 5.0, 6.0, 7.0, 1.0]


def test_rows_and_lists_in_either_order_are_the_same_pose() -> None:
    for value in (ROWS, BY_ROWS, BY_COLUMNS):
        position, rotation = read_listed_pose(element(value))
        assert position.tolist() == [5.0, 6.0, 7.0]
        np.testing.assert_allclose(rotation @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_array_equal(read_listed_pose(element(np.eye(4).ravel().tolist()))[1], np.eye(3))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (BY_ROWS[:15], "expected 4 rows of 4 numbers, or 16 numbers"),
        ("identity", "found 'identity', expected 4 rows"),
        ([*BY_ROWS[:12], 1.0, 2.0, 3.0, 1.0], "whose last row is 0, 0, 0, 1"),
        ([number if k % 4 < 3 else float(k == 15) for k, number in enumerate(BY_ROWS)], "order of 16 numbers cannot"),
        ([*BY_ROWS[:3], 1e9, *BY_ROWS[4:]], r"\[3\]: found .*, expected `float` <= 100000000"),
        ([*BY_ROWS[:3], None, *BY_ROWS[4:]], r"\[3\]: found .*, expected `float`, got `null`"),
        ([ROWS[0], ROWS[0], *ROWS[2:]], "expected an orthonormal, right-handed rotation matrix"),
    ],
)
def test_an_impossible_matrix_is_refused_with_its_place(value: object, message: str) -> None:
    with pytest.raises(SceneError, match=rf"labels.json: frames.3.*{message}"):
        read_listed_pose(element(value))
    with pytest.raises(SceneError, match=r"frames.3: found .*, expected `array` of length 4, got 16"):
        element(BY_ROWS).rigid()  # rows are documented there

"""Node results survive a round trip."""

import numpy as np
import pytest

from mast_zenoh.control import results
from mast_zenoh.errors import MessageError


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6, dtype=np.int64).reshape(2, 3),
        np.zeros((0, 3)),
        np.array([[1.5, np.nan], [np.inf, -0.0]]),
        np.array([True, False]),
        np.arange(6).reshape(2, 3).T,
    ],
)
def test_arrays_keep_values_dtype_and_shape(array: np.ndarray) -> None:
    back = results.unpack(results.pack({"table": array}))["table"]
    np.testing.assert_array_equal(back, array)
    assert back.dtype == array.dtype
    assert back.shape == array.shape


@pytest.mark.parametrize(
    "array", [np.array(["ego", "é"], dtype=object), np.array(["ego", "infra_1"]), np.array([], str)]
)
def test_text_arrays_become_object_arrays(array: np.ndarray) -> None:
    back = results.unpack(results.pack(array))
    assert back.dtype == object
    assert back.tolist() == array.tolist()


def test_nested_plain_values_are_unchanged() -> None:
    value = {
        "metrics": {"mean": 1.25, "n": 3, "none": None, "yes": True, "rows": [1, [2.0, "x"]], "empty": {}},
        7: "seven",
    }
    assert results.unpack(results.pack(value)) == value


def test_numpy_numbers_become_plain_numbers() -> None:
    back = results.unpack(results.pack({"n": np.int64(3), "x": np.float64(0.5), "yes": np.bool_(True)}))
    assert back == {"n": 3, "x": 0.5, "yes": True}
    assert [type(value) for value in back.values()] == [int, float, bool]


def test_other_values_are_refused_with_their_type() -> None:
    with pytest.raises(TypeError, match="a result holds a set, expected plain values and arrays"):
        results.pack({"names": {"ego"}})


def test_arrays_have_at_most_eight_dimensions() -> None:
    assert results.unpack(results.pack(np.zeros((1,) * 8))).shape == (1,) * 8
    with pytest.raises(MessageError):
        results.unpack(results.pack(np.zeros((1,) * 9)))


@pytest.mark.parametrize(
    "array", [np.zeros((1 << 24, 0)), np.zeros(1 << 21, bool), np.array(["x"] * (1 << 21), object)]
)
def test_large_arrays_are_allowed_only_in_tables(array: np.ndarray) -> None:
    results.checked({"tables": {"t": {"x": array}}})
    with pytest.raises(TypeError, match="outside tables"):
        results.checked({"x": [{"y": array}]})


def test_the_place_of_an_invalid_value_is_reported_and_shortened() -> None:
    with pytest.raises(TypeError, match=r"^results\.a\.1\.b: found a set, expected plain values"):
        results.checked({"a": [0, {"b": {1}}]})
    results.checked({"x" * (1 << 20): {"y" * (1 << 20): list(range(1 << 17))}})  # as many names of 2 MB would be 256 GB
    with pytest.raises(TypeError) as caught:
        results.checked({"x" * (1 << 20): [{1}]})
    assert len(str(caught.value)) < 300

"""What nodes hand in at the end comes out as it went in."""

import numpy as np
import pytest

from mast_zenoh.runtime import results


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
def test_arrays_keep_their_numbers_dtype_and_shape(array: np.ndarray) -> None:
    back = results.unpack(results.pack({"table": array}))["table"]
    np.testing.assert_array_equal(back, array)
    assert back.dtype == array.dtype
    assert back.shape == array.shape


@pytest.mark.parametrize(
    "array", [np.array(["ego", "é"], dtype=object), np.array(["ego", "infra_1"]), np.array([], str)]
)
def test_arrays_of_text_come_out_as_objects(array: np.ndarray) -> None:
    back = results.unpack(results.pack(array))
    assert back.dtype == object
    assert back.tolist() == array.tolist()


def test_nested_plain_values_are_as_they_were() -> None:
    value = {
        "metrics": {"mean": 1.25, "n": 3, "none": None, "yes": True, "rows": [1, [2.0, "x"]], "empty": {}},
        7: "seven",
    }
    assert results.unpack(results.pack(value)) == value


def test_numbers_of_numpy_become_plain_ones() -> None:
    back = results.unpack(results.pack({"n": np.int64(3), "x": np.float64(0.5), "yes": np.bool_(True)}))
    assert back == {"n": 3, "x": 0.5, "yes": True}
    assert [type(value) for value in back.values()] == [int, float, bool]


def test_what_is_neither_is_refused_by_name() -> None:
    with pytest.raises(TypeError, match="a result holds a set, expected plain values and arrays"):
        results.pack({"names": {"ego"}})

"""Every draw comes from a named, portable and independent stream."""

import numpy as np
import pytest

from mast_zenoh.streams import stream


@pytest.mark.parametrize(
    ("names", "drawn"),
    [
        ((0,), [0.6857510109362787, 0.13276976175371136, 0.5204395686300203]),
        ((0, "adversary_1", "selection", 40), [0.9606421298318955, 0.597830483290582, 0.4837887344841165]),
        ((7, "ego", "detections"), [0.3461546924231548, 0.1898282314463946, 0.3576835350480835]),
    ],
)
def test_draws_are_unchanged(names: tuple, drawn: list[float]) -> None:
    """A change here changes every run of every study: a new major version."""
    assert stream(*names).random(3).tolist() == drawn


def test_equal_names_always_give_equal_draws() -> None:
    first, second = stream(3, "a", 1), stream(3, "a", 1)
    first.random(10)
    np.testing.assert_array_equal(stream(3, "a", 1).random(5), second.random(5))


def test_different_names_give_different_streams() -> None:
    names = [(0,), (1,), (0, ""), (0, "a"), (0, "b"), (0, "a", 0), (0, "a", 1), (0, "a", "b"), (0, "ab"), (0, 1), (-1,)]
    drawn = {tuple(stream(*name).integers(2**62, size=2).tolist()) for name in names}
    assert len(drawn) == len(names)


def test_streams_are_independent() -> None:
    rows = np.array([stream(0, "node", i).standard_normal(400) for i in range(60)])
    correlation = np.corrcoef(rows)[np.triu_indices(60, 1)]
    assert np.abs(correlation).max() < 0.25
    assert abs(correlation.mean()) < 0.005
    assert abs(rows.mean()) < 0.03
    assert abs(rows.std() - 1.0) < 0.02


def test_nothing_is_drawn_from_the_global_generator() -> None:
    np.random.seed(5)  # noqa: NPY002 (that is what must not matter)
    before = stream(1, "x").random(4)
    np.random.seed(6)  # noqa: NPY002
    np.testing.assert_array_equal(before, stream(1, "x").random(4))

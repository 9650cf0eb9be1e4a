"""Random numbers of objects that wander, or stay with the viewing angle."""

import numpy as np
import pytest

from mast_zenoh.sensing.detection_model import ViewErrors, WanderingNumbers
from mast_zenoh.streams import stream

IDS = np.arange(2000)


def correlation(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.corrcoef(one.ravel(), other.ravel())[0, 1])


def test_wandering_numbers_correlate_as_asked_and_keep_their_variance() -> None:
    numbers = WanderingNumbers(np.array([0.9, 0.3]))
    frames = np.stack([numbers.step(IDS, stream(0, frame).standard_normal((len(IDS), 2))) for frame in range(20)])
    np.testing.assert_allclose(frames.std(axis=(0, 1)), 1.0, atol=0.03)
    for column, keep in enumerate((0.9, 0.3)):
        assert correlation(frames[:-2, :, column], frames[2:, :, column]) == pytest.approx(keep**2, abs=0.02)


def test_an_object_that_was_away_begins_anew() -> None:
    numbers = WanderingNumbers(np.array([0.99]))
    first, _, third = (
        numbers.step(ids, stream(0, frame).standard_normal((len(ids), 1)))
        for frame, ids in enumerate((IDS, IDS[::2], IDS))
    )
    assert correlation(first[::2], third[::2]) > 0.95
    assert abs(correlation(first[1::2], third[1::2])) < 0.1


@pytest.mark.parametrize("width_deg", [30.0, 40.0, 90.0])
def test_errors_of_a_view_change_with_the_angle(width_deg: float) -> None:
    view = ViewErrors(3, np.radians(width_deg))
    at = {degrees: view.at(IDS, np.full(len(IDS), np.radians(degrees)), stream(0)) for degrees in (10.0, 370.0)}
    turned = view.at(IDS, np.full(len(IDS), np.radians(10.0 + width_deg)), stream(1))
    np.testing.assert_allclose(at[10.0], at[370.0], atol=1e-9)
    np.testing.assert_allclose(at[10.0].std(axis=0), 1.0, atol=0.05)
    assert correlation(at[10.0], turned) == pytest.approx(np.exp(-0.5), abs=0.1)


def test_errors_of_a_view_stay_with_an_object_that_was_away() -> None:
    view, other = ViewErrors(2, 1.0), ViewErrors(2, 1.0)
    angle = np.linspace(0.0, 6.0, 5)
    first = view.at(IDS[:5], angle, stream(0))
    view.at(IDS[:0], angle[:0], stream(1))
    np.testing.assert_array_equal(view.at(IDS[:5], angle, stream(2)), first)
    assert not np.isclose(other.at(IDS[:5], angle, stream(1)), first).any()

"""Kaplan-Meier estimates of the time until detection."""

import numpy as np
import pytest

from mast_zenoh.study.defences.intervals import kaplan_meier


def test_without_censoring_it_is_the_share_left() -> None:
    curve = kaplan_meier([1.0, 2.0, 3.0, 4.0], [True] * 4)
    assert curve.time_s.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert curve.undetected.tolist() == pytest.approx([1.0, 0.75, 0.5, 0.25, 0.0])
    assert curve.median_s == 2.0


def test_a_censored_time_counts_as_watched_until_then() -> None:
    # At 1 s one of four is detected; one is lost at 2 s; at 3 s one of the remaining two is detected.
    curve = kaplan_meier([1.0, 2.0, 3.0, 5.0], [True, False, True, False])
    assert curve.undetected.tolist() == pytest.approx([1.0, 0.75, 0.375, 0.375])
    assert curve.time_s.tolist() == [0.0, 1.0, 3.0, 5.0]
    assert (curve.median_s, curve.detections, curve.watched) == (3.0, 2, 4)


def test_the_median_is_unknown_if_fewer_than_half_are_detected() -> None:
    curve = kaplan_meier([1.0, 5.0, 6.0], [True, False, False])
    assert np.isnan(curve.median_s)
    assert curve.time_s[-1] == 6.0


def test_a_tie_of_detection_and_censoring_counts_both_as_watched() -> None:
    assert kaplan_meier([2.0, 2.0], [True, False]).undetected.tolist() == [1.0, 0.5]


def test_nothing_watched_is_an_empty_curve() -> None:
    curve = kaplan_meier([], [])
    assert (curve.time_s.tolist(), curve.undetected.tolist(), curve.watched) == ([0.0], [1.0], 0)


@pytest.mark.parametrize("times", [[-1.0], [float("nan")]])
def test_negative_and_unknown_times_are_refused(times: list[float]) -> None:
    with pytest.raises(ValueError, match="time_s"):
        kaplan_meier(times, [True])

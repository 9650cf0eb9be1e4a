"""Perception quality of objects: 0 to 15, from confidence, success and age."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.v2x import PerceptionQuality, quality_of_score

FRAME_NS = 100_000_000


def rated(quality: PerceptionQuality, frame: int, confidence: float, detected: bool = True, id_: int = 1) -> int:
    """The quality of one object in a frame of 100 ms."""
    ratings = quality.rate(frame * FRAME_NS, np.array([id_]), np.array([confidence]), np.array([detected]))
    return int(ratings[0])


def test_the_quality_of_a_score_is_rounded() -> None:
    assert quality_of_score(np.array([0.0, 0.2, 0.5, 1.0, 7.0])).tolist() == [0, 3, 8, 15, 15]


def test_a_certain_object_starts_at_ten_and_grows_to_fifteen_with_age() -> None:
    quality = PerceptionQuality()
    assert [rated(quality, frame, 1.0) for frame in range(18)] == [10 + min(frame, 15) // 3 for frame in range(18)]


def test_missed_detections_lower_the_quality_and_new_ones_raise_it() -> None:
    quality = PerceptionQuality()
    for frame in range(20):
        rated(quality, frame, 1.0)
    missed = [rated(quality, 20 + frame, 0.0, detected=False) for frame in range(3)]
    assert missed == [(15 + success + 15) // 3 for success in (7, 3, 1)], "the confidence stays"
    assert rated(quality, 23, 1.0) > missed[-1]


@given(confidence=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=30), alpha=st.floats(0.1, 1.0))
def test_the_quality_is_the_mean_of_three_ratings(confidence: list[float], alpha: float) -> None:
    quality = PerceptionQuality(alpha=alpha)
    average = confidence[0]
    for frame, value in enumerate(confidence):
        average = alpha * value + (1.0 - alpha) * average
        mean = (15.0 * average + 15.0 + min(frame, 15)) / 3.0
        assert rated(quality, frame, value) in {math.floor(mean - 1e-6), math.floor(mean + 1e-6)}


def test_objects_are_rated_apart_in_any_order() -> None:
    quality = PerceptionQuality()
    quality.rate(0, np.array([1, 2]), np.array([1.0, 0.0]))
    assert quality.rate(FRAME_NS, np.array([2, 3, 1]), np.array([0.0, 0.0, 1.0])).tolist() == [5, 5, 10]


def test_an_object_that_returns_after_it_was_forgotten_is_young() -> None:
    quality = PerceptionQuality(retention_s=1.0)
    for frame in range(16):
        rated(quality, frame, 1.0)
    assert rated(quality, 25, 1.0) == 15
    assert rated(quality, 36, 1.0) == 10


def test_memory_is_bounded() -> None:
    quality = PerceptionQuality(remembered=10)
    for frame in range(5):
        quality.rate(frame * FRAME_NS, np.arange(30) + 30 * frame, np.ones(30))
    assert len(quality._table) == 10


def test_invalid_parameters_are_refused() -> None:
    with pytest.raises(ValueError, match=r"alpha: found 0\.0, expected more than 0 and at most 1"):
        PerceptionQuality(alpha=0.0)

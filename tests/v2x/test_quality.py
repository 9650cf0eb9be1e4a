"""Perception quality of objects: 0 to 15."""

from __future__ import annotations

import numpy as np

from mast_zenoh.v2x import quality_of_score


def test_the_quality_of_a_score_is_rounded() -> None:
    assert quality_of_score(np.array([0.0, 0.2, 0.5, 1.0, 7.0])).tolist() == [0, 3, 8, 15, 15]

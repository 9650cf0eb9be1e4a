"""OSPA and GOSPA: by hand, by brute force, and against Stone Soup."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from metric_worlds import boxes

from mast_zenoh.metrics import SetDistance


def by_brute_force(x: np.ndarray, y: np.ndarray, how: SetDistance) -> tuple[float, float]:
    """OSPA and GOSPA of (n, 2) and (m, 2), from the definitions."""
    x, y = sorted((x, y), key=len)
    m, n = len(x), len(y)
    if n == 0:
        return 0.0, 0.0
    cut = np.minimum(np.linalg.norm(x[:, None] - y[None], axis=2), how.c) ** how.p
    least = min(sum(cut[i, j] for i, j in enumerate(chosen)) for chosen in permutations(range(n), m))
    missing = how.c**how.p * (n - m)
    return ((least + missing) / n) ** (1 / how.p), (least + missing / how.alpha) ** (1 / how.p)


def test_two_empty_sets_have_distance_zero_and_an_empty_and_a_full_one_c() -> None:
    ospa, gospa = SetDistance(c=5.0, p=2.0).of(boxes([(0.0, 0.0)] * 2, group=[1, 1]), boxes(np.zeros((0, 3))), 2)
    assert ospa.tolist() == [0.0, 5.0]
    assert gospa == pytest.approx([0.0, np.sqrt(2 * 25.0 / 2)])


places = st.lists(st.tuples(st.integers(0, 12), st.integers(0, 6)), max_size=5)


@settings(max_examples=150)
@given(
    frames=st.lists(st.tuples(places, places), min_size=1, max_size=4),
    p=st.sampled_from([1.0, 1.5, 2.0]),
    c=st.sampled_from([1.5, 3.0, 8.0]),
    alpha=st.sampled_from([0.5, 1.0, 2.0]),
)
def test_the_distance_is_minimal_over_all_assignments(frames, p: float, c: float, alpha: float) -> None:
    how = SetDistance(c=c, p=p, alpha=alpha)
    sets = [[np.array(estimate, float).reshape(-1, 2) for estimate in frame] for frame in frames]
    sides = [
        boxes(
            np.concatenate([frame[k] for frame in sets]), group=np.repeat(range(len(sets)), [len(f[k]) for f in sets])
        )
        for k in (0, 1)
    ]
    estimate = np.column_stack(how.of(*sides, len(sets)))
    assert estimate == pytest.approx(np.array([by_brute_force(x, y, how) for x, y in sets]), abs=1e-6)


@pytest.mark.parametrize("p", [1.0, 2.0])
def test_distances_equal_stone_soups(p: float) -> None:
    """Stone Soup's OSPA assigns by d, not by d^p, so only p = 1 is compared."""
    ospa = pytest.importorskip("stonesoup.metricgenerator.ospametric", reason="Stone Soup is not installed")
    from stonesoup.types.state import State

    rng = np.random.default_rng(0)
    for _ in range(20):
        sets = [rng.uniform(0.0, 15.0, (rng.integers(1, 9), 2)) for _ in range(2)]
        states = [[State(place.reshape(2, 1), timestamp=0) for place in places] for places in sets]
        ours = SetDistance(c=4.0, p=p).of(boxes(sets[0]), boxes(sets[1]), 1)
        if p == 1.0:
            stone_soup = ospa.OSPAMetric(p=p, c=4.0).compute_OSPA_distance(*states[::-1])
            assert ours[0] == pytest.approx([stone_soup.value])
        stone_soup, _ = ospa.GOSPAMetric(p=p, c=4.0).compute_gospa_metric(*states[::-1])
        assert ours[1] == pytest.approx([stone_soup.value["distance"]])

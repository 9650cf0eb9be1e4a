"""Where honest viewers outnumber malicious ones."""

from itertools import combinations

import numpy as np
import pytest

from mast_zenoh.study.defences import by_coverage, expected_honest_majority, honest_majority

#: Lidar returns of five objects at four agents.
POINTS = np.array([[9, 9, 9, 0], [9, 0, 0, 0], [9, 9, 0, 0], [0, 0, 9, 9], [4, 0, 0, 0]])


def test_everything_has_an_honest_majority_without_liars() -> None:
    assert honest_majority(POINTS, [False] * 4) == 1.0


def test_a_tie_is_no_majority() -> None:
    # Agent 0 lies: outnumbered at object 0 alone; tied at object 2, alone at object 1, absent at object 3.
    assert honest_majority(POINTS, [True, False, False, False]) == 2 / 4


def test_objects_that_nobody_sees_do_not_count() -> None:
    assert np.isnan(honest_majority(POINTS[4:], [False] * 4))
    assert np.isnan(expected_honest_majority(POINTS[4:], 1))


@pytest.mark.parametrize("count", range(4))
@pytest.mark.parametrize("eligible", [None, [False, True, True, True]])
def test_the_expectation_is_the_mean_over_all_choices(count: int, eligible: list[bool] | None) -> None:
    candidates = [index for index in range(4) if eligible is None or eligible[index]]
    shares = [
        honest_majority(POINTS, [index in liars for index in range(4)]) for liars in combinations(candidates, count)
    ]
    assert expected_honest_majority(POINTS, count, eligible) == pytest.approx(np.mean(shares))


def test_more_liars_than_agents_are_refused() -> None:
    with pytest.raises(ValueError, match="count: found 4, expected 0 to 3"):
        expected_honest_majority(POINTS, 4, [False, True, True, True])


def test_agents_that_cover_more_objects_come_first() -> None:
    assert by_coverage(POINTS).tolist() == [0, 1, 2, 3]
    assert by_coverage(POINTS[3:4]).tolist() == [2, 3, 0, 1]

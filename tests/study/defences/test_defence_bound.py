"""Where honest viewers outnumber malicious ones."""

import numpy as np

from mast_zenoh.study.defences.choices import by_coverage, honest_majority

#: Lidar returns of five objects at four agents.
POINTS = np.array([[9, 9, 9, 0], [9, 0, 0, 0], [9, 9, 0, 0], [0, 0, 9, 9], [4, 0, 0, 0]])


def test_everything_has_an_honest_majority_without_liars() -> None:
    assert honest_majority(POINTS, [False] * 4) == 1.0


def test_a_tie_is_no_majority() -> None:
    # Agent 0 lies: outnumbered at object 0 alone; tied at object 2, alone at object 1, absent at object 3.
    assert honest_majority(POINTS, [True, False, False, False]) == 2 / 4


def test_objects_that_nobody_sees_do_not_count() -> None:
    assert np.isnan(honest_majority(POINTS[4:], [False] * 4))


def test_agents_that_cover_more_objects_come_first() -> None:
    assert by_coverage(POINTS).tolist() == [0, 1, 2, 3]
    assert by_coverage(POINTS[3:4]).tolist() == [2, 3, 0, 1]

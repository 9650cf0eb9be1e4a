"""An object keeps the agents whose tracks have ever been in it."""

import numpy as np

from mast_zenoh.pipelines.origins import Origins

ALL = ["a", "b", "c"]


def one_hot(*names: str) -> np.ndarray:
    return np.array([[name == each for each in ALL] for name in names], bool).reshape(len(names), 3)


def test_origins_are_those_of_all_members_and_last_as_long_as_the_object() -> None:
    origins = Origins()
    first = origins.update(np.array([5, 9]), np.array([0, 0, 1]), one_hot("a", "b", "c"), ALL)
    assert first.tolist() == [[True, True, False], [False, False, True]]
    second = origins.update(np.array([5, 7]), np.array([0, 1, -1]), one_hot("c", "b", "a"), ALL)
    assert second.tolist() == [[True, True, True], [False, True, False]], "9 has gone, 7 is new"
    third = origins.update(np.array([5, 9]), np.zeros(0, np.int64), one_hot(), ALL)
    assert third.tolist() == [[True, True, True], [False, False, False]], "9 is another object now"


def test_agents_come_and_go() -> None:
    origins = Origins()
    origins.update(np.array([1]), np.array([0, 0]), one_hot("a", "c"), ALL)
    fewer = origins.update(np.array([1]), np.array([0]), np.array([[True]]), ["b"])
    assert fewer.tolist() == [[True]]

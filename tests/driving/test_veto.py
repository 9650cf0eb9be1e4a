"""The veto of own sensors: which objects a driver drives by, if its own sensors overrule the mission estimate."""

import numpy as np
import pytest

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.driving.driver import REFUTED_S, SAME_OBJECT_M, Refutations, overruled


def cars(*places: tuple[float, float]) -> ObjectStates:
    n = len(places)
    return ObjectStates.of(
        np.array([(x, y, 0.75) for x, y in places]).reshape(n, 3), size=np.tile([4.5, 1.8, 1.5], (n, 1))
    )


def believed(own: ObjectStates, mission: ObjectStates, *free: bool) -> list[tuple[float, float]]:
    mask = np.array(free or [False] * len(mission), np.bool_)
    before = mask.copy()
    objects = overruled(own, mission, mask)
    assert np.array_equal(mask, before), "inputs stay as they are"
    assert len(set(objects.id.tolist())) == len(objects)
    return [tuple(place) for place in objects.position[:, :2].tolist()]


def test_an_own_track_counts_whether_or_not_the_mission_estimate_has_it() -> None:
    assert believed(cars((20.0, 0.0)), cars()) == [(20.0, 0.0)]
    assert believed(cars((20.0, 0.0)), cars((60.0, 0.0))) == [(20.0, 0.0), (60.0, 0.0)]
    assert believed(cars((20.0, 0.0)), cars((21.0, 0.0)), True) == [(20.0, 0.0)], "even where it is seen through"


def test_an_object_that_nobody_else_contradicts_counts_unless_its_place_is_free() -> None:
    assert believed(cars(), cars((20.0, 0.0), (30.0, 0.0)), False, True) == [(20.0, 0.0)]


def test_an_own_track_stands_for_the_nearest_object_and_for_no_other() -> None:
    own = cars((20.0, 0.0))
    assert believed(own, cars((21.5, 0.0), (20.5, 0.0))) == [(20.0, 0.0), (21.5, 0.0)]
    assert believed(own, cars((20.0, SAME_OBJECT_M + 0.1))) == [(20.0, 0.0), (20.0, SAME_OBJECT_M + 0.1)]


@pytest.mark.parametrize("seed", range(5))
def test_what_is_believed_does_not_depend_on_the_order_of_objects(seed: int) -> None:
    random = np.random.default_rng(seed)
    own, mission = (cars(*random.uniform(0.0, 12.0, (n, 2)).tolist()) for n in (6, 9))
    free = random.random(9) < 0.4
    plain = believed(own, mission, *free)
    one, other = random.permutation(6), random.permutation(9)
    assert sorted(believed(own.select(one), mission.select(other), *free[other])) == sorted(plain)


def refuted(refutations: Refutations, time_s: float, **free: bool) -> str:
    """Of objects 0 to 9, in the order given, those that are refuted; free: whether each is seen through now."""
    ids = np.array([int(name[1:]) for name in free], np.int64)
    found = refutations.update(round(time_s * 1e9), ids, np.array(list(free.values()), np.bool_))
    return " ".join(str(id_) for id_ in ids[found])


def test_what_was_seen_through_stays_refuted_for_a_while_and_nothing_else() -> None:
    refutations = Refutations()
    assert refuted(refutations, 0.0, o1=True, o2=False) == "1"
    assert refuted(refutations, 0.5, o2=False, o1=False) == "1"
    assert refuted(refutations, 0.6, o2=False) == ""
    assert refuted(refutations, REFUTED_S, o1=False) == "1"
    assert refuted(refutations, REFUTED_S + 0.1, o1=False, o2=True) == "2"
    assert refuted(refutations, REFUTED_S + 0.2) == ""


def test_what_is_seen_through_again_stays_refuted_for_longer() -> None:
    refutations = Refutations()
    assert refuted(refutations, 0.0, o1=True) == refuted(refutations, 0.8 * REFUTED_S, o1=True) == "1"
    assert refuted(refutations, 1.6 * REFUTED_S, o1=False) == "1"

"""An object of the mission estimate keeps its id while its sources come, go and change theirs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.fusion.pipelines import MissionEstimator, OwnAndPicture, PictureFirst
from mast_zenoh.fusion.pipelines.mission import MAX_LOST, RETURNING_S

PERIOD_NS = 100_000_000
ESTIMATORS = pytest.mark.parametrize("estimator_type", [OwnAndPicture, PictureFirst])


def cars(*cars: tuple[int, float], speed: float = 0.0) -> ObjectStates:
    """Cars (id, x) on a line, with a variance of 0.04 m^2."""
    count = len(cars)
    covariance = np.tile(0.04 * np.eye(9), (count, 1, 1))
    position = np.array([[x, 0.0, 0.8] for _, x in cars]).reshape(-1, 3)
    velocity = np.tile([speed, 0.0, 0.0], (count, 1))
    return ObjectStates.of(position, velocity=velocity, covariance=covariance, id=np.array([i for i, _ in cars], int))


def ids(estimator: MissionEstimator, frame: int, own: ObjectStates, picture: ObjectStates) -> dict[float, int]:
    """The ids of the estimate by x, rounded."""
    mission = estimator.estimate(frame * PERIOD_NS, own, picture)
    return dict(zip(mission.position[:, 0].round().tolist(), mission.id.tolist(), strict=True))


@ESTIMATORS
def test_the_picture_takes_an_object_over_and_returns_it(estimator_type: type) -> None:
    estimator = estimator_type()
    sources = [([(7, 0.0)], []), ([(7, 0.0)], [(3, 0.3)]), ([], [(3, 0.3)]), ([(9, 0.1)], [(3, 0.3)]), ([(9, 0.1)], [])]
    seen = [ids(estimator, k, cars(*own), cars(*picture)) for k, (own, picture) in enumerate(sources)]
    assert len({each[0.0] for each in seen}) == 1


@ESTIMATORS
def test_an_object_that_the_picture_gets_as_the_own_track_is_lost_keeps_its_id(estimator_type: type) -> None:
    estimator = estimator_type()
    (first,) = ids(estimator, 0, cars((7, 0.0), speed=20.0), cars()).values()
    (then,) = ids(estimator, 1, cars(), cars((3, 2.3), speed=20.0)).values()
    assert first == then


@ESTIMATORS
def test_an_object_elsewhere_gets_a_new_id(estimator_type: type) -> None:
    estimator = estimator_type()
    (first,) = ids(estimator, 0, cars((7, 0.0)), cars()).values()
    (then,) = ids(estimator, 1, cars(), cars((3, 5.0))).values()
    assert first != then


@ESTIMATORS
def test_where_both_part_the_id_stays_where_the_object_should_be(estimator_type: type) -> None:
    """The own track jumps to another object."""
    estimator = estimator_type()
    before = ids(estimator, 0, cars((7, 0.0)), cars((3, 0.0)))
    after = ids(estimator, 1, cars((7, 4.0)), cars((3, 0.0)))
    assert after[0.0] == before[0.0]
    assert after[4.0] != before[0.0]


@ESTIMATORS
def test_the_picture_does_not_rename_what_the_agent_sees(estimator_type: type) -> None:
    estimator = estimator_type()
    before = ids(estimator, 0, cars((7, 0.0)), cars((3, 10.0)))
    together = [ids(estimator, k, cars((7, 0.0)), cars((3, 0.4))) for k in range(1, 8)]
    assert {each[0.0] for each in together} == {before[0.0]}
    assert ids(estimator, 8, cars(), cars((3, 0.4)))[0.0] == before[0.0], "it continues as the own track did"


@ESTIMATORS
def test_of_two_objects_that_are_one_the_id_of_the_picture_stays(estimator_type: type) -> None:
    """Own track and picture have had the same thing as two objects, too far apart for a pair."""
    estimator = estimator_type()
    before = ids(estimator, 0, cars((7, 0.0)), cars((3, 2.2)))
    together = ids(estimator, 1, cars((7, 0.4)), cars((3, 1.0)))
    assert list(together.values()) == [before[2.0]]


@ESTIMATORS
def test_an_own_track_that_returns_after_seconds_has_its_id_again(estimator_type: type) -> None:
    estimator = estimator_type()
    before = ids(estimator, 0, cars((7, 0.0)), cars())
    for frame in range(1, 25):
        ids(estimator, frame, cars(), cars())
    assert list(ids(estimator, 25, cars((9, 0.3)), cars()).values()) == list(before.values())


@ESTIMATORS
def test_meetings_now_and_then_do_not_settle_who_the_object_is(estimator_type: type) -> None:
    estimator = estimator_type()
    before = ids(estimator, 0, cars((7, 0.0)), cars((3, 10.0)))
    for frame in range(1, 41):
        ids(estimator, frame, cars((7, 0.0)), cars((3, 0.4 if frame % 4 == 0 else 10.0)))
    after = ids(estimator, 41, cars((7, 0.0)), cars((3, 10.0)))
    assert after == before


@ESTIMATORS
def test_thousands_of_new_objects_in_each_frame_take_little_time_and_memory(estimator_type: type) -> None:
    estimator = estimator_type()
    for frame in range(4):
        crowd = cars(*((frame * 3000 + k, 3.0 * k + frame) for k in range(3000)))
        assert len(ids(estimator, frame, cars((frame, 0.0)), crowd)) >= 3000
    assert len(estimator._pairs._ids._lost) <= MAX_LOST


@ESTIMATORS
def test_an_object_away_for_long_is_a_new_one(estimator_type: type) -> None:
    estimator = estimator_type()
    (first,) = ids(estimator, 0, cars((7, 0.0)), cars()).values()
    frames = int(RETURNING_S * 1e9) // PERIOD_NS + 2
    (then,) = ids(estimator, frames, cars((8, 0.0)), cars()).values()
    assert first != then


@ESTIMATORS
@given(st.data())
def test_ids_are_unique_and_independent_of_the_order_of_the_rows(estimator_type: type, data: st.DataObject) -> None:
    estimators = estimator_type(), estimator_type()
    for frame in range(4):
        both = []
        for _ in range(2):
            car = st.tuples(st.integers(0, 5), st.floats(-8.0, 8.0))
            both.append(data.draw(st.lists(car, unique_by=lambda each: each[0], max_size=5)))
        orders = [both, [data.draw(st.permutations(one)) for one in both]]
        results = []
        for estimator, (own, picture) in zip(estimators, orders, strict=True):
            mission = estimator.estimate(frame * PERIOD_NS, cars(*own), cars(*picture))
            assert len(set(mission.id.tolist())) == len(mission)
            results.append(sorted(zip(mission.id.tolist(), mission.position[:, 0].tolist(), strict=True)))
        assert results[0] == results[1]


def test_a_precise_own_track_outweighs_a_vague_picture() -> None:
    own, picture = cars((1, 0.0)), cars((1, 1.0))
    vague = picture.with_(covariance=9.0 * picture.covariance)
    mission = OwnAndPicture().estimate(0, own, vague)
    weight = 0.36 / (0.36 + 0.04)
    assert mission.position[0, 0] == pytest.approx(1.0 - weight)
    assert np.diag(mission.covariance[0])[0] == pytest.approx(weight * 0.04 + (1.0 - weight) * 0.36)


def test_what_the_agent_saw_before_the_picture_was_made_counts_once() -> None:
    """A track that is not updated adds nothing to a picture that has it; one that has just moved moves the object."""
    estimator = OwnAndPicture()
    own, picture = cars((1, 0.0)), cars((1, 0.02))
    estimator.estimate(0, own, picture)
    coasting = own.with_(covariance=2.0 * own.covariance)
    assert estimator.estimate(PERIOD_NS, coasting, picture).position[0, 0] == pytest.approx(0.02, abs=1e-3)
    after = estimator.estimate(2 * PERIOD_NS, cars((1, 0.2)), picture)
    assert after.position[0, 0] > 0.04


def test_more_of_an_own_track_is_new_to_an_older_picture() -> None:
    """A car drives off: the own track has followed it, the picture has not yet."""
    places = {}
    for made in (0, 2):
        estimator = OwnAndPicture()
        for frame in range(4):
            estimator.date_picture(made * PERIOD_NS)
            own = cars((1, 0.03 * frame))
            mission = estimator.estimate(frame * PERIOD_NS, own, cars((1, 0.0)))
        places[made] = float(mission.position[0, 0])
    assert places[0] > places[2]


def test_an_own_track_that_returns_does_not_rename_what_the_picture_continued() -> None:
    estimator = OwnAndPicture()
    ids(estimator, 0, cars((7, 0.0)), cars((3, 10.0)))
    before = ids(estimator, 1, cars(), cars((3, 10.0)))
    after = ids(estimator, 2, cars((7, 10.2)), cars((3, 10.0)))
    assert after[10.0] == before[10.0]


@pytest.mark.parametrize("claimed", [-0.159, 0.0, 1e-9])
def test_a_picture_that_claims_to_be_exact_does_not_outweigh_an_own_track(claimed: float) -> None:
    own, picture = cars((1, 0.0)), cars((1, 1.0))
    exact = picture.with_(covariance=np.tile(claimed * np.eye(9), (1, 1, 1)))
    mission = OwnAndPicture().estimate(0, own, exact)
    assert mission.position[0, 0] == pytest.approx(0.8), "0.04 + 0.04 against 0.01 + 0.01 m^2"
    assert np.linalg.eigvalsh(mission.covariance[0]).min() > 0.0

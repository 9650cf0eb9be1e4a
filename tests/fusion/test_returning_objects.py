"""Objects keep their ids when they are out of view for seconds, and next to others."""

import numpy as np
import pytest
from tracked_objects import MATURE, STEP_S, cars, centre, nanoseconds

from mast_zenoh.arrays.states import CLASS_INDEX, ObjectStates, concatenate
from mast_zenoh.fusion.group_tracking import RETURN_GATE, ReturningObjects
from mast_zenoh.fusion.pipelines import CommandCenterPipeline
from mast_zenoh.tracking import classes
from mast_zenoh.tracking.kalman import process_noise
from mast_zenoh.tracking.tracks import known_class

LOST_S = 4.0


def pictured_ids(pipeline: CommandCenterPipeline, hidden_s: float, speed: float, turn: float = 0.0) -> set[int]:
    """The ids of a car that two agents do not see for some time, in which it turns; their own tracks begin anew."""
    random, place, heading, ids = np.random.default_rng(0), np.zeros(2), 0.0, set()
    for frame in range(120):
        elapsed = STEP_S * frame - LOST_S
        hidden = 0.0 <= elapsed < hidden_s
        heading += turn * STEP_S * hidden
        velocity = speed * np.array([np.cos(heading), np.sin(heading)])
        place = place + STEP_S * velocity
        seen = [
            cars(
                place + random.normal(0, 0.1, (1, 2)),
                velocity + random.normal(0, 0.3, (1, 2)),
                id=np.array([int(elapsed >= 0)]),
            )
            for _ in range(2)
            if not hidden
        ]
        picture, _ = pipeline.step(
            nanoseconds(frame), concatenate(seen) if seen else ObjectStates.empty(), np.arange(len(seen)), ("a", "b")
        )
        ids.update(picture.id.tolist() if seen else [])
    return ids


@pytest.mark.parametrize(("hidden_s", "speed", "turn"), [(3.0, 10.0, 0.0), (3.0, 0.0, 0.0), (3.0, 8.0, 0.2)])
def test_an_object_that_returns_after_three_seconds_keeps_its_id(hidden_s, speed, turn):
    assert pictured_ids(centre(), hidden_s, speed, turn) == {0}


def test_without_memory_or_after_it_an_object_has_a_new_id():
    assert pictured_ids(centre(id_memory_s=0.0), 3.0, 10.0) == {0, 1}
    assert pictured_ids(centre(), 4.5, 10.0) == {0, 1}


def test_parked_cars_whose_boxes_nearly_touch_keep_their_ids():
    """Two metres from centre to centre, boxes 1.8 m wide, seen by three agents with errors of 0.2 m per axis."""
    random, pipeline = np.random.default_rng(1), centre()
    place = np.array([[0.0, 0.0], [0.0, 2.0], [0.0, 4.0]])
    for frame in range(100):
        seen = [cars(place + random.normal(0, 0.2, (3, 2)), id=np.arange(3)) for _ in range(3)]
        picture, support = pipeline.step(
            nanoseconds(frame), concatenate(seen), np.repeat(np.arange(3), 3), ("a", "b", "c")
        )
        if frame > 1:
            assert picture.id.tolist() == [0, 1, 2]
            assert support.min() >= 2


def given(
    returning: ReturningObjects, time_s: float, *objects: tuple[int, float, float, float], name: str = "car"
) -> list:
    """The ids of the tracker's objects (id, x, y, speed along x)."""
    values = np.array(objects, float).reshape(-1, 4)
    velocity = np.column_stack([values[:, 3], np.zeros(len(values))])
    picture = cars(values[:, 1:3], velocity, kind=name, id=values[:, 0].astype(int))
    return returning.ids_for(round(time_s * 1e9), picture).tolist()


def test_only_an_object_that_can_be_the_lost_one_takes_its_id():
    for returned, expected in [
        ((7, 20.0, 0.0, 10.0), 0),  # where and as fast as expected after two seconds
        ((7, 20.0, 14.0, 10.0), 7),  # too far aside
        ((7, 20.0, 0.0, -10.0), 7),  # the other way
    ]:
        returning = ReturningObjects(4.0)
        assert given(returning, 0.0, (0, 0.0, 0.0, 10.0)) == [0]
        assert given(returning, 0.1) == []
        assert given(returning, 2.0, returned) == [expected]
        assert given(returning, 2.1, returned) == [expected]
    returning = ReturningObjects(4.0)
    given(returning, 0.0, (0, 0.0, 0.0, 1.0))
    assert given(returning, 1.0, (7, 1.0, 0.0, 1.0), name="pedestrian") == [7]


def test_of_two_lost_objects_each_gets_its_own_id():
    returning = ReturningObjects(4.0)
    given(returning, 0.0, (3, 0.0, 0.0, 0.0), (5, 0.0, 3.0, 0.0))
    given(returning, 0.1)
    assert given(returning, 2.0, (8, 0.0, 3.1, 0.0), (9, 0.0, 0.1, 0.0)) == [5, 3]


def test_no_id_is_given_twice_when_the_tracker_continues_a_lost_one():
    returning = ReturningObjects(4.0)
    given(returning, 0.0, (0, 0.0, 0.0, 0.0))
    given(returning, 0.1)
    assert given(returning, 1.0, (1, 0.2, 0.0, 0.0)) == [0]
    assert sorted(given(returning, 1.1, (0, 2.5, 0.0, 0.0), (1, 0.2, 0.0, 0.0))) == [0, 1]
    both = given(returning, 1.2, (0, 2.5, 0.0, 0.0), (1, 0.2, 0.0, 0.0))
    assert given(returning, 1.3, (0, 2.5, 0.0, 0.0), (1, 0.2, 0.0, 0.0)) == both


def test_an_object_whose_id_the_tracker_continues_takes_its_own():
    """Object 9 has returned as 4, so that two of the tracker's ids are free."""
    returning = ReturningObjects(4.0)
    given(returning, 0.0, (0, 0.0, 0.0, 0.0), (4, 0.0, 50.0, 0.0))
    given(returning, 0.1)
    assert given(returning, 1.0, (1, 0.2, 0.0, 0.0), (9, 0.2, 50.0, 0.0)) == [0, 4]
    assert given(returning, 1.1, (0, 2.5, 0.0, 0.0), (1, 0.2, 0.0, 0.0), (9, 0.2, 50.0, 0.0)) == [0, 1, 4]


@pytest.mark.parametrize("lost_s", [0.5, 3.0])
def test_an_object_returns_as_far_away_as_the_process_noise_of_the_tracker_allows(lost_s: float):
    rows = np.array([0, 1, 6, 7])
    density = classes.ACCELERATION[known_class(np.array([CLASS_INDEX["car"]], np.uint8))]
    motion, move = MATURE[np.ix_(rows, rows)], np.eye(4)
    move[:2, 2:] = lost_s * np.eye(2)
    noise = process_noise(lost_s, density, 1.0, 1.0)[0][np.ix_(rows, rows)]
    farthest = np.sqrt(RETURN_GATE / np.linalg.inv(move @ motion @ move.T + noise + motion)[0, 0])
    for distance, expected in [(0.999 * farthest, 0), (1.001 * farthest, 7)]:
        returning = ReturningObjects(LOST_S)
        given(returning, 0.0, (0, 0.0, 0.0, 0.0))
        assert given(returning, lost_s, (7, distance, 0.0, 0.0)) == [expected]

"""The newest tracks that were heard from others, and the agents whose tracks have ever been in an object."""

import numpy as np

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.fusion.pipelines.collation import Origins
from mast_zenoh.fusion.pipelines.heard import HeardTracks

PERIOD_NS = 100_000_000


def tracks(*ids: int, x: float = 0.0, speed: float = 10.0) -> ObjectStates:
    n = len(ids)
    position = np.column_stack([np.full(n, x), np.array(ids, float), np.zeros(n)])
    return ObjectStates.of(
        position,
        id=np.array(ids, np.int64),
        size=np.ones((n, 3)),
        velocity=np.tile([speed, 0.0, 0.0], (n, 1)),
        yaw=np.zeros(n),
    )


def of(heard: HeardTracks, sender: str, time_ns: int) -> ObjectStates:
    names, states, rows = heard.at(time_ns)
    return states.select(rows == names.index(sender))


def test_a_message_is_predicted_to_the_present() -> None:
    heard = HeardTracks()
    heard.add("a", 3 * PERIOD_NS, tracks(1))
    np.testing.assert_allclose(of(heard, "a", 4 * PERIOD_NS).position[0], [1.0, 1.0, 0.0])


def test_the_newest_message_of_a_sender_replaces_all_its_objects_whatever_comes_later() -> None:
    for messages in ([(0, (1, 2)), (1, (2,))], [(1, (2,)), (0, (1,)), (1, (3,))]):
        heard = HeardTracks()
        for frame, ids in messages:
            heard.add("a", frame * PERIOD_NS, tracks(*ids))
        assert of(heard, "a", 2 * PERIOD_NS).id.tolist() == [2]


def test_with_a_memory_an_object_that_was_left_out_is_kept_for_that_long() -> None:
    heard = HeardTracks(memory_s=0.25)
    heard.add("a", 0, tracks(1, 2))
    seen = []
    for frame in range(1, 5):
        heard.add("a", frame * PERIOD_NS, tracks(2))
        seen.append(sorted(of(heard, "a", (frame + 1) * PERIOD_NS).id.tolist()))
    assert seen == [[1, 2], [1, 2], [2], [2]]


def test_tracks_of_different_times_are_all_predicted_and_stay_with_their_senders() -> None:
    heard = HeardTracks(memory_s=1.0)
    heard.add("b", 0, tracks(4, 5))
    heard.add("a", 0, tracks(2, 1))
    heard.add("b", PERIOD_NS, tracks(5))
    names, states, sender = heard.at(2 * PERIOD_NS)
    assert names == ("a", "b")
    assert list(zip(sender.tolist(), states.id.tolist(), strict=True)) == [(0, 2), (0, 1), (1, 5), (1, 4)]
    np.testing.assert_allclose(states.position[:, 0], [2.0, 2.0, 1.0, 2.0])


def test_what_is_too_old_is_not_used() -> None:
    heard = HeardTracks(max_age_s=0.3)
    heard.add("a", 0, tracks(1))
    assert heard.at(3 * PERIOD_NS).names == ("a",)
    assert heard.at(4 * PERIOD_NS).names == ()


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

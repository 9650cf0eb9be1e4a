"""What is heard of other agents, whatever the order in which it arrived."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.pipelines.heard import HeardTracks

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


def test_a_message_is_used_from_the_frame_after_its_arrival() -> None:
    heard = HeardTracks()
    heard.add("a", 3, 3 * PERIOD_NS, tracks(1))
    assert heard.at(3, 3 * PERIOD_NS) == {}
    states = heard.at(4, 4 * PERIOD_NS)["a"]
    np.testing.assert_allclose(states.position[0], [1.0, 1.0, 0.0])


def test_a_new_message_replaces_all_objects_of_its_sender() -> None:
    heard = HeardTracks()
    heard.add("a", 0, 0, tracks(1, 2))
    heard.add("a", 1, PERIOD_NS, tracks(2))
    assert heard.at(2, 2 * PERIOD_NS)["a"].id.tolist() == [2]


def test_with_a_memory_an_object_that_was_left_out_is_kept_for_that_long() -> None:
    heard = HeardTracks(memory_s=0.25)
    heard.add("a", 0, 0, tracks(1, 2))
    seen = {}
    for frame in range(1, 5):
        heard.add("a", frame, frame * PERIOD_NS, tracks(2))
        seen[frame + 1] = sorted(heard.at(frame + 1, (frame + 1) * PERIOD_NS)["a"].id.tolist())
    assert seen == {2: [1, 2], 3: [1, 2], 4: [2], 5: [2]}


def test_what_is_too_old_is_not_used() -> None:
    heard = HeardTracks(max_age_s=0.3)
    heard.add("a", 0, 0, tracks(1))
    assert set(heard.at(3, 3 * PERIOD_NS)) == {"a"}
    assert heard.at(4, 4 * PERIOD_NS) == {}


@given(st.permutations(range(6)), st.sampled_from([0.0, 0.25]))
def test_the_order_of_arrival_within_a_frame_does_not_matter(order: list[int], memory_s: float) -> None:
    messages = [("a", 0, tracks(1, 2)), ("a", 1, tracks(2)), ("a", 1, tracks(3)), ("b", 1, tracks(4))]
    messages += [("b", 0, tracks(5)), ("a", 2, tracks(6, x=9.0))]
    results = []
    for each in (range(6), order):
        heard = HeardTracks(memory_s)
        for row in each:
            sender, frame, states = messages[row]
            heard.add(sender, 2, frame * PERIOD_NS, states)
        results.append(heard.at(3, 3 * PERIOD_NS))
    one, other = results
    assert one.keys() == other.keys()
    for sender in one:
        assert one[sender].id.tolist() == other[sender].id.tolist()
        assert one[sender].position.tobytes() == other[sender].position.tobytes()


def test_invalid_times_are_refused() -> None:
    with pytest.raises(ValueError, match=r"memory_s: found -1\.0, expected 0 or more"):
        HeardTracks(-1.0)

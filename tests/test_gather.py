"""Gathering depends on the set of messages, never on their order."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.gather import CollationBuffer, Gather, LatestBefore, Newest, plausible_rows

messages = st.lists(st.tuples(st.integers(0, 4), st.sampled_from("abc")), max_size=12, unique=True)  # (frame, member)


@given(messages, st.randoms(use_true_random=False))
def test_a_gathered_frame_does_not_depend_on_the_order_of_its_items(items: list, random) -> None:
    def outcome(order: list) -> dict:
        gather: Gather[str, tuple] = Gather("abc")
        ready = {frame: done for frame, member in order if (done := gather.add(frame, member, (frame, member)))}
        return {"ready": ready, "left": dict(gather.expired(5))}

    shuffled = list(items)
    random.shuffle(shuffled)
    assert outcome(items) == outcome(shuffled)


def test_a_frame_is_complete_when_all_members_have_contributed_once() -> None:
    gather: Gather[str, int] = Gather({"a", "b"})
    assert gather.add(0, "a", 1) is None
    assert gather.add(0, "a", 9) is None, "ignored, and counted"
    assert gather.add(0, "b", 2) == {"a": 1, "b": 2}
    assert gather.add(0, "b", 3) is None
    assert gather.duplicates == 2


def test_an_incomplete_frame_expires_at_the_next_clock() -> None:
    gather: Gather[str, int] = Gather({"a", "b"})
    gather.add(0, "a", 1)
    assert list(gather.expired(0)) == []
    assert list(gather.expired(1)) == [(0, {"a": 1})]
    assert gather.add(0, "b", 2) is None, "later items are too late"
    assert list(gather.expired(9)) == []


@given(st.permutations(list(range(6))), st.integers(0, 7))
def test_the_latest_item_before_a_frame_is_independent_of_order_and_of_the_frame(order: list, frame: int) -> None:
    latest: LatestBefore[int] = LatestBefore()
    for item in order:
        latest.add(item, item)
    earlier = [f for f in range(6) if f < frame]
    assert latest.get(frame) == ((earlier[-1], earlier[-1]) if earlier else None)


@given(
    st.lists(st.tuples(st.sampled_from("abc"), st.integers(0, 9)), unique=True, max_size=20),
    st.integers(0, 9),
    st.integers(1, 4),
    st.randoms(use_true_random=False),
)
def test_a_batch_does_not_depend_on_the_order_of_arrival(items: list, at: int, capacity: int, random) -> None:
    def batch(order: list) -> tuple:
        buffer: CollationBuffer[tuple] = CollationBuffer(capacity)
        for agent, frame in order:
            buffer.push(agent, frame, (agent, frame))
        return buffer.present(at), buffer.pop(at), buffer.dropped

    shuffled = list(items)
    random.shuffle(shuffled)
    assert batch(items) == batch(shuffled)


def test_a_full_buffer_drops_the_oldest() -> None:
    buffer: CollationBuffer[str] = CollationBuffer(capacity=3)
    for frame in (4, 1, 2, 3):
        buffer.push("ego", frame, f"of {frame}")
    assert buffer.dropped == 1
    assert buffer.pop(1) == {}
    assert buffer.pop(3) == {"ego": "of 3"}
    assert buffer.pop(9) == {"ego": "of 4"}


def test_an_item_after_its_batch_is_late_and_in_the_next_one_unless_one_of_its_sender_was_newer() -> None:
    buffer: CollationBuffer[str] = CollationBuffer()
    buffer.push("ego", 10, "in time")
    assert buffer.pop(10) == {"ego": "in time"}
    assert buffer.push("infra_1", 9, "late")
    assert buffer.push("infra_1", 10, "later")
    assert not buffer.push("ego", 9, "overtaken")
    assert buffer.late == {"infra_1": 2, "ego": 1}
    assert buffer.pop(20) == {"infra_1": "later"}


def test_a_duplicate_changes_nothing_and_is_never_late() -> None:
    buffer: CollationBuffer[str] = CollationBuffer()
    assert buffer.push("ego", 10, "first")
    assert not buffer.push("ego", 10, "second")
    assert buffer.pop(10) == {"ego": "first"}
    assert not buffer.push("ego", 10, "third")
    assert buffer.push("infra_1", 9, "late")
    assert not buffer.push("infra_1", 9, "late twice")
    assert (buffer.duplicates, buffer.late, buffer.pop(20)) == (3, {"infra_1": 1}, {"infra_1": "late"})


def test_a_duplicate_of_a_waiting_item_is_recognised() -> None:
    buffer: CollationBuffer[object] = CollationBuffer(capacity=2)
    incomparable = object()
    assert buffer.push("ego", 10**9, incomparable)
    for frame in range(200):
        buffer.push("ego", frame, object())
    assert not buffer.push("ego", 10**9, object())
    assert buffer.pop(10**9) == {"ego": incomparable}


def test_an_item_about_the_future_does_not_stand_before_those_about_the_present() -> None:
    latest: LatestBefore[str] = LatestBefore()
    latest.add(5, "of 15, forged", about=15)
    latest.add(5, "of 5")
    assert latest.get(6) == (5, "of 5")
    latest.add(6, "of 16, forged", about=16)
    latest.add(7, "of 7")
    assert [latest.get(frame) for frame in (7, 8)] == [(5, "of 5"), (7, "of 7")]


def test_the_newest_earlier_item_refers_to_the_latest_frame() -> None:
    latest: LatestBefore[str] = LatestBefore()
    latest.add(5, "of 5")
    latest.add(6, "of 3, held up", about=3)
    assert latest.get(7) == (5, "of 5")
    latest.add(7, "of 6", about=6)
    assert latest.get(7) == (5, "of 5"), "items of this frame count from the next"
    assert latest.get(8) == (7, "of 6")


def test_the_item_about_the_latest_frame_is_kept() -> None:
    for order in itertools.permutations([(1, "a"), (3, "b"), (2, "c")]):
        latest: LatestBefore[str] = LatestBefore()
        for about, item in order:
            latest.add(4, item, about=about)
        latest.add(4, "a duplicate", about=3)
        assert latest.get(5) == (4, "b")


def test_a_frame_is_complete_with_items_of_all_agents() -> None:
    buffer: CollationBuffer[str] = CollationBuffer()
    buffer.push("a", 3, "of a")
    assert buffer.complete(3, {"a"})
    assert not buffer.complete(3, {"a", "b"})
    buffer.push("b", 2, "older")
    assert not buffer.complete(3, {"a", "b"})
    buffer.push("b", 3, "of b")
    assert buffer.complete(3, {"a", "b"})
    assert buffer.complete(3, set())


def test_tracks_beyond_all_bounds_or_of_negative_size_are_implausible() -> None:
    states = ObjectStates.of(np.zeros((5, 3)), size=np.full((5, 3), 2.0))
    states.size[1, 0], states.size[2] = -2.0, 0.0
    assert plausible_rows(states).tolist() == [0, 2, 3, 4], "an unknown size may be 0"
    states.position[3, 0] = 1e300
    assert plausible_rows(states).tolist() == [0, 2, 4]


def test_the_newest_item_of_a_publisher_counts_until_it_is_too_old() -> None:
    newest: Newest[str] = Newest(max_age_s=0.2)
    for time_ns, item in ((300, "first"), (100, "late"), (300, "same time"), (400, "newest")):
        newest.add("ego", time_ns * 1_000_000, item)
    newest.add("infra_1", 900_000_000, "from the future")
    assert newest.at(600_000_000) == {"ego": (200_000_000, "newest")}
    assert newest.at(400_000_000) == {"ego": (0, "newest")}
    assert newest.at(700_000_000) == {}

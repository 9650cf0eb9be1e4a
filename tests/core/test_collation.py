"""What is gathered depends on the set of messages, never on their order."""

from hypothesis import given, settings
from hypothesis import strategies as st

from mast_zenoh.fusion.collation import CollationBuffer, Gather, LatestBefore

messages = st.lists(st.tuples(st.integers(0, 4), st.sampled_from("abc")), max_size=12, unique=True)  # (frame, member)


@given(messages, st.randoms(use_true_random=False))
@settings(max_examples=200)
def test_a_gathered_frame_does_not_depend_on_the_order_of_its_items(items: list, random) -> None:
    def outcome(order: list) -> dict:
        gather: Gather[str, tuple] = Gather("abc")
        ready = {frame: done for frame, member in order if (done := gather.add(frame, member, (frame, member)))}
        return {"ready": ready, "left": dict(gather.flush())}

    shuffled = list(items)
    random.shuffle(shuffled)
    assert outcome(items) == outcome(shuffled)


def test_a_frame_is_ready_when_everyone_has_spoken() -> None:
    gather: Gather[str, int] = Gather({"pose", "detections"})
    assert gather.add(0, "pose", 1) is None
    assert gather.add(0, "detections", 2) == {"pose": 1, "detections": 2}


def test_an_incomplete_frame_is_given_up_when_the_next_clock_comes() -> None:
    gather: Gather[str, int] = Gather({"a", "b"})
    gather.add(0, "a", 1)
    assert list(gather.expired(0)) == []
    assert list(gather.expired(1)) == [(0, {"a": 1})]
    assert gather.add(0, "b", 2) is None, "what comes later is too late"
    assert list(gather.flush()) == []


def test_a_second_item_of_one_member_is_left_out_and_counted() -> None:
    gather: Gather[str, int] = Gather({"a", "b"})
    gather.add(0, "a", 1)
    gather.add(0, "a", 9)
    assert gather.add(0, "b", 2) == {"a": 1, "b": 2}
    assert gather.duplicates == 1


@given(st.permutations(list(range(6))), st.integers(0, 7))
def test_the_latest_before_a_frame_does_not_depend_on_order_nor_on_the_frame_itself(order: list, frame: int) -> None:
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
@settings(max_examples=200)
def test_a_batch_does_not_depend_on_the_order_of_arrival(items: list, at: int, capacity: int, random) -> None:
    def batch(order: list) -> tuple:
        buffer: CollationBuffer[tuple] = CollationBuffer(capacity)
        for agent, time_ns in order:
            buffer.push(agent, time_ns, (agent, time_ns))
        return buffer.present(at), buffer.pop(at), buffer.dropped

    shuffled = list(items)
    random.shuffle(shuffled)
    assert batch(items) == batch(shuffled)


def test_a_full_buffer_drops_the_oldest() -> None:
    buffer: CollationBuffer[str] = CollationBuffer(capacity=3)
    for time_ns in (4, 1, 2, 3):
        buffer.push("ego", time_ns, f"at {time_ns}")
    assert buffer.dropped == 1
    assert buffer.pop(1) == {}
    assert buffer.pop(3) == {"ego": (3, "at 3")}
    assert buffer.pop(9) == {"ego": (4, "at 4")}


def test_what_comes_after_its_batch_is_counted_as_late() -> None:
    buffer: CollationBuffer[str] = CollationBuffer()
    buffer.push("ego", 10, "in time")
    assert buffer.pop(10) == {"ego": (10, "in time")}
    assert not buffer.push("infra_1", 10, "late")
    assert buffer.late == {"infra_1": 1}
    assert buffer.pop(20) == {}

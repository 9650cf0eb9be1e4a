"""Answers belong to frames by their stamps; what answers nothing is counted; silence is not waited for, for ever."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mast_ros2 import frame_exchange
from mast_ros2.frame_exchange import TF, TF_STATIC, About, AnswerTopic, FrameExchange, Timing
from mast_ros2.object_messages import tracked_objects
from mast_ros2.received_objects import ReceivedObjects, received_tracks
from mast_ros2.received_poses import FrameTransforms, Placement
from mast_ros2.spatial import Transform, transform_message
from mast_ros2.type_store import TF_MESSAGE, TRACKED_OBJECTS, decode, encode
from ros2_messages import RosLink, random_states

from mast_zenoh import outside
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.errors import MessageError

PERIOD_NS = 100_000_000
TOPIC = "/answers"
STATES = random_states(np.random.default_rng(0), 3)


def use(received: ReceivedObjects[ObjectStates], about: About, placement: Placement) -> tuple[Any, ...]:
    return len(received.objects), about.skew_ns, placement.position.tolist()


def exchange(**timing: Any) -> FrameExchange:
    topic = AnswerTopic(TOPIC, TRACKED_OBJECTS, received_tracks, use)
    return FrameExchange([topic], FrameTransforms("map"), Timing(**timing))


def about(time_ns: int, frame_id: str = "map", states: ObjectStates = STATES) -> tuple[str, Any]:
    """An answer with this stamp."""
    return TOPIC, tracked_objects(states, time_ns, frame_id)


def ask(answers: FrameExchange, link: RosLink, frame: int, arriving: Iterable[tuple[str, Any]] = ()) -> list[Any]:
    """Begin a frame and ask about it; these messages arrive then. Returns (frame, late, content) of the answers."""
    answers.begin(frame, frame * PERIOD_NS)
    answers.ask(link, frame, [TOPIC])
    for message in arriving:
        link.arrive(*message)
    return [(each.about.frame, each.about.late, each.content) for each in answers.collect(link, frame)]


def counts(answers: FrameExchange, link: RosLink) -> dict[str, Any]:
    result = answers.results(link)
    return {name: result[name] for name in ("asked", "answered", "late", "unanswered")}


def test_the_answer_with_the_stamp_of_the_frame_is_used_once() -> None:
    answers, link = exchange(), RosLink()
    used = ask(answers, link, 5, [about(5 * PERIOD_NS), about(5 * PERIOD_NS)])
    assert used == [(5, False, (3, 0, [0.0, 0.0, 0.0]))]
    assert answers.refused == {"duplicate": 1}
    assert link.waited_s == []
    assert counts(answers, link) == {"asked": 1, "answered": 1, "late": 0, "unanswered": 0}


@pytest.mark.parametrize(("skew_ns", "frame"), [(30_000_000, 7), (-40_000_000, 7), (60_000_000, 8)])
def test_a_stamp_between_frames_belongs_to_the_nearest_one(skew_ns: int, frame: int) -> None:
    answers, link = exchange(), RosLink(waits=False)
    for number in (7, 8):
        ask(answers, link, number)
    link.arrive(*about(7 * PERIOD_NS + skew_ns))
    (answer,) = answers.collect(link, -1)
    skewed = skew_ns if frame == 7 else skew_ns - PERIOD_NS
    assert (answer.about.frame, answer.about.skew_ns, answer.content[1]) == (frame, skewed, skewed)


@pytest.mark.parametrize("stamp_ns", [0, 5 * PERIOD_NS + 20_000_001, 2_000_000_000 * 10**9], ids=str)
def test_a_stamp_far_from_all_frames_is_refused(stamp_ns: int) -> None:
    answers, link = exchange(skew_s=0.02), RosLink()
    assert ask(answers, link, 5, [about(stamp_ns)]) == []
    assert answers.refused == {"stamp": 1}


def test_an_answer_that_comes_in_the_next_frame_is_late_and_counted_so() -> None:
    answers, link = exchange(), RosLink()
    assert ask(answers, link, 1) == []
    assert ask(answers, link, 2, [about(PERIOD_NS), about(2 * PERIOD_NS)])[0][:2] == (1, True)
    assert counts(answers, link) == {"asked": 2, "answered": 1, "late": 1, "unanswered": 0}


def test_answers_about_frames_that_were_not_asked_about_or_long_ago_are_refused() -> None:
    answers, link = exchange(), RosLink()
    answers.begin(0, 0)
    assert ask(answers, link, 1, [about(0)]) == []
    assert answers.refused == {"no question": 1}
    for frame in range(2, 2 + frame_exchange.KEPT):
        ask(answers, link, frame)
    assert ask(answers, link, 100, [about(PERIOD_NS)]) == []
    assert answers.refused["stamp"] == 1
    assert len(answers._open) <= frame_exchange.KEPT


def test_after_three_silent_frames_waits_are_short_until_an_answer_comes() -> None:
    answers, link = exchange(wait_s=0.7), RosLink()
    for frame in range(5):
        ask(answers, link, frame)
    ask(answers, link, 5, [about(5 * PERIOD_NS)])
    ask(answers, link, 6)
    brief = frame_exchange.BRIEF_S
    assert link.waited_s == [0.7, 0.7, 0.7, brief, brief, 0.7]


def test_why_nothing_came_is_told_with_the_frames_of_the_newest_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    answers, link, reason = exchange(), RosLink(), "nobody publishes it"
    monkeypatch.setattr(link, "absence", lambda topic: reason)
    for frame in (1, 2):
        ask(answers, link, frame)
    assert answers.results(link)["absent"] == {TOPIC: "from frame 1 on: nobody publishes it"}
    ask(answers, link, 3, [about(3 * PERIOD_NS)])
    assert answers.results(link)["absent"] == {TOPIC: "from frame 1 to 3: nobody publishes it"}
    reason = ""
    ask(answers, link, 4)
    assert answers.results(link)["absent"] == {TOPIC: "from frame 1 to 3: nobody publishes it"}
    reason = "the link to the router has ended"
    ask(answers, link, 5)
    assert answers.results(link)["absent"] == {TOPIC: f"from frame 5 on: {reason}"}


def test_a_flood_of_transforms_costs_the_largest_messages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frame_exchange, "MOST_TRANSFORMS_AT_ONCE", 8)
    answers, link = exchange(), RosLink()
    moved = Transform("map", "car", PERIOD_NS, np.ones(3), np.array([1.0, 0.0, 0.0, 0.0]))
    flood = [Transform("map", f"f{k}", PERIOD_NS, np.zeros(3), moved.rotation) for k in range(5)]
    for transforms in (flood, [moved], flood):
        link.arrive(TF, transform_message(transforms))
    assert ask(answers, link, 1, [about(PERIOD_NS, "car")]) == [(1, False, (3, 0, [1.0, 1.0, 1.0]))]
    assert answers.refused == {"too many transforms": 1}


@pytest.mark.parametrize(("silent", "answers_used"), [(3, [1]), (frame_exchange.KEPT + 3, [])])
def test_an_answer_about_an_earlier_frame_ends_the_silence(silent: int, answers_used: list[int]) -> None:
    answers, link = exchange(wait_s=0.7), RosLink()
    for frame in range(1, silent + 1):
        ask(answers, link, frame)
    assert [frame for frame, _, _ in ask(answers, link, 100, [about(PERIOD_NS)])] == answers_used
    ask(answers, link, 101)
    assert link.waited_s[-2:] == [frame_exchange.BRIEF_S, 0.7]


@pytest.mark.parametrize("waits", [True, False], ids=["lockstep", "realtime"])
def test_what_comes_before_the_question_is_no_answer(waits: bool) -> None:
    answers, link = exchange(), RosLink(waits=waits)
    ask(answers, link, 1)
    answers.begin(2, 2 * PERIOD_NS)
    link.arrive(*about(2 * PERIOD_NS))
    link.arrive(*about(PERIOD_NS))
    assert [each[:2] for each in ask(answers, link, 2, [about(2 * PERIOD_NS)])] == [(1, True), (2, False)]
    assert answers.refused == {"before its question": 1}


def test_in_lock_step_a_stamp_nearer_to_the_next_frame_is_before_its_question() -> None:
    answers, link = exchange(), RosLink()
    ask(answers, link, 1, [about(PERIOD_NS)])
    used = ask(answers, link, 2, [about(3 * PERIOD_NS), about(2 * PERIOD_NS + 50_000_000)])
    assert [(frame, content[1]) for frame, _, content in used] == [(2, 50_000_000)]
    assert answers.refused == {"before its question": 1}


def test_publishers_of_answers_are_counted_up_to_a_limit() -> None:
    answers, link = exchange(), RosLink()
    for number in range(2 * outside.MOST_PUBLISHERS):
        link.arrive(*about(0), publisher=number.to_bytes(16, "big"))
    ask(answers, link, 0, [about(0)])
    assert answers.results(link)["publishers"] == {TOPIC: outside.MOST_PUBLISHERS}


def test_in_real_time_nothing_is_waited_for() -> None:
    answers, link = exchange(), RosLink(waits=False)
    assert ask(answers, link, 0) == []
    assert ask(answers, link, 1, [about(0)])[0][:2] == (0, True)
    assert link.waited_s == []


def test_a_question_during_which_the_run_was_stopped_is_not_counted() -> None:
    answers, link = exchange(), RosLink()
    ask(answers, link, 0, [about(0)])
    link.end()
    ask(answers, link, 1)
    assert counts(answers, link) == {"asked": 1, "answered": 1, "late": 0, "unanswered": 0}
    assert answers.results(link)["interrupted"] == 1


def test_frames_of_reference_come_from_transforms_at_the_stamp() -> None:
    answers, link = exchange(), RosLink()

    def transform(child: str, time_ns: int, x: float) -> Any:
        place = np.array([x, 0.0, 0.0])
        return transform_message([Transform("map", child, time_ns, place, np.array([1.0, 0.0, 0.0, 0.0]))])

    link.arrive(TF_STATIC, transform("mast", 0, 7.0))
    link.arrive(TF, transform("car", 0, 0.0))
    link.arrive(TF, transform("car", 2 * PERIOD_NS, 2.0))
    assert ask(answers, link, 1, [about(PERIOD_NS, "car")]) == [(1, False, (3, 0, [1.0, 0.0, 0.0]))]
    assert ask(answers, link, 2, [about(2 * PERIOD_NS, "/mast")]) == [(2, False, (3, 0, [7.0, 0.0, 0.0]))]
    assert ask(answers, link, 3, [about(3 * PERIOD_NS, "odom")]) == []
    assert answers.refused == {"unknown frame": 1}


def test_a_refused_answer_leaves_room_for_a_better_one() -> None:
    answers, link = exchange(), RosLink()
    used = ask(answers, link, 1, [about(PERIOD_NS, "odom"), about(PERIOD_NS)])
    assert [number for number, *_ in used] == [1]


def test_objects_that_are_left_out_are_counted_by_reason() -> None:
    answers, link = exchange(), RosLink()
    bad = STATES.with_(size=np.zeros((3, 3)))
    assert ask(answers, link, 1, [about(PERIOD_NS, states=bad)])[0][2][0] == 0
    assert answers.left_out == {"size: not above 0 and at most 300 m": 3}


def test_objects_with_a_foreign_class_are_counted() -> None:
    answers, link = exchange(), RosLink()
    topic, message = about(PERIOD_NS)
    for each in message.objects:
        each.classification[0].label = 200
    assert ask(answers, link, 1, [(topic, message)])[0][2][0] == 3
    assert answers.results(link)["unclassified"] == 3


@pytest.mark.parametrize(
    ("waits", "stamp_ns", "frame", "skew_ns"),
    [
        (False, 1_000_000_000, 1, 0),
        (False, 1_025_000_000, 1, 50_000_000),  # the clock runs at twice the wall clock's pace
        (False, 1_049_000_000, 2, -2_000_000),
        (False, 1_070_000_000, 2, 40_000_000),
        (True, 1_049_000_000, 1, 0),  # the scene's time stands still while it is waited for
    ],
)
def test_wall_clock_stamps_are_placed_between_the_arrivals_of_clocks(waits, stamp_ns, frame, skew_ns) -> None:
    answers, link = exchange(stamps="wall"), RosLink(waits=waits)
    link.clock_arrivals_ns = {1: 1_000_000_000, 2: 1_050_000_000}
    for number in (1, 2):
        ask(answers, link, number)
    link.arrive(*about(stamp_ns))
    (answer,) = answers.collect(link, -1)
    assert (answer.about.frame, answer.about.skew_ns) == (frame, skew_ns)


def test_a_wall_clock_stamp_before_the_first_clock_is_refused() -> None:
    answers, link = exchange(stamps="wall"), RosLink()
    link.clock_arrivals_ns = {1: 1_000_000_000}
    assert ask(answers, link, 1, [about(999_999_999)]) == []
    assert answers.refused == {"stamp": 1}


@pytest.mark.parametrize(("name", "value"), [("wait_s", 5.1), ("wait_s", -1.0), ("skew_s", 11.0), ("start_s", 21.0)])
def test_limits_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name}: found {value}, expected 0 to"):
        Timing(**{name: value})


PAYLOADS = {
    TOPIC: (TRACKED_OBJECTS, encode(about(PERIOD_NS)[1])),
    TF: (
        TF_MESSAGE,
        encode(transform_message([Transform("map", "car", PERIOD_NS, np.ones(3), np.array([1.0, 0.0, 0.0, 0.0]))])),
    ),
}
BYTES = st.lists(st.tuples(st.integers(0, 1 << 16), st.integers(0, 255)), max_size=30)


@given(messages=st.lists(st.tuples(st.sampled_from(sorted(PAYLOADS)), BYTES), max_size=5))
def test_messages_with_any_bytes_changed_are_answers_or_counted(messages) -> None:
    answers, link = exchange(), RosLink()
    arrived = 0
    for topic, changes in messages:
        type_name, original = PAYLOADS[topic]
        payload = bytearray(original)
        for place, value in changes:
            payload[place % len(payload)] = value
        try:
            link.arrive(topic, decode(type_name, bytes(payload)))
        except MessageError:
            continue  # the participant counts it
        arrived += topic == TOPIC
    used = ask(answers, link, 1)
    refused = sum(answers.refused.values())
    assert len(used) <= 1, "one answer to a question"
    assert arrived <= len(used) + refused, "nothing is silent"
    for _, _, (number, skew_ns, position) in used:
        assert number <= len(STATES)
        assert abs(skew_ns) <= 100_000_000
        assert np.isfinite(position).all()

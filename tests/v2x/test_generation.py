"""Generation rules of Collective Perception: when a station sends a message, and which objects are in it."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from perceptions import FRAME_NS, objects, perceived, reports, sent_ids

from mast_zenoh.arrays.states import CLASSES, ObjectStates, concatenate
from mast_zenoh.v2x import CpmGeneration, DistanceRedundancy, EveryFrame, GenerationRules, Perception, RedundancyRule


@pytest.mark.parametrize(
    ("answer", "kind"),
    [(np.ones(1, bool), r"bool \(1,\)"), (np.zeros(3), r"float64 \(3,\)"), ([True, False, True], "list")],
)
def test_a_redundancy_rule_answers_for_each_object_or_is_named_in_an_error(answer: Any, kind: str) -> None:
    class Careless(RedundancyRule):
        def left_out(self, *_: Any) -> Any:
            return answer

    rules = CpmGeneration(redundancy=(Careless(),))
    expected = rf"Careless: found {kind} as which objects to leave out, expected an array bool \(3,\)"
    with pytest.raises(ValueError, match=expected):
        rules.generate(perceived(0, objects(1, 2, 3), heard=reports(objects(1))))


def test_every_frame_sends_all_objects_in_their_order() -> None:
    states = objects(3, 1, 2)
    for frame in range(3):
        generation = EveryFrame().generate(perceived(frame, states))
        assert generation.generated
        assert generation.sensors
        assert sent_ids(generation, states) == [3, 1, 2]


def sent(rules: GenerationRules, frame: int, states: ObjectStates, **others: Any) -> list[int]:
    """The ids that are sent in a frame, sorted."""
    return sorted(sent_ids(rules.generate(perceived(frame, states, **others)), states))


@pytest.mark.parametrize(
    ("change", "due"),
    [
        (dict(x=4.0), False),
        (dict(x=4.1), True),
        (dict(v=(10.5, 0.0)), False),
        (dict(v=(10.6, 0.0)), True),
        (dict(v=(9.4, 0.0)), True),
        (dict(v=(10 * math.cos(math.radians(3.9)), 10 * math.sin(math.radians(3.9)))), False),
        (dict(v=(10 * math.cos(math.radians(4.1)), 10 * math.sin(math.radians(4.1)))), True),
    ],
)
def test_an_object_is_sent_if_it_moved_or_changed_its_speed_or_direction(change: dict[str, Any], due: bool) -> None:
    rules = CpmGeneration()
    assert sent(rules, 0, objects(1, v=(10.0, 0.0))) == [1]
    assert sent(rules, 1, objects(1, **(dict(v=(10.0, 0.0)) | change))) == ([1] if due else [])


def with_speed_std(states: ObjectStates, std_mps: float) -> ObjectStates:
    """The same with a standard deviation of each component of the velocity, m/s."""
    return states.with_(covariance=np.tile(np.diag([0.0] * 6 + [std_mps**2] * 3), (len(states), 1, 1)))


def estimated(v: tuple[float, float]) -> ObjectStates:
    """Object 1 with an estimated velocity v, m/s, with a standard deviation of 0.2 m/s in each component."""
    return with_speed_std(objects(1, v=v), 0.2)


def test_a_standing_object_does_not_turn_by_the_noise_of_its_velocity() -> None:
    rules, rng = CpmGeneration(), np.random.default_rng(0)
    noise = np.clip(rng.normal(0.0, 0.1, (20, 2)), -0.2, 0.2)
    assert [frame for frame in range(20) if sent(rules, frame, estimated(tuple(noise[frame])))] == [0, 10]


def test_a_moving_object_turns_and_so_does_any_velocity_on_request() -> None:
    assert sent_after(CpmGeneration(), (2.0, 0.0), (1.98, 0.16)) == [1]
    assert sent_after(CpmGeneration(), (0.3, 0.0), (0.29, 0.1)) == []
    assert sent_after(CpmGeneration(direction_sigmas=0.0), (0.3, 0.0), (0.29, 0.1)) == [1]


def sent_after(rules: GenerationRules, *velocities: tuple[float, float]) -> list[int]:
    """The ids that are sent in the last of some frames, the others of which are sent as a matter of course."""
    for frame, velocity in enumerate(velocities):
        ids = sent(rules, frame, estimated(velocity))
    return ids


def test_an_object_that_stops_keeps_its_direction_until_it_moves_in_another_one() -> None:
    rules = CpmGeneration(speed_mps=100.0)
    assert sent(rules, 0, estimated((5.0, 0.0))) == [1]
    assert sent(rules, 5, estimated((0.0, 0.1))) == [], "it has stopped"
    assert sent(rules, 10, estimated((0.0, 0.1))) == [1], "after a second, still with the direction that it had"
    assert sent(rules, 12, estimated((5.0, 0.1))) == [], "it moves on as before"
    assert sent(rules, 14, estimated((0.0, 5.0))) == [1], "it moves off to the side"


def test_an_object_that_was_never_seen_to_move_does_not_turn_by_beginning_to() -> None:
    rules = CpmGeneration(speed_mps=100.0)
    assert sent(rules, 0, estimated((0.0, 0.0))) == [1]
    assert sent(rules, 1, estimated((5.0, 0.0))) == []


def test_objects_of_low_quality_are_not_sent_and_bring_no_others() -> None:
    rules = CpmGeneration()
    states = objects(1, 2, 3, cls="pedestrian")
    assert sent(rules, 0, states, quality=np.array([3, 4, 15])) == [2, 3]
    assert sent(rules, 1, states, quality=np.array([3, 4, 15])) == []


def test_quality_follows_from_the_score_by_default() -> None:
    assert sent(CpmGeneration(), 0, objects(1, 2).with_(score=np.array([0.1, 0.9]))) == [2]


def test_frames_whose_times_are_rounded_are_not_skipped() -> None:
    rules = CpmGeneration()
    times = [round(frame * 1e9 / 30.0) for frame in range(12)]
    generated = [rules.generate(Perception.of(time, objects(1, x=time / 1e6))).generated for time in times]
    assert np.flatnonzero(generated).tolist() == [0, 3, 6, 9]


def test_all_objects_are_sent_in_each_message_on_request() -> None:
    rules = CpmGeneration(send_all=True)
    assert [sent(rules, frame, objects(1, 2)) for frame in range(3)] == [[1, 2]] * 3


def test_new_objects_come_first_then_those_that_changed_most() -> None:
    rules = CpmGeneration()
    rules.generate(perceived(0, objects(1, 2, 3)))
    states = concatenate([objects(1, x=5.0), objects(2, x=9.0), objects(3, x=6.0), objects(4)])
    assert sent_ids(rules.generate(perceived(1, states)), states) == [4, 2, 3, 1]


def test_objects_that_do_not_fit_into_a_message_come_in_the_next() -> None:
    rules = CpmGeneration(most_objects=2)
    states = objects(5, 1, 4, 2, 3)
    assert [sent(rules, frame, states) for frame in range(4)] == [[1, 2], [3, 4], [5], []]


def test_an_object_that_others_have_reported_is_left_out_until_they_stop() -> None:
    rules = CpmGeneration(redundancy=(DistanceRedundancy(distance_m=100.0),))
    heard = reports(objects(77, x=0.5).with_(position=np.array([[0.5, 10.0, 0.0]])), frame=0)
    assert sent(rules, 0, objects(1, 2), heard=heard) == [2]
    assert sent(rules, 5, objects(1, 2), heard=heard) == []
    assert sent(rules, 11, objects(1, 2), heard=heard) == [1, 2], "the report is older than a second"


def test_an_object_is_new_again_after_it_was_forgotten() -> None:
    rules = CpmGeneration(retention_s=2.0, most_s=60.0)
    sent(rules, 0, objects(1))
    assert sent(rules, 20, objects(1)) == []
    assert sent(rules, 40, objects(1)) == [], "it was perceived in between"
    assert sent(rules, 61, objects(1)) == [1]


def test_memory_is_bounded_and_keeps_what_was_perceived_last() -> None:
    rules = CpmGeneration(remembered=50)
    for frame in range(20):
        sent(rules, frame, objects(*range(frame * 30, frame * 30 + 30)))
        assert len(rules._sent) <= 50
    assert set(range(570, 600)) <= set(rules._sent.ids.tolist())


#: One object in one frame: id, x, speed, class; whether it is there is up to the list.
SEEN = st.tuples(
    st.integers(0, 5), st.sampled_from([0.0, 3.0, 6.0, 20.0]), st.floats(0.0, 3.0), st.sampled_from(CLASSES)
)
FRAMES = st.lists(st.lists(SEEN, max_size=6, unique_by=lambda seen: seen[0]), min_size=1, max_size=25)


def states_of(seen: list[tuple[int, float, float, str]]) -> ObjectStates:
    """Objects of a drawn frame."""
    return concatenate([objects(id_, x=x, v=(speed, 0.0), cls=cls) for id_, x, speed, cls in seen])


def plain_rules(frames: list[list[tuple[int, float, float, str]]], interval: int) -> list[tuple[set[int], bool] | None]:
    """The ids in the message of each frame and whether it has sensor information, object by object; None: no message.

    interval: frames
    """
    messages: list[tuple[set[int], bool] | None] = []
    last: dict[int, tuple[int, float, float]] = {}
    last_message = last_sensors = -1000
    for frame, seen in enumerate(frames):
        due = set()
        type_a = {id_ for id_, _, _, cls in seen if cls in ("pedestrian", "bicycle")}
        if any(id_ not in last or frame - last[id_][0] >= 5 for id_ in type_a):
            due |= type_a
        for id_, x, speed, _ in seen:
            if id_ not in type_a:
                before = last.get(id_)
                changed = before is None or abs(x - before[1]) > 4.0 or abs(speed - before[2]) > 0.5
                if changed or (before is not None and frame - before[0] >= 10):
                    due.add(id_)
        sensors = frame - last_sensors >= 10
        if frame - last_message < interval or not (due or sensors):
            messages.append(None)
            continue
        last_message, last_sensors = frame, frame if sensors else last_sensors
        last |= {id_: (frame, x, speed) for id_, x, speed, _ in seen if id_ in due}
        messages.append((due, sensors))
    return messages


@given(frames=FRAMES, interval=st.integers(1, 4))
def test_messages_equal_those_of_the_rules_object_by_object(frames: list[list[Any]], interval: int) -> None:
    rules = CpmGeneration(least_s=interval * 0.1)
    for frame, expected in enumerate(plain_rules(frames, interval)):
        states = states_of(frames[frame])
        generation = rules.generate(perceived(frame, states))
        message = (set(sent_ids(generation, states)), generation.sensors) if generation.generated else None
        assert message == expected, frame


@given(frames=FRAMES, seed=st.integers(0, 100))
def test_messages_do_not_depend_on_the_order_of_rows(frames: list[list[Any]], seed: int) -> None:
    plain, shuffled = (CpmGeneration(most_objects=3, redundancy=(DistanceRedundancy(),)) for _ in range(2))
    rng = np.random.default_rng(seed)
    for frame, seen in enumerate(frames):
        states = states_of(seen)
        heard = reports(states.select(rng.permutation(len(states))[:2]), frame)
        other = states.select(rng.permutation(len(states)))
        messages = [
            sent_ids(rules.generate(perceived(frame, rows, heard=heard)), rows)
            for rules, rows in ((plain, states), (shuffled, other))
        ]
        assert messages[0] == messages[1]


@given(frames=FRAMES, interval_s=st.floats(0.1, 1.0))
def test_no_object_is_silent_for_longer_than_its_limit_and_an_interval(frames, interval_s):
    rules = CpmGeneration(least_s=interval_s)
    last: dict[int, int] = {}
    interval_ns = interval_s * 1e9 + FRAME_NS
    for frame, seen in enumerate(frames):
        states = states_of(seen)
        generation = rules.generate(perceived(frame, states))
        last |= dict.fromkeys(sent_ids(generation, states), frame)
        for id_, _, _, cls in seen:
            limit_ns = 0.5e9 if cls in ("pedestrian", "bicycle") else 1e9
            appeared = next(
                i for i in range(frame, -1, -1) if i == 0 or id_ not in {object_[0] for object_ in frames[i - 1]}
            )
            silent_ns = (frame - max(last.get(id_, -1), appeared)) * FRAME_NS
            assert silent_ns <= limit_ns + interval_ns

"""Redundancy rules: objects that others have reported are left out."""

import numpy as np
import pytest
from perceptions import FRAME_NS, objects, reports

from mast_zenoh.arrays.states import Bools, ObjectStates
from mast_zenoh.v2x import (
    DistanceRedundancy,
    DynamicsRedundancy,
    FrequencyRedundancy,
    HeardObjects,
    RedundancyRule,
    SelfAnnouncementRedundancy,
)

ORIGIN = np.zeros(3)
RULES = [FrequencyRedundancy(reports=0), DynamicsRedundancy(), DistanceRedundancy()]


def together(*parts: HeardObjects) -> HeardObjects:
    """All reports of several messages."""
    columns = ("time_ns", "position", "velocity", "sender_position")
    return HeardObjects(*[np.concatenate([getattr(part, column) for part in parts]) for column in columns])


def left_out(rule: RedundancyRule, own: ObjectStates, heard: HeardObjects, frame: int = 0) -> list[bool]:
    """Which objects are left out."""
    redundant: Bools = rule.redundant(frame * FRAME_NS, own, ORIGIN, heard)
    return redundant.tolist()


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: type(rule).__name__)
class TestEveryRule:
    def test_an_object_is_left_out_if_it_was_reported_a_moment_ago(self, rule: RedundancyRule) -> None:
        assert left_out(rule, objects(1, 2), reports(objects(2))) == [False, True]

    def test_nothing_is_left_out_if_nothing_was_heard(self, rule: RedundancyRule) -> None:
        assert left_out(rule, objects(1, 2), HeardObjects.empty()) == [False, False]
        assert left_out(rule, objects(), reports(objects(1))) == []

    def test_reports_that_are_old_or_from_the_future_do_not_count(self, rule: RedundancyRule) -> None:
        assert left_out(rule, objects(1), reports(objects(1)), frame=10) == [True]
        assert left_out(rule, objects(1), reports(objects(1)), frame=11) == [False]
        assert left_out(rule, objects(1), reports(objects(1), frame=5), frame=4) == [False]

    def test_a_report_is_about_the_nearest_object_within_the_gate(self, rule: RedundancyRule) -> None:
        own = objects(1, 2, 3).with_(position=np.array([[0.0, 0, 0], [1.5, 0, 0], [9.0, 0, 0]]))
        near, far = (objects(9).with_(position=np.array([[x, 0.0, 0.0]])) for x in (1.0, 6.0))
        assert left_out(rule, own, reports(near)) == [False, True, False]
        assert left_out(rule, own, reports(far)) == [False, False, False]

    def test_a_report_moves_on_at_constant_velocity(self, rule: RedundancyRule) -> None:
        heard = reports(objects(1, v=(7.0, 0.0)))
        assert left_out(rule, objects(1, x=3.5, v=(7.0, 0.0)), heard, frame=5) == [True]
        assert left_out(rule, objects(1, x=0.0, v=(7.0, 0.0)), heard, frame=5) == [False]

    def test_the_order_of_reports_and_objects_does_not_matter(self, rule: RedundancyRule) -> None:
        rng = np.random.default_rng(3)
        own = ObjectStates.of(rng.uniform(0.0, 20.0, (30, 3)))
        heard = together(*(reports(ObjectStates.of(rng.uniform(0.0, 20.0, (40, 3))), frame) for frame in range(3)))
        plain = np.array(left_out(rule, own, heard, 4))
        rows, order = rng.permutation(30), rng.permutation(len(heard))
        assert left_out(rule, own.select(rows), heard.select(order), 4) == plain[rows].tolist()


def test_an_object_reported_often_is_left_out_and_a_rare_one_is_sent() -> None:
    rule = FrequencyRedundancy(reports=3)
    often = together(*(reports(objects(1, 2), frame) for frame in range(3)), reports(objects(2), 3))
    assert left_out(rule, objects(1, 2), often, frame=4) == [False, True]


@pytest.mark.parametrize(("v", "redundant"), [((10.0, 0.0), True), ((10.4, 0.0), True), ((10.6, 0.0), False)])
def test_an_object_whose_speed_has_changed_since_its_report_is_sent(v: tuple[float, float], redundant: bool) -> None:
    assert left_out(DynamicsRedundancy(), objects(1, v=v), reports(objects(1, v=(10.0, 0.0)))) == [redundant]


@pytest.mark.parametrize(("frame", "redundant"), [(3, True), (5, False)])
def test_an_object_that_has_moved_since_its_report_is_sent(frame: int, redundant: bool) -> None:
    own = objects(1, x=float(frame), v=(10.0, 0.0))
    assert left_out(DynamicsRedundancy(), own, reports(objects(1, v=(10.0, 0.0))), frame) == [redundant]


def test_only_the_newest_report_of_an_object_is_compared() -> None:
    right, wrong = objects(1, v=(10.0, 0.0)), objects(1, v=(20.0, 0.0))
    own = objects(1, x=1.0, v=(10.0, 0.0))
    rule = DynamicsRedundancy(gate_m=5.0)
    assert left_out(rule, own, together(reports(right), reports(wrong.with_(position=own.position), 1)), 1) == [False]
    assert left_out(rule, own, together(reports(wrong), reports(right.with_(position=own.position), 1)), 1) == [True]


def test_reports_of_distant_stations_do_not_count_by_distance() -> None:
    near, far = (reports(objects(1), sender_position=(x, 0, 0)) for x in (10.0, 10.1))
    assert left_out(DistanceRedundancy(), objects(1), near) == [True]
    assert left_out(DistanceRedundancy(), objects(1), far) == [False]
    assert left_out(DistanceRedundancy(distance_m=20.0), objects(1), far) == [True]


def test_a_lie_next_to_an_object_silences_two_rules_but_not_the_comparison_of_dynamics() -> None:
    """What an attacker can do with redundancy rules."""
    own = objects(1, v=(10.0, 0.0))
    lie = reports(objects(1, x=1.0, v=(0.0, 0.0)))
    assert [left_out(rule, own, lie) for rule in RULES] == [[True], [False], [True]]


def test_what_says_itself_where_it_is_is_left_out_and_what_others_report_is_not() -> None:
    rule, own = SelfAnnouncementRedundancy(), objects(1, 2)
    itself = reports(objects(2), sender_position=tuple(objects(2).position[0]))
    assert left_out(rule, own, itself) == [False, True]
    assert left_out(rule, own, reports(objects(1, 2))) == [False, False]
    assert left_out(rule, own, itself, frame=11) == [False, False], "it has fallen silent"

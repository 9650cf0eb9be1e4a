"""The driver notes lost and returned nodes, however fast their tokens change."""

from __future__ import annotations

import pytest

from mast_zenoh.runtime.protocol.pacer import MAX_LOSSES, Membership, Presence

MEMBERS = {"driver": "simulator", "a": "agent"}
GONE, THERE, REPLACED = Presence(True, False), Presence(False, True), Presence(True, True)


@pytest.fixture
def membership() -> Membership:
    membership = Membership("driver", dict(MEMBERS))
    membership.alive.add("a")
    return membership


def note(membership: Membership, *changes: Presence) -> str:
    return [membership.note("a", change, 3, MEMBERS) for change in changes][-1]


def churn(membership: Membership) -> list[str]:
    return [event["what"] for event in membership.churn]


def test_changes_that_nobody_has_taken_combine_to_whether_it_went_and_whether_it_is_there() -> None:
    assert THERE.followed_by(GONE) == GONE
    assert GONE.followed_by(THERE) == REPLACED
    assert REPLACED.followed_by(GONE).followed_by(THERE) == REPLACED


def test_a_node_that_goes_and_returns_before_the_driver_notices_was_lost_and_came_back(membership: Membership) -> None:
    note(membership, REPLACED)
    assert churn(membership) == ["lost", "back"]
    assert membership.alive == {"driver", "a"}


def test_a_new_process_of_a_node_joins_in_an_epoch_after_one_without_it(membership: Membership) -> None:
    note(membership, REPLACED)
    assert membership.differs(MEMBERS)
    first = membership.begin_epoch()
    assert first.keys() == {"driver"}
    assert membership.differs(first)
    second = membership.begin_epoch()
    assert second == MEMBERS
    assert not membership.differs(second)


def test_a_node_that_goes_again_before_the_driver_notices_its_return_is_not_lost_twice_in_a_row(
    membership: Membership,
) -> None:
    note(membership, GONE, REPLACED, GONE)
    assert churn(membership) == ["lost", "back", "lost", "back", "lost"]


def test_a_node_that_the_scenario_ends_is_not_lost(membership: Membership) -> None:
    membership.leaving.add("a")
    assert note(membership, GONE) == ""
    assert churn(membership) == []


def test_a_node_that_constantly_goes_and_returns_ends_the_run_and_is_named(membership: Membership) -> None:
    reasons = [note(membership, REPLACED) for _ in range(MAX_LOSSES + 1)]
    assert [bool(reason) for reason in reasons] == [False] * MAX_LOSSES + [True]
    assert reasons[-1].startswith("a was lost and came back")

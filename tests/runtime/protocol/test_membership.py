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


def test_changes_that_nobody_has_taken_combine_to_whether_it_went_and_whether_it_is_there() -> None:
    assert THERE.followed_by(GONE) == GONE
    assert GONE.followed_by(THERE) == REPLACED
    assert REPLACED.followed_by(GONE).followed_by(THERE) == REPLACED


@pytest.mark.parametrize(
    ("changes", "leaving", "events"),
    [
        ((REPLACED,), set(), ["lost", "back"]),
        ((GONE, REPLACED, GONE), set(), ["lost", "back", "lost", "back", "lost"]),
        ((GONE,), {"a"}, []),  # the scenario ends it
    ],
)
def test_losses_and_returns_are_noted_in_pairs(
    membership: Membership, changes: tuple[Presence, ...], leaving: set[str], events: list[str]
) -> None:
    membership.leaving |= leaving
    assert note(membership, *changes) == ""
    assert [event["what"] for event in membership.churn] == events
    assert ("a" in membership.alive) == changes[-1].present


def test_a_new_process_of_a_node_joins_in_an_epoch_after_one_without_it(membership: Membership) -> None:
    note(membership, REPLACED)
    assert membership.differs(MEMBERS)
    first = membership.begin_epoch()
    assert first.keys() == {"driver"}
    assert membership.differs(first)
    second = membership.begin_epoch()
    assert second == MEMBERS
    assert not membership.differs(second)


def test_a_node_that_constantly_goes_and_returns_ends_the_run_and_is_named(membership: Membership) -> None:
    reasons = [note(membership, REPLACED) for _ in range(MAX_LOSSES + 1)]
    assert [bool(reason) for reason in reasons] == [False] * MAX_LOSSES + [True]
    assert reasons[-1].startswith("a was lost and came back")

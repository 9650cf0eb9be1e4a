"""The driver notes lost and returned nodes, however fast their tokens change."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from mast_zenoh.runtime.mesh.membership import MAX_LOSSES, Membership

MEMBERS = {"driver": "simulator", "a": "agent"}


class Driver:
    """A membership whose events are processed on request."""

    def __init__(self) -> None:
        self.events: list[Any] = []
        self.membership = Membership("driver", dict(MEMBERS), self.events.append)
        self.membership.alive.add("a")

    def token(self, *there: bool) -> None:
        for each in there:
            kind = zenoh.SampleKind.PUT if each else zenoh.SampleKind.DELETE
            self.membership.on_token(SimpleNamespace(key_expr="mast/r/alive/a", kind=kind))

    def take(self, count: int) -> str:
        return [self.membership.take(self.events.pop(0)[1], 3, MEMBERS) for _ in range(count)][-1]

    @property
    def churn(self) -> list[str]:
        return [event["what"] for event in self.membership.churn]


@pytest.fixture
def driver() -> Driver:
    return Driver()


def test_a_node_that_goes_and_returns_before_the_driver_notices_was_lost_and_came_back(driver: Driver) -> None:
    driver.token(False, True)
    driver.take(1)
    assert "a" not in driver.membership.alive, "a new epoch can begin without it"
    driver.take(1)
    assert driver.churn == ["lost", "back"]
    assert driver.membership.alive == {"driver", "a"}


def test_a_node_that_goes_again_before_the_driver_notices_its_return_is_not_lost_twice_in_a_row(driver: Driver) -> None:
    driver.token(False, True)
    driver.take(1)
    driver.token(False)
    driver.take(1)
    assert driver.churn == ["lost", "back", "lost"]
    assert driver.events == []


def test_a_node_that_the_scenario_ends_is_not_lost(driver: Driver) -> None:
    driver.membership.leaving.add("a")
    driver.token(False)
    assert driver.take(1) == ""
    assert driver.churn == []


def test_a_node_that_constantly_goes_and_returns_ends_the_run_and_is_named(driver: Driver) -> None:
    reasons = []
    for _ in range(MAX_LOSSES + 1):
        driver.token(False)
        reasons.append(driver.take(1))
        driver.token(True)
        driver.take(1)
    assert [bool(reason) for reason in reasons] == [False] * MAX_LOSSES + [True]
    assert reasons[-1].startswith("a was lost and came back")

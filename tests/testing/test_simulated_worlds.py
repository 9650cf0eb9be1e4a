"""Users simulate worlds of their own, with promises of their own."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from small_worlds import SmallAgent, small_world

from mast_zenoh import scenario, testing
from mast_zenoh.errors import ConfigurationError, WiringError
from mast_zenoh.node import Context, Received
from mast_zenoh.testing.comparison import first_difference
from mast_zenoh.testing.simulation import (
    Disturbance,
    Schedule,
    SimulatedWorld,
    SimulationOutcome,
    check,
    explore,
    play,
    undisturbed,
)

RELAY = dict(wire="agent/infra_1/tracks", file="adversary.py", name="relay", settings=["attack.type=PassThrough"])
INSERTED = Schedule(8, (Disturbance(0.0563, "intercept", "relay"),))


def world(*requests: dict[str, object]) -> SimulatedWorld:
    return SimulatedWorld.of(scenario.resolve(*scenario.load("baseline", ["n_infrastructure=2"]), frames=10), requests)


def test_a_shipped_node_that_is_inserted_and_changes_nothing_keeps_every_promise() -> None:
    simulated = world(RELAY)
    assert check(simulated, INSERTED) == []
    assert [change["node"] for change in play(simulated, INSERTED).changes] == ["relay"]


def test_an_inserted_node_that_changes_messages_is_found() -> None:
    attack = RELAY | {"settings": ["attack.type=UncoordinatedAttack", "attack.start_s=0"]}
    lines = check(world(attack), INSERTED)
    assert any(line.startswith("messages on agent/infra_1/tracks") for line in lines)


def test_a_request_for_a_wire_that_does_not_exist_is_refused() -> None:
    with pytest.raises(WiringError, match="no wire 'agent/infra_9/tracks'"):
        world(RELAY | {"wire": "agent/infra_9/tracks"})


def test_a_request_that_is_no_dict_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"requests.*'adversary\.py'.*dicts"):
        world("adversary.py")  # type: ignore[arg-type]


class Failing(SmallAgent):
    """Fails in every frame."""

    def on_number(self, received: Received, context: Context) -> None:
        raise ValueError("no")


def test_a_world_that_fails_without_any_disturbance_is_found() -> None:
    plain = small_world()
    build = plain.build
    failing = replace(plain, build=lambda name, spec: Failing() if name == "a" else build(name, spec))
    with pytest.raises(AssertionError, match=r"without.*disturbance: a\.on_number"):
        explore(failing, range(3))


def test_a_promise_of_ones_own_is_checked_and_its_counterexample_simplified() -> None:
    def never_without_b(outcome: SimulationOutcome) -> Iterator[str]:
        if "b" in outcome.lost:
            yield "b is gone"

    plain = small_world()
    assert check(plain, Schedule(1, (Disturbance(0.05, "kill", "b"),)), never_without_b) == ["b is gone"]
    with pytest.raises(AssertionError, match=r"b is gone\n(.|\n)*kill b") as error:
        explore(plain, range(200), never_without_b)
    assert str(error.value).count("Disturbance(") == 1


def test_a_scenario_of_real_time_is_simulated_in_real_time() -> None:
    assert undisturbed(small_world(mode="realtime")).seconds > 0.3
    testing.check_scenario("sybil", frames=5, schedules=3)


def test_messages_that_the_undisturbed_run_rejects_too_are_no_difference() -> None:
    reference = undisturbed(small_world())
    rejecting = replace(reference, rejected={"hub": {"out: malformed": 3}})
    assert not rejecting.claims_to_be_exact()
    assert not rejecting.claims_to_be_exact(reference)
    assert rejecting.claims_to_be_exact(replace(rejecting))


@pytest.mark.parametrize(
    ("actual", "expected", "difference"),
    [
        ({"a": {"b": [1, 2]}}, {"a": {"b": [1, 3]}}, "a.b[1]: 2, expected 3"),
        ({"a": 1}, {}, "a: found, expected nothing"),
        ({}, {"a": 1}, "a: missing"),
        ({"a": 1, "b": 2}, {"b": 2, "a": 1}, ": the order of its keys: ['a', 'b'], expected ['b', 'a']"),
        ({"a": np.zeros(2)}, {"a": np.array([0.0, 1.0])}, "a: [0. 0.], expected [0. 1.]"),
        ({"a": np.zeros(2)}, {"a": np.zeros(2)}, ""),
        ({"a": float("nan")}, {"a": float("nan")}, ""),
    ],
)
def test_the_first_difference_of_results_is_named(actual: object, expected: object, difference: str) -> None:
    assert first_difference(actual, expected) == difference

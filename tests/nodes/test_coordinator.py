"""The coordinator sends one plan to all its live adversaries."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tiny_world import Bench, Run, states, tiny

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.attacks import Surroundings
from mast_zenoh.messages.schemas import Message

DIRECTIVES = tuple(f"attack/adversary_{i}/directive" for i in (1, 2))


@pytest.fixture(scope="module")
def resolved():
    return tiny("coordinated", "n_adversaries=2", "attack_start_s=0.0", "false_positives=6.0")


def observation(*places: tuple[float, float], x: float = 0.0) -> dict[str, np.ndarray]:
    return states(*places).columns() | {
        "agent_position": np.array([x, 0.0, 0.0]),
        "agent_rotation": np.array([1.0, 0.0, 0.0, 0.0]),
        "agent_velocity": np.zeros(3),
        "sensor_position": np.array([x, 0.0, 2.0]),
        "sensor_rotation": np.eye(3),
        "azimuth": np.array([-np.pi, np.pi]),
        "elevation": np.array([-1.5, 1.5]),
        "max_range": np.array([100.0]),
    }


def observe(coordinator: Bench, adversary: int, frame: int, *, step: int | None = None) -> list[tuple[str, Message]]:
    body = observation((10.0 * adversary, 5.0), (30.0, 5.0), x=5.0 * adversary)
    return coordinator.send("observations", body, frame, subject=f"adversary_{adversary}", step=step)


def test_all_adversaries_get_the_same_plan_when_all_have_reported(resolved) -> None:
    coordinator = Bench(resolved, "coordinator")
    coordinator.clock(0)
    assert observe(coordinator, 2, 0) == []
    published = observe(coordinator, 1, 0)
    assert [key for key, _ in published] == list(DIRECTIVES)
    first, second = (message for _, message in published)
    assert first.header.frame == second.header.frame == 0
    assert len(first.body["add_id"]) > 0
    for name, column in first.body.items():
        np.testing.assert_array_equal(column, second.body[name])


def test_the_coordinator_waits_for_a_silent_adversary_until_the_next_clock(resolved) -> None:
    coordinator = Bench(resolved, "coordinator")
    coordinator.clock(0)
    assert observe(coordinator, 1, 0) == []
    published = coordinator.clock(1)
    assert [(key, message.header.frame) for key, message in published] == [(DIRECTIVES[0], 0)]
    observe(coordinator, 1, 1)
    assert [key for key, _ in observe(coordinator, 2, 1)] == list(DIRECTIVES), "it may send again"


@pytest.mark.parametrize("joined", [True, False])
def test_the_coordinator_waits_for_no_adversary_that_has_died_or_not_joined(resolved, joined: bool) -> None:
    nodes = {name: spec for name, spec in resolved.nodes.items() if joined or name != "adversary_2"}
    coordinator = Bench(replace(resolved, nodes=nodes), "coordinator")
    assert coordinator.node.adversaries == {"adversary_1", "adversary_2"}
    coordinator.clock(0)
    if joined:
        coordinator.left("adversary_2", "adversary")
    assert [key for key, _ in observe(coordinator, 1, 0)] == [DIRECTIVES[0]]
    coordinator.host.joined("adversary_2", "adversary")
    coordinator.clock(1)
    assert observe(coordinator, 1, 1) == []
    assert len(observe(coordinator, 2, 1)) == 2


def test_an_undirected_adversary_does_not_delay_the_run() -> None:
    def leave_out(scenario: dict) -> None:
        scenario["coordinator"]["adversaries"] = ["adversary_1"]
        scenario["adversaries"]["adversary_2"]["attack"] = dict(type="PassThrough")

    run = Run(tiny("coordinated", "n_adversaries=2", "attack_start_s=0.2", edit=leave_out))
    assert not run.failures
    directives = run.decoded(DIRECTIVES[0], "directive")
    assert [message.header.frame for message in directives] == list(range(12))
    assert "attack/adversary_2/directive" not in run.messages
    first = run.decoded("attack/adversary_1/report", "attack_report")[0].header.frame
    assert first == 3, "the frame after the first plan, which is of frame 2"


def test_observations_of_different_times_are_brought_to_the_latest_of_them(resolved, monkeypatch) -> None:
    coordinator = Bench(resolved, "coordinator")
    calls: dict[str, Any] = {}
    coordination = coordinator.node.coordination
    step = coordination.step
    monkeypatch.setattr(
        type(coordination), "locate", lambda self, turns, speeds: calls.update(rotations=turns, velocities=speeds)
    )
    coordination.look = lambda views: calls.update(views=views)

    def recorded(frame: int, time_ns: int, objects: ObjectStates, source: Any, positions: Any) -> Any:
        calls.update(time_ns=time_ns, objects=objects, positions=positions)
        return step(frame, time_ns, objects, source, positions)

    coordination.step = recorded
    coordinator.clock(0)
    for adversary, time_ns in ((1, 0), (2, 200_000_000)):
        body = observation((10.0, 5.0), x=3.0) | {"agent_velocity": np.array([5.0, 0.0, 0.0])}
        body["velocity"] = np.array([[10.0, 0.0, 0.0]])
        key = coordinator.key("observations", f"adversary_{adversary}")
        coordinator.deliver(key, coordinator.message(key, body, 0, time_ns=time_ns))
    assert calls["time_ns"] == 200_000_000
    np.testing.assert_allclose(calls["objects"].position[:, 0], [12.0, 10.0])
    np.testing.assert_allclose(calls["positions"][:, 0], [4.0, 3.0])
    np.testing.assert_allclose([view.position[0] for view in calls["views"]], [4.0, 3.0])
    np.testing.assert_allclose(calls["velocities"][:, 0], 5.0)
    np.testing.assert_allclose(calls["rotations"], np.stack([np.eye(3)] * 2))


def test_what_the_agents_cover_is_worked_out_only_when_new_targets_are_selected(resolved, monkeypatch) -> None:
    coordinator = Bench(resolved, "coordinator")
    made: list[float] = []
    whole = Surroundings.other_positions
    monkeypatch.setattr(Surroundings, "other_positions", lambda self, s: made.append(s) or whole(self, s))
    for frame in range(4):
        coordinator.clock(frame)
        observe(coordinator, 1, frame)
        observe(coordinator, 2, frame)
    assert made == [0.0]

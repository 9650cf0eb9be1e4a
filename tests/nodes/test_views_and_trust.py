"""Views go from sensors to the command centre, and its trust is published; neither changes other messages."""

from dataclasses import replace

import numpy as np
import pytest
from tiny_world import PERIOD_NS, Bench, Run, states, tiny, tracks

from mast_zenoh.integrity import Assessment, Batch, NoIntegrity
from mast_zenoh.integrity.views import collated_columns, view_columns, views_of
from mast_zenoh.messages.schemas import text
from mast_zenoh.tracking.view import SensorView
from nodes.command_center import MAX_WAITING

AGENTS = ("ego", "infra_1", "infra_2")
VIEW = SensorView(np.array([1.0, 2.0, 3.0]), np.eye(3), -1.0, 1.0, -0.4, 0.2, 80.0)


@pytest.fixture(scope="module")
def resolved():
    return tiny("defended", "n_adversaries=0")


def view(free: float = 50.0) -> dict[str, np.ndarray]:
    return view_columns(VIEW, np.full((2, 3), free))


def test_the_broker_collates_views_with_the_tracks_of_their_frame(resolved) -> None:
    broker = Bench(resolved, "broker")
    broker.clock(0)
    for agent in AGENTS:
        broker.send("tracks", tracks((0.0, 0.0)), 0, subject=agent)
    for agent in AGENTS[:-1]:
        assert broker.send("view", view(), 0, subject=agent) == []
    (_, collated), (key, views) = broker.send("view", view(7.0), 0, subject=AGENTS[-1])
    assert collated.header.schema == "collated"
    assert key == "cc/views"
    received = views_of(views.body)
    assert sorted(received) == sorted(AGENTS)
    assert received["infra_2"].free.tolist() == [[7.0] * 3] * 2
    assert received["ego"].age_s == 0.0


def test_a_missing_view_delays_a_batch_to_the_next_clock_and_is_replaced_by_the_last_one(resolved) -> None:
    broker = Bench(resolved, "broker")
    broker.clock(0)
    for agent in AGENTS:
        broker.send("tracks", tracks((0.0, 0.0)), 0, subject=agent)
        broker.send("view", view(), 0, subject=agent)
    broker.clock(1)
    for agent in AGENTS:
        broker.send("tracks", tracks((0.0, 0.0)), 1, subject=agent)
    messages = [message for key, message in broker.clock(2) if key == "cc/views"]
    assert [message.header.frame for message in messages] == [1]
    assert {view.age_s for view in views_of(messages[0].body).values()} == {PERIOD_NS * 1e-9}


def batch() -> dict[str, np.ndarray]:
    columns = states((0.0, 0.0), (30.0, 0.0)).columns()
    return columns | {"agent": np.zeros(2, np.int64), "agents": text(["ego"]), "age_ns": np.zeros(1, np.int64)}


def views() -> dict[str, np.ndarray]:
    return collated_columns([view()]) | {"agents": text(["ego"]), "age_ns": np.zeros(1, np.int64)}


@pytest.mark.parametrize("first", ["collated", "views"])
def test_the_command_centre_waits_for_batch_and_views_in_either_order(resolved, first: str) -> None:
    centre = Bench(resolved, "command_center")
    centre.clock(0)
    bodies = {"collated": batch(), "views": views()}
    second = next(name for name in bodies if name != first)
    assert centre.send(first, bodies[first], 0) == []
    assert [key for key, _ in centre.send(second, bodies[second], 0)] == ["cc/picture", "cc/trust"]


def test_a_batch_whose_views_are_lost_is_processed_at_the_next_clock(resolved) -> None:
    centre = Bench(resolved, "command_center")
    centre.play(0, collated=batch())
    assert [(key, message.header.frame) for key, message in centre.clock(1)] == [("cc/picture", 0), ("cc/trust", 0)]


def test_views_wait_for_a_batch_that_is_delayed_but_not_for_ever(resolved) -> None:
    centre = Bench(resolved, "command_center")
    centre.play(0, views=views())
    centre.clock(1)
    assert [key for key, _ in centre.send("collated", batch(), 0)] == ["cc/picture", "cc/trust"]
    for frame in range(2, 200):
        centre.play(frame, views=views())
    assert len(centre.host.node.views) == MAX_WAITING


def test_views_with_impossible_grids_cost_one_message_not_the_picture(resolved) -> None:
    centre = Bench(resolved, "command_center")
    centre.play(0, views=views() | {"grid": np.array([[10**9, 10**9]])})
    assert [key for key, _ in centre.send("collated", batch(), 0)] == ["cc/picture", "cc/trust"]
    assert centre.host.rejected["cc/views", "malformed"] == 1


def test_invalid_trust_is_a_failure_of_the_command_centre_not_a_lost_message(resolved) -> None:
    class Percent(NoIntegrity):
        def assess(self, given: Batch) -> Assessment:
            sound = super().assess(given)
            return replace(sound, agents=replace(sound.agents, mean=np.full(len(given.agents), 95.0)))

    centre = Bench(resolved, "command_center")
    centre.host.node.pipeline.integrity = Percent()
    centre.play(0, views=views(), collated=batch())
    (failure,) = centre.host.failures.values()
    assert "Percent.assess: agents.mean" in failure.exception


def test_a_stage_that_trusts_everybody_changes_no_other_message() -> None:
    settings = "n_adversaries=1", "attack_start_s=1.0"
    plain, judged = (Run(tiny(name, *settings, frames=50)).messages for name in ("coordinated", "defended"))
    kinds = ("/sweep", "/view", "cc/views", "cc/trust")
    assert {key: messages for key, messages in judged.items() if not key.endswith(kinds)} == plain
    assert len(judged) > len(plain)

"""Nodes that are killed, started, paused and restarted, in simulated runs with many interleavings."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from simulated_runs import (
    CHURN,
    assert_equals_one_process,
    harmless_schedules,
    in_one_process,
    resolve,
    schedule,
)

from mast_zenoh.config.process_steps import ProcessStep
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.testing.simulation import World, play, small_world

SEEDS = range(0, 24, 2)
EVERY = {"ticker", "a", "b", "hub", "listener"}


class FrameListener(Node):
    """Returns the frames of what it hears of each agent."""

    role = "evaluator"
    inputs = {"clock": "clock", "out": "status", "picture": "status"}

    def __init__(self) -> None:
        self.frames: dict[str, list[int]] = {}

    def on_clock(self, received: Received, context: Context) -> None: ...

    def on_out(self, received: Received, context: Context) -> None:
        self.frames.setdefault(received.subject, []).append(received.frame)

    def on_picture(self, received: Received, context: Context) -> None: ...

    def finish(self, context: Context) -> dict[str, Any]:
        return {"frames": self.frames}


def heard(mode: str = "lockstep") -> World:
    """The small world with a listener that returns frames."""
    world = small_world(mode=mode)
    build = world.build
    return replace(world, build=lambda name, spec: FrameListener() if name == "listener" else build(name, spec))


def test_planned_kills_and_starts_give_the_same_messages_as_in_one_process() -> None:
    resolved = resolve("coordinated", "n_infrastructure=3", "attack_start_s=0.2", steps=CHURN, frames=16)
    expected = in_one_process(resolved)
    assert expected.frames("agent/infra_1/tracks/@tap/0") == [0, 1, 2, *range(5, 16)]
    assert expected.frames("agent/infra_1/tracks") == [0, 1, 2, 5, *range(10, 16)], "its adversary was away"
    assert expected.frames("agent/infra_3/tracks") == list(range(2, 16))
    for each in harmless_schedules(resolved, 2):
        assert_equals_one_process(resolved, each, expected)


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_a_run_continues_without_a_killed_node_that_may_end(mode: str) -> None:
    world = small_world(mode=mode)
    for seed in SEEDS:
        disturbed = schedule(seed, (0.06 + 0.004 * seed, "kill", "b"))
        outcome = play(world, disturbed)
        assert outcome.violations == [], disturbed
        assert (outcome.error, outcome.frames) == ("", 20), disturbed
        assert outcome.lost == {"b": "killed by signal 9 (SIGKILL)"}, disturbed
        assert outcome.results.keys() == EVERY - {"b"}, disturbed
        assert any("b killed by signal 9" in note and "continuing without it" in note for note in outcome.notes)


def test_a_restarted_node_takes_part_again_until_the_end_in_lock_step() -> None:
    world = heard()
    for seed in SEEDS:
        disturbed = schedule(seed, (0.06 + 0.004 * seed, "kill", "a"))
        outcome = play(world, disturbed)
        assert (outcome.error, outcome.frames, outcome.lost) == ("", 20, {}), disturbed
        assert outcome.results.keys() == EVERY, disturbed
        lost, back = outcome.churn
        assert (lost["what"], back["what"], lost["node"], back["node"]) == ("lost", "back", "a", "a"), disturbed
        frames = outcome.results["listener"]["frames"]
        assert frames["b"] == list(range(20)), "the run waits for no other node"
        assert all(before < after for before, after in pairwise(frames["a"])), disturbed
        assert frames["a"][-1] == 19, disturbed
        away = range(lost["frame"], back["frame"])
        assert not set(away) & set(frames["a"]), disturbed


def test_a_restarted_node_takes_part_again_until_the_end_in_real_time() -> None:
    world = replace(heard("realtime"), start_s=0.05)
    for number in SEEDS:
        outcome = play(world, schedule(number, (0.2 + 0.004 * number, "kill", "a"), calm=True))
        assert (outcome.error, outcome.frames, outcome.lost) == ("", 20, {})
        frames = outcome.results["listener"]["frames"]
        assert frames["b"] == list(range(20))
        assert all(before < after for before, after in pairwise(frames["a"]))
        assert frames["a"][-1] == 19
        assert len(frames["a"]) < 20, "frames passed while it was away"


def paused(*steps: tuple[int, str, str]) -> World:
    """The small world in real time, with process steps."""
    return small_world(mode="realtime", steps=tuple(ProcessStep(*step) for step in steps))


def test_a_node_paused_by_the_scenario_is_resumed_when_the_run_is_interrupted_and_hands_in_its_results() -> None:
    world = paused((2, "pause", "b"))
    for seed in SEEDS:
        outcome = play(world, schedule(seed, (0.15 + 0.01 * seed, "interrupt", "")))
        assert outcome.error.startswith("Interrupted"), seed
        assert outcome.results.keys() == EVERY, seed
        assert outcome.lost == {}, seed


def test_a_node_still_paused_at_the_end_of_the_scene_is_resumed_and_hands_in_its_results() -> None:
    world = paused((5, "pause", "b"))
    for seed in SEEDS:
        outcome = play(world, schedule(seed))
        assert (outcome.error, outcome.frames, outcome.lost) == ("", 20, {}), seed
        assert outcome.results.keys() == EVERY, seed


def test_an_unplanned_death_among_planned_ones_fails_the_run() -> None:
    world = paused((2, "kill", "a"), (3, "pause", "b"))
    for seed in SEEDS:
        outcome = play(world, schedule(seed, (0.2 + 0.005 * seed, "kill", "hub")))
        assert outcome.error.startswith("NodeDied: hub killed by signal 9"), seed
        assert outcome.lost.keys() == {"hub"}, "a was killed by the scenario"
        assert outcome.results.keys() >= EVERY - {"a", "hub"}, seed

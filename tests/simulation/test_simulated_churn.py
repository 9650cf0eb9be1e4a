"""Nodes that are killed, started, paused and restarted, in simulated runs with many interleavings."""

from dataclasses import replace
from itertools import pairwise

import pytest
from simulated_runs import CHURN, assert_equals_one_process, listening, resolve, schedule
from small_worlds import small_world

from mast_zenoh.config.resolved import ProcessStep
from mast_zenoh.testing.simulation import SimulatedWorld, play

SEEDS = range(0, 24, 2)
EVERY = {"ticker", "a", "b", "hub", "listener"}


def test_planned_kills_and_starts_give_the_same_messages_as_in_one_process() -> None:
    resolved = resolve("coordinated", "n_infrastructure=3", "attack_start_s=0.2", steps=CHURN, frames=16)
    expected = assert_equals_one_process(resolved)
    assert expected.frames("agent/infra_1/tracks/@tap/0") == [0, 1, 2, *range(5, 16)]
    assert expected.frames("agent/infra_1/tracks") == [0, 1, 2, 5, *range(10, 16)], "its adversary was away"
    assert expected.frames("agent/infra_3/tracks") == list(range(2, 16))


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
        assert any("killed by signal" in note and "continuing without it" in note for note in outcome.notes)


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_a_restarted_node_takes_part_again_until_the_end(mode: str) -> None:
    world = replace(listening(small_world(mode=mode)), start_s=0.05)
    for seed in SEEDS:
        at_s = (0.2 if mode == "realtime" else 0.1) + 0.004 * seed
        disturbed = schedule(seed, (at_s, "kill", "a"), calm=mode == "realtime")
        outcome = play(world, disturbed)
        assert (outcome.error, outcome.frames, outcome.lost) == ("", 20, {}), disturbed
        assert outcome.results.keys() == EVERY, disturbed
        assert any("restarted" in note for note in outcome.notes)
        frames = {name: [frame for _, frame in heard] for name, heard in outcome.results["listener"]["heard"].items()}
        assert frames["b"] == list(range(20)), "the run waits for no other node"
        assert all(before < after for before, after in pairwise(frames["a"])), disturbed
        assert frames["a"][-1] == 19, disturbed
        if mode == "realtime":
            assert len(frames["a"]) < 20, "frames passed while it was away"
            continue
        lost, back = outcome.churn
        assert (lost["what"], back["what"], lost["node"], back["node"]) == ("lost", "back", "a", "a"), disturbed
        assert not set(range(lost["frame"], back["frame"])) & set(frames["a"]), disturbed


def paused(*steps: tuple[int, str, str]) -> SimulatedWorld:
    """The small world in real time, with process steps."""
    return small_world(mode="realtime", steps=tuple(ProcessStep(*step) for step in steps))


@pytest.mark.parametrize("interrupted", [True, False])
def test_a_node_still_paused_at_the_end_or_an_interruption_is_resumed_and_hands_in_its_results(interrupted) -> None:
    world = paused((2 if interrupted else 5, "pause", "b"))
    for seed in SEEDS:
        outcome = play(world, schedule(seed, *[(0.15 + 0.01 * seed, "interrupt", "")] * interrupted))
        assert outcome.error.startswith("Interrupted") if interrupted else not outcome.error, seed
        assert interrupted or outcome.frames == 20, seed
        assert outcome.results.keys() == EVERY, seed
        assert outcome.lost == {}, seed


def test_an_unplanned_death_among_planned_ones_fails_the_run() -> None:
    world = paused((2, "kill", "a"), (3, "pause", "b"))
    for seed in SEEDS:
        outcome = play(world, schedule(seed, (0.2 + 0.005 * seed, "kill", "hub")))
        assert outcome.error.startswith("NodeDied: hub killed"), seed
        assert outcome.lost.keys() == {"hub"}, "a was killed by the scenario"
        assert outcome.results.keys() >= EVERY - {"a", "hub"}, seed

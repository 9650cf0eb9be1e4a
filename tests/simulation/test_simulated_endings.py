"""Simulated runs that are stopped, stall or lose their launcher, at many times and with many interleavings."""

from dataclasses import replace

import pytest
from simulated_runs import schedule
from small_worlds import small_world

from mast_zenoh.node import Context, Node
from mast_zenoh.testing.simulation import SimulatedWorld, check, play

SEEDS = range(0, 24, 2)
EVERY = {"ticker", "a", "b", "hub", "listener"}
MODES = ["lockstep", "realtime"]


def continuing(world: SimulatedWorld, *names: str) -> SimulatedWorld:
    """The same run, which continues without these nodes."""
    nodes = {
        name: replace(spec, on_exit="continue") if name in names else spec
        for name, spec in world.resolved.nodes.items()
    }
    return replace(world, resolved=replace(world.resolved, nodes=nodes))


@pytest.mark.parametrize("mode", MODES)
def test_a_run_without_a_node_that_it_needs_fails_and_keeps_the_results_of_the_others(mode: str) -> None:
    world = small_world(mode=mode)
    for seed in SEEDS:
        disturbed = schedule(seed, (0.06 + 0.004 * seed, "kill", "hub"))
        outcome = play(world, disturbed)
        assert outcome.error.startswith("NodeDied: hub killed"), disturbed
        assert outcome.results.keys() == EVERY - {"hub"}, disturbed
        assert outcome.lost.keys() == {"hub"}, disturbed


def test_a_driver_left_alone_does_not_continue_the_scene() -> None:
    others = sorted(EVERY - {"ticker"})
    world = continuing(small_world(frames=60), *others)
    for seed in SEEDS:
        kills = [(0.06 + 0.004 * seed, "kill", name) for name in others]
        outcome = play(world, schedule(seed, *kills))
        assert outcome.error.startswith("StallError"), seed
        assert "no other node" in outcome.error, seed
        assert outcome.frames < 60, seed
        assert outcome.lost.keys() == set(others), seed


@pytest.mark.parametrize("mode", MODES)
def test_an_interrupted_run_keeps_the_results_of_all_nodes(mode: str) -> None:
    world = small_world(frames=60, mode=mode)
    for seed in SEEDS:
        disturbed = schedule(seed, (0.06 + 0.01 * seed, "interrupt"))
        outcome = play(world, disturbed)
        assert outcome.error.startswith("Interrupted"), disturbed
        assert outcome.results.keys() == EVERY, disturbed
        assert outcome.lost == {}, disturbed
        assert outcome.frames < 60, disturbed


@pytest.mark.parametrize("mode", MODES)
def test_nodes_that_are_still_starting_end_when_the_run_is_interrupted(mode: str) -> None:
    world = replace(small_world(mode=mode), start_s=0.05)
    for seed in SEEDS:
        disturbed = schedule(seed, (0.005 * seed, "interrupt"))
        outcome = play(world, disturbed)
        assert outcome.error.startswith("Interrupted"), disturbed
        assert outcome.lost == {}, disturbed
        assert outcome.seconds < 4.0, "no node had to be killed"


def test_a_second_signal_ends_nodes_at_once() -> None:
    world = small_world(frames=60)
    for seed in SEEDS:
        at_s = 0.06 + 0.004 * seed
        outcome = play(world, schedule(seed, (at_s, "suspend", "hub", 30.0), (at_s, "interrupt"), (at_s, "interrupt")))
        assert outcome.error.startswith("Interrupted"), seed
        assert outcome.seconds < at_s + 0.03, "nothing is waited for"
        assert "hub" in outcome.lost, seed


def test_a_node_that_does_not_finish_after_a_signal_is_killed() -> None:
    world = small_world(frames=60)
    for seed in SEEDS:
        outcome = play(world, schedule(seed, (0.1, "freeze", "b", 45.0), (0.12 + 0.002 * seed, "interrupt")))
        assert outcome.error.startswith("Interrupted"), seed
        assert outcome.lost == {"b": "killed by signal 9 (SIGKILL)"}, seed
        assert outcome.results.keys() == EVERY - {"b"}, seed
        assert 10.0 < outcome.seconds < 11.0, "it had 10 s"


@pytest.mark.parametrize("seconds", [0.5, 5.0, 25.0])
def test_a_suspended_launcher_has_no_effect_on_a_run_in_lock_step(seconds: float) -> None:
    world = small_world()
    for seed in SEEDS:
        disturbed = schedule(seed, (0.012 * seed, "suspend launcher", "", seconds))
        assert check(world, disturbed) == []
        outcome = play(world, disturbed)
        assert outcome.claims_to_be_exact(), disturbed
        assert outcome.frames == 20, disturbed


@pytest.mark.parametrize("mode", MODES)
def test_nodes_leave_soon_after_their_launcher_was_killed_at_any_stage(mode: str) -> None:
    world = small_world(mode=mode)
    for number in range(0, 50, 2):  # starting, playing, and collecting results
        at_s = 0.01 * number
        outcome = play(world, schedule(number, (at_s, "lose launcher")))
        assert (outcome.ended, outcome.violations) == (True, []), number
        assert outcome.launcher_lost or number > 20, "the run is over sooner"
        assert outcome.seconds < at_s + 3.0, number


class Unable(Node):
    """Fails to start."""

    role = "agent"
    inputs = {"clock": "clock", "number": "status", "picture": "status"}
    outputs = {"out": "status"}

    def start(self, context: Context) -> None:
        raise FileNotFoundError("no weights")

    def on_clock(self, received: object, context: Context) -> None: ...

    on_number = on_picture = on_clock


@pytest.mark.parametrize("mode", MODES)
def test_a_node_that_fails_to_start_ends_the_run_although_it_may_end(mode: str) -> None:
    world = small_world(mode=mode)
    build = world.build
    world = continuing(replace(world, build=lambda name, spec: Unable() if name == "b" else build(name, spec)), "b")
    for seed in SEEDS:
        outcome = play(world, schedule(seed))
        assert outcome.error.startswith("StartError: b"), seed
        assert "first frame" in outcome.error, seed
        assert "FileNotFoundError: no weights" in outcome.error, seed
        assert outcome.frames == 0, seed
        assert outcome.results.keys() == EVERY - {"b"}, "the others hand in their results"

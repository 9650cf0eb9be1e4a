"""The simulation finds planted bugs, and schedules with which runs of earlier versions broke a promise break none."""

from itertools import cycle

import planted_bugs as bugs
import pytest
from planted_bugs import ENOUGH_SEEDS, PLANTS, Plant

from mast_zenoh.testing.simulation import Disturbance, Schedule, check, find, simplest


def schedule(seed: int, *disturbances: tuple[float, str, str, float], calm: bool = False) -> Schedule:
    """A schedule; disturbances: time in s, kind, node, how long it lasts in s."""
    return Schedule(seed, tuple(Disturbance(*disturbance) for disturbance in disturbances), calm)


#: Each bug, the name of a world, and a schedule with which that world shows the bug.
FOUND: list[tuple[Plant, str, Schedule]] = [
    (bugs.publishers_do_not_wait_for_subscribers, "lockstep", schedule(33)),
    (bugs.a_node_that_returns_at_once_is_not_noticed, "lockstep", schedule(5, (0.07, "kill", "a", 0.0))),
    (
        bugs.all_nodes_begin_with_the_planned_wiring,
        "lockstep",
        schedule(13, (0.041, "intercept", "relay", 0.0), (0.082, "kill", "a", 0.0)),
    ),
    (bugs.listeners_are_not_waited_for_before_a_change, "lockstep", schedule(73, (0.042, "intercept", "relay", 0.0))),
    (bugs.a_new_process_handles_what_was_sent_before_it_joined, "lockstep", schedule(5, (0.07, "kill", "a", 0.0))),
    (
        bugs.a_cancelled_change_is_not_awaited,
        "lockstep",
        schedule(0, (0.088, "intercept", "relay", 0.0), (0.11, "kill", "a", 0.0), (0.149, "kill", "relay", 0.0)),
    ),
    (
        bugs.a_change_hides_who_has_come,
        "lockstep",
        schedule(285, (0.035, "intercept", "relay", 0.0), (0.078, "kill", "a", 0.0)),
    ),
    (
        bugs.a_node_that_comes_or_goes_before_steps_is_not_noticed,
        "steps",
        schedule(0, (0.034, "cut", "listener", 1.014), (0.089, "kill", "b", 0.0), (0.267, "kill", "a", 0.0), calm=True),
    ),
    (
        bugs.a_loss_after_the_end_is_not_told,
        "lockstep",
        schedule(17392, (0.18916456439600626, "suspend", "ticker", 0.642), (0.774413117695563, "kill", "a", 0.0)),
    ),
    (
        bugs.a_step_that_came_too_late_is_undone,
        "steps",
        schedule(0, (0.17062222222222223, "kill", "a", 0.0), calm=True),
    ),
    (
        bugs.a_full_inbox_drops_the_clock,
        "lockstep",
        schedule(259, (0.023, "fill", "listener", 0.0), (0.023, "suspend", "listener", 0.5)),
    ),
    (bugs.a_node_that_does_not_finish_is_forgotten, "realtime", schedule(0, (0.553, "freeze", "hub", 45.0), calm=True)),
]


@pytest.mark.parametrize(("plant", "name", "schedule"), FOUND, ids=lambda value: getattr(value, "__name__", ""))
def test_a_schedule_that_once_broke_a_promise_breaks_none(plant, name, schedule, worlds, monkeypatch) -> None:
    assert check(worlds[name], schedule) == []
    plant(monkeypatch)
    assert check(worlds[name], schedule), f"this schedule no longer shows the bug: {plant.__doc__}"


#: Numbers of the schedules that show bugs which take long to find: these are tried first.
SHOWN_BY: dict[Plant, int] = {
    bugs.counts_of_an_older_epoch_are_taken: 351,
    bugs.listeners_are_not_waited_for_before_a_change: 156,
    bugs.the_wiring_changes_before_all_are_ready: 221,
    bugs.all_nodes_begin_with_the_planned_wiring: 392,
    bugs.dropped_messages_are_not_counted: 101,
    bugs.a_stop_signal_waits_for_no_results: 158,
    bugs.the_last_exit_is_not_handled: 252,
}


@pytest.mark.heavy
@pytest.mark.parametrize("plant", PLANTS, ids=lambda plant: plant.__name__)
def test_a_planted_bug_is_found(plant, worlds, monkeypatch) -> None:
    plant(monkeypatch)
    worlds_of_seeds = zip(range(ENOUGH_SEEDS), cycle(PLANTS[plant]), strict=False)
    known = SHOWN_BY.get(plant)
    likely_first = sorted(worlds_of_seeds, key=lambda pair: pair[0] != known)
    assert any(find(worlds[name], [seed]) for seed, name in likely_first), plant.__doc__


def test_a_schedule_with_which_a_promise_is_broken_is_simplified(worlds, monkeypatch) -> None:
    (dead,) = (plant for plant in PLANTS if plant.__name__ == "a_dead_node_is_waited_for")
    dead(monkeypatch)
    broken = find(worlds["lockstep"], range(ENOUGH_SEEDS))
    assert broken is not None
    simple = simplest(worlds["lockstep"], broken)
    assert [disturbance.kind for disturbance in simple.schedule.disturbances] == ["kill"]
    assert "kill" in str(simple)
    assert repr(simple.schedule) in str(simple)

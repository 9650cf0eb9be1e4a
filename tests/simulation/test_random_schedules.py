"""Every run keeps its promises, whatever its schedule, and a schedule that cannot be played is refused."""

import math

import pytest
from endings_table import ending
from fuzzing import Fuzzing
from hypothesis import given
from hypothesis import strategies as st
from planted_bugs import ENOUGH_SEEDS
from small_worlds import small_world, small_worlds

from mast_zenoh import testing
from mast_zenoh.errors import ConfigurationError, StallError
from mast_zenoh.testing.simulation import Disturbance, Schedule, SimulatedWorld, check, explore, play, random_schedule
from mast_zenoh.testing.simulation.promises import undisturbed
from mast_zenoh.testing.simulation.world import KINDS

pytestmark = pytest.mark.long


def test_runs_with_random_schedules_keep_every_promise(worlds: dict[str, SimulatedWorld]) -> None:
    explore(worlds["lockstep"], range(80))


@pytest.mark.heavy
@pytest.mark.parametrize("name", ["lockstep", "steps", "late", "realtime"])
def test_runs_with_more_random_schedules_keep_every_promise(worlds, name: str, fuzzing: Fuzzing) -> None:
    explore(worlds[name], range(fuzzing.draws(ENOUGH_SEEDS, 4000)))


def test_a_schedule_decides_everything(worlds: dict[str, SimulatedWorld]) -> None:
    for seed in range(8):
        schedule = random_schedule(seed, worlds["lockstep"])
        assert play(worlds["lockstep"], schedule) == play(worlds["lockstep"], schedule)


def test_random_schedules_contain_every_kind_of_disturbance(worlds: dict[str, SimulatedWorld]) -> None:
    schedules = [random_schedule(seed, worlds["lockstep"]) for seed in range(300)]
    assert {disturbance.kind for schedule in schedules for disturbance in schedule.disturbances} == KINDS.keys()


def test_an_undisturbed_run_plays_every_frame_and_hands_in_every_result(worlds: dict[str, SimulatedWorld]) -> None:
    for world in worlds.values():
        outcome = undisturbed(world)
        assert (outcome.ended, outcome.error, outcome.frames) == (True, "", 20)
        assert outcome.results.keys() == world.resolved.nodes.keys()
        assert outcome.claims_to_be_exact()


# -- what a disturbance does: each is seen in the outcome ------------------------------------------------------------


def disturbed(world: SimulatedWorld, kind: str, node: str = "", *, at_s: float = 0.04, lasts_s: float = 0.0):
    """The outcome of a run with one disturbance, after its promises have been checked."""
    schedule = Schedule(3, (Disturbance(at_s, kind, node, lasts_s),), calm=True)
    assert check(world, schedule) == []
    return play(world, schedule)


def test_a_suspended_node_changes_nothing_in_lockstep(worlds: dict[str, SimulatedWorld]) -> None:
    outcome = disturbed(worlds["lockstep"], "suspend", "a", lasts_s=10.0)
    assert outcome.results == undisturbed(worlds["lockstep"]).results
    assert outcome.seconds > 10.0


def test_a_node_that_is_suspended_for_too_long_stalls_the_run(worlds: dict[str, SimulatedWorld]) -> None:
    assert disturbed(worlds["lockstep"], "freeze", "a", lasts_s=45.0).error.startswith("StallError")


def test_a_launcher_that_is_suspended_for_longer_than_the_driver_waits_stalls_the_run(worlds) -> None:
    short = disturbed(worlds["lockstep"], "suspend launcher", lasts_s=19.0)
    assert (short.error, short.churn) == ("", [])
    assert disturbed(worlds["lockstep"], "suspend launcher", lasts_s=34.0).error.startswith("StallError")
    row = ending("launcher suspended for more than 30 s and resumed, lock-step")
    assert row == ("failed", StallError.exit_code)


def test_a_node_that_has_not_finished_when_the_run_is_over_fails_it(worlds: dict[str, SimulatedWorld]) -> None:
    outcome = disturbed(worlds["realtime"], "freeze", "hub", at_s=0.4, lasts_s=45.0)
    assert "finished within 20" in outcome.error


def test_an_inserted_node_changes_no_result_in_lockstep() -> None:
    world = small_world(frames=60)
    outcome = disturbed(world, "intercept", "relay")
    assert [change["action"] for change in outcome.changes] == ["intercept"]
    results = dict(outcome.results)
    results.pop("relay")
    assert results == undisturbed(world).results


def test_in_real_time_a_node_behind_a_cut_link_is_lost_until_the_link_is_back(worlds) -> None:
    world = small_world(frames=400, mode="realtime")
    outcome = disturbed(world, "cut", "a", at_s=1.0, lasts_s=4.0)
    lost, back = outcome.churn
    assert ((lost["what"], back["what"]), outcome.error) == (("lost", "back"), "")
    assert abs(lost["frame"] - 150) < 5, "after its lease, 2 s"
    assert abs(back["frame"] - 250) < 5


def test_a_process_that_is_replaced_behind_a_cut_link_does_not_take_its_successors_token_along() -> None:
    world = small_world(frames=400, mode="realtime")
    schedule = Schedule(3, (Disturbance(1.0, "cut", "a", 4.0), Disturbance(1.2, "kill", "a")), calm=True)
    assert check(world, schedule) == []
    outcome = play(world, schedule)
    assert [event["what"] for event in outcome.churn] == ["lost", "back"]
    assert outcome.results["a"]["handled"] > 200


def test_disturbances_that_met_nothing_are_told(worlds: dict[str, SimulatedWorld]) -> None:
    late, absent = Disturbance(80.0, "kill", "b"), Disturbance(0.05, "kill", "relay")
    used = Disturbance(0.05, "suspend", "a", 0.1)
    assert play(worlds["lockstep"], Schedule(0, (absent, used, late))).missed == [absent, late]


def test_a_node_that_dies_after_its_results_were_taken_is_not_started_again(worlds: dict[str, SimulatedWorld]) -> None:
    outcome = disturbed(worlds["lockstep"], "kill at stop", "a", lasts_s=0.00025)
    assert outcome.results == undisturbed(worlds["lockstep"]).results
    assert (outcome.churn, outcome.rejected["a"]) == ([], {})
    assert outcome.notes[0].endswith("had been taken")


def test_a_full_inbox_drops_messages_and_says_so(worlds: dict[str, SimulatedWorld]) -> None:
    schedule = Schedule(3, (Disturbance(0.07, "fill", "listener"), Disturbance(0.07, "suspend", "listener", 2.0)))
    outcome = play(worlds["lockstep"], schedule)
    assert check(worlds["lockstep"], schedule) == []
    assert any(reason.endswith("queued") for reason in outcome.rejected["listener"])


@pytest.mark.parametrize(
    ("disturbance", "message"),
    [
        (Disturbance(0.1, "kil", "a"), r"disturbances\[0\].*'kil'.*'kill'"),
        (Disturbance(-0.1, "kill", "a"), r"disturbances\[0\].*-0.1.*finite"),
        (Disturbance(0.1, "suspend", "a", math.nan), r"disturbances\[0\].*finite times"),
        (Disturbance(0.1, "kill", "aa"), r"disturbances\[0\].*'aa'.*'a'"),
        (Disturbance(0.1, "kill"), r"disturbances\[0\]: kill.*''"),
        (Disturbance(0.1, "intercept", "a"), r"disturbances\[0\]: intercept.*'a'"),
        (Disturbance(0.1, "interrupt", "a"), r"disturbances\[0\]: interrupt.*'a'"),
    ],
)
def test_a_schedule_that_cannot_be_played_is_refused(worlds, disturbance, message) -> None:
    with pytest.raises(ConfigurationError, match=message):
        play(worlds["lockstep"], Schedule(0, (disturbance,)))


def test_an_impossible_share_of_losses_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"loss.*2\.0.*0"):
        Schedule(0, loss=2.0)


@pytest.mark.parametrize("number", ["many", -1, 0.5])
def test_an_impossible_number_of_schedules_is_refused(number: object) -> None:
    with pytest.raises(ConfigurationError, match="schedules: found"):
        testing.check_scenario("baseline", frames=2, schedules=number)  # type: ignore[arg-type]


@given(seed=st.integers(), name=st.sampled_from(["lockstep", "realtime"]))
def test_a_random_schedule_fits_its_world_and_its_text_is_python(seed: int, name: str) -> None:
    world = small_worlds()[name]
    schedule = random_schedule(seed, world)
    schedule.check(world)
    assert eval(repr(schedule), {"Schedule": Schedule, "Disturbance": Disturbance}) == schedule


def test_processes_that_stop_for_longer_than_the_driver_waits_may_stall_a_run() -> None:
    short, long = (Schedule(0, (Disturbance(0.1, "suspend", "a", lasts_s),)) for lasts_s in (8.0, 40.0))
    assert (short.harmless, long.harmless) == (True, False)

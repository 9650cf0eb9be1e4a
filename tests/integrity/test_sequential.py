"""Agents whose claims the others refute are suspended, honest ones and open disputes are not."""

import numpy as np
import pytest
from calibrate_integrity import fitted_tail
from integrity_batches import Track, batch, view

from mast_zenoh.integrity import SequentialConsistency, TruthDiscovery
from mast_zenoh.integrity.alarms import accumulate, discoveries
from mast_zenoh.integrity.base import SUSPENDED, UNDECIDED

PLACES = {"a": (-20.0, 0.0), "b": (20.0, 0.0), "c": (0.0, 20.0)}
PHANTOMS, CAR = [(0.0, 0.0), (-9.0, 9.0)], (9.0, 9.0)


def batches(frames: int, liars: str = "", shift: float = 0.0, phantoms: list[tuple[float, float]] = PHANTOMS):
    """Three agents that see one car; liars also report phantoms, and their views end there; `c` may be off."""
    for frame in range(frames):
        tracks: list[Track] = [(name, 0, (CAR[0] + (shift if name == "c" else 0.0), CAR[1])) for name in PLACES]
        tracks += [(name, 1 + row, phantom) for name in liars for row, phantom in enumerate(phantoms)]
        views = {
            name: view(place, (*CAR, 2.5), *((*phantom, 2.5) for phantom in phantoms if name in liars))
            for name, place in PLACES.items()
        }
        yield batch(tracks, tuple(PLACES), views, frame=frame)


def states(stage, given) -> dict[str, int]:
    for each in given:
        assessment = stage.assess(each)
    return dict(zip(each.agents, assessment.agents.state.tolist(), strict=True))


@pytest.mark.parametrize("stage", [SequentialConsistency, TruthDiscovery])
def test_a_liar_is_suspended_and_its_phantoms_withheld_from_the_first_frame(stage: type) -> None:
    judge = stage()
    first = judge.assess(next(batches(1, "a")))
    assert first.objects.withheld.tolist() == [False, True, True]
    found = states(stage(), batches(80, "a"))
    assert found["a"] == SUSPENDED
    assert SUSPENDED not in (found["b"], found["c"])


@pytest.mark.parametrize("stage", [SequentialConsistency, TruthDiscovery])
def test_honest_agents_are_never_suspended(stage: type) -> None:
    assert SUSPENDED not in states(stage(), batches(200)).values()


def test_two_liars_that_deny_what_one_reports_do_not_get_it_suspended_at_once() -> None:
    # What they all see cannot be decided: TruthDiscovery believes the majority, but only after some time.
    views = {name: view(place, *([(*CAR, 2.5)] if name == "c" else [])) for name, place in PLACES.items()}
    given = (batch([("c", 0, CAR)], tuple(PLACES), views, frame=frame) for frame in range(10))
    assert states(TruthDiscovery(), given)["c"] != SUSPENDED


def test_a_track_that_is_off_by_more_than_the_noise_suspends_its_agent() -> None:
    stage = SequentialConsistency()
    *_, last = (stage.assess(each) for each in batches(100, shift=1.2))
    assert last.agents.state.tolist()[2] == SUSPENDED
    assert last.agents.reason[2].startswith("reports a position")
    assert SUSPENDED not in states(SequentialConsistency(), batches(100, shift=0.1)).values()


def test_a_suspended_agent_has_no_vote_and_is_released_after_a_clean_time() -> None:
    stage = SequentialConsistency(release_s=5.0)
    *_, lied = (stage.assess(each) for each in batches(45, "a"))
    assert lied.agents.state[0] == SUSPENDED
    assert lied.agents.reason[0]
    later = [stage.assess(batch_at(frame)) for frame in range(45, 500)]
    assert later[0].agents.state[0] == SUSPENDED
    assert later[-1].agents.state[0] != SUSPENDED
    assert not later[-1].agents.reason[0]


def batch_at(frame: int):
    views = {name: view(place, (*CAR, 2.5)) for name, place in PLACES.items()}
    return batch([(name, 0, CAR) for name in PLACES], tuple(PLACES), views, frame=frame)


def test_an_object_that_only_a_suspended_agent_reports_is_withheld_and_tracked_on() -> None:
    stage = SequentialConsistency()
    for each in batches(45, "a"):
        stage.assess(each)
    isolated = batch([("a", 0, (-60.0, -60.0)), ("b", 1, CAR)], tuple(PLACES), {}, frame=45)
    found = stage.assess(isolated)
    assert found.objects.withheld.tolist() == [True, False]
    assert found.weights is not None
    assert found.weights.tolist() == [1.0, 1.0]


def test_discoveries_are_those_of_benjamini_and_hochberg() -> None:
    rates = np.array([0.02, 0.3, 0.5, 3.0])
    # One false alarm an hour among four: the limits of the ordered rates are 0.25, 0.5, 0.75, 1.
    assert discoveries(rates, 1.0).tolist() == [True, True, True, False]
    assert discoveries(np.array([0.3, 0.6, 0.8, 3.0]), 1.0).tolist() == [False] * 4
    assert discoveries(np.zeros(0), 1.0).tolist() == []


def test_cumulative_sums_grow_with_evidence_and_never_fall_below_zero() -> None:
    total = np.zeros(2)
    for _ in range(10):
        total = accumulate(total, np.array([1.0, 0.0]), allowance=0.25, dt=0.1)
    assert total == pytest.approx([0.75, 0.0])


def test_the_tail_of_exponential_maxima_is_found() -> None:
    maxima = np.random.default_rng(5).exponential(0.5, 20_000)
    tail = fitted_tail(maxima, hours=100.0)
    assert tail.scale == pytest.approx(0.5, rel=0.05)
    assert tail.per_hour == pytest.approx(200.0, rel=0.2)
    assert tail.value_at(tail.per_hour / np.e) == pytest.approx(tail.scale)


@pytest.mark.parametrize(("maxima", "found"), [(np.arange(5.0), r"above.*90% quantile"), (np.zeros(100), "0 of 100")])
def test_a_tail_is_refused_for_few_blocks_and_for_equal_ones_with_what_was_found(maxima, found):
    with pytest.raises(ValueError, match=f"maxima.*{found}.*2"):
        fitted_tail(maxima, 1.0)


def test_agents_with_new_names_in_every_frame_do_not_take_the_numbers_of_others() -> None:
    stage = SequentialConsistency()
    for frame in range(80):
        names = tuple(sorted(["a", "b", "c", "d", *(f"x{frame}_{i}" for i in range(20))]))
        tracks: list[Track] = [(name, 0, (CAR[0] + 1.5 * (name == "d"), CAR[1])) for name in "abcd"]
        found = stage.assess(batch(tracks, names, {}, frame=frame)).agents
        stage.excuse("a")
    assert dict(zip(names, found.state.tolist(), strict=True))["d"] == UNDECIDED, "24 agents, and three accuse"
    numbers = stage._agents.of.number
    assert len(np.unique(numbers)) == len(numbers) > 1024


def test_a_suspended_agent_that_goes_on_with_the_same_phantoms_is_not_released() -> None:
    stage = SequentialConsistency(release_s=1.0)
    found = [stage.assess(each).agents.state[0] for each in batches(250, "a")]
    assert set(found[found.index(SUSPENDED) :]) == {SUSPENDED}

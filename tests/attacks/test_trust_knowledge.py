"""A budget limits the lies per second, without flicker; attackers that hear the trust in their agents react to it."""

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from attack_worlds import SECOND, at, coverage_of, world
from hypothesis import given
from hypothesis import strategies as st
from plaza import plaza

from mast_zenoh.arrays.states import propagate
from mast_zenoh.attacks import Attack, Surroundings
from mast_zenoh.attacks.adaptive import SAVED_S, Budget, Moment
from mast_zenoh.attacks.coordination import Collusion
from mast_zenoh.attacks.following import Follower
from mast_zenoh.attacks.knowledge import Trust, TrustWatch
from mast_zenoh.attacks.phantoms import BlindSpot, Sleeper
from mast_zenoh.attacks.real_objects import ChosenObjects, Framing, Overconfidence, Replay, SlowDrift, StatePerturbation
from mast_zenoh.integrity import STATES

ORIGIN = np.zeros(3)


def trust(mean: float, state: str = "unknown", other: float = 1.0) -> Trust:
    """The trust in infra_1, the victim, and in another agent."""
    return Trust(
        ("infra_1", "infra_2"),
        np.array([mean, other]),
        np.array([STATES.index(state), 0], np.uint8),
        np.zeros((0, 3)),
        np.zeros(0),
        np.zeros(0, np.uint8),
    )


def prepared(attack: Attack) -> Attack:
    attack.inform(Surroundings(victims=("infra_1",)))
    attack.bind(0, "adversary_1")
    return attack


def test_trust_has_fallen_when_it_is_below_its_highest_value_by_more_than_is_tolerated() -> None:
    watch, fallen = TrustWatch(0.1), []
    for mean in (0.5, 0.8, 0.75, 0.69, 0.72):
        watch.hear(trust(mean), ("infra_1",))
        fallen.append(watch.fallen)
    assert fallen == [False, False, False, True, False]


def test_a_suspended_agent_is_not_trusted() -> None:
    watch = TrustWatch(1.0)
    watch.hear(trust(1.0, "suspended"), ("infra_1",))
    assert watch.fallen


def test_the_trust_in_others_does_not_matter() -> None:
    watch = TrustWatch(0.1)
    for other in (1.0, 0.0):
        watch.hear(trust(0.9, other=other), ("infra_1",))
        watch.hear(Trust((), np.zeros(0), np.zeros(0, np.uint8), *[np.zeros(0)] * 2, np.zeros(0, np.uint8)), ("x",))
    assert not watch.fallen


def test_a_drift_goes_back_while_the_trust_has_fallen() -> None:
    attack = prepared(SlowDrift(rate_mps=1.0, limit_m=5.0, budget=1.0, start_s=0.5))
    offsets = []
    for frame in range(60):
        attack.hear_trust(frame, frame * SECOND // 10, trust(0.3 if 30 <= frame < 40 else 0.9))
        report = attack.step(frame, frame * SECOND // 10, world(6), ORIGIN).report
        offset = report.after_position - report.before_position
        offsets.append(float(np.linalg.norm(offset[0])) if len(report) else 0.0)
    change = np.diff(offsets)
    assert np.allclose(change[8:28], 0.1)
    assert np.allclose(change[30:38], -0.1)
    assert np.allclose(change[41:], 0.1)


def test_the_object_nearest_to_the_ego_is_changed_but_never_the_ego_itself() -> None:
    attack = SlowDrift(budget=1.0, start_s=0.5)
    attack.inform(plaza(("infra_1",), ego=[(0.0, 10.0, 0.0, 80.0)]))
    attack.bind(0, "adversary_1")
    seen, changed = at((10.0, 0.0), (30.0, 0.0), (60.0, 0.0), id=np.arange(3)), set()
    for frame in range(40):
        report = attack.step(frame, frame * SECOND // 10, seen, ORIGIN).report
        changed |= {*report.before_position[:, 0].tolist()}
    assert changed == {30.0}


def test_colluding_adversaries_are_honest_while_the_trust_in_one_has_fallen() -> None:
    coordination = Collusion(start_s=0.5, budget=8.0)
    coordination.inform(Surroundings(victims=("infra_1", "infra_2")))
    coordination.bind(0, "coordinator")
    counts = []
    for frame in range(40):
        coordination.hear_trust(frame, frame * SECOND // 10, trust(0.9, other=0.3 if 20 <= frame < 30 else 0.9))
        plans = coordination.step(
            frame, frame * SECOND // 10, world(6), np.zeros(6, np.int64), np.array([[0.0, 0.0, 0.0], [20.0, 0.0, 0.0]])
        )
        counts.append([len(plan) for plan in plans])
    assert all(count == [4, 4] for count in counts[10:20])
    assert all(count == [0, 0] for count in counts[20:30])
    assert all(count == [4, 4] for count in counts[30:])


def test_a_blind_spot_keeps_clear_of_objects_in_the_picture() -> None:
    attack = prepared(BlindSpot(budget=8.0, start_s=0.5))
    crowd = world(90, seed=3, spread=20.0)
    for frame in range(12):
        attack.hear_picture(frame, frame * SECOND // 10, crowd.with_(velocity=np.zeros((90, 3))))
        added = attack.step(frame, frame * SECOND // 10, world(6), ORIGIN).added
        if len(added):
            distance = np.linalg.norm(added.position[:, None, :2] - crowd.position[None, :, :2], axis=2)
            assert distance.min() > 1.5


def spent(rate: float, wanted: list[int], period_s: float = 0.1) -> list[int]:
    budget, active, told = Budget(rate), 0, []
    for count in wanted:
        budget.advance(period_s)
        active = budget.admit(active, count)
        budget.spend(active)
        told.append(active)
    return told


@given(st.floats(0.1, 20.0), st.lists(st.integers(0, 50), max_size=200))
def test_no_more_than_what_was_earned_is_ever_spent(rate: float, wanted: list[int]) -> None:
    told = spent(rate, wanted)
    assert np.all(np.array(told) <= wanted)
    total = np.cumsum(told) * 0.1
    assert np.all(total <= rate * 0.1 * np.arange(1, len(told) + 1) + 1e-6)
    for start in range(0, len(told), 7):
        window = sum(told[start:]) * 0.1
        assert window <= rate * (SAVED_S + 0.1 * (len(told) - start)) + 1e-6


@given(st.integers(1, 20))
def test_a_whole_number_of_lies_is_told_all_the_time(rate: int) -> None:
    assert spent(float(rate), [50] * 100) == [rate] * 100


def test_a_lie_beyond_the_steady_number_lasts_for_a_second() -> None:
    told = np.array(spent(1.5, [50] * 400))
    assert set(told.tolist()) == {1, 2}
    changes = np.flatnonzero(np.diff(told)) + 1
    lengths = np.diff(changes)[told[changes[:-1]] == 2]
    assert lengths.min() >= 10
    assert told.mean() == pytest.approx(1.5, abs=0.05)


def test_an_honest_period_saves_for_a_burst() -> None:
    told = spent(2.0, [0] * 50 + [6] * 20)
    assert told[50:] == [6] * 20


@pytest.mark.parametrize("budget", [1.0, 3.0])
@pytest.mark.parametrize(
    "make",
    [
        lambda budget: SlowDrift(budget=budget, start_s=1.0),
        lambda budget: StatePerturbation(budget=budget, start_s=1.0),
        lambda budget: Overconfidence(budget=budget, start_s=1.0),
        lambda budget: Replay(budget=budget, start_s=1.0, delay_s=0.5),
        lambda budget: BlindSpot(budget=budget, start_s=1.0),
        lambda budget: Sleeper(attack=SlowDrift(budget=budget, start_s=1.0), start_s=1.0, honest_s=1.0, lying_s=1.0),
    ],
    ids=["SlowDrift", "StatePerturbation", "Overconfidence", "Replay", "BlindSpot", "Sleeper"],
)
def test_attacks_keep_to_their_budget(make, budget: float) -> None:
    attack = make(budget)
    attack.inform(Surroundings())
    attack.bind(0, "adversary_1")
    lies = 0
    for frame in range(60):
        objects = propagate(world(12), 0.1 * frame)
        lies += len(attack.step(frame, frame * SECOND // 10, objects, np.zeros(3)).report)
    assert 0 < lies <= round(budget * 5.1 * 10)


def test_framing_without_anybody_to_frame_is_honest() -> None:
    attack = Framing(start_s=0.5)
    attack.inform(Surroundings())
    attack.bind(0, "adversary_1")
    assert all(len(attack.step(f, f * SECOND // 10, world(12), np.zeros(3)).report) == 0 for f in range(20))


def test_an_object_that_is_chosen_already_is_not_chosen_again() -> None:
    follower, numbers = Follower(3.0), itertools.count()
    budget: Any = SimpleNamespace()
    chosen = ChosenObjects(follower, budget, lambda n: np.array([next(numbers) for _ in range(n)]))
    seen = at((0.0, 0.0), (20.0, 0.0), id=np.arange(2))
    coverage, rows = coverage_of(np.zeros(3)), []
    for frame, allowed in enumerate((1, 2)):
        budget.admit = lambda active, wanted, allowed=allowed: allowed
        follower.observe(seen, frame * SECOND)
        moment = Moment(frame, frame * SECOND, 1.0, seen, np.ones(2, bool), coverage, np.zeros(3))
        rows.append(chosen.update(moment, np.array([0.0, 1.0]))[1].tolist())
    assert rows == [[0], [0, 1]]

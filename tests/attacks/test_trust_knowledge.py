"""Attackers that hear the trust in their agents react to it."""

from __future__ import annotations

import numpy as np
from attack_worlds import SECOND, world

from mast_zenoh.attacks import Attack, Surroundings
from mast_zenoh.attacks.coordination import Collusion
from mast_zenoh.attacks.knowledge import Trust, TrustWatch
from mast_zenoh.attacks.phantoms import BlindSpot, Sleeper
from mast_zenoh.attacks.real_objects import SlowDrift
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


def test_a_sleeper_sleeps_on_while_the_trust_has_fallen() -> None:
    attack = prepared(
        Sleeper(attack=SlowDrift(start_s=0.5), honest_s=0.5, lying_s=0.5, start_s=0.5),
    )
    lies = []
    for frame in range(80):
        attack.hear_trust(frame, frame * SECOND // 10, trust(0.3 if 30 <= frame < 60 else 0.9))
        lies.append(len(attack.step(frame, frame * SECOND // 10, world(6), ORIGIN).report))
    assert sum(lies[:30]) > 0
    assert sum(lies[30:60]) == 0
    assert sum(lies[60:]) > 0


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

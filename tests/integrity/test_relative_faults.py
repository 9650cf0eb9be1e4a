"""Faults of whole agents are found from the differences of all pairs, on one agent and on several at once."""

import numpy as np
import pytest

from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.integrity.relative_faults import RelativeFaults

NAMES = ("a", "b", "c", "d", "e")
PIVOTS = np.array([[-30.0, 0.0], [30.0, 0.0], [0.0, 30.0], [0.0, -30.0], [20.0, 20.0]])
NOBODY = np.zeros(5, np.bool_)
STEP_NS = 100_000_000
SKEW, SHIFT, TURN = (0.0, 0.0, 0.0, 0.3), (1.6, -1.2, 0.0, 0.0), (0.0, 0.0, 0.1, 0.0)


def cars(place: Floats, velocity: Floats) -> ObjectStates:
    n = len(place)
    return ObjectStates.of(
        np.column_stack([place, np.zeros(n)]),
        id=np.arange(n),
        velocity=np.column_stack([velocity, np.zeros(n)]),
        size=np.tile([4.5, 1.8, 1.5], (n, 1)),
        covariance=np.tile(np.diag([0.04] * 3 + [0.02] * 3 + [0.25] * 3), (n, 1, 1)),
    )


def batches(faults: dict[str, tuple[float, ...]], frames: int = 25, seed: int = 0, odd: str = ""):
    """States and agents of five agents that see the same twelve moving objects, with noise.

    odd: an agent that moves a third of its objects by 2 m, which is no fault
    """
    random = np.random.default_rng(seed)
    start = random.uniform(-50.0, 50.0, (12, 2))
    velocity = random.uniform(-12.0, 12.0, (12, 2))
    for frame in range(frames):
        true = start + velocity * 0.1 * frame
        position, agent = [], np.repeat(np.arange(5), 12)
        for row, name in enumerate(NAMES):
            x, y, turn, lead = faults.get(name, (0.0,) * 4)
            arm = true - PIVOTS[row]
            moved = true + [x, y] + turn * np.column_stack([-arm[:, 1], arm[:, 0]]) + lead * velocity
            if name in odd:
                moved[::3] += [2.0, 0.0]
            position.append(moved + random.normal(0.0, 0.2, moved.shape))
        yield frame * STEP_NS, cars(np.concatenate(position), np.tile(velocity, (5, 1))), agent


def estimating() -> RelativeFaults:
    return RelativeFaults(significance=30.0, least_m=0.3, share=0.7, memory_s=1.5)


def found(given, names=NAMES, pivots=PIVOTS, estimator: RelativeFaults | None = None) -> Floats:
    """Faults after batches (time, states, agents)."""
    estimator = estimator or estimating()
    for time_ns, states, agent in given:
        estimator.update(time_ns, states, agent, names, pivots, np.zeros(len(names), np.bool_))
    return estimator.faults(pivots)


@pytest.mark.parametrize(
    "faults",
    [
        {},
        {"a": SKEW},
        {"a": SHIFT},
        {"a": TURN},
        {"a": (5.0, -4.0, 0.0, 0.0)},
        {"a": (0.0, 0.0, 0.0, 0.5)},
        {"a": SKEW, "c": SKEW},
        {"a": SHIFT, "b": SHIFT},
        {"d": TURN, "e": TURN},
        {"a": SHIFT, "e": SKEW},
        {"b": (0.0, 0.0, 0.0, -0.5), "c": (0.0, 0.0, 0.0, 0.5)},
    ],
    ids=str,
)
@pytest.mark.parametrize("seed", [0, 1])
def test_faults_of_up_to_two_of_five_are_found_and_of_nobody_else(faults, seed):
    expected = np.array([faults.get(name, (0.0,) * 4) for name in NAMES])
    assert (np.abs(found(batches(faults, seed=seed)) - expected) <= [0.25, 0.25, 0.012, 0.03]).all()


def test_an_agent_that_moves_some_of_its_objects_has_no_fault():
    assert not found(batches({}, odd="b")).any()


def test_an_agent_that_sees_other_cars_of_a_queue_than_the_rest_has_no_fault():
    def queues():
        for time_ns, states, agent in batches({}):
            # Five cars each, 6.2 m apart; those that "a" sees stand between those of the others.
            row = np.arange(len(states)) % 12
            states, agent, row = states.select(row < 5), agent[row < 5], row[row < 5]
            position = np.column_stack([12.4 * row + 6.2 * (agent == 0), 0.0 * row, 0.0 * row])
            yield time_ns, states.with_(position=position, velocity=np.zeros_like(position)), agent

    assert not found(queues()).any()


def test_nobody_is_corrected_where_as_many_agents_differ_as_agree():
    four = (
        (time, states.select(agent < 4), agent[agent < 4]) for time, states, agent in batches({"a": SHIFT, "b": SHIFT})
    )
    assert not found(four, NAMES[:4], PIVOTS[:4]).any()


def test_a_delay_is_kept_while_nothing_moves_and_forgotten_when_it_is_over():
    estimator = estimating()
    found(batches({"a": SKEW}, frames=30), estimator=estimator)
    ((_, states, agent),) = batches({}, frames=1)
    still = states.with_(velocity=np.zeros((len(states), 3)))
    kept = found(((frame * STEP_NS, still, agent) for frame in range(30, 90)), estimator=estimator)
    assert kept[0, 3] == pytest.approx(0.3, abs=0.05)
    later = ((9_000_000_000 + time, *rest) for time, *rest in batches({}, frames=40))
    assert not found(later, estimator=estimator).any()


def test_no_more_than_a_minority_is_corrected_and_those_known_before_stay() -> None:
    estimator, faulty = estimating(), []
    for shifted in ("ab", "abe"):  # then c and d differ from most
        begin_ns = len(faulty) * STEP_NS
        for time_ns, states, agent in batches(dict.fromkeys(shifted, SHIFT)):
            estimator.update(begin_ns + time_ns, states, agent, NAMES, PIVOTS, NOBODY)
            faulty.append(estimator.faults(PIVOTS).any(axis=1).nonzero()[0].tolist())
    assert max(map(len, faulty)) == 2
    assert faulty[24] == faulty[-1] == [0, 1]


def test_a_fault_is_found_among_many_agents():
    random, agent = np.random.default_rng(0), np.repeat(np.arange(25), 12)
    place, pivots = random.uniform(-50.0, 50.0, (12, 2)), random.uniform(-40.0, 40.0, (25, 2))

    def shifted():
        for frame in range(20):
            position = np.tile(place, (25, 1)) + random.normal(0.0, 0.2, (300, 2))
            position[agent == 7, 0] += 2.0
            yield frame * STEP_NS, cars(position, np.zeros((300, 2))), agent

    names = tuple(f"agent_{row:02}" for row in range(25))
    assert np.flatnonzero(found(shifted(), names, pivots).any(axis=1)).tolist() == [7]


@pytest.mark.parametrize(("liars", "suspended", "framed"), [("bc", "", False), ("bcd", "", True), ("bc", "b", False)])
def test_the_word_of_two_of_five_proves_no_fault_of_a_third(liars: str, suspended: str, framed: bool) -> None:
    """Liars displace what only `a` sees besides them, and do not report the rest: each alone differs from `a`."""
    estimator = estimating()
    for time_ns, states, agent in batches({}):
        number = np.tile(np.arange(12), 5)
        lying = np.isin(np.array(NAMES)[agent], list(liars))
        kept = np.flatnonzero(np.where(lying, number < 6, (agent == 0) | (number >= 6)))
        moved = states.position + np.array([2.0, 0.0, 0.0]) * lying[:, None]
        tracks = states.with_(position=moved).select(kept)
        estimator.update(time_ns, tracks, agent[kept], NAMES, PIVOTS, np.isin(NAMES, list(suspended)), urgent=True)
    assert estimator.differ[0, 1]
    assert estimator.faults(PIVOTS)[0].any() == framed

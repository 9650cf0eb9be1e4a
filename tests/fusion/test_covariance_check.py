"""Covariances that agents report are believed as far as sensors achieve them and the other agents agree."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tracked_objects import INVALID_COVARIANCES, MATURE, cars, centre, nanoseconds

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.fusion import CheckedCovariances, CovarianceCheck, ReportedCovariances

NAMES = tuple("abcde")
CARS = np.array([[15.0 * x, 15.0 * y] for x in range(4) for y in range(4)])
FRAMES = 20


def reported(
    agents: int, frame: int, offset: dict[int, float], factor: dict[int, float], std_m: float = 0.15
) -> tuple[ObjectStates, np.ndarray]:
    """Tracks of parked cars by some agents.

    offset: m along x, by agent; factor: on the covariance, by agent; std_m: of their errors
    """
    random = np.random.default_rng(frame)
    agent = np.repeat(np.arange(agents), len(CARS))
    place = np.tile(CARS, (agents, 1)) + random.normal(0.0, std_m, (len(agent), 2))
    place[:, 0] += [offset.get(each, 0.0) for each in agent.tolist()]
    scale = np.array([factor.get(each, 1.0) for each in agent.tolist()])
    covariance = MATURE * scale[:, None, None]
    states = cars(place, covariance=covariance, id=np.tile(np.arange(len(CARS)), agents))
    return states, agent


def inflated(check: CovarianceCheck, agents: int, offset: dict[int, float], factor: dict[int, float]) -> ObjectStates:
    """The tracks of the last frame, as the check believes them."""
    for frame in range(FRAMES):
        states, agent = reported(agents, frame, offset, factor)
        labels = np.tile(np.arange(len(CARS)), agents)
        result = check.inflated(nanoseconds(frame), check.floored(states), agent, NAMES[:agents], labels, None)
    return result


def variances(states: ObjectStates, agents: int) -> list[float]:
    """The mean variance of x by agent."""
    return states.covariance[:, 0, 0].reshape(agents, -1).mean(axis=1).tolist()


def picture(covariances: CovarianceCheck, agents: int, offset: dict[int, float], factor: dict[int, float]):
    """The last picture of the cars."""
    pipeline = centre(covariances=covariances)
    for frame in range(FRAMES):
        states, agent = reported(agents, frame, offset, factor)
        result, _ = pipeline.step(nanoseconds(frame), states, agent, NAMES[:agents])
    return result


def error_m(states: ObjectStates) -> float:
    """The mean distance of the pictured cars from the nearest real one."""
    return float(np.linalg.norm(states.position[:, None, :2] - CARS[None], axis=2).min(axis=1).mean())


def test_honest_covariances_are_unchanged_to_the_last_bit():
    check = CheckedCovariances()
    for frame in range(FRAMES):
        states, agent = reported(5, frame, {}, {})
        assert check.floored(states) is states
        labels = np.tile(np.arange(len(CARS)), 5)
        assert check.inflated(nanoseconds(frame), states, agent, NAMES, labels, None) is states


def test_one_agent_that_claims_to_be_certain_does_not_decide_the_picture():
    offset, factor = {1: 1.5}, {1: 1e-6}
    assert error_m(picture(ReportedCovariances(), 5, offset, factor)) > 1.4
    assert error_m(picture(CheckedCovariances(), 5, offset, factor)) < 0.2
    assert error_m(picture(CheckedCovariances(), 5, {}, {})) < 0.15


def test_variances_grow_by_the_excess_of_the_observed_differences():
    """An offset of 1.5 m along x is 1.1 m² per axis."""
    result = variances(inflated(CheckedCovariances(), 5, {1: 1.5}, {1: 1e-6}), 5)
    assert result[1] == pytest.approx(0.5 * 1.5**2, rel=0.2)
    assert np.delete(result, 1).tolist() == [pytest.approx(0.05)] * 4


def test_two_of_five_that_agree_with_each_other_are_in_the_minority():
    result = variances(inflated(CheckedCovariances(), 5, {1: 1.5, 3: 1.5}, {1: 1e-6, 3: 1e-6}), 5)
    assert min(result[1], result[3]) > 0.5
    assert [result[0], result[2], result[4]] == [pytest.approx(0.05)] * 3


def test_of_two_agents_that_disagree_both_become_uncertain():
    result = variances(inflated(CheckedCovariances(), 2, {1: 1.5}, {1: 1e-6}), 2)
    assert min(result) > 0.3
    assert result[0] - result[1] == pytest.approx(0.04)


@pytest.mark.parametrize("agents", [2, 5])
def test_one_accuser_makes_no_tracks_too_uncertain_to_be_reported(agents):
    """Agent 1 is 1.9 m off, and the only one that sees an object that agent 0 sees."""
    check = CheckedCovariances()
    for frame in range(FRAMES):
        states, agent = reported(agents, frame, {1: 1.9}, {1: 1e-6})
        labels = np.where(agent <= 1, 0, agent)[:, None] * len(CARS) + np.tile(np.arange(len(CARS)), agents)[:, None]
        result = check.inflated(nanoseconds(frame), states, agent, NAMES[:agents], labels[:, 0], None)
    horizontal = result.covariance[agent == 0, 0, 0] + result.covariance[agent == 0, 1, 1]
    assert 0.5 < horizontal.max() < 1.2**2


@pytest.mark.parametrize("honest", [0, 3])
def test_an_agent_that_is_honest_in_one_of_five_frames_becomes_as_uncertain_as_it_is_on_average(honest):
    """Whichever frame that is: no frame matters more than others."""
    check, grown = CheckedCovariances(), []
    for frame in range(40):
        states, agent = reported(5, frame, {} if frame % 5 == honest else {1: 1.5}, {1: 1e-6})
        labels = np.tile(np.arange(len(CARS)), 5)
        result = check.inflated(nanoseconds(frame), check.floored(states), agent, NAMES, labels, None)
        grown.append(variances(result, 5))
    settled = np.array(grown[20:])
    assert settled[:, 1] == pytest.approx(0.75, rel=0.2)  # 0.8 of 1.1 m², less what the limit allows
    assert np.delete(settled, 1, axis=1) == pytest.approx(0.05)


def test_agents_that_are_not_trusted_make_nobody_uncertain():
    check = CheckedCovariances()
    for frame in range(FRAMES):
        states, agent = reported(3, frame, {1: 1.5, 2: 1.5}, {})
        labels, trust = np.tile(np.arange(len(CARS)), 3), np.where(agent == 0, 1.0, 0.0)
        assert check.inflated(nanoseconds(frame), states, agent, NAMES[:3], labels, trust) is states


def test_what_is_known_of_an_agent_outlasts_that_others_join_and_leave():
    check = CheckedCovariances()
    inflated(check, 5, {1: 1.5}, {})
    states, _ = reported(1, FRAMES, {}, {})
    alone = np.zeros(len(states), np.int64), ("b",), np.arange(len(states))
    result = check.inflated(nanoseconds(FRAMES), states, alone[0], *alone[1:], None)
    assert result.covariance[0, 0, 0] > 0.5
    check.reset()
    assert check.inflated(nanoseconds(FRAMES), states, alone[0], *alone[1:], None) is states


def believed(check: CovarianceCheck, frame: int, present: tuple[int, ...], offset: dict[int, float]) -> list[float]:
    """The mean variance of x of the agents that are present in a frame."""
    states, agent = reported(5, frame, offset, {})
    rows = np.isin(agent, present)
    labels = np.tile(np.arange(len(CARS)), 5)[rows]
    names = tuple(NAMES[k] for k in present)
    arguments = states.select(rows), np.searchsorted(present, agent[rows]), names, labels, None
    return variances(check.inflated(nanoseconds(frame), *arguments), len(present))


def test_an_agent_that_misses_batches_is_known_when_it_returns_unless_it_was_away_for_long():
    for away, grown in [(1, True), (30, True), (149, True), (200, False)]:
        check = CheckedCovariances()
        for frame in range(20):
            believed(check, frame, (0, 1, 2, 3, 4), {1: 1.5})
        for frame in range(20, 20 + away):
            assert believed(check, frame, (0, 2, 3, 4), {}) == pytest.approx([0.05] * 4)
        assert (believed(check, 20 + away, (0, 1, 2, 3, 4), {})[1] > 0.5) == grown


def test_an_agent_that_is_absent_now_and_then_is_compared_over_all_its_frames():
    check, everybody = CheckedCovariances(), (0, 1, 2, 3, 4)
    for frame in range(60):
        present = everybody if frame % 5 else (0, 2, 3, 4)
        result = believed(check, frame, present, {1: 1.5})
    assert result[1] > 0.8


def test_absent_agents_make_nobody_uncertain():
    """One agent under three names, each for a second, against two honest ones."""
    check = CheckedCovariances()
    for frame in range(45):
        result = believed(check, frame, (0, 1, 2 + frame // 15), {2: 1.5, 3: 1.5, 4: 1.5})
        assert result[:2] == pytest.approx([0.05] * 2)
    assert result[2] > 0.5


def test_the_number_of_absent_agents_that_are_known_is_limited():
    check, states = CheckedCovariances(), reported(1, 0, {}, {})[0]
    alone = np.zeros(len(states), np.int64), np.arange(len(states))
    for frame in range(150):
        check.inflated(frame, states, alone[0], (f"agent{frame}",), alone[1], None)
    assert len(check._sums) == len(check._excess) == 101


covariances = st.sampled_from(
    [
        *INVALID_COVARIANCES.values(),
        MATURE * 1e-6,
        MATURE + 0.0499 * (np.eye(9)[[1, 0, *range(2, 9)]] - np.diag([0.0, 0.0, *[1.0] * 7])),  # x and y nearly equal
        MATURE,
    ]
)


@given(st.lists(covariances, min_size=1, max_size=6))
def test_no_direction_of_a_state_is_more_certain_than_the_floor(each):
    states = ObjectStates.of(np.zeros((len(each), 3)), covariance=np.array(each))
    floored = CheckedCovariances().floored(states)
    least = np.array([0.1, 0.1, 0.03, 0.03, 0.03, 0.03, 0.1, 0.1, 0.1])
    symmetric = 0.5 * (floored.covariance + floored.covariance.transpose(0, 2, 1))
    assert np.isfinite(symmetric).all()
    assert (
        np.linalg.eigvalsh(symmetric / least[:, None] / least).min() >= 1.0 - 1e-3
    )  # rounding, next to the largest variances
    for before, after in zip(each, floored.covariance, strict=True):
        if before is MATURE:
            assert after.tobytes() == before.tobytes()


@given(st.randoms(use_true_random=False))
def test_the_order_of_tracks_and_agents_does_not_matter(random):
    check, other = CheckedCovariances(), CheckedCovariances()
    for frame in range(8):
        states, agent = reported(4, frame, {1: 1.5, 2: -0.7}, {1: 1e-6})
        labels = np.tile(np.arange(len(CARS)), 4)
        rows = np.array(random.sample(range(len(states)), len(states)))
        result = check.inflated(nanoseconds(frame), states, agent, NAMES[:4], labels, None)
        again = other.inflated(nanoseconds(frame), states.select(rows), agent[rows], NAMES[:4], labels[rows], None)
        assert result.covariance[rows].tobytes() == again.covariance.tobytes()

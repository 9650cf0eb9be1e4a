"""The intelligent driver model against what its authors published: equilibrium gaps, and string stability."""

import numpy as np
import pytest

from mast_zenoh.driving.following import IntelligentDriverModel

DESIRED = 120.0 / 3.6  # m/s, of table I


def acceleration(model: IntelligentDriverModel, speed: float, gap: float, ahead: float, desired: float) -> float:
    own = np.array([speed])
    free, interaction = model.free(own, np.array([desired])), model.interaction(own, np.array([gap]), np.array([ahead]))
    return float((free + interaction)[0])


def equilibrium_gap(model: IntelligentDriverModel, speed: float, desired: float) -> float:
    """Equation 6 of Treiber et al. (2000): the gap at which nobody accelerates."""
    return (model.gap_m + speed * model.headway_s) / np.sqrt(1.0 - (speed / desired) ** model.exponent)


def settle(model: IntelligentDriverModel, leader: float, seconds: float, n: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Gaps and speeds of n cars behind one at constant speed, after a while."""
    step = 0.1
    position, speed = -30.0 * np.arange(n + 1.0), np.full(n + 1, 0.5 * leader)
    speed[0] = leader
    for _ in range(int(seconds / step)):
        gap = position[:-1] - position[1:]
        change = model.free(speed[1:], np.full(n, DESIRED)) + model.interaction(speed[1:], gap, speed[:-1])
        new = np.maximum(speed[1:] + change * step, 0.0)
        position[0] += leader * step
        position[1:] += (speed[1:] + new) / 2.0 * step
        speed[1:] = new
    return position[:-1] - position[1:], speed


@pytest.mark.parametrize("speed", [0.0, 5.0, 10.0, 20.0, 30.0])
def test_nobody_accelerates_at_the_equilibrium_gap(speed: float) -> None:
    model = IntelligentDriverModel()
    gap = equilibrium_gap(model, speed, DESIRED)
    assert acceleration(model, speed, gap, speed, DESIRED) == pytest.approx(0.0, abs=1e-12)
    assert acceleration(model, speed, gap + 1.0, speed, DESIRED) > 0.0
    assert acceleration(model, speed, gap - 0.5, speed, DESIRED) < 0.0


def test_cars_behind_a_leader_settle_at_the_equilibrium_gap() -> None:
    model = IntelligentDriverModel(acceleration=1.5)
    gaps, speeds = settle(model, leader=15.0, seconds=400.0)
    assert speeds == pytest.approx(15.0, abs=1e-3)
    assert gaps == pytest.approx(equilibrium_gap(model, 15.0, DESIRED), abs=1e-2)


def test_a_car_behind_a_standing_one_stops_at_the_least_gap() -> None:
    gaps, speeds = settle(IntelligentDriverModel(), leader=0.0, seconds=300.0, n=1)
    assert speeds[1] == pytest.approx(0.0, abs=1e-2)
    assert gaps[0] == pytest.approx(2.0, abs=0.1)


def test_a_free_car_reaches_its_desired_speed_and_slows_down_comfortably_from_above() -> None:
    model = IntelligentDriverModel()
    assert acceleration(model, 0.0, np.inf, 0.0, 10.0) == pytest.approx(0.73)
    assert acceleration(model, 10.0, np.inf, 0.0, 10.0) == pytest.approx(0.0, abs=1e-12)
    assert acceleration(model, 30.0, np.inf, 0.0, 10.0) == pytest.approx(-1.67)


def criterion(model: IntelligentDriverModel, speed: float) -> float:
    """Positive where platoons are string stable: Wilson and Ward, Car-following models: fifty years of linear
    stability analysis (2011), from numerical derivatives by gap, speed and speed difference."""
    gap, step = equilibrium_gap(model, speed, DESIRED), 1e-5

    def of(gap_change: float = 0.0, speed_change: float = 0.0, ahead_change: float = 0.0) -> float:
        own = speed + speed_change
        return acceleration(model, own, gap + gap_change, own + ahead_change, DESIRED)

    by_gap = (of(gap_change=step) - of(gap_change=-step)) / (2 * step)
    by_speed = (of(speed_change=step) - of(speed_change=-step)) / (2 * step)
    by_difference = (of(ahead_change=step) - of(ahead_change=-step)) / (2 * step)
    return by_speed**2 / 2.0 - by_difference * by_speed - by_gap


def test_dense_platoons_are_string_stable_above_the_published_acceleration() -> None:
    """Treiber and Kesting, Traffic Flow Dynamics (2013), chapter 15: near a standstill, if a > s0 / T^2."""
    threshold = 2.0 / 1.6**2
    slow = 0.01
    assert criterion(IntelligentDriverModel(acceleration=1.05 * threshold), slow) > 0.0
    assert criterion(IntelligentDriverModel(acceleration=0.95 * threshold), slow) < 0.0

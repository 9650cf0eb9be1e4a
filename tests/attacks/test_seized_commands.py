"""An attack on commands acts during its time, and an attack on a driven ego knows where it is on its route."""

import numpy as np
import pytest

from mast_zenoh.attacks.seizure import SeizedCommands
from mast_zenoh.attacks.surroundings import Route


@pytest.mark.parametrize(("time_s", "acceleration"), [(0.9, 1.0), (1.0, -6.0), (2.9, -6.0), (3.0, 1.0)])
def test_the_acceleration_is_replaced_from_the_start_to_the_end_and_the_curvature_never(
    time_s: float, acceleration: float
) -> None:
    attack = SeizedCommands(acceleration=-6.0, start_s=1.0, end_s=3.0)
    assert attack.forge_command(round(time_s * 1e9), 1.0, 0.02) == (acceleration, 0.02)


@pytest.mark.parametrize(
    "wrong", [dict(start_s=-1.0), dict(start_s=5.0, end_s=5.0), dict(end_s=np.nan), dict(acceleration=np.inf)]
)
def test_a_time_or_an_acceleration_that_cannot_be_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(reversed(wrong))):
        SeizedCommands(**wrong)


def test_the_time_of_a_route_is_when_it_is_nearest() -> None:
    """It stands for 2 s, then drives 10 m/s to the east."""
    route = Route.of_rows([[0.0, 0, 0, 0, 1, 0, 0, 0], [2.0, 0, 0, 0, 1, 0, 0, 0], [4.0, 20, 0, 0, 1, 0, 0, 0]])
    assert route.time_near(np.array([-3.0, 0.0])) == 0.0
    assert route.time_near(np.array([7.0, 2.0])) == pytest.approx(2.7)
    assert route.time_near(np.array([99.0, 0.0])) == pytest.approx(4.0)

"""Late messages are worth less the later they are, and never nothing at once."""

from itertools import pairwise
from pathlib import Path

import pytest

import mast_zenoh as mast

pytestmark = pytest.mark.heavy

DELAYS_S = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)


@pytest.fixture(scope="module")
def missed(tmp_path_factory: pytest.TempPathFactory) -> dict[float, float]:
    """Missed objects a frame in the ego's picture, by the delay of the four poles' messages; inf: they have none."""
    folder: Path = tmp_path_factory.mktemp("late")

    def play(delay_s: float, **more: object) -> float:
        out = folder / f"{delay_s} {len(more)}"
        run = mast.run("delayed", delay_s=delay_s, scene_index=1, frames=80, seed=5, record=False, out=out, **more)
        return float(run.summary["agents"]["ego"]["picture"]["fn"]["mean"])

    return {delay_s: play(delay_s) for delay_s in DELAYS_S} | {float("inf"): play(1.0, max_age_s=0.5)}


def test_a_delay_of_one_frame_costs_a_fifth_at_most(missed: dict[float, float]) -> None:
    assert missed[0.1] <= 1.2 * missed[0.0]


def test_the_picture_gets_worse_little_by_little(missed: dict[float, float]) -> None:
    """Each tenth of a second costs at most a third of what the poles are worth."""
    worth = missed[float("inf")] - missed[0.0]
    steps = [missed[later] - missed[sooner] for sooner, later in pairwise(DELAYS_S)]
    assert worth > 3.0
    assert max(steps) < worth / 3
    assert min(steps) > -worth / 20, "never better by much"
    assert missed[0.5] < missed[0.0] + worth / 2, "after half a second, half of it is left"

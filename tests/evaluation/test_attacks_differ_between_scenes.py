"""Attacks on two scenes of one seed are independent, as studies assume."""

from collections.abc import Callable

import numpy as np
import pytest
from played import Played

#: The paper's distribution is the same about every victim, whatever the scene.
PAPER = {
    "uncoordinated": "adversaries.adversary_1.attack.selection.region=paper",
    "coordinated": "coordinator.coordination.selection.region=paper",
}


def inserted(played: Played, agent: str) -> np.ndarray:
    """(n, 2) m: first positions of false objects relative to their victim, sorted."""
    table = played.table("attacks")
    rows = table["effect"] == "inserted"
    rows &= table["frame"] == table["frame"][rows].min()
    truth = dict(played.bodies("scene/truth"))[0]
    victim = truth["agent_position"][list(truth["agents"]).index(agent)]
    places = np.column_stack([table["after_x"][rows] - victim[0], table["after_y"][rows] - victim[1]])
    return places[np.lexsort(places.T)]


@pytest.mark.parametrize("scenario", PAPER)
def test_false_objects_of_one_seed_differ_between_scenes(once: Callable[..., Played], scenario: str) -> None:
    settings = ("n_adversaries=1", "attack_start_s=0.5", "n_infrastructure=2", PAPER[scenario])
    one, other = (inserted(once(scenario, f"scene_index={index}", *settings), "infra_1") for index in (0, 1))
    assert len(one) > 0
    assert len(other) > 0
    apart = np.linalg.norm(one[:, None] - other[None], axis=2)
    assert apart.min() > 0.5, "no false object is at a position of the other scene"

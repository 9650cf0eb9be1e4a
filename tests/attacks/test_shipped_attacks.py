"""Effects that the shipped scenarios promise, and agents that they spare."""

from typing import Any

import numpy as np
import pytest

from mast_zenoh import scenario
from mast_zenoh.mesh.inproc import InProcess

FRAMES = 90


def played(name: str, *settings: str) -> dict[str, Any]:
    """Metrics of a scenario on the generated junction."""
    path, content = scenario.load(name, ["attack_start_s=3.0", *settings])
    results: dict[str, Any] = InProcess(scenario.resolve(path, content, frames=FRAMES)).run()["evaluator"]
    return results


@pytest.fixture(scope="module")
def hidden() -> dict[str, Any]:
    return played("hide_object")


@pytest.fixture(scope="module")
def downlink() -> dict[str, Any]:
    return played("downlink", "false_positives=6.0")


def test_the_picture_misses_the_hidden_object_almost_all_the_time(hidden) -> None:
    achieved = hidden["metrics"]["achieved"]["all"]
    assert achieved["success_centre"]
    assert achieved["hidden_share_centre"] == 1.0
    assert achieved["hidden_time_share_centre"] > 0.9


def test_all_agents_that_report_the_object_hide_the_same_one(hidden) -> None:
    targets = hidden["tables"]["targets"]
    known = targets["object"][targets["object"] >= 0]
    values, counts = np.unique(known, return_counts=True)
    assert counts.max() / counts.sum() >= 0.97, values


def test_an_attack_on_the_downlink_deceives_only_the_ego(downlink) -> None:
    ego = downlink["metrics"]["agents"]["ego"]
    assert ego["mission"]["fp"]["mean"] > ego["picture"]["fp"]["mean"] + 0.3
    achieved = downlink["metrics"]["achieved"]["all"]
    assert achieved["inserted_share_ego"] > 0.5
    assert achieved["inserted_share_centre"] == 0.0
    split = ego["mission"]["fp_split"]["attack"]
    assert split > 0.9 * (ego["mission"]["fp"]["mean"] - ego["picture"]["fp"]["mean"])
    assert ego["picture"]["fp_split"]["attack"] == ego["local"]["fp_split"]["attack"] == 0.0
    objects = downlink["tables"]["objects"]
    assert set(objects["agent"][objects["by"] != ""]) == {"ego"}

"""An attack on a leg affects exactly the estimates behind it."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from played import Played

Once = Callable[..., Played]

#: A user-written adversary on the ego's downlink: moves every object of the picture 6 m north.
DOWNLINK = {
    "lifter": """
import numpy as np

from mast_zenoh.node import Node


class Lifter(Node):
    role = "adversary"
    inputs = {"picture": "picture"}
    outputs = {"picture_out": "picture"}

    def __init__(self, agent: str):
        self.agent = agent

    def on_picture(self, received, context):
        body = received.body
        context.relay("picture_out", received, {**body, "position": body["position"] + np.array([0.0, 6.0, 0.0])})
""",
    "downlink": """
from mast_zenoh.config import loading

_, baseline = loading.function("scenarios", "baseline", "scenario")


def scenario():
    return baseline() | dict(
        name="downlink",
        adversaries=dict(mallory=dict(file="lifter.py", agent="ego")),
        keyexpr=dict(map="testbed.toml", rewrites=["on_picture.toml"]),
    )
""",
}
#: Coordinated adversaries on the tracks that infra_1 and the ego send.
UPLINK = {
    "uplink": """
from mast_zenoh.config import loading

_, coordinated = loading.function("scenarios", "coordinated", "scenario")


def scenario():
    made = coordinated(n_adversaries=2, attack_start_s=0.6)
    made["adversaries"]["adversary_2"]["agent"] = "ego"
    return made | dict(name="uplink")
"""
}


@pytest.fixture(scope="module")
def baseline(once: Once) -> Played:
    return once("baseline")


def counts(played: Played, agent: str, estimator: str) -> dict[str, list[float]]:
    """Counts and errors of an estimate, frame by frame."""
    table = played.table("metrics")
    selected = (table["agent"] == agent) & (table["estimator"] == estimator)
    return {name: table[name][selected].tolist() for name in ("fn", "fp", "tp", "id_switches", "ospa_m")}


def test_an_attack_on_the_downlink_affects_the_received_picture_and_the_mission_estimate(
    once: Once, baseline: Played
) -> None:
    attacked = once("downlink", **DOWNLINK)
    for estimator in ("local", "received", "picture"):
        assert attacked.agents["ego"][estimator] == baseline.agents["ego"][estimator], estimator
    for agent in ("infra_1", "infra_2"):
        assert {"picture_received", "mission"}.isdisjoint(attacked.agents[agent]), "poles act on nothing"
    for estimator in ("picture_received", "picture_on_arrival", "mission"):
        before, after = baseline.agents["ego"][estimator], attacked.agents["ego"][estimator]
        assert after["fp"]["mean"] > before["fp"]["mean"] + 2.0, estimator
        assert after["tp"]["mean"] < before["tp"]["mean"] - 2.0, estimator
        assert before["fp_split"]["attack"] == 0.0
        assert after["fp_split"]["attack"] > 0.9 * (after["fp"]["mean"] - before["fp"]["mean"]), estimator
    objects = attacked.table("objects")
    blamed = objects["by"] != ""
    assert set(objects["by"][blamed]) == {"mallory"}
    assert set(objects["agent"][blamed]) == {"ego"}


def test_an_attack_on_sent_tracks_does_not_change_the_agents_own_estimates(once: Once, baseline: Played) -> None:
    attacked = once("uplink", **UPLINK)
    for agent in baseline.agents:
        assert attacked.agents[agent]["local"] == baseline.agents[agent]["local"], agent
        assert counts(attacked, agent, "local") == counts(baseline, agent, "local"), agent
    for agent in ("ego", "infra_1"):
        before, after = (played.agents[agent]["received"]["fp"]["mean"] for played in (baseline, attacked))
        assert after > before + 1.0, "the broker received different tracks from a compromised agent"
    for agent in ("infra_2", "infra_3", "infra_4"):
        assert attacked.agents[agent]["received"] == baseline.agents[agent]["received"]
        assert attacked.metrics["same_as"][agent]["received"] == "local"


def test_results_tell_how_old_the_pictures_are_that_agents_use(once: Once, baseline: Played) -> None:
    late = once("baseline", "broker.latency_s=0.3")
    for played, age_s in ((baseline, 0.1), (late, 0.4)):
        assert set(played.metrics["picture_age_s"]) == {"ego"}
        ages = played.metrics["picture_age_s"]["ego"]
        assert ages["mean"] == pytest.approx(age_s)
        assert ages["max"] == pytest.approx(age_s)
        assert ages["frames_without"] == 0

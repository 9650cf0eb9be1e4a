"""An attack on a leg affects exactly the estimates behind it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from played import FRAMES, Played

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


def test_a_late_picture_scores_the_same_by_stamp_and_worse_on_arrival(once: Once, baseline: Played) -> None:
    late = once("baseline", "broker.latency_s=0.3")
    assert late.metrics["latency_ms"]["sim_to_picture"]["p50"] == pytest.approx(300.0)
    first = slice(0, FRAMES - 3)  # pictures of the last three frames are never sent
    for name, values in counts(late, "ego", "picture").items():
        assert values[first] == counts(baseline, "ego", "picture")[name][first], name
    stamped, arrived = (late.agents["ego"][name] for name in ("picture", "picture_on_arrival"))
    assert arrived["tp"]["mean"] < stamped["tp"]["mean"] - 1.0
    assert arrived["fp"]["mean"] > stamped["fp"]["mean"] + 1.0
    assert late.agents["ego"]["mission"]["rmse_m"] != baseline.agents["ego"]["mission"]["rmse_m"]
    assert baseline.metrics["same_as"]["ego"]["picture_on_arrival"] == "picture", "without latency both are identical"


def test_results_tell_how_old_the_pictures_are_that_agents_use(once: Once, baseline: Played) -> None:
    late = once("baseline", "broker.latency_s=0.3")
    for played, age_s in ((baseline, 0.1), (late, 0.4)):
        assert set(played.metrics["picture_age_s"]) == {"ego"}
        ages = played.metrics["picture_age_s"]["ego"]
        assert ages["mean"] == pytest.approx(age_s)
        assert ages["max"] == pytest.approx(age_s)
        assert ages["frames_without"] == 0


METRICS = {
    "judged": """
import numpy as np

from mast_zenoh.config import loading
from mast_zenoh.metrics import FrameMetric, RunMetric

_, baseline = loading.function("scenarios", "baseline", "scenario")


class Ahead(FrameMetric):
    unit = "objects"

    def __init__(self, *, range_m: float = 30.0):
        self.range_m = range_m

    def per_frame(self, estimate):
        return estimate.count(estimate.is_track & (estimate.range_m <= self.range_m))


class HighestId(RunMetric):
    def per_run(self, estimate):
        ids = estimate.id[estimate.is_track]
        return int(ids.max()) if len(ids) else None


def scenario(range_m=30.0):
    made = baseline(n_infrastructure=2)
    made["evaluator"]["metrics"] = [dict(type="Ahead", range_m=range_m), dict(type="HighestId")]
    return made | dict(name="judged")
"""
}


def test_user_metrics_are_in_the_summary_and_tables_of_every_estimate(once: Once) -> None:
    played = once("judged", "range_m=25.0", **METRICS)
    per_frame, objects = played.table("metrics"), played.table("objects")
    first, last = played.metrics["scored_frames"]
    places = {
        (frame, agent): place
        for frame, body in played.bodies("scene/truth")
        for agent, place in zip(body["agents"], body["agent_position"], strict=True)
    }
    for agent, estimators in played.agents.items():
        for estimator, summary in estimators.items():
            twin = played.metrics["same_as"][agent].get(estimator, estimator)
            rows = (objects["agent"] == agent) & (objects["estimator"] == twin) & (objects["kind"] == "track")
            values = []
            for frame in range(played.metrics["frames"]):
                now = rows & (objects["frame"] == frame)
                x, y, _ = places[frame, agent]
                values.append(np.sum(np.hypot(objects["x"][now] - x, objects["y"][now] - y) <= 25.0))
            selected = (per_frame["agent"] == agent) & (per_frame["estimator"] == estimator)
            assert per_frame["ahead"][selected].tolist() == values
            assert summary["ahead"]["mean"] == pytest.approx(np.mean(values[first : last + 1]), abs=1e-12)
            assert summary["ahead"]["std"] == pytest.approx(np.std(values[first : last + 1]), abs=1e-12)
            assert summary["highest_id"] == objects["id"][rows].max()
    assert max(per_frame["ahead"]) > 0


def test_driving_is_summarised_over_the_scored_frames_of_its_table(once: Once) -> None:
    attacked = once("uncoordinated", "attack_start_s=0.5")
    table, (first, last) = attacked.table("driving"), attacked.metrics["scored_frames"]
    assert set(attacked.metrics["driving"]) == {"ego"}, "poles do not drive"
    assert len(table["frame"]) == 3 * attacked.metrics["frames"]
    for estimate, summary in attacked.metrics["driving"]["ego"].items():
        rows = (table["estimate"] == estimate) & (table["frame"] >= first) & (table["frame"] <= last)
        assert rows.sum() == last - first + 1
        for name, column in (("corridor_objects", "objects"), ("brake_share", "brake")):
            assert summary[name] == pytest.approx(table[column][rows].mean())
    assert table["false"].max() > 0

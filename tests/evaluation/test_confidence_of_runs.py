"""Runs report how confident estimates are compared with their accuracy, and warn of too confident ones."""

import json
from collections.abc import Callable
from typing import Any

import pytest
from played import Played

#: One agent reports a 25th of its covariances, one none, and one does not tell its innovations; the centre believes
#: them. Or nothing counts as truth, and one agent takes its detections for five times as accurate as they are.
SCENARIOS = """
from dataclasses import replace

from mast_zenoh.scenario import load
from mast_zenoh.tracking import KalmanBoxTracker3D, Tracker


class SureTracker(KalmanBoxTracker3D):
    def __init__(self, *, scale: float) -> None:
        super().__init__()
        self.scale = scale

    def step(self, time_ns, detections, view=None):
        states = super().step(time_ns, detections, view)
        return states.with_(covariance=self.scale * states.covariance)


class SilentTracker(Tracker):
    def __init__(self) -> None:
        self.tracker = KalmanBoxTracker3D()

    matched = property(lambda self: self.tracker.matched)
    step = lambda self, *seen, **more: self.tracker.step(*seen, **more)
    step_states = lambda self, *measured: self.tracker.step_states(*measured)
    reset = lambda self: self.tracker.reset()


class SharpTracker(KalmanBoxTracker3D):
    def step(self, time_ns, detections, view=None):
        return super().step(time_ns, replace(detections, covariance=0.04 * detections.covariance), view)


def scenario(blind=False):
    _, base = load("baseline")
    if blind:
        base["scene"] |= dict(detector=dict(type="DetectionModel", white=True))
        base["evaluator"] = dict(scorer=dict(type="Scorer", min_points=1_000_000))
        trackers = dict(infra_2=dict(type="SharpTracker"))
    else:
        base["command_center"]["pipeline"] |= dict(covariances=dict(type="ReportedCovariances"))
        scales = dict(infra_2=0.04, infra_3=0.0)
        trackers = {agent: dict(type="SureTracker", scale=scale) for agent, scale in scales.items()}
        trackers["infra_1"] = dict(type="SilentTracker")
    for agent, tracker in trackers.items():
        base["agents"][agent] = dict(pipeline=base["agents"]["*"]["pipeline"] | dict(tracker=tracker))
    return base | dict(name="own")
"""

Once = Callable[..., Played]


def record_of(played: Played) -> dict[str, Any]:
    """Its run.json."""
    record: dict[str, Any] = json.loads((played.folder / "run.json").read_text())
    return record


def confidence_notices(played: Played) -> list[dict[str, Any]]:
    return [notice for notice in record_of(played)["notices"] if notice["kind"] == "confidence"]


@pytest.fixture
def sure(once: Once) -> Played:
    return once("own", own=SCENARIOS)


def test_the_shipped_agents_are_about_as_accurate_as_they_say(once: Once) -> None:
    baseline = once("baseline", "scene_index=3")
    assert confidence_notices(baseline) == []
    for agent, estimates in baseline.metrics["consistency"].items():
        assert 0.7 < estimates["local"]["position"]["factor"] < 1.2, agent
        assert estimates["local"]["position"]["without_covariance"] == 0


def test_every_estimate_is_in_metrics_json_and_the_picture_once(once: Once) -> None:
    metrics = once("baseline").metrics
    own = {agent: list(estimates) for agent, estimates in metrics["consistency"].items()}
    assert own == {"ego": ["local", "picture", "mission"]} | {f"infra_{i}": ["local"] for i in range(1, 5)}
    assert metrics["same_as"]["ego"]["received"] == "local", "which is why it has no separate entry"


def test_an_agent_that_is_too_confident_is_named_and_the_picture_that_it_drags_along(sure: Played) -> None:
    named = {notice["where"] for notice in confidence_notices(sure) if notice["what"] == "position"}
    assert {"infra_2", "the picture"} <= named <= {"infra_2", "the picture", "the mission estimate of ego"}
    notice = next(notice for notice in confidence_notices(sure) if notice["who"] == ["infra_2"])
    position = sure.metrics["consistency"]["infra_2"]["local"]["position"]
    assert position["factor"] == pytest.approx(5.0, rel=0.25)
    assert position["typical_factor"] == pytest.approx(5.0, rel=0.3)
    assert (notice["value"], notice["other"]) == (position["factor"], position["nees"])


def test_tracks_without_covariance_are_left_out(sure: Played) -> None:
    position = sure.metrics["consistency"]["infra_3"]["local"]["position"]
    assert (position["pairs"], position["nees"]) == (0, None)
    assert position["without_covariance"] > 100
    json.dumps(sure.metrics["consistency"], allow_nan=False)


def test_nodes_tell_their_innovations_unless_their_tracker_does_not(sure: Played) -> None:
    innovations = record_of(sure)["innovations"]
    assert set(innovations) == {"ego", "infra_2", "infra_3", "infra_4", "command_center"}
    for agent in ("ego", "infra_2", "infra_4"):
        # Below 1: what lasts of an error is in the track as in the next detection, and in no innovation.
        assert 0.4 < innovations[agent]["factor"] < 1.2, "scaled output does not change the tracker itself"
    assert innovations["command_center"]["at_most"]
    results = json.loads((sure.folder / "results" / "ego" / "results.json").read_text())
    assert results["innovations"]["pairs"] == innovations["ego"]["pairs"]
    assert results["innovations"]["nis"] == pytest.approx(innovations["ego"]["nis"])


def test_without_truth_the_trackers_themselves_are_judged(once: Once) -> None:
    blind = once("own", "blind=true", own=SCENARIOS)
    estimates = [each for of_agent in blind.metrics["consistency"].values() for each in of_agent.values()]
    assert {summary["position"]["pairs"] for summary in estimates} == {0}
    (notice,) = confidence_notices(blind)
    assert (notice["who"], notice["what"]) == (["infra_2"], "tracker")

"""Runs report how confident estimates are compared with their accuracy, and warn of too confident ones."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

import pytest
from played import Played

#: One agent reports a 25th of its covariances, one none, and one does not tell its innovations.
#: The centre believes them.
SURE = """
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

    @property
    def matched(self):
        return self.tracker.matched

    def step(self, time_ns, detections, view=None):
        return self.tracker.step(time_ns, detections, view)

    def step_states(self, time_ns, measured):
        return self.tracker.step_states(time_ns, measured)

    def reset(self):
        self.tracker.reset()


def scenario():
    _, base = load("baseline")
    pipeline = base["agents"]["*"]["pipeline"]
    trackers = dict(
        infra_1=dict(type="SilentTracker"),
        infra_2=dict(type="SureTracker", scale=0.04),
        infra_3=dict(type="SureTracker", scale=0.0),
    )
    for agent, tracker in trackers.items():
        base["agents"][agent] = dict(pipeline=pipeline | dict(tracker=tracker))
    base["command_center"]["pipeline"] |= dict(covariances=dict(type="ReportedCovariances"))
    return base | dict(name="sure")
"""


#: Nothing counts as truth, and one agent takes its detections for five times as accurate as they are.
BLIND = """
from dataclasses import replace

from mast_zenoh.scenario import load
from mast_zenoh.tracking import KalmanBoxTracker3D


class SharpTracker(KalmanBoxTracker3D):
    def step(self, time_ns, detections, view=None):
        return super().step(time_ns, replace(detections, covariance=0.04 * detections.covariance), view)


def scenario():
    _, base = load("baseline")
    base["scene"] |= dict(detector=dict(type="DetectionModel", white=True))
    pipeline = base["agents"]["*"]["pipeline"]
    base["agents"]["infra_2"] = dict(pipeline=pipeline | dict(tracker=dict(type="SharpTracker")))
    base["evaluator"] = dict(scorer=dict(type="Scorer", min_points=1_000_000))
    return base | dict(name="blind")
"""


Once = Callable[..., Played]


def record_of(played: Played) -> dict[str, Any]:
    """Its run.json."""
    record: dict[str, Any] = json.loads((played.folder / "run.json").read_text())
    return record


def confidence_notices(played: Played) -> list[str]:
    notices = record_of(played)["notices"]
    return [notice["text"] for notice in notices if notice["kind"] == "confidence"]


def numbers(value: Any) -> list[float]:
    """All numbers in nested results."""
    if isinstance(value, dict):
        return [number for item in value.values() for number in numbers(item)]
    return [value] if isinstance(value, (int, float)) else []


def test_the_shipped_agents_are_about_as_accurate_as_they_say(once: Once) -> None:
    baseline = once("baseline", "scene_index=3")
    assert confidence_notices(baseline) == []
    for agent, estimates in baseline.metrics["consistency"].items():
        assert 0.7 < estimates["local"]["position"]["factor"] < 1.2, agent
        assert estimates["local"]["position"]["without_covariance"] == 0


def test_every_estimate_is_in_metrics_json_and_the_picture_once(once: Once) -> None:
    metrics = once("baseline").metrics
    own = {agent: list(estimates) for agent, estimates in metrics["consistency"].items()}
    assert own.pop("ego") == ["local", "picture", "mission"]
    assert own == {f"infra_{i}": ["local"] for i in range(1, 5)}, "poles do not act on a picture"
    assert metrics["same_as"]["ego"]["received"] == "local", "which is why it has no separate entry"


def test_an_agent_that_is_too_confident_is_named(once: Once) -> None:
    sure = once("sure", sure=SURE)
    (notice,) = [text for text in confidence_notices(sure) if text.startswith("infra_")]
    match = re.fullmatch(
        r"infra_2 is (\S+) times more confident than accurate \(NEES (\S+), expected 2\)"
        r"(, and \S+ times in velocity \(NEES \S+, expected 2\))?",
        notice.replace("accurate in velocity", "accurate"),
    )
    assert match is not None, notice
    position = sure.metrics["consistency"]["infra_2"]["local"]["position"]
    assert position["factor"] == pytest.approx(5.0, rel=0.25)
    assert position["typical_factor"] == pytest.approx(5.0, rel=0.3)
    assert float(match[1]) == pytest.approx(position["factor"], abs=0.051)
    assert float(match[2]) == pytest.approx(position["nees"], abs=0.051)


def test_a_picture_that_is_too_confident_because_of_one_agent_is_named(once: Once) -> None:
    """An agent without covariances counts as exact, and drags the picture along."""
    assert any(text.startswith("the picture is ") for text in confidence_notices(once("sure", sure=SURE)))


def test_tracks_without_covariance_are_left_out_and_all_numbers_are_finite(once: Once) -> None:
    sure = once("sure", sure=SURE)
    position = sure.metrics["consistency"]["infra_3"]["local"]["position"]
    assert (position["pairs"], position["nees"]) == (0, None)
    assert position["without_covariance"] > 100
    found = numbers(sure.metrics["consistency"])
    assert found
    assert max(map(abs, found)) < 1e12


def test_nodes_tell_their_innovations_unless_their_tracker_does_not(once: Once) -> None:
    innovations = record_of(once("sure", sure=SURE))["innovations"]
    assert set(innovations) == {"ego", "infra_2", "infra_3", "infra_4", "command_center"}
    for agent in ("ego", "infra_2", "infra_4"):
        # Below 1: what lasts of an error is in the track as in the next detection, and in no innovation.
        assert 0.4 < innovations[agent]["factor"] < 1.2, "scaled output does not change the tracker itself"
    assert innovations["command_center"]["at_most"]
    results = json.loads((once("sure", sure=SURE).folder / "results" / "ego" / "results.json").read_text())
    assert results["innovations"]["pairs"] == innovations["ego"]["pairs"]
    assert results["innovations"]["nis"] == pytest.approx(innovations["ego"]["nis"])


def test_without_truth_the_trackers_themselves_are_judged(once: Once) -> None:
    blind = once("blind", blind=BLIND)
    assert all(
        summaries["position"]["pairs"] == 0
        for estimates in blind.metrics["consistency"].values()
        for summaries in estimates.values()
    )
    (notice,) = confidence_notices(blind)
    assert re.fullmatch(
        r"the tracker of infra_2 is .+ times more confident than its measurements bear out \(NIS \S+, expected 2\)",
        notice,
    )

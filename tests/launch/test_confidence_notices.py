"""A run names estimates that are more confident than accurate, one line each."""

from __future__ import annotations

import math
from typing import Any

import pytest
from tiny_world import tiny

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.launch import notices
from mast_zenoh.tracking import Innovations

SURE, FINE = "overconfident", None


def compared(position: str | None, velocity: str | None, nees: float = 19.2) -> dict[str, Any]:
    """An estimate with these verdicts."""
    numbers = {"nees": nees, "factor": math.sqrt(nees / 2), "pairs": 100}
    return {"position": numbers | {"verdict": position}, "velocity": numbers | {"verdict": velocity}}


def texts(consistency: object, **trackers: Innovations) -> list[str]:
    summaries = {name: each.summary() for name, each in trackers.items()}
    found = notices.of_confidence({"consistency": consistency}, summaries)
    assert all((each["kind"], each["count"]) == ("confidence", 1) for each in found)
    return [each["text"] for each in found]


def test_the_notice_names_the_agent_the_factor_and_the_nees() -> None:
    assert texts({"infra_2": {"local": compared(SURE, FINE)}}) == [
        "infra_2 is 3.1 times more confident than accurate (NEES 19.2, expected 2)"
    ]
    assert texts({"infra_2": {"local": compared(FINE, SURE)}}) == [
        "infra_2 is 3.1 times more confident than accurate in velocity (NEES 19.2, expected 2)"
    ]
    assert texts({"infra_2": {"local": compared(SURE, SURE, 2e6)}}) == [
        "infra_2 is 1e+03 times more confident than accurate (NEES 2e+06, expected 2), "
        "and 1e+03 times in velocity (NEES 2e+06, expected 2)"
    ]


def test_each_estimate_has_its_own_line() -> None:
    sure = compared(SURE, FINE)
    lines = texts({"ego": {"received": sure, "picture": sure, "mission": sure}, "infra_1": {"local": sure}})
    subjects = [line.partition(" is ")[0] for line in lines]
    assert subjects == ["ego as received", "the picture", "the mission estimate of ego", "infra_1"]


def test_accurate_and_cautious_estimates_have_no_line() -> None:
    assert texts({"ego": {"local": compared(FINE, FINE), "picture": compared("overcautious", "overcautious")}}) == []


def test_many_lines_are_cut_short() -> None:
    lines = texts({f"infra_{i}": {"local": compared(SURE, FINE)} for i in range(50)})
    assert len(lines) == 21
    assert lines[-1] == "30 more estimates are more confident than accurate"


def test_trackers_are_judged_only_where_nothing_could_be_compared_with_the_truth() -> None:
    sharp = Innovations(700.0, 100, 50)
    nothing = compared(FINE, FINE)
    for summary in nothing.values():
        summary["pairs"] = 0
    assert texts({"ego": {"local": compared(FINE, FINE)}}, ego=sharp) == []
    assert texts({"ego": {"local": nothing}}, ego=sharp, infra_1=Innovations(200.0, 100, 0)) == [
        "the tracker of ego is 2.7 times more confident than its measurements bear out (NIS 7.0, expected 2)"
    ]


@pytest.mark.parametrize(
    "returned",
    [None, 7, "text", [], {"ego": None}, {"ego": {"local": 3}}, {"ego": {"local": {"position": {"verdict": SURE}}}}],
)
def test_what_a_users_evaluator_returns_instead_has_no_line(returned: object) -> None:
    assert texts(returned) == []


def test_only_sound_summaries_of_nodes_with_a_tracker_are_taken() -> None:
    resolved: Resolved = tiny()
    sound = {"innovations": Innovations(3.0, 2).summary() | {"verdict": SURE, "factor": 1e9}}
    handed_in: dict[str, dict[str, Any]] = {
        "ego": sound,
        "infra_1": {"innovations": {"pairs": -3}},
        "infra_2": {},
        "broker": sound,
        "stranger": sound,
    }
    found = notices.tracker_innovations(handed_in, resolved.nodes)
    assert found == {"ego": Innovations(3.0, 2).summary()}, "derived values are computed again"


def test_a_tracker_that_reports_nothing_because_all_is_uncertain_has_a_line() -> None:
    lines = texts({}, infra_1=Innovations(silent=9), infra_2=Innovations(silent=40))
    assert lines == [
        "the tracker of infra_2 reported none of its tracks in 40 steps, as the standard deviation of each was "
        "above max_std_m: raise it if the detections are that noisy"
    ]

"""In every shipped scenario, errors in every estimate are split by cause, and only idle parts are said to be idle."""

import json
from collections import Counter

import pytest
from shipped import HARMLESS

from mast_zenoh.metrics import ATTACK_CAUSES

pytestmark = pytest.mark.heavy


def test_errors_in_every_estimate_are_split_into_fault_attack_and_natural(shipped, variant):
    played, _ = shipped(variant)
    frames = 1 + played.metrics["scored_frames"][1] - played.metrics["scored_frames"][0]
    for agent, estimators in played.agents.items():
        for estimator, estimate in estimators.items():
            for what, total in (
                ("fp", estimate["fp"]["mean"]),
                ("fn", estimate["fn"]["mean"]),
                ("id_switches", estimate["id_switches"]),
            ):
                split = estimate[f"{what}_split"]
                assert sum(split.values()) == pytest.approx(total, abs=1e-9), (agent, estimator, what)
                counts = Counter(estimate["causes"][what])
                per = 1 if what == "id_switches" else frames
                assert split["attack"] == pytest.approx(sum(counts[cause] for cause in ATTACK_CAUSES) / per)
                assert split["fault"] == pytest.approx(counts["link or fault"] / per)
    causes = Counter(played.table("objects")["cause"].tolist())
    attacked = bool(set(causes) & set(ATTACK_CAUSES))
    assert not (attacked and variant[0] in HARMLESS)
    assert attacked or variant[0] not in ("uncoordinated", "coordinated", "downlink", "hide_object")


#: What is so in the first 3.6 s: the ego never sees the object that its adversary is to hide.
IDLE = {
    "hide_object": ["adversary_0 on agent/ego/tracks changed no message"],
    "sybil": ["faults[0] (Join) begins at 12 s, after the last frame (3.5 s)"],
}


def test_no_part_of_a_shipped_scenario_is_idle_by_mistake(shipped, variant):
    record = json.loads((shipped(variant)[0].folder / "run.json").read_text())
    assert [notice["text"] for notice in record["notices"] if notice["kind"] == "idle"] == IDLE.get(variant[0], [])

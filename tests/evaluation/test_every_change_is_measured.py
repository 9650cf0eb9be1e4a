"""Changes by an adversary are measured and attributed despite its reports, also if it crashes."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from played import Played, files_of

from mast_zenoh import scenario
from mast_zenoh.errors import HandlerFailed
from mast_zenoh.launch import run

Once = Callable[..., Played]


def test_the_tutorials_silent_attacker_is_measured_and_blamed(once: Once) -> None:
    """It moves every detection of infra_1 by 3 m from the first frame."""
    files = {name: text for name, text in files_of("tutorial-first-attack.md").items() if name in ("shover", "shoved")}
    attacked, baseline = once("shoved", **files), once("baseline")
    attacks = attacked.table("attacks")
    assert set(attacks["interposer"]) == {"mallory"}
    assert set(attacks["effect"]) == {"moved"}
    assert not attacks["reported"].any()
    assert attacks["frame"].min() == 0
    assert len(set(attacks["frame"])) == attacked.metrics["frames"], "in every frame"
    offset = np.column_stack([attacks[f"after_{axis}"] - attacks[f"before_{axis}"] for axis in "xyz"])
    assert np.linalg.norm(offset, axis=1) == pytest.approx(3.0)
    verdict = attacked.metrics["interposers"]["mallory"]
    assert verdict["agreement"] == "silent"
    assert verdict["effects"] == {"moved": len(attacks["frame"])}
    before, after = (played.agents["ego"]["picture"] for played in (baseline, attacked))
    added = after["fp"]["mean"] - before["fp"]["mean"]
    assert added > 2.0
    assert after["fp_split"]["attack"] == pytest.approx(added, rel=0.25)
    assert after["fp_split"]["natural"] == pytest.approx(before["fp_split"]["natural"], abs=0.25 * added)
    objects = attacked.table("objects")
    assert set(objects["by"]) == {"", "mallory"}


CRASHER = """
from mast_zenoh.node import Node


class Crasher(Node):
    role = "adversary"
    inputs = {"detections": "detections"}
    outputs = {"detections_out": "detections"}

    def __init__(self, agent: str):
        self.agent = agent

    def on_detections(self, received, context):
        if received.frame >= 10:
            raise ZeroDivisionError("no plan")
        context.relay("detections_out", received)
"""
FRAMES = 30
ACTIVE = 20  # frames in which it fails


def test_a_crashing_adversary_is_measured_as_dropping_messages_and_named(tmp_path: Path) -> None:
    """Its handler raises before relaying, so all later messages are dropped."""
    (tmp_path / "crasher.py").write_text(CRASHER)
    (tmp_path / "own.py").write_text("")
    _, content = scenario.load("uncoordinated", ["n_infrastructure=2", "n_adversaries=2", "attack_start_s=1.0"])
    content["adversaries"]["adversary_1"] = dict(file="crasher.py", agent="infra_1")
    resolved = scenario.resolve(tmp_path / "own.py", content, frames=FRAMES, seed=0)
    outcome = run.run(resolved, tmp_path / "run", runtime="inproc")
    assert isinstance(outcome.error, HandlerFailed)
    assert outcome.record["status"] == "handler_failures"
    for words in ("adversary_1", "on_detections", "20 frames", "ZeroDivisionError: no plan", "crasher.py:"):
        assert words in str(outcome.error), words
    played = Played(outcome.folder)
    verdict = played.metrics["interposers"]["adversary_1"]
    assert verdict["effects"] == {"dropped": ACTIVE}
    assert (verdict["agreement"], verdict["unreported"]) == ("silent", ACTIVE - 1)
    assert played.metrics["interposers"]["adversary_2"]["agreement"] == "agrees"
    assert played.agents["infra_1"]["local"]["fn_split"]["attack"] > 0.0
    objects = played.table("objects")
    assert "adversary_1" in set(objects["by"][objects["agent"] == "infra_1"])

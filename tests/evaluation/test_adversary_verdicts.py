"""Silent, lying and crashing adversaries are identified from their wires."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from played import Played, play

from mast_zenoh import scenario
from mast_zenoh.errors import HandlerFailed
from mast_zenoh.launch import run

Once = Callable[..., Played]

#: User-written adversaries on the detections of infra_1 and infra_2. Each removes the first detection from frame 10 on,
#: and reports nothing, the truth, another object, or one object too many.
FILES = {
    "hider": """
import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.node import Node


class Hider(Node):
    role = "adversary"
    inputs = {"pose": "pose", "detections": "detections"}
    outputs = {"detections_out": "detections", "report": "attack_report"}

    def __init__(self, agent: str, says: str, hides: bool = True):
        self.agent, self.says, self.hides = agent, says, hides
        self.pose = None

    def on_pose(self, received, context):
        self.pose = received.body  # of infrastructure, which stands still

    def on_detections(self, received, context):
        body = received.body
        acts = received.frame >= 10 and len(body["position"]) > 1
        n = len(body["position"])
        if self.says == "crash" and acts:
            raise ZeroDivisionError("no plan")
        if self.hides and acts:
            context.relay("detections_out", received, {
                name: column[1:] if column.shape[:1] == (n,) and not name.startswith("mount") else column
                for name, column in body.items()
            })
        else:
            context.relay("detections_out", received)
        if acts and self.says in ("truth", "another", "more"):
            turn = rotation_from_quaternion(self.pose["rotation"])
            mount = rotation_from_quaternion(body["mount_rotation"])
            places = self.pose["position"] + (body["mount_position"] + body["position"] @ mount.T) @ turn.T
            hidden = {"truth": [0], "another": [1], "more": [0, 1]}[self.says]
            context.publish("report", {
                "action": np.ones(len(hidden), np.uint8),
                "target": np.array(hidden),
                "before_position": places[hidden],
                "after_position": np.zeros((len(hidden), 3)),
                "velocity": np.zeros((len(hidden), 3)),
            }, frame=received.frame, time_ns=received.time_ns)
""",
    "hidden": """
from mast_zenoh.config import loading

_, baseline = loading.function("scenarios", "baseline", "scenario")


def scenario(one="silence", hides=True):
    return baseline(n_infrastructure=2) | dict(
        name="hidden",
        adversaries=dict(
            one=dict(file="hider.py", agent="infra_1", says=one, hides=hides),
            other=dict(file="hider.py", agent="infra_2", says="truth"),
        ),
        keyexpr=dict(map="testbed.toml", rewrites=["on_detections.toml"]),
    )
""",
}
FRAMES = 30
ACTIVE = 20  # frames in which they are active


@pytest.mark.parametrize(
    ("says", "hides", "agreement", "unreported", "unfounded"),
    [
        ("silence", True, "silent", ACTIVE, 0),
        ("truth", True, "agrees", 0, 0),
        ("another", True, "disagrees", ACTIVE, ACTIVE),
        ("more", True, "disagrees", 0, ACTIVE),
        ("truth", False, "disagrees", 0, ACTIVE),
    ],
)
def test_reports_of_an_adversary_are_compared_with_its_measured_effects(
    tmp_path: Path, says: str, hides: bool, agreement: str, unreported: int, unfounded: int
) -> None:
    """The verdict on `one` does not depend on `other`, which hides and reports correctly."""
    played = play(tmp_path, "hidden", f"one={says}", f"hides={hides}", frames=FRAMES, **FILES)
    verdicts = played.metrics["interposers"]
    one = verdicts["one"]
    assert one["effects"] == ({"removed": ACTIVE} if hides else {})
    # Reports about the last frame may not arrive before the run ends, so it does not count as unreported.
    assert one["agreement"] == agreement
    assert one["unreported"] == max(0, unreported - 1)
    assert one["unfounded"] == unfounded
    assert verdicts["other"]["agreement"] == "agrees"
    table = played.table("attacks")
    selected = table["interposer"] == "one"
    assert table["frame"][selected].tolist() == (list(range(FRAMES - ACTIVE, FRAMES)) if hides else [])
    assert set(table["reported"][selected]) == ({says in ("truth", "more")} if hides else set())
    blamed = {name for by in set(played.table("objects")["by"]) for name in by.split("+")}
    assert hides or "one" not in blamed
    assert set(table["reported"][~selected]) == {True}


def test_a_crashing_adversary_is_measured_as_dropping_messages_and_named(tmp_path: Path) -> None:
    """Its handler raises before relaying, so all later messages are dropped."""
    for file, text in FILES.items():
        (tmp_path / f"{file}.py").write_text(text)
    path, content = scenario.load(str(tmp_path / "hidden.py"), ["one=crash"])
    outcome = run.run(scenario.resolve(path, content, frames=FRAMES, seed=0), tmp_path / "run", runtime="inproc")
    assert isinstance(outcome.error, HandlerFailed)
    assert outcome.record["status"] == "handler_failures"
    for words in ("one", "on_detections", "20 frames", "ZeroDivisionError: no plan", "hider.py:"):
        assert words in str(outcome.error), words
    played = Played(outcome.folder)
    verdict = played.metrics["interposers"]["one"]
    assert verdict["effects"] == {"dropped": ACTIVE}
    assert (verdict["agreement"], verdict["unreported"]) == ("silent", ACTIVE - 1)
    assert played.metrics["interposers"]["other"]["agreement"] == "agrees"
    assert played.agents["infra_1"]["local"]["fn_split"]["attack"] > 0.0
    objects = played.table("objects")
    assert "one" in set(objects["by"][objects["agent"] == "infra_1"])

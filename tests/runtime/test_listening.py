"""Listeners receive the wires of their rewrite, and do not change a run."""

from collections import defaultdict
from pathlib import Path
from typing import Any

from tiny_world import Run, tiny

SUPPORT = Path(__file__).parents[1] / "support"
ATTACK = dict(type="UncoordinatedAttack", start_s=0.2)


def shadowed(scenario: dict[str, Any]) -> None:
    """An adversary on infra_1's detections that hears all agents' poses."""
    heard = ["ego", "infra_1", "infra_2"]
    scenario["adversaries"] = {"shadow": dict(file=str(SUPPORT / "shadow.py"), agent="infra_1", heard=heard)}
    listen = dict(wire="agent/*/pose", role="adversary", input="poses")
    scenario["keyexpr"] = dict(rewrites=["on_detections.toml", {"listen": [listen]}])


def guarded(scenario: dict[str, Any]) -> None:
    """An adversary on infra_1's tracks, and two defences on different legs."""
    guard = dict(role="defence", file=str(SUPPORT / "guard.py"))
    scenario["nodes"] = {"guard": guard, "source_guard": guard}
    scenario["adversaries"] = {"eve": dict(agent="infra_1", attack=ATTACK)}
    every = dict(wire="agent/*/tracks", role="defence", input="tracks")
    listen = [every | dict(node="guard"), every | dict(node="source_guard", leg="source")]
    scenario["keyexpr"] = dict(rewrites=["on_tracks.toml", {"listen": listen}])


def test_an_adversary_receives_the_poses_that_it_listens_to() -> None:
    run, plain = Run(tiny(edit=shadowed)), Run(tiny())
    assert not run.failures
    for key in ("agent/ego/pose", "agent/infra_2/pose", "agent/infra_2/detections"):
        assert run.messages[key] == plain.messages[key]
    sent = run.decoded("agent/infra_1/detections/@tap/0", "detections")
    detections = run.decoded("agent/infra_1/detections", "detections")
    places = [run.decoded(f"agent/{agent}/pose", "pose") for agent in ("ego", "infra_1", "infra_2")]
    for frame, (before, after) in enumerate(zip(sent, detections, strict=True)):
        offset = sum(poses[frame].body["position"] for poses in places) * 0.01
        assert (after.body["position"] == before.body["position"] + offset).all()


def test_a_defence_receives_the_brokers_messages_or_those_of_the_agents_and_leaves_no_trace() -> None:
    def unguarded(scenario: dict[str, Any]) -> None:
        guarded(scenario)
        scenario["nodes"] = {}
        scenario["keyexpr"] = dict(rewrites=["on_tracks.toml"])

    run = Run(tiny(edit=guarded))
    assert not run.failures
    for name, leg in (("guard", ""), ("source_guard", "/@tap/0")):
        heard = defaultdict(list)
        for subject, _, payload in run.nodes[name].heard:
            heard[subject].append(payload)
        assert heard == {
            "ego": run.messages["agent/ego/tracks"],
            "infra_1": run.messages[f"agent/infra_1/tracks{leg}"],
            "infra_2": run.messages["agent/infra_2/tracks"],
        }
    assert run.messages["agent/infra_1/tracks"] != run.messages["agent/infra_1/tracks/@tap/0"]
    assert Run(tiny(edit=unguarded)).messages == run.messages

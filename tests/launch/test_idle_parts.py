"""A run names the parts of its scenario that took part in nothing, and why."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from kept_texts import assert_kept
from table_writing import write_table
from tiny_world import tiny

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.launch import run
from mast_zenoh.launch.idle import idle_parts
from mast_zenoh.metrics import FrameMetric, RunMetric
from mast_zenoh.run_folder.finding import sentence

Edit = Callable[[dict[str, Any]], Any]
UNCOORDINATED = dict(type="UncoordinatedAttack", start_s=0.0)
EARLY = dict(agent="infra_1", attack=UNCOORDINATED)


class NeverDefined(FrameMetric):
    """Has no value in any frame."""

    def per_frame(self, estimate: Any) -> Any:
        return np.full(len(estimate.frames), np.nan)


class OfEgo(RunMetric):
    """Has no number for other agents."""

    def per_run(self, estimate: Any) -> float:
        return 1.0 if estimate.agent == "ego" else math.nan


def attack(*rewrites: str, **adversary: Any) -> Edit:
    def edit(content: dict[str, Any]) -> None:
        content["adversaries"] = {"adversary_1": EARLY | adversary}
        content["keyexpr"] = dict(rewrites=list(rewrites))

    return edit


def coordinate(*rewrites: str, adversaries: int) -> Edit:
    def edit(content: dict[str, Any]) -> None:
        directed = dict(agent="infra_1", attack=dict(type="CoordinatedAttack", start_s=0.0))
        content["adversaries"] = {"adversary_1": directed} if adversaries else {}
        content["coordinator"] = dict(coordination=dict(type="Coordinator", start_s=0.0))
        content["keyexpr"] = dict(rewrites=list(rewrites))

    return edit


def defend(defence: str, *rewrites: str, **parameters: Any) -> Edit:
    def edit(content: dict[str, Any]) -> None:
        content["command_center"]["pipeline"]["integrity"] = dict(type=defence, **parameters)
        content["keyexpr"] = dict(rewrites=list(rewrites))

    return edit


def setting(**parts: Any) -> Edit:
    return lambda content: content.update(parts)


PARTITION = dict(type="Partition", at=0.5, nodes=["infra_1"])
CASES: dict[str, Edit] = {
    "nothing": setting(),
    "an adversary on no wire": attack(),
    "an attack after the run": attack("on_tracks.toml", attack=UNCOORDINATED | dict(start_s=9.0)),
    "an attack without targets": attack(
        "on_tracks.toml",
        attack=UNCOORDINATED
        | dict(selection=dict(type="UncoordinatedSelection", n_false_positives=0.0, fraction_false_negatives=0.0)),
    ),
    "an attack that is none": attack("on_tracks.toml", attack=dict(type="PassThrough")),
    "an adversary without its coordinator": attack(
        "on_tracks.toml", attack=dict(type="CoordinatedAttack", start_s=0.0)
    ),
    "a coordinator without adversaries": coordinate("coordination.toml", adversaries=0),
    "a defence without views": defend("KOfN"),
    "a defence that needs none": defend("RobustFusion"),
    "a defence that trusts an agent": defend("Robosac", ego="infra_1"),
    "a defence that trusts nobody there is": defend("Robosac", ego="infra_7"),
    "a defence in another one that trusts nobody there is": defend(
        "FaultOrLie", "views.toml", stage=dict(type="PoseGuard", ego="truck")
    ),
    "a defence with views": defend("KOfN", "views.toml"),
    "links of no agent": setting(links={"truck_*": "wired"}),
    "a link that changes nothing": setting(links={"*": "wired"}),
    "link rules that change nothing": setting(
        links={"infra_1": dict(up=[dict(type="Loss", probability=0.0)]), "*": dict(up=[])}
    ),
    "a fault after the run": setting(faults=[PARTITION | dict(at=5.0)]),
    "a fault": setting(faults=[PARTITION]),
    "a fault that changes nothing": setting(faults=[dict(type="Loss", at=0.5, nodes=["infra_1"], probability=0.0)]),
    "a metric without values": setting(evaluator=dict(scorer=dict(type="Scorer"), metrics=[dict(type="NeverDefined")])),
    "a metric that is NaN for some agents": setting(
        evaluator=dict(scorer=dict(type="Scorer"), metrics=[dict(type="OfEgo")])
    ),
}


def test_idle_parts_are_named_with_the_reason(tmp_path: Path) -> None:
    lines = []
    for name, edit in CASES.items():
        outcome = run.run(tiny(edit=edit), tmp_path / name, runtime="inproc")
        assert outcome.error is None
        notices = json.loads((outcome.folder / "run.json").read_text())["notices"]
        lines += [name, *(f"  {notice['text']}" for notice in notices if notice["kind"] == "idle")]
    assert_kept("idle_parts", *lines)


def test_a_sensor_without_detections_is_named() -> None:
    world = tiny()
    n_sensors = len(world.recording.sensor_names)
    counts = np.diff(world.recording.detection_start).reshape(-1, n_sensors) * [1, 0, 1]
    start = np.concatenate([[0], np.cumsum(counts)])
    blind = replace(
        world.recording,
        detections=world.recording.detections.select(np.arange(start[-1])),
        detection_truth_id=world.recording.detection_truth_id[: start[-1]],
        detection_start=start,
    )
    assert idle(replace(world, recording=blind)) == [("infra_1", "no detections")]
    assert idle(world) == []


def test_a_defence_that_never_had_two_viewers_is_named() -> None:
    world = tiny(edit=defend("KOfN", "views.toml"))
    points = world.recording.points.copy()
    points[:, 1:] = 0
    alone = replace(world, recording=replace(world.recording, points=points))
    assert idle(alone) == [("KOfN", "one viewer")]
    assert idle(world) == []


def test_a_veto_is_named_where_nobody_knows_what_is_free() -> None:
    world = scenario.resolve(*scenario.load("driving", ["veto=True", "n_infrastructure=0"]), frames=5, seed=0)
    assert idle(world) == []
    assert idle(replace(world, recording=replace(world.recording, buildings=()))) == [("driver_ego", "no buildings")]


@pytest.mark.parametrize(("settled", "expected"), [(True, [("infra_1", "no tracks")]), (False, [])])
def test_an_agent_without_tracks_is_named_if_the_run_was_long_enough(
    settled: bool, expected: list[tuple[str, str]], tmp_path: Path
) -> None:
    table = {
        "agent": np.array(["ego", "infra_1", "infra_1"], object),
        "estimator": np.array(["local", "local", "picture"], object),
        "tp": np.array([1, 0, 3]),
        "fp": np.zeros(3, int),
    }
    metrics = {"interposers": {}, "settled": settled, "agents": {}}
    write_table(tmp_path / "metrics.parquet", table)
    assert idle(tiny(), {"evaluator": {"metrics": metrics}}, tmp_path) == expected


@pytest.mark.parametrize("results", [{}, {"metrics": 3}, {"metrics": {}, "tables": []}, {"tables": {"attacks": None}}])
def test_an_evaluator_of_the_user_may_return_anything(results: Any) -> None:
    assert idle(tiny(edit=attack("on_tracks.toml")), {"evaluator": results}) == []


def test_an_attack_on_points_that_changed_nothing_says_why_and_who_changed_the_scans_before_it() -> None:
    def two(content: dict[str, Any]) -> None:
        content["adversaries"] = {"adversary_1": EARLY, "adversary_2": EARLY}
        content["keyexpr"] = dict(rewrites=["on_tracks.toml"])

    world = tiny(edit=two)
    (wire,) = {wire["key"]: wire for wire in world.wiring["wires"] if "adversary_1" in wire["interposers"]}.values()
    first, last = wire["interposers"]
    measured = {"metrics": {"interposers": {last: {"messages": 60, "effects": {}}}}}
    counted = {"scans": 60, "no_sight": 48, "missed": 12}
    (finding,) = idle_parts(world, 12, {"evaluator": measured, last: counted}, Path("nowhere"))
    assert sentence(finding) == (
        f"{last} on {wire['key']} changed no message: 60 scans came during its attack by its own count, "
        "48 without a line of sight to "
        f"the lidar, 12 missed by its aim or timing (sight is judged by the scans that {first} passed on)"
    )


def idle(
    world: Resolved, handed_in: Any = MappingProxyType({}), folder: Path = Path("nowhere")
) -> list[tuple[str, str]]:
    """What is idle in a run of 12 frames with these results, and the tables in this folder, and how."""
    return [(*each.who, each.what) for each in idle_parts(world, 12, handed_in, folder)]

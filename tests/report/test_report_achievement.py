"""Achievements of attacks, reasons for limited effects, and driving."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from mast_zenoh.report.comparison import Reference
from mast_zenoh.report.figures.over_time import driving_over_time
from mast_zenoh.report.html import write_page, write_report
from mast_zenoh.report.narrative import changes
from mast_zenoh.report.narrative.adversaries import explanations
from mast_zenoh.report.narrative.run import reading
from mast_zenoh.report.tables.of_run import achieved_table, driving_table
from mast_zenoh.report.tables.text_table import DASH
from mast_zenoh.report.terminal import show_loaded
from mast_zenoh.viewer.run import RunRecord

ACHIEVED = {"inserted": 4, "inserted_share_centre": 1.0, "inserted_share_ego": 0.5, "inserted_s_centre": 9.25}
ACHIEVED |= {"inserted_s_ego": None, "hidden": 0, "moved": 2, "moved_error_m_centre": 0.5, "moved_error_m_ego": 0.25}
ACHIEVED |= {"first_success_s_centre": 0.2, "first_success_s_ego": None, "id_switches_centre": 3, "id_switches_ego": 0}


@pytest.fixture
def attacked(run_folder: Callable[..., Path]) -> RunRecord:
    return RunRecord.load(run_folder("uncoordinated"))


def achieving(run: RunRecord, **achieved: Any) -> RunRecord:
    run.metrics["achieved"] = {"adversary_1": achieved, "all": achieved}
    return run


def targets(kind: str, n: int = 10, **columns: Any) -> dict[str, np.ndarray]:
    """adversary_1's effect on one object in n frames, from frame 20 on."""
    defaults = {"object": 7, "x": 0.0, "y": 0.0, "seen_by_others": False, "error_m_centre": np.nan}
    defaults |= {"judged_centre": True, "judged_ego": True, "believed_centre": False, "believed_ego": False}
    table = {name: np.full(n, value) for name, value in (defaults | {"error_m_ego": np.nan} | columns).items()}
    return table | {
        "adversary": np.full(n, "adversary_1", object),
        "kind": np.full(n, kind, object),
        "frame": np.arange(20, 20 + n),
    }


def why(run: RunRecord, table: dict[str, np.ndarray] | None, blamed_for: str = "", **achieved: Any) -> str:
    """The reasons of adversary_1; blamed_for: the only score changed by attacks."""
    achieving(run, **achieved)
    for summary in run.metrics["agents"]["ego"].values():
        for key in ("fn", "fp"):
            summary[f"{key}_split"] = {"fault": 0.0, "attack": 2.0 if key == blamed_for else 0.0, "natural": 0.0}
    object.__setattr__(run, "targets", table)
    return "; ".join(explanations(run).get("adversary_1", ()))


@pytest.mark.parametrize(("error_m", "counts"), [(1.5, True), (15.0, False)])
def test_duplicate_beyond_the_gate_is_false_and_not_in_the_rmse(
    attacked: RunRecord, error_m: float, counts: bool
) -> None:
    object.__setattr__(attacked, "targets", targets("moved", error_m_centre=error_m))
    displaced = [each for each in changes.attributed(attacked) if each.kind == changes.DISPLACED]
    assert any(each.estimate == "picture" and each.weight > 0.0 for each in displaced) == counts


def test_table_has_a_row_per_adversary_and_one_for_all(attacked: RunRecord) -> None:
    attacked.metrics["achieved"] = {"adversary_1": ACHIEVED, "adversary_2": ACHIEVED, "all": ACHIEVED}
    rows = [line.cells for line in achieved_table(attacked)[0].lines]
    assert [row[0] for row in rows] == ["adversary_1", "adversary_2", "all together"]
    inserted, hidden, moved = ("4", "100% / 50%", f"9.2 / {DASH}"), ("0", f"{DASH} / {DASH}"), ("2", "0.50 / 0.25")
    assert rows[0][1:] == (*inserted, *hidden, *moved, f"0.2 / {DASH}", "3 / 0")


def test_run_without_adversaries_has_no_achievement_table(run_folder: Callable[..., Path]) -> None:
    assert achieved_table(RunRecord.load(run_folder()))[0].lines == []


def idle(run: RunRecord, received: int = 40) -> RunRecord:
    summary = {"role": "adversary", "wires": ["agent/infra_1/detections"], "messages": received, "effects": {}}
    summary |= {"reports": 0, "agreement": "nothing to report", "unreported": 0, "unfounded": 0}
    run.metrics["interposers"] = {"adversary_1": summary}
    return run


def test_reason_for_an_adversary_that_changed_nothing(attacked: RunRecord) -> None:
    assert why(idle(attacked), None) == "it passed all 40 messages on unchanged"
    assert why(idle(attacked, received=0), None) == "no message reached it"


def test_reason_for_an_attack_planned_after_the_end(attacked: RunRecord) -> None:
    plan = {"label": "Attack", "kind": "attack", "at_s": 60.0, "until_s": None, "nodes": ["adversary_1"]}
    attacked.scenario["timeline"] = [plan]
    assert why(idle(attacked), None) == "its attack was to begin at 60 s, after the end of the run at 4.0 s"


def test_attack_settings_reveal_a_start_after_the_end(attacked: RunRecord) -> None:
    attack = {"type": "UncoordinatedAttack", "start_s": 60.0}
    attacked.scenario["nodes"] = {"adversary_1": {"config": {"attack": attack}}}
    assert why(idle(attacked), None) == "its attack was to begin at 60 s, after the end of the run at 4.0 s"
    attack["start_s"] = 3.5
    assert why(idle(attacked), None) == "it passed all 40 messages on unchanged"


def test_reason_for_an_adversary_that_failed_first(attacked: RunRecord) -> None:
    attacked.run["nodes"]["adversary_1"]["failures"] = [{"handler": "detections", "count": 3}]
    assert why(idle(attacked), None) == "it changed nothing: detections failed 3 times"
    attacked.run["nodes"]["adversary_1"] |= {"failures": [], "exit": 1, "ended": "exit code 1"}
    assert why(idle(attacked), None) == "it crashed before it changed anything: exit code 1"


def test_reason_for_an_adversary_without_measurements(attacked: RunRecord) -> None:
    attacked.metrics.pop("interposers")
    assert why(attacked, None) == "what it did was not measured"


NOT_ACCEPTED = {"inserted": 1, "inserted_share_centre": 0.0, "inserted_share_ego": 0.0}


def test_objects_inserted_out_of_range_of_every_agent(attacked: RunRecord) -> None:
    away = targets("inserted", x=500.0, judged_centre=False, judged_ego=False)
    assert why(attacked, away, **NOT_ACCEPTED) == "inserted: what it inserted was out of range of every agent (100 m)"


def test_objects_inserted_out_of_the_egos_range_alone_were_rejected(attacked: RunRecord) -> None:
    assert "the fusion rejected" in why(attacked, targets("inserted", x=500.0, judged_ego=False), **NOT_ACCEPTED)


def test_objects_inserted_on_a_real_object_match_it(attacked: RunRecord) -> None:
    truth = attacked.objects
    assert truth is not None
    at = (truth["frame"] == 20) & (truth["kind"] == "truth") & (truth["estimator"] == "picture")
    x, y = float(truth["x"][at][0]), float(truth["y"][at][0])
    beside = targets("inserted", n=1, x=x + 1.5, y=y)
    assert "within 2 m of a real object" in why(attacked, beside, **NOT_ACCEPTED)
    scorer = {"type": "Scorer", "assigner": {"type": "CenterDistanceAssigner", "gate_m": 0.5}}
    attacked.scenario["nodes"] = {"evaluator": {"config": {"scorer": scorer}}}
    assert "the fusion rejected everything" in why(attacked, beside, **NOT_ACCEPTED)


def test_reason_for_objects_rejected_by_the_fusion(attacked: RunRecord) -> None:
    assert "the fusion rejected everything" in why(attacked, targets("inserted", x=30.0, y=40.0), **NOT_ACCEPTED)
    half = NOT_ACCEPTED | {"inserted_share_centre": 1.0}
    assert "the ego did not adopt it" in why(attacked, targets("inserted", x=30.0, y=40.0), **half)


def test_accepted_objects_need_no_reason(attacked: RunRecord) -> None:
    believed = {"inserted": 1, "inserted_share_centre": 1.0, "inserted_share_ego": 1.0}
    assert why(attacked, targets("inserted", x=30.0, y=40.0), **believed) == ""


def test_reason_for_changes_in_unscored_frames(attacked: RunRecord) -> None:
    attacked.metrics["scored_frames"] = [0, 10]
    believed = {"inserted": 1, "inserted_share_centre": 1.0, "inserted_share_ego": 1.0}
    reason = "everything that it did was in frames that are not scored"
    assert why(attacked, targets("inserted", x=30.0, y=40.0), **believed) == reason


HIDDEN: dict[str, tuple[dict[str, Any], str]] = {
    "others": ({"seen_by_others": True}, "other agents still saw what it removed, all the time"),
    "clutter": ({"object": -1}, "what it removed was clutter, not part of the scene"),
    "nobody": (
        {"judged_centre": False, "judged_ego": False},
        "what it removed is not scored: no agent sees it, or it is out of range of every agent",
    ),
    "coasting": ({}, "what it removed was still tracked"),
}


@pytest.mark.parametrize(("columns", "reason"), HIDDEN.values(), ids=HIDDEN)
def test_reasons_for_removed_objects_that_were_not_missed(
    attacked: RunRecord, columns: dict[str, Any], reason: str
) -> None:
    nothing = {"hidden": 1, "hidden_share_centre": 0.0, "hidden_share_ego": 0.0}
    assert reason in why(attacked, targets("removed", **columns), **nothing)
    assert why(attacked, targets("removed", **columns), **(nothing | {"hidden_share_ego": 1.0})) == ""


NOT_HIDDEN = {"hidden": 1, "hidden_share_centre": 0.0, "hidden_share_ego": 0.0}


@pytest.mark.parametrize("first_dropped", [15, 25])
def test_dropped_messages_have_their_own_reasons(attacked: RunRecord, first_dropped: int) -> None:
    effects = attacked.effects
    assert effects is not None
    selected = (effects["interposer"] == "adversary_1") & (effects["effect"] == "removed")
    dropped = selected & (effects["frame"] >= first_dropped)
    effects["effect"] = np.where(dropped, "dropped", effects["effect"])
    reason = "other agents still saw the objects in the messages that it dropped, all the time"
    removed = "removed: other agents still saw what it removed, all the time; " if first_dropped > 15 else ""
    assert why(attacked, targets("removed", seen_by_others=True), **NOT_HIDDEN) == f"{removed}dropped: {reason}"


def test_unreachable_estimates_show_dashes(attacked: RunRecord) -> None:
    attacked.metrics["achieved"] = dict.fromkeys(("adversary_1", "adversary_2", "all"), ACHIEVED)
    for name in ("adversary_1", "adversary_2"):
        for wire in attacked.wiring["wires"]:
            wire["interposers"] = [node for node in wire.get("interposers", ()) if node != name]
        leg = {"key": f"cc/picture/@tap/ego/{name}", "from": name, "to": ["ego"], "before": "ego"}
        picture = next(wire for wire in attacked.wiring["wires"] if wire["key"] == "cc/picture")
        picture["interposers"].append(name)
        picture["legs"].append(leg)
        both = [line.cells for line in achieved_table(attacked)[0].lines]
        assert both[-1][2] == (f"{DASH} / 50%" if name == "adversary_2" else "100% / 50%")
    assert (both[0][2], both[0][7], both[0][9]) == (f"{DASH} / 50%", f"{DASH} / 0.25", f"{DASH} / 0")


def seen_by(run: RunRecord, *agents: str) -> None:
    """Let only these agents see the objects of the scene."""
    scene = run.recording
    assert scene is not None
    columns = np.isin(scene.agent_names, agents)
    object.__setattr__(run, "recording", replace(scene, points=np.where(columns, 10, 0) + 0 * scene.points))


def by_both(kind: str) -> dict[str, np.ndarray]:
    """Effects of adversary_1, and of adversary_2 on the same object and frames."""
    first = targets(kind, seen_by_others=True)
    second = first | {"adversary": np.full(10, "adversary_2", object)}
    return {name: np.concatenate([first[name], second[name]]) for name in first}


@pytest.mark.parametrize("kind", ["removed", "moved"])
def test_agent_with_the_object_removed_by_another_adversary_does_not_see_it(attacked: RunRecord, kind: str) -> None:
    table = by_both("removed")
    table["kind"][table["adversary"] == "adversary_2"] = kind
    seen_by(attacked, "infra_1", "infra_3")
    assert "other agents" not in why(attacked, table, **NOT_HIDDEN)
    seen_by(attacked, "infra_1", "infra_3", "infra_2")
    assert "removed: other agents still saw what it removed, all the time" in why(attacked, table, **NOT_HIDDEN)


def test_an_agent_with_an_adversary_that_leaves_the_object_alone_sees_it(attacked: RunRecord) -> None:
    table = by_both("removed")
    table["object"][table["adversary"] == "adversary_2"] = 8
    seen_by(attacked, "infra_1", "infra_3")
    assert "removed: other agents still saw what it removed, all the time" in why(attacked, table, **NOT_HIDDEN)


def test_adversary_before_another_agent_is_not_judged_by_the_ego(attacked: RunRecord) -> None:
    legs = [{"key": "cc/picture/@tap/infra_1/0", "from": "adversary_1", "to": ["infra_1"], "before": "infra_1"}]
    attacked.wiring["wires"].append({"key": "cc/picture", "message": "picture", "legs": legs})
    assert why(attacked, None) == "it sat on the picture's path to infra_1, not to the ego"


def test_terminal_and_page_show_limited_effects(attacked: RunRecord) -> None:
    why(attacked, targets("removed", seen_by_others=True), **NOT_HIDDEN)
    page = io.StringIO()
    show_loaded(Console(file=page, width=200), attacked)
    assert "  limited effect: removed: other agents still saw what it removed, all the time\n" in page.getvalue()
    assert "no effect" not in page.getvalue()
    html = write_page(attacked).read_text()
    assert "Changes with limited effect, and why" in html
    assert "no effect" not in html


def test_reason_for_moved_objects_without_displacement(attacked: RunRecord) -> None:
    nothing = {"moved": 1, "moved_share_centre": 0.0, "moved_share_ego": 0.0, "moved_error_m_centre": 0.4}
    reason = "the tracks of what it {} are 0.40 m off on average, which does not count as a displacement"
    for kind, done in (("moved", "moved"), ("altered", "altered")):
        table = targets(kind, error_m_centre=0.4)
        nothing |= {f"{kind}_share_centre": 0.0, f"{kind}_error_m_centre": 0.4}
        assert why(attacked, table, **nothing) == f"{kind}: {reason.format(done)}"
        for judge in ("centre", "ego"):
            assert why(attacked, table, **nothing, **{f"id_switches_{judge}": 2}) == "", "they are also an effect"


def test_changes_blamed_in_the_headline_have_no_reason_for_limited_effect(attacked: RunRecord) -> None:
    assert attacked.objects is not None
    by = np.where(attacked.objects["outcome"] != "matched", "adversary_1", "")
    attacked.objects["by"] = by.astype(object)
    hidden = {"hidden": 1, "hidden_share_centre": 0.0, "hidden_share_ego": 0.0}
    assert why(attacked, targets("removed"), "fn", **hidden) == ""
    assert why(attacked, targets("removed"), "fp", **hidden).startswith("removed: "), "it is blamed for its insertions"
    assert why(attacked, targets("inserted", x=30.0, y=40.0), "fp", **NOT_ACCEPTED) == ""
    attacked.metrics["interposers"]["adversary_1"]["effects"] = {"removed": 25}
    assert why(attacked, targets("removed"), "fp", **hidden) == "", "it only removed objects"


def on_the_downlink(run: RunRecord) -> RunRecord:
    assert run.effects is not None
    run.effects["message"] = np.full(len(run.effects["frame"]), "picture", object)
    return run


@pytest.mark.parametrize(
    ("tracked", "reason"),
    [
        (10, "the ego sees what it removed itself, all the time"),
        (9, "the ego sees what it removed itself, 90% of the time"),
        (0, "what it removed was still tracked by the ego: tracks outlive a gap"),
    ],
)
def test_downlink_manipulations_are_judged_by_the_ego_alone(attacked: RunRecord, tracked: int, reason: str) -> None:
    nothing = {"hidden": 1, "hidden_share_centre": 0.0, "hidden_share_ego": 0.0}
    objects = on_the_downlink(attacked).objects
    assert objects is not None
    own = (objects["estimator"] == "local") & (objects["kind"] == "truth") & (objects["id"] == 7)
    seen = (objects["frame"] >= 20) & (objects["frame"] < 20 + tracked)
    objects["outcome"] = np.where(own, np.where(seen, "matched", "missed"), objects["outcome"]).astype(object)
    assert why(attacked, targets("removed", seen_by_others=True), **nothing) == f"removed: {reason}"


def test_visibility_for_other_agents_is_given_in_per_cent(attacked: RunRecord) -> None:
    nothing = {"hidden": 1, "hidden_share_centre": 0.0, "hidden_share_ego": 0.0}
    table = targets("removed", n=300)
    table["seen_by_others"] = np.arange(300) > 0
    assert "other agents still saw what it removed, 99% of the time" in why(attacked, table, **nothing)


DRIVES = {
    "truth": {"corridor_objects": 2.0, "min_ttc_s": None, "brake_share": 0.0},
    "mission": {"corridor_objects": 2.5, "min_ttc_s": 0.4, "brake_share": 0.25, "corridor_false": 0.5}
    | {"corridor_missed": 0.0, "needless_brake_share": 0.25, "needless_brake_share_attack": 0.125}
    | {"missed_brake_share": 0.0, "missed_brake_share_attack": 0.0},
}


def test_driving_has_a_row_for_the_truth_and_each_estimate(attacked: RunRecord) -> None:
    assert driving_table(attacked).lines == []
    attacked.metrics["driving"] = {"ego": DRIVES}
    truth, mission = (line.cells for line in driving_table(attacked).lines)
    assert truth == ("truth", "2.00", DASH, DASH, DASH, "never", "0.0%", DASH, DASH)
    corridor = "2.50", "0.50", "0.00", DASH, "0.4"
    assert mission == ("ego with picture", *corridor, "25.0%", "25.0% (12.5% by attack)", "0.0%")


def test_driving_is_compared_with_another_run(run_folder: Callable[..., Path], attacked: RunRecord) -> None:
    reference = RunRecord.load(run_folder())
    attacked.metrics["driving"] = {"ego": DRIVES}
    assert len(driving_table(attacked, reference, "unattacked").lines) == 2, "the other run's value is unknown"
    mission = DRIVES["mission"] | {"needless_brake_share": 0.125, "brake_share": 0.3, "min_ttc_s": None}
    reference.metrics["driving"] = {"ego": {"truth": DRIVES["truth"], "mission": mission}}
    rows = [line.cells for line in driving_table(attacked, reference, "unattacked").lines]
    assert [row[:2] for row in rows] == [
        ("truth", "unattacked"),
        ("truth", attacked.label),
        ("ego with picture", "unattacked"),
        ("ego with picture", attacked.label),
    ]
    assert [row[7] for row in rows] == ["0.0%", "0.0% (+0.0)", "30.0%", "25.0% (\u22125.0)"]
    assert (rows[2][8], rows[3][8]) == (
        "12.5% (12.5% by attack)",
        "25.0% (+12.5) (12.5% by attack; 12.5% more than unattacked, not attributed)",
    )
    assert (rows[2][6], rows[3][6], rows[3][2]) == ("never", "0.4", "2.50 (+0.00)")


@pytest.mark.parametrize(
    ("before", "after", "attack", "more"),
    [(0.0, 0.059, 0.0, "5.9%"), (0.1, 0.159, 0.02, "3.9%"), (0.0, 0.059, 0.059, ""), (0.1, 0.05, 0.0, "")],
)
def test_unattributed_increase_of_needless_braking_is_reported(
    run_folder: Callable[..., Path], attacked: RunRecord, before: float, after: float, attack: float, more: str
) -> None:
    reference = RunRecord.load(run_folder())
    share = "needless_brake_share"
    attacked.metrics["driving"] = {"ego": {"mission": {share: after, f"{share}_attack": attack}}}
    reference.metrics["driving"] = {"ego": {"mission": {share: before, f"{share}_attack": 0.0}}}
    needless = driving_table(attacked, reference, "unattacked").lines[-1].cells[8]
    assert (f"{more} more than unattacked, not attributed" in needless) == bool(more)
    often = f"The ego with the picture brakes needlessly in {more} of the scored frames"
    sentence = f"{often} more than unattacked, not attributed."
    sentences = reading(attacked, Reference(reference, "unattacked"))
    assert (sentence in sentences) == bool(more)
    assert any("not attributed" in each for each in sentences) == bool(more)


def test_objects_overlapping_the_ego_have_their_own_column(attacked: RunRecord) -> None:
    mission = DRIVES["mission"] | {"overlapping_objects": 0.75}
    attacked.metrics["driving"] = {"ego": {"mission": mission}}
    assert driving_table(attacked).lines[0].cells[4] == "0.75"
    metrics = json.loads((attacked.path / "metrics.json").read_text())
    (attacked.path / "metrics.json").write_text(json.dumps(metrics | {"driving": {"ego": {"mission": mission}}}))
    assert "overlapping<br>the ego" in write_report(attacked.path).read_text()


def drive(needless: list[int]) -> dict[str, np.ndarray]:
    """driving.parquet of 40 frames: the ego sometimes brakes needlessly."""
    part: dict[str, list[Any]] = {name: [] for name in ("frame", "agent", "estimate", "false", "missed", "ttc_s")}
    part |= {name: [] for name in ("brake", "needless", "omitted")}
    for estimate in ("truth", "mission"):
        for frame in range(40):
            brakes = estimate == "mission" and frame in needless
            values = (frame, "ego", estimate, int(brakes), 0, 1.0 if brakes else np.nan, brakes, brakes, False)
            for column, value in zip(part.values(), values, strict=True):
                column.append(value)
    return {name: np.array(column) for name, column in part.items()}


def test_needless_braking_is_drawn_when_it_happens(attacked: RunRecord) -> None:
    assert driving_over_time(attacked, None) is None
    object.__setattr__(attacked, "driving", drive([20, 21, 22, 30]))
    figure = driving_over_time(attacked, 21)
    assert figure is not None
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "brakes needlessly" in labels
    (bars,) = (each for each in figure.axes[2].collections if each.get_label() == "brakes needlessly")
    spans = [path.get_extents() for path in bars.get_paths()]
    stretches = sorted((round(float(span.x0), 3), round(float(span.x1), 3)) for span in spans)
    assert stretches == [(1.95, 2.25), (2.95, 3.05)]


def test_older_runs_have_unknown_achievements(run_folder: Callable[..., Path]) -> None:
    folder = run_folder("uncoordinated")
    metrics = json.loads((folder / "metrics.json").read_text())
    for name in ("achieved", "driving", "interposers"):
        metrics.pop(name)
    (folder / "metrics.json").write_text(json.dumps(metrics))
    run = RunRecord.load(folder)
    assert any("what attacks achieved is not known" in sentence for sentence in run.missing)
    assert {why for _, why in achieved_table(run)[1]} == {"what it did was not measured"}

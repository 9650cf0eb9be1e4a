"""Achievements of attacks, reasons for limited effects, and driving."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mast_zenoh.run_folder.finding import Finding, sentence
from mast_zenoh.runs.run import Run
from mast_zenoh.show.comparison import Reference
from mast_zenoh.show.figures.over_time import driving_over_time
from mast_zenoh.show.findings import changes, found_in
from mast_zenoh.show.findings.adversaries import limits
from mast_zenoh.show.findings.words import said
from mast_zenoh.show.number_text import DASH
from mast_zenoh.show.tables.of_run import achieved_table, driving_table

RunOf = Callable[..., Run]

ACHIEVED = {"inserted": 4, "inserted_share_centre": 1.0, "inserted_share_ego": 0.5, "inserted_s_centre": 9.25}
ACHIEVED |= {"inserted_s_ego": None, "hidden": 0, "moved": 2, "moved_error_m_centre": 0.5, "moved_error_m_ego": 0.25}
ACHIEVED |= {"first_success_s_centre": 0.2, "first_success_s_ego": None, "id_switches_centre": 3, "id_switches_ego": 0}


@pytest.fixture
def attacked(run_of: RunOf) -> Run:
    return run_of("uncoordinated")


def targets(kind: str, n: int = 10, **columns: Any) -> dict[str, np.ndarray]:
    """adversary_1's effect on one object in n frames, from frame 20 on."""
    defaults = {"object": 7, "x": 0.0, "y": 0.0, "seen_by_others": False, "error_m_centre": np.nan}
    defaults |= {"judged_centre": True, "judged_ego": True, "believed_centre": False, "believed_ego": False}
    table = {name: np.full(n, value) for name, value in (defaults | {"error_m_ego": np.nan} | columns).items()}
    names = {"adversary": np.full(n, "adversary_1", object), "kind": np.full(n, kind, object)}
    return table | names | {"frame": np.arange(20, 20 + n)}


def why(run: Run, table: dict[str, np.ndarray] | None, blamed_for: str = "", **achieved: Any) -> list[tuple[Any, ...]]:
    """The reasons of adversary_1: what it did, why, and how much; blamed_for: the only score changed by attacks."""
    run.files.summary["achieved"] = {"adversary_1": achieved, "all": achieved}
    for summary in run.files.summary["agents"]["ego"].values():
        for key in ("fn", "fp"):
            summary[f"{key}_split"] = {"fault": 0.0, "attack": 2.0 if key == blamed_for else 0.0, "natural": 0.0}
    run.files.targets = table
    own = [each for each in limits(run) if each.who == ("adversary_1",)]
    assert len(said(run, own)) == len(own), "each reason has words"
    return [(each.what, *each.cause, each.where if each.value is None else round(each.value, 2)) for each in own]


@pytest.mark.parametrize(("error_m", "counts"), [(1.5, True), (15.0, False)])
def test_duplicate_beyond_the_gate_is_false_and_not_in_the_rmse(attacked: Run, error_m: float, counts: bool) -> None:
    attacked.files.targets = targets("moved", error_m_centre=error_m)
    displaced = [each for each in changes.attributed(attacked) if each.kind == changes.DISPLACED]
    assert any(each.estimate == "picture" and each.weight > 0.0 for each in displaced) == counts


IDLE = {"role": "adversary", "wires": ["agent/infra_1/detections"], "messages": 40, "effects": {}}
IDLE |= {"reports": 0, "agreement": "nothing to report", "unreported": 0, "unfounded": 0}
UNCHANGED = ("", "idle", 40)
LATE = ("", "late", 60.0)


def idle(received: int = 40) -> dict[str, Any]:
    return {"metrics": {"interposers": lambda _: {"adversary_1": IDLE | {"messages": received}}}}


def noted(cause: str) -> dict[str, Any]:
    notice = Finding("idle", ("adversary_1",), "no change", 60.0, 4.0, "s", cause=(cause,)).to_json()
    return {"run": {"notices": [notice | {"text": "as its launcher said it"}]}}


def of_node(**changes: Any) -> dict[str, Any]:
    return {"run": {"nodes": {"adversary_1": changes}}}


@pytest.mark.parametrize(
    ("files", "reason"),
    [
        (idle(), UNCHANGED),
        (idle(received=0), ("", "idle", 0)),
        (idle() | noted("late"), LATE),
        (idle() | noted("no target"), UNCHANGED),
        (
            idle() | of_node(failures=[{"handler": "detections", "count": 3}]),
            ("", "failed", "detections failed 3 times", ""),
        ),
        (
            idle() | of_node(failures=[], exit=1, ended="exit code 1"),
            ("", "failed", "exit code 1", ""),
        ),
        ({"metrics": {"interposers": ...}}, ("", "unmeasured", "")),
    ],
)
def test_reasons_for_an_adversary_that_changed_nothing(
    run_of: RunOf, files: dict[str, Any], reason: tuple[Any, ...]
) -> None:
    assert why(run_of("uncoordinated", **files), None) == [reason]


def test_an_attack_on_points_that_changed_nothing_says_why_in_the_results(run_of: RunOf) -> None:
    count = Finding("count", ("untimed",), value=60)
    note = Finding("idle", ("adversary_1",), "no change", 60, unit="scans", cause=("scans",), parts=(count,)).to_json()
    run = run_of("uncoordinated", **idle(), run={"notices": [note | {"text": "as its launcher said it"}]})
    (reason,) = said(run, [each for each in limits(run) if each.who == ("adversary_1",)])
    assert "on unchanged: 60 scans came during its attack by its own count, 60 without firing times" in reason


NOT_ACCEPTED = {"inserted": 1, "inserted_share_centre": 0.0, "inserted_share_ego": 0.0}
AT_CENTRE = NOT_ACCEPTED | {"inserted_share_centre": 1.0}
NOT_HIDDEN = {"hidden": 1, "hidden_share_centre": 0.0, "hidden_share_ego": 0.0}
NOT_MOVED = {"moved": 1, "altered": 1}
NOT_MOVED |= {f"{kind}_share_{judge}": 0.0 for kind in ("moved", "altered") for judge in ("centre", "ego")}
NOT_MOVED |= {"moved_error_m_centre": 0.4, "altered_error_m_centre": 0.4}
NOWHERE = {"judged_centre": False, "judged_ego": False}
BESIDE = {"x": 30.0, "y": 40.0}
SEEN = ("removed", "seen by others", 1.0)


@pytest.mark.parametrize(
    ("table", "achieved", "reasons"),
    [
        (targets("inserted", x=500.0, **NOWHERE), NOT_ACCEPTED, [("inserted", "not scored", "")]),
        (targets("inserted", x=500.0, judged_ego=False), NOT_ACCEPTED, [("inserted", "rejected", "")]),
        (targets("inserted", **BESIDE), NOT_ACCEPTED, [("inserted", "rejected", "")]),
        (targets("inserted", **BESIDE), AT_CENTRE, [("inserted", "not adopted", "")]),
        (targets("inserted", **BESIDE), AT_CENTRE | {"inserted_share_ego": 1.0}, []),
        (targets("removed", seen_by_others=True), NOT_HIDDEN, [SEEN]),
        (targets("removed", object=-1), NOT_HIDDEN, [("removed", "not scored", "")]),
        (targets("removed", **NOWHERE), NOT_HIDDEN, [("removed", "not scored", "")]),
        (targets("removed"), NOT_HIDDEN, [("removed", "tracked", 0.0)]),
        (targets("removed"), NOT_HIDDEN | {"hidden_time_share_centre": 0.25}, [("removed", "tracked", 0.25)]),
        (targets("removed", seen_by_others=True), NOT_HIDDEN | {"hidden_share_ego": 1.0}, []),
        (
            targets("removed", n=300) | {"seen_by_others": np.arange(300) > 29},
            NOT_HIDDEN,
            [("removed", "seen by others", 0.9)],
        ),
        (targets("moved", error_m_centre=0.4), NOT_MOVED, [("moved", "too little", 0.4)]),
        (targets("altered", error_m_centre=0.4), NOT_MOVED, [("altered", "too little", 0.4)]),
        (targets("moved", error_m_centre=0.4), NOT_MOVED | {"id_switches_centre": 2}, []),
        (targets("altered", error_m_centre=0.4), NOT_MOVED | {"id_switches_ego": 2}, []),
    ],
)
def test_reasons_for_limited_effects(
    attacked: Run, table: dict[str, np.ndarray], achieved: dict[str, Any], reasons: list[tuple[Any, ...]]
) -> None:
    assert why(attacked, table, **achieved) == reasons


def test_a_share_of_the_time_is_never_rounded_up_to_all_of_it(attacked: Run) -> None:
    why(attacked, targets("removed", n=300) | {"seen_by_others": np.arange(300) > 0}, **NOT_HIDDEN)
    assert any("removed, 99%" in each.lower() for each in said(attacked, limits(attacked)))


def test_objects_inserted_on_a_real_object_match_it(attacked: Run) -> None:
    truth = attacked.files.objects
    at = (truth["frame"] == 20) & (truth["kind"] == "truth") & (truth["estimator"] == "picture")
    beside = targets("inserted", n=1, x=float(truth["x"][at][0]) + 1.5, y=float(truth["y"][at][0]))
    assert why(attacked, beside, **NOT_ACCEPTED) == [("inserted", "on real objects", 1.0)]
    scorer = {"type": "Scorer", "assigner": {"type": "CenterDistanceAssigner", "gate_m": 0.5}}
    attacked.files.scenario["nodes"] = {"evaluator": {"config": {"scorer": scorer}}}
    assert why(attacked, beside, **NOT_ACCEPTED) == [("inserted", "rejected", "")]


def test_a_rejected_object_may_have_been_undetected_or_withheld_by_the_defence_of_the_run(
    attacked: Run,
) -> None:
    of_points = Finding("limited", ("adversary_1",), "inserted", where="points", cause=("rejected",))
    attacked.files.scenario["nodes"] = {}
    (plain,), (points,) = said(attacked, [replace(of_points, where="")]), said(attacked, [of_points])
    assert "inserted: the fusion rejected it, or it" in plain
    assert "inserted: the detector found nothing, the fusion rejected it, or it" in points
    attacked.files.scenario["nodes"] = {"cc": {"config": {"pipeline": {"integrity": {"type": "KOfN"}}}}}
    assert "rejected it, the defence withheld it, or it" in said(attacked, [of_points])[0]


@pytest.mark.parametrize(("switches", "words"), [(1.0, "1 identity switch P is"), (2.0, "2 identity switches P are")])
def test_one_identity_switch_is_and_several_are(switches: float, words: str) -> None:
    finding = Finding("change", what="identity", value=switches, cause=("adversary_1",))
    assert sentence(finding, None, lambda: "P") == f"{words} due to adversary_1"
    during = Finding("during", what="identity", value=switches, when=(1.0, 2.0))
    assert f"there {words.split()[-1]} {words[0]} identity switch" in sentence(during, None, lambda: "P")


def test_reason_for_changes_in_unscored_frames(attacked: Run) -> None:
    attacked.files.summary["scored_frames"] = [0, 10]
    achieved = AT_CENTRE | {"inserted_share_ego": 1.0}
    assert why(attacked, targets("inserted", **BESIDE), **achieved) == [("", "unscored", "")]


def test_unreachable_estimates_show_dashes(attacked: Run) -> None:
    attacked.files.summary["achieved"] = dict.fromkeys(("adversary_1", "adversary_2", "all"), ACHIEVED)
    for name in ("adversary_1", "adversary_2"):
        for wire in attacked.files.wiring["wires"]:
            wire["interposers"] = [node for node in wire.get("interposers", ()) if node != name]
        leg = {"key": f"cc/picture/@tap/ego/{name}", "from": name, "to": ["ego"], "before": "ego"}
        leg |= {"from_port": "picture", "to_ports": ["picture"]}
        picture = next(wire for wire in attacked.files.wiring["wires"] if wire["key"] == "cc/picture")
        picture["interposers"].append(name)
        picture["legs"][0]["to"] = [name if node == "ego" else node for node in picture["legs"][0]["to"]]
        picture["legs"].append(leg)
        both = achieved_table(Run.of(attacked.files)).lines
        assert both[-1][2] == (f"{DASH} / 50%" if name == "adversary_2" else "100% / 50%")
    assert (both[0][2], both[0][7], both[0][9]) == (f"{DASH} / 50%", f"{DASH} / 0.25", f"{DASH} / 0")


@pytest.mark.parametrize(
    ("changes_of_the_other", "seen_by", "seen"),
    [
        ({}, ("infra_1", "infra_3"), False),
        ({}, ("infra_1", "infra_3", "infra_2"), True),
        ({"kind": "moved"}, ("infra_1", "infra_3"), False),
        ({"kind": "moved"}, ("infra_1", "infra_3", "infra_2"), True),
        ({"object": 8}, ("infra_1", "infra_3"), True),
    ],
)
def test_an_agent_whose_adversary_changes_the_same_object_does_not_see_it(
    attacked: Run, changes_of_the_other: dict[str, Any], seen_by: tuple[str, ...], seen: bool
) -> None:
    first = targets("removed", seen_by_others=True)
    other = targets("removed", seen_by_others=True) | {"adversary": np.full(10, "adversary_2", object)}
    other |= {name: np.full(10, value) for name, value in changes_of_the_other.items()}
    table = {name: np.concatenate([first[name], other[name]]) for name in first}
    scene = attacked.files.scene
    points = np.where(np.isin(scene.agent_names, seen_by), 10, 0) + 0 * scene.points
    reason = why(attacked.with_(scene=replace(scene, points=points)), table, **NOT_HIDDEN)
    assert reason == [SEEN if seen else ("removed", "tracked", 0.0)]


def test_adversary_before_another_agent_is_not_judged_by_the_ego(attacked: Run) -> None:
    legs = [{"key": "cc/picture/@tap/infra_1/0", "from": "adversary_1", "to": ["infra_1"], "before": "infra_1"}]
    attacked.files.wiring["wires"].append({"key": "cc/picture", "message": "picture", "legs": legs})
    assert why(attacked, None) == [("", "elsewhere", "infra_1", "")]


def test_changes_blamed_in_the_headline_have_no_reason_for_limited_effect(attacked: Run) -> None:
    boxes = attacked.files.objects
    boxes["by"] = np.where(boxes["outcome"] != "matched", "adversary_1", "").astype(object)
    assert why(attacked, targets("removed"), "fn", **NOT_HIDDEN) == []
    assert why(attacked, targets("removed"), "fp", **NOT_HIDDEN), "blamed for its insertions"
    assert why(attacked, targets("inserted", **BESIDE), "fp", **NOT_ACCEPTED) == []
    attacked.files.summary["interposers"]["adversary_1"]["effects"] = {"removed": 25}
    assert why(attacked, targets("removed"), "fp", **NOT_HIDDEN) == [], "it only removed objects"


@pytest.mark.parametrize(
    ("tracked", "reason"),
    [
        (10, ("removed", "seen by the ego", 1.0)),
        (9, ("removed", "seen by the ego", 0.9)),
        (0, ("removed", "tracked", 0.0)),
    ],
)
def test_downlink_manipulations_are_judged_by_the_ego_alone(
    attacked: Run, tracked: int, reason: tuple[Any, ...]
) -> None:
    objects, effects = attacked.files.objects, attacked.files.effects
    effects["message"] = np.full(len(effects["frame"]), "picture", object)
    own = (objects["estimator"] == "local") & (objects["kind"] == "truth") & (objects["id"] == 7)
    seen = (objects["frame"] >= 20) & (objects["frame"] < 20 + tracked)
    objects["outcome"] = np.where(own, np.where(seen, "matched", "missed"), objects["outcome"]).astype(object)
    assert why(attacked, targets("removed", seen_by_others=True), **NOT_HIDDEN) == [reason]


DRIVES = {
    "truth": {"corridor_objects": 2.0, "min_ttc_s": None, "brake_share": 0.0},
    "mission": {"corridor_objects": 2.5, "min_ttc_s": 0.4, "brake_share": 0.25, "corridor_false": 0.5}
    | {"corridor_missed": 0.0, "needless_brake_share": 0.25, "needless_brake_share_attack": 0.125}
    | {"missed_brake_share": 0.0, "missed_brake_share_attack": 0.0},
}


def test_driving_is_compared_with_another_run(run_of: RunOf, attacked: Run) -> None:
    reference = run_of()
    attacked.files.summary["driving"] = {"ego": DRIVES}
    assert len(driving_table(attacked, reference, "unattacked").lines) == 2, "the other run's value is unknown"
    mission = DRIVES["mission"] | {"needless_brake_share": 0.125, "brake_share": 0.3, "min_ttc_s": None}
    reference.files.summary["driving"] = {"ego": {"truth": DRIVES["truth"], "mission": mission}}
    rows = driving_table(attacked, reference, "unattacked").lines
    assert [row[:2] for row in rows] == [
        (estimate, run) for estimate in ("truth", "ego with picture") for run in ("unattacked", attacked.name)
    ]
    assert [row[7] for row in rows] == ["0.0%", "0.0% (+0.0)", "30.0%", "25.0% (\u22125.0)"]
    assert (rows[2][8], rows[3][8]) == (
        "12.5% (12.5% by attack)",
        "25.0% (+12.5) (12.5% by attack; 12.5% more than unattacked, not attributed)",
    )
    assert (rows[2][6], rows[3][6], rows[3][2]) == ("never", "0.4", "2.50 (+0.00)")


def test_unattributed_increase_of_needless_braking_is_reported(run_of: RunOf, attacked: Run) -> None:
    reference = run_of()
    share = "needless_brake_share"
    for before, after, attack, more in (
        (0.0, 0.059, 0.0, "5.9%"),
        (0.1, 0.159, 0.02, "3.9%"),
        (0.0, 0.059, 0.059, ""),
        (0.1, 0.05, 0.0, ""),
    ):
        attacked.files.summary["driving"] = {"ego": {"mission": {share: after, f"{share}_attack": attack}}}
        reference.files.summary["driving"] = {"ego": {"mission": {share: before, f"{share}_attack": 0.0}}}
        needless = driving_table(attacked, reference, "unattacked").lines[-1][8]
        assert (f"{more} more" in needless) == bool(more)
        details = found_in(attacked, Reference(reference, "unattacked"))["details"]
        told = [each.value for each in details if each.kind == "braking"]
        assert told == [attack] * bool(attack)


def test_needless_braking_is_drawn_when_it_happens(attacked: Run) -> None:
    assert driving_over_time(attacked, None) is None
    frames, agent = np.tile(np.arange(40), 2), np.full(80, "ego")
    estimate = np.repeat(["truth", "mission"], 40)
    brakes = (estimate == "mission") & np.isin(frames, [20, 21, 22, 30])
    table = {"frame": frames, "agent": agent, "estimate": estimate, "false": brakes.astype(int)}
    table |= {"missed": np.zeros(80, int), "ttc_s": np.where(brakes, 1.0, np.nan)}
    table |= {"brake": brakes, "needless": brakes, "omitted": np.zeros(80, bool)}
    figure = driving_over_time(attacked.with_(driving=table), 21)
    assert "brakes needlessly" in [text.get_text() for text in figure.legends[0].get_texts()]
    (bars,) = (each for each in figure.axes[2].collections if each.get_label() == "brakes needlessly")
    spans = [path.get_extents() for path in bars.get_paths()]
    stretches = sorted((round(float(span.x0), 3), round(float(span.x1), 3)) for span in spans)
    assert stretches == [(1.95, 2.25), (2.95, 3.05)]


def test_runs_without_measurements_have_unknown_achievements(run_of: RunOf) -> None:
    run = run_of("uncoordinated", metrics=dict.fromkeys(("achieved", "driving", "interposers"), ...))
    assert any("what attacks achieved" in sentence for sentence in run.files.missing)
    assert {each.cause for each in limits(run)} == {("unmeasured",)}
    assert achieved_table(run_of()).lines == driving_table(run_of()).lines == [], "no adversary, no driving"

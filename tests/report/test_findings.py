"""Findings agree with the numbers, and name a cause only if it was measured."""

import io
import json
import re
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from kept_texts import assert_kept
from rich.console import Console
from run_samples import edit

from mast_zenoh.run_folder.finding import Finding, sentence
from mast_zenoh.runs.events import first_changes
from mast_zenoh.runs.interposers import interposers
from mast_zenoh.runs.run import Run
from mast_zenoh.show import terminal
from mast_zenoh.show.comparison import Reference
from mast_zenoh.show.findings import findings, found_in, headline, of_compared, outcome
from mast_zenoh.show.findings.adversaries import attacks
from mast_zenoh.show.findings.causes import reaches
from mast_zenoh.show.findings.differences import other_differences
from mast_zenoh.show.findings.results import during
from mast_zenoh.show.findings.words import said, text
from mast_zenoh.show.html import write_page
from mast_zenoh.show.tables.scores import score_table

pytestmark = pytest.mark.usefixtures("without_figures")

RunOf = Callable[..., Run]
Metrics = dict[str, Any]

NONE = {"fault": 0.0, "attack": 0.0, "natural": 0.0}
FAILURE = {"handler": "on_detections", "count": 19, "frames": 19, "first_frame": 11, "last_frame": 29}
FAILURE |= {"exception": "ValueError: no", "where": "mine.py:3"}


def found(run: Run, reference: Run | None = None, name: str = "unattacked", **fields: Any) -> list[Finding]:
    """The findings of a run with these fields; names in `who` and `cause`, and a part, are among others."""
    every = findings(run, Reference(reference, name) if reference else None)
    return [
        each
        for each in every
        if all(
            {value} <= set(getattr(each, field))
            if field in ("who", "cause", "parts")
            else getattr(each, field) == value
            for field, value in fields.items()
        )
    ]


def text_of(run: Run, reference: Run | None = None, name: str = "unattacked") -> str:
    """`^headline$ sentences$`"""
    other = Reference(reference, name) if reference else None
    return f"^{headline(run, other)}$ {text(run, found_in(run, other)['details'])}$"


def of_ego(**estimates: Any) -> Metrics:
    """A change of metrics.json."""
    return {"agents": {"ego": estimates}}


def braking(**shares: float) -> Metrics:
    return {"driving": {"ego": {"mission": {f"{name}_brake_share_attack": share for name, share in shares.items()}}}}


def attacked_frames(number: int, of: int) -> Finding:
    return Finding("attacked frames", value=number, other=of, unit="frames")


def acting_on_misses(ego: Metrics) -> Metrics:
    clean = ego["picture"] | {"fp_split": NONE, "fn_split": NONE, "id_switches_split": NONE}
    received = clean | {"fn_split": NONE | {"attack": 6.0}}
    mission = clean | {"fn_split": NONE | {"attack": 1.1}, "id_switches_split": NONE | {"attack": 12}}
    return {"picture": clean, "picture_received": received, "mission": mission}


ROADSIDE = Finding("place", what="static", value=2, other=4, unit="agents")
ROWS_INSERTED = Finding("effect", what="inserted", value=125, unit="rows")
INSERTED = dict(kind="change", what="false", value=6.25, where="picture", cause="adversary_2")
#: Attack, changed files, findings, and one that must be absent.
ALONE: dict[str, tuple[str, dict[str, Any], list[dict[str, Any]], dict[str, Any]]] = {
    "an unattacked run": ("", {}, [dict(kind="missed", value=1.175, other=10.525)], dict(kind="change")),
    "an attacked run": (
        "uncoordinated",
        {},
        [
            INSERTED,
            dict(kind="adversaries", what="compromised", who="adversary_1", parts=ROADSIDE),
            dict(kind="attack", who="adversary_2", when=(1.5, 3.9), parts=ROWS_INSERTED),
            dict(kind="during", what="false", value=10.0, when=(1.5, 3.9), parts=attacked_frames(25, 40)),
        ],
        dict(kind="ended"),
    ),
    "a failed handler": (
        "uncoordinated",
        {"run": {"nodes": {"adversary_1": {"failures": [FAILURE]}}}},
        [
            dict(kind="ended", what="handlers", who="adversary_1", value=19),
            dict(kind="verdict", what="failed", who="adversary_1", value=19),
            INSERTED,
        ],
        dict(kind="no scores"),
    ),
    "damaged metrics": (
        "uncoordinated",
        {"metrics": '{"agents": '},
        [dict(kind="no scores", what="damaged")],
        INSERTED,
    ),
    "metrics of the user alone": (
        "uncoordinated",
        {"metrics": '{"mine": 3}'},
        [dict(kind="no scores", what="own")],
        INSERTED,
    ),
    "no metrics": ("uncoordinated", {"metrics": ...}, [dict(kind="no scores", what="not evaluated")], INSERTED),
    "silent and lying adversaries": (
        "uncoordinated",
        {
            "metrics": {
                "interposers": {"adversary_1": {"agreement": "silent"}, "adversary_2": {"agreement": "disagrees"}}
            }
        },
        [
            dict(kind="verdict", what="silent", who="adversary_1"),
            dict(kind="verdict", what="disagrees", who="adversary_2"),
        ],
        dict(kind="verdict", what="failed"),
    ),
    "braking because of attacks": (
        "uncoordinated",
        {"metrics": braking(needless=0.125, missed=0.0)},
        [dict(kind="braking", what="needless", value=0.125)],
        dict(kind="braking", what="missed"),
    ),
    "no braking because of attacks": (
        "uncoordinated",
        {"metrics": braking(needless=0.0, missed=0.0)},
        [],
        dict(kind="braking"),
    ),
    "fewer than half of the frames attacked": (
        "uncoordinated",
        {"metrics": {"scored_frames": [0, 28]}},
        [dict(kind="during", parts=attacked_frames(14, 29))],
        dict(kind="during", parts=attacked_frames(25, 40)),
    ),
    "changes with a cause each": (
        "uncoordinated",
        {
            "metrics": of_ego(picture={"fn_split": {"fault": 0.5, "attack": 0.0, "natural": 0.7}}),
            "scenario": {"timeline": [{"label": "Partition infra_2", "kind": "fault", "at_s": 0.5, "until_s": 1.0}]},
        },
        [INSERTED, dict(kind="change", what="missed", value=0.5, where="picture", cause="Partition infra_2")],
        dict(kind="change", what="missed", cause="adversary_1"),
    ),
    "changes with the same cause": (
        "uncoordinated",
        {"metrics": of_ego(picture={"fn_split": {"fault": 0.0, "attack": 0.5, "natural": 0.7}})},
        [INSERTED, dict(kind="change", what="missed", value=0.5, cause="adversary_1")],
        dict(kind="faults"),
    ),
    "what the ego acts on": (
        "uncoordinated",
        {"metrics": {"agents": {"ego": acting_on_misses}, "same_as": lambda _: {}}},
        [
            dict(kind="change", what="missed", value=6.0, where="picture_received", cause="adversary_1"),
            dict(kind="change", what="missed", value=1.1, where="mission"),
            dict(kind="change", what="identity", value=12, where="mission"),
        ],
        dict(kind="unchanged"),
    ),
}


@pytest.mark.parametrize(("attack", "changes", "expected", "absent"), ALONE.values(), ids=ALONE)
def test_findings_on_one_run(
    run_of: RunOf, attack: str, changes: dict[str, Any], expected: list[dict[str, Any]], absent: dict[str, Any]
) -> None:
    run = run_of(attack, **changes)
    for fields in expected:
        assert found(run, **fields), fields
    assert not found(run, **absent)
    assert len(said(run, findings(run))) == len(findings(run)), "each kind has a phrase"


@pytest.mark.parametrize("name", ["attacked", "compared", "failed", "unattacked"])
def test_the_words_of_a_page_and_of_the_terminal(name: str, run_of: RunOf) -> None:
    run = run_of("" if name == "unattacked" else "uncoordinated")
    if name == "failed":
        run.files.record["nodes"]["adversary_1"]["failures"] = [FAILURE]
    reference = Reference(run_of(), "baseline") if name == "compared" else None
    console = Console(file=io.StringIO(), width=1000)
    terminal.show_loaded(console, run, reference, found_in(run, reference))
    page = [headline(run, reference), text(run, found_in(run, reference)["details"]), text(run, attacks(run))]
    assert_kept(f"run_{name}", *page, "", console.file.getvalue())


def test_sentences_give_the_numbers_of_the_table(run_of: RunOf) -> None:
    runs = {"baseline": run_of(), "uncoordinated": run_of("uncoordinated")}
    table = score_table(runs)
    missed = [table.score("fn", "baseline", name).number for name in ("picture", "local")]
    assert re.findall(r"\d+\.\d+", headline(runs["baseline"])) == missed
    false = table.score("fp", "uncoordinated", "picture")
    more = false.signed(false.change).removeprefix("+")
    reference = Reference(runs["baseline"], "baseline")
    assert f"{more} more false" in headline(runs["uncoordinated"], reference)
    assert f"{more} more false" in of_compared(runs, reference)[0]


def test_an_attack_in_a_single_frame_has_one_time(run_of: RunOf) -> None:
    run = run_of("uncoordinated", metrics={"interposers": {"adversary_2": ...}})
    only = (run.files.effects["frame"] == 20) & (run.files.effects["interposer"] == "adversary_1")
    run = run.with_(effects={name: column[only] for name, column in run.files.effects.items()})
    assert found(run, kind="during", when=(2.0, 2.0), value=10.0)
    assert found(run.with_(scene=None), kind="during", when=(2.0, 2.0))


def test_every_kind_of_change_in_every_estimate_is_reported(run_of: RunOf) -> None:
    attacked, reference = run_of("coordinated"), run_of()
    for what, key, more, words in (
        ("missed", "fn", -5.0, "5.00 fewer missed objects a frame"),
        ("false", "fp", 5.0, "5.00 more false objects a frame"),
        ("displaced", "rmse_m", 0.4, "0.40 m more RMSE"),
        ("identity", "id_switches", 400, "400 more identity switches"),
        ("length", "length_error_m", 1.8, "1.80 m more error in the lengths of matched objects"),
        ("width", "width_error_m", -0.9, "0.90 m less error in the widths of matched objects"),
        ("heading", "heading_error_deg", 60.0, "60.0\u00b0 more error in the headings of matched objects"),
        ("velocity", "velocity_error_mps", 5.0, "5.00 m/s more error in the velocities of matched objects"),
    ):
        for estimate in ("local", "picture", "mission"):
            metrics = attacked.files.summary | {"agents": deepcopy(reference.files.summary["agents"])}
            summary = metrics["agents"]["ego"][estimate]
            summary[key] = {"mean": summary[key]["mean"] + more} if "mean" in str(summary[key]) else summary[key] + more
            run = attacked.with_(summary=metrics)
            (change,) = found(run, reference, kind="change", what=what, where=estimate)
            assert change.value == pytest.approx(more)
            assert words in said(run, [change])[0]


def test_a_change_for_another_agent_is_named_when_the_ego_has_none(run_of: RunOf) -> None:
    reference = run_of(metrics={"agents": lambda agents: agents | {"infra_1": agents["ego"]}})
    agents = deepcopy(reference.files.summary["agents"])
    agents["infra_1"]["mission"]["fp"]["mean"] += 2.0
    run = run_of("coordinated", metrics={"agents": lambda _: agents})
    assert found(run, reference, kind="change", what="false", value=2.0, who="infra_1", where="mission")


#: Errors that are added, and the estimates and kinds of errors that change in the outcome.
IN_TRANSIT: dict[str, tuple[dict[str, float], list[tuple[str, str]]]] = {
    "the ego acts on it": (
        {"picture_received": 4.0, "picture_on_arrival": 4.0, "mission": 1.0},
        [("mission", "false")],
    ),
    "the ego acts on little of it": (
        {"picture_received": 4.0, "picture_on_arrival": 4.0, "mission": 0.5},
        [("picture_received", "false"), ("mission", "false")],
    ),
    "the ego loses identities for it": (
        {"picture_received": 4.0, "picture_on_arrival": 4.0, "mission": 0.5, "switches": 2},
        [("picture_received", "false"), ("mission", "false"), ("mission", "identity")],
    ),
    "the ego acts on nothing of it": (
        {"picture_received": 4.0, "picture_on_arrival": 4.0},
        [("picture_received", "false"), ("mission", "errors")],
    ),
}


def test_change_of_the_picture_in_transit_reports_what_the_ego_acts_on(run_of: RunOf) -> None:
    run = run_of()

    def with_false_objects(added: dict[str, float]) -> Run:
        picture = run.files.summary["agents"]["ego"]["picture"]
        names = ("picture", "picture_received", "picture_on_arrival", "mission")
        ego = {name: picture | {"fp": {"mean": added.get(name, 0.0), "std": 0.0}} for name in names}
        ego["mission"]["id_switches"] = 1 + added.get("switches", 0)
        return run.with_(summary=run.files.summary | {"agents": {"ego": ego}, "same_as": {}})

    for added, expected in IN_TRANSIT.values():
        found = outcome(with_false_objects(added), Reference(with_false_objects({}), "unattacked"))
        assert [(each.where, each.what) for each in found if each.kind != "unattributed"] == expected
        assert found[-1].what == "no cause"


def test_effects_without_a_change_of_scores_are_named(run_of: RunOf) -> None:
    reference = run_of()
    agents = {"agents": lambda _: reference.files.summary["agents"]}
    attacked = run_of("uncoordinated", metrics=agents)
    assert found(attacked, reference, kind="unchanged", what="scores", who="adversary_1", than="unattacked")
    assert found(attacked, kind="attack", who="adversary_1", parts=ROWS_INSERTED)
    passive = {"effects": lambda _: {}, "agreement": "nothing to report"}
    changes = {"interposers": {"adversary_1": passive, "adversary_2": passive}}
    silent = run_of("uncoordinated", metrics=changes)  # its errors differ, as with another defence
    one = replace(ROADSIDE, value=1)
    for run, what, place in (
        (run_of("uncoordinated", metrics=agents | changes), "idle", ROADSIDE),
        (run_of("uncoordinated", metrics=agents | {"interposers": ...}), "unmeasured", ROADSIDE),
        (silent, "idle", ROADSIDE),
        (run_of("uncoordinated", metrics={"interposers": {"adversary_1": passive}}), "compromised", one),
    ):
        assert found(run, kind="adversaries", what=what, parts=place)
    assert found(silent, reference, kind="adversaries", what="idle")


def test_difference_in_driving_alone_is_reported(run_of: RunOf) -> None:
    def with_braking(attack: str, share: float) -> Run:
        mission = {"needless_brake_share": share, "needless_brake_share_attack": share}
        agents = run_of().files.summary["agents"]
        return run_of(attack, metrics={"agents": lambda _: agents, "driving": {"ego": {"mission": mission}}})

    reference = with_braking("", 0.0)
    told = outcome(with_braking("uncoordinated", 0.125), Reference(reference, "unattacked"))
    assert [(each.kind, each.what) for each in told[1:]] == [("unchanged", "driving"), ("braking", "needless")]
    assert found(reference, reference, kind="unchanged", what="scores")


def test_a_reference_that_ended_badly_is_named_first(run_of: RunOf) -> None:
    run, reference = run_of("uncoordinated"), run_of()
    for state, ended in (
        ("handler_failures", "failed"),
        ("failed", "failed"),
        ("running", "has not ended"),
        ("killed", "was cut off"),
    ):
        reference.files.record["status"] = state
        start = f"^Compared with unattacked, which {ended}: 2 of 4 roadside sensors compromised: 6.2"
        assert text_of(run, reference).startswith(start)


def test_false_objects_during_the_attack_are_those_of_its_scored_frames(run_of: RunOf) -> None:
    base, run = run_of(), run_of("uncoordinated", metrics={"scored_frames": [0, 29]})
    assert found(run, base, kind="during", what="false", value=10.0, other=pytest.approx(0.0))
    assert during(base) == []
    run.files.counts["fp"] = np.where(run.files.counts["frame"] >= 30, 1000, run.files.counts["fp"])
    assert found(run, kind="during", what="false", value=10.0)


def with_changes(run: Run, estimate: str = "picture", *, agent: str = "ego", **added: float) -> Run:
    """A run with more or fewer errors: fn, fp, as means per frame, of them the part due to attacks in `attack`."""
    metrics = deepcopy(run.files.summary)
    summary = metrics["agents"][agent][estimate]
    due = added.pop("attack", 0.0)
    for key, more in added.items():
        summary[key] = {"mean": summary[key]["mean"] + more, "std": 0.0}
        summary[f"{key}_split"] = {"fault": 0.0, "natural": 0.0, "attack": due if more > 0.0 else 0.0}
    return run.with_(summary=metrics | {"same_as": {}})


def test_of_changes_of_the_same_size_the_headline_names_the_harm(run_of: RunOf) -> None:
    clean, attacked = pair(run_of, {"metrics": {"agents": lambda _: run_of().files.summary["agents"]}})[::-1]
    harmed, better = (
        with_changes(attacked, fp=-0.55, fn=0.5, attack=0.5),
        with_changes(attacked, fp=-2.0, fn=0.5, attack=0.5),
    )
    for run, what in ((harmed, "missed"), (better, "false")):
        changes = [each for each in outcome(run, Reference(clean, "unattacked")) if each.kind == "change"]
        assert [(each.what, each.where) for each in changes] == [(what, "picture")]


def test_the_score_during_an_attack_that_hides_objects_is_of_missed_ones(run_of: RunOf) -> None:
    hides = {"adversary_1": {"effects": lambda _: {"removed": 25}}, "adversary_2": {"effects": lambda _: {}}}
    unattacked = run_of().files.summary["agents"]
    attacked = run_of("uncoordinated", metrics={"interposers": hides, "agents": lambda _: unattacked})
    better = with_changes(attacked, fp=-0.5)
    assert found(better, run_of(), kind="during", what="missed", where="picture")


def test_an_attack_that_stays_out_of_the_picture_is_headed_by_the_picture(run_of: RunOf) -> None:
    clean = run_of(metrics={"agents": lambda agents: agents | {"infra_1": {"received": agents["ego"]["local"]}}})
    agents = {"agents": lambda _: clean.files.summary["agents"]}
    attacked = run_of("uncoordinated", metrics=agents, scenario=judged_by("FaultOrLie"))
    flooded = with_changes(attacked, "received", agent="infra_1", fp=20.0, attack=20.0)
    for reference, judge in ((None, "FaultOrLie"), (clean, None)):
        fields: dict[str, Any] = dict(cause=judge) if judge else dict(than="unattacked")
        assert found(flooded, reference, kind="unchanged", what="errors", where="picture", **fields)
        assert found(flooded, reference, kind="change", what="false", value=20.0, who="infra_1", where="received")


def test_compared_runs_are_headed_by_the_strongest_attack_and_each_has_a_sentence(run_of: RunOf) -> None:
    runs = {attack or "baseline": run_of(attack) for attack in ("", "uncoordinated", "coordinated")}
    title, sentences = of_compared(runs, Reference(runs["baseline"], "baseline"))
    assert "6.25 more false" in title
    assert [each.partition(":")[0] for each in sentences] == ["baseline", *list(runs)[1:]]
    assert "4.00 false objects" in sentences[2]
    runs["uncoordinated"].files.record["status"] = "failed"
    assert of_compared(runs, Reference(runs["baseline"], "baseline"))[0].startswith("uncoordinated did not")


def centre(radius: float, **more: Any) -> dict[str, Any]:
    clustering = {"type": "Clustering", "assign_radius": radius} | more
    pipeline = {"type": "Pipeline", "clustering": clustering}
    return {"nodes": {"command_center": {"role": "command_center", "config": {"pipeline": pipeline}}}}


def judged_by(stage: str) -> dict[str, Any]:
    pipeline = {"type": "Pipeline", "integrity": {"type": stage}}
    return {"nodes": {"command_center": {"role": "command_center", "config": {"pipeline": pipeline}}}}


def pair(run_of: RunOf, here: dict[str, Any] | None = None, there: dict[str, Any] | None = None) -> tuple[Any, Any]:
    """A coordinated run and one without adversaries, whose files differ from each other as given."""
    adversary = {"nodes": {"adversary_1": {"role": "adversary", "config": {"metres": 4.0}}}}
    records = run_of("coordinated", scenario=centre(2.0)), run_of(scenario=centre(2.0))
    edit(records[0].path, scenario=adversary)
    edit(records[0].path, **(here or {}))
    edit(records[1].path, **(there or {}))
    return Run(records[0].path), Run(records[1].path)


def test_added_adversaries_and_their_wires_are_not_other_differences(run_of: RunOf) -> None:
    runs = pair(run_of)
    assert other_differences(*runs) == ()
    assert found(*runs, kind="change", cause="adversary_1", than="unattacked")


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"scenario": centre(3.0)}, "command_center.pipeline.clustering.assign_radius"),
        ({"scenario": centre(3.0, type="Other")}, "command_center.pipeline.clustering"),
        ({"scenario": {"mode": "realtime"}}, "mode"),
        ({"scenario": {"scene": {"noise_m": 1.0}}}, "scene.noise_m"),
        ({"run": {"nodes": {"link_ego": {"role": "link"}}}}, "link_ego"),
        ({"wiring": {"wires": lambda wires: [*wires, {"key": "mine", "publisher": "ego"}]}}, "wire mine"),
        ({"run": {"versions": {"mast-zenoh": "9"}}}, "version of mast-zenoh"),
        ({"run": {"nodes": {"broker": {"failures": [{"handler": "on_tracks", "count": 3}]}}}}, "failures of broker"),
    ],
)
def test_no_cause_is_named_if_runs_differ_otherwise(run_of: RunOf, changes: dict[str, Any], name: str) -> None:
    for runs in (pair(run_of, changes), pair(run_of, None, changes)):
        assert other_differences(*runs) == (name,)
        assert found(*runs, kind="unattributed", what="also differ", cause=name)
        assert all(each.cause == () for each in found(*runs, kind="change"))


def test_causes_are_named_of_an_increase_that_adversaries_of_one_run_alone_can_reach(run_of: RunOf) -> None:
    attacked, clean = pair(run_of)
    weaker = run_of("coordinated", scenario=centre(2.0), metrics=of_ego(picture={"fp": {"mean": 0.0}}))
    edit(weaker.path, scenario={"nodes": {"adversary_1": {"role": "adversary", "config": {"metres": 1.5}}}})
    assert found(attacked, Run(weaker.path), kind="unattributed", what="differ", cause="adversary_1.metres")
    more_false = of_ego(picture={"fp": {"mean": 30.0}})
    attacked, clean = pair(run_of, None, {"metrics": more_false})
    (differences,) = found(clean, attacked, kind="unattributed", what="differ")
    assert differences.cause == ("adversary_1", "adversary_2", "coordinator")
    fewer = found(attacked, clean, kind="change", what="false")
    assert [each.cause for each in [*fewer, *found(clean, attacked, kind="change")]] == [(), ()]
    assert not found(attacked, clean, kind="unattributed"), "a decrease has no cause"
    attacked, clean = pair(run_of, {"metrics": of_ego(local={"fn": {"mean": 30.0}})})
    assert found(attacked, clean, kind="change", what="missed", where="local", cause="adversary_1") == []
    assert found(attacked, clean, kind="unattributed", what="no cause")
    assert [reaches(attacked, "adversary_1", name) for name in ("local", "picture", "mission")] == [False, True, True]
    dropped = {"interposers": {"adversary_1": {"effects": lambda _: {"dropped": 8}}, "adversary_2": ...}}
    missed = of_ego(picture={"fn": {"mean": 30.0}, "fn_split": {"fault": 0.0, "attack": 0.0}})
    (change,) = found(*pair(run_of, {"metrics": missed | dropped}), kind="change", what="missed")
    assert change.cause == ("adversary_1",)
    local = {"agents": {"ego": {"local": {"fn": {"mean": 30.0}}}}}
    assert found(run_of(metrics=local), run_of(), kind="unattributed", what="no cause")


LOST = {"churn": [{"frame": 40, "node": "infra_2", "what": "lost"}]}


@pytest.mark.parametrize("mode", ["realtime", "lockstep"])
def test_a_run_whose_node_died_says_so_first_and_names_it_as_the_cause(run_of: RunOf, mode: str) -> None:
    missed = of_ego(picture={"fn_split": {"fault": 0.5, "attack": 0.0, "natural": 0.7}})
    run = run_of(metrics=missed, run=LOST | {"mode": mode, "status": "ok"})
    (lost,) = found(run, kind="ended", who="infra_2")
    assert lost == findings(run)[0]
    assert lost.what == ("lost" if mode == "lockstep" else "lost in real time")
    assert "before frame 40" in headline(run)
    assert found(run, kind="change", what="missed", cause="the loss of infra_2")


def test_a_run_that_failed_says_why(run_of: RunOf) -> None:
    run = run_of(run={"status": "failed", "message": "infra_1 ended with exit code 1\nsee its log"})
    assert "(failed): infra_1 ended" in headline(run)


def test_a_run_without_adversaries_says_so_and_names_its_faults(run_of: RunOf) -> None:
    faults = [{"label": f"loss {n}", "kind": "fault", "at_s": float(n), "until_s": None} for n in range(5)]
    # wiring.json names adversaries, in every run of these tests
    run = run_of(wiring=..., metrics={"interposers": ...}, scenario={"timeline": faults})
    assert attacks(run) == [Finding("adversaries", what="none")]
    (planned,) = found(run, kind="faults")
    assert said(run, [planned])[0].endswith("and 2 more")


def test_every_kind_of_effect_is_described(run_of: RunOf) -> None:
    for effects, words in (
        ({"dropped": 3, "delayed": 1}, ("1 message delayed", "3 messages dropped")),
        ({"forged": 2}, ("2 messages forged",)),
        ({"reframed": 2}, ("2 messages changed outside their objects",)),
        ({"slandered": 2}, ("2 messages slandered",)),
        ({"moved": 7}, ("7 rows of objects moved",)),
        ({"sung": 2}, ("2 messages sung",)),
    ):
        run = run_of("uncoordinated")
        run.files.summary["interposers"]["adversary_1"]["effects"] = effects
        assert tuple(map(sentence, attacks(run)[0].parts)) == words


def test_a_forged_view_is_described_as_what_the_agent_says_it_sees(run_of: RunOf) -> None:
    run = run_of("uncoordinated")
    run.files.summary["interposers"]["adversary_1"]["effects"] = {"reframed": 27}
    table = run.files.effects
    views = (table["interposer"] == "adversary_1") & (table["effect"] == "removed")
    table["message"] = np.where(views, "view", table["message"]).astype(object)
    table["wire"] = np.where(views, "agent/infra_1/view", table["wire"]).astype(object)
    table["effect"] = np.where(views, "reframed", table["effect"]).astype(object)
    (adversary,) = (each for each in interposers(run) if each.name == "adversary_1")
    reframed, views = attacks(run)[0].parts
    assert (reframed.what, reframed.value, reframed.unit) == ("reframed", 2, "messages")
    assert (views.what, views.value, views.unit) == ("changed", 25, "views")
    assert "2 reframed, 25" in adversary.other
    assert "changes what infra_1" in " ".join(event.text for event in first_changes(run))


def test_idle_unmeasured_and_live_adversaries_are_distinguished(run_of: RunOf) -> None:
    idle = {"adversary_1": {"effects": lambda _: {}}, "adversary_2": {"effects": ...}}
    run = run_of("uncoordinated", metrics={"interposers": idle})
    did = {each.who[0]: (each.value, each.parts) for each in attacks(run)}
    assert did == {"adversary_1": (0, ()), "adversary_2": (None, ())}
    nothing, not_measured = said(run, attacks(run))
    assert nothing.endswith(": nothing")
    assert not_measured.endswith(": not measured")
    events = [
        {"action": "intercept", "node": "adversary_1", "frame": 15, "wires": ["agent/infra_1/detections"]},
        {"action": "release", "node": "adversary_1", "frame": 30, "wires": []},
    ]
    run = run_of("coordinated", run={"interceptions": events})
    assert "in frames 15 to 29" in attacks(run)[0].what


def test_a_coordinator_is_named_and_many_adversaries_are_summed_up(run_of: RunOf) -> None:
    def more(known: Metrics) -> Metrics:
        return known | {f"adversary_{number}": known["adversary_1"] for number in range(3, 9)}

    boss = {"nodes": {"boss": {"role": "coordinator"}}}
    run = run_of("uncoordinated", metrics={"interposers": more}, scenario=boss, run=boss)
    assert [(each.who, each.what) for each in attacks(run) if each.kind == "verdict"] == [(("boss",), "directed")]
    assert "table of interposers" in write_page(run).read_text()
    written = json.loads((run.path / "findings.json").read_text())
    assert [each["kind"] for each in written] == [each.kind for each in findings(run)]
    assert "2 of 4" in " ".join(each["text"] for each in written)

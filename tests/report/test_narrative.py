"""Sentences of the report agree with the numbers, and name a cause only if it was measured."""

from __future__ import annotations

import re
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from run_samples import edit

from mast_zenoh.report.comparison import Reference
from mast_zenoh.report.narrative.adversaries import attack_description
from mast_zenoh.report.narrative.attribution import other_differences, reaches
from mast_zenoh.report.narrative.changes import effects as effects_in_words
from mast_zenoh.report.narrative.run import (
    headline,
    reading,
    study_headline,
    study_reading,
    while_attacked,
)
from mast_zenoh.report.tables.scores import number, score_table, signed
from mast_zenoh.runs.events import first_changes
from mast_zenoh.runs.interposers import interposers
from mast_zenoh.runs.run import Run

RunOf = Callable[..., Run]
Metrics = dict[str, Any]

NONE = {"fault": 0.0, "attack": 0.0, "natural": 0.0}
FAILURE = {"handler": "on_detections", "count": 19, "frames": 19, "first_frame": 11, "last_frame": 29}
FAILURE |= {"exception": "ValueError: no", "where": "mine.py:3"}
DUE = "are due to adversary_1 and adversary_2"


def text_of(run: Run, reference: Run | None = None, name: str = "unattacked") -> str:
    """`^headline$ sentences$`"""
    other = Reference(reference, name) if reference else None
    return f"^{headline(run, other)}$ {' '.join(reading(run, other))}$"


def of_ego(**estimates: Any) -> Metrics:
    """A change of metrics.json."""
    return {"agents": {"ego": estimates}}


def braking(**shares: float) -> Metrics:
    return {"driving": {"ego": {"mission": {f"{name}_brake_share_attack": share for name, share in shares.items()}}}}


def acting_on_misses(ego: Metrics) -> Metrics:
    clean = ego["picture"] | {"fp_split": NONE, "fn_split": NONE, "id_switches_split": NONE}
    received = clean | {"fn_split": NONE | {"attack": 6.0}}
    mission = clean | {"fn_split": NONE | {"attack": 1.1}, "id_switches_split": NONE | {"attack": 12}}
    return {"picture": clean, "picture_received": received, "mission": mission}


#: Attack, changed files, sentences, and words that must be absent.
ALONE: dict[str, tuple[str, dict[str, Any], list[str], str]] = {
    "an unattacked run": (
        "",
        {},
        ["^The common picture misses 1.18 objects a frame, the ego alone 10.53, the ego with the picture 1.18$"],
        "due to",
    ),
    "an attacked run": (
        "uncoordinated",
        {},
        [
            f"^Two of four roadside sensors compromised: 6.25 false objects a frame in the common picture {DUE}$",
            "adversary_1 and adversary_2 changed messages from t = 1.5 s to 3.9 s; while they did, the picture has "
            "10.00 false objects a frame.",
        ],
        "scored frames",
    ),
    "a failed handler": (
        "uncoordinated",
        {"run": {"nodes": {"adversary_1": {"failures": [FAILURE]}}}},
        [
            "^Handlers of adversary_1 failed in 19 frames: the numbers may be wrong$ Two of four roadside sensors "
            "compromised: 6.25 false objects",
            "adversary_1's handlers failed in 19 frames.",
        ],
        "",
    ),
    "damaged metrics": (
        "uncoordinated",
        {"metrics": '{"agents": '},
        ["^No scores: metrics.json is damaged$ adversary_1 and adversary_2 changed messages from t = 1.5 s to 3.9 s.$"],
        "",
    ),
    "metrics of the user alone": (
        "uncoordinated",
        {"metrics": '{"mine": 3}'},
        ["^No scores: metrics.json holds none of the common picture$"],
        "",
    ),
    "no metrics": (
        "uncoordinated",
        {"metrics": ...},
        ["^No scores: this run did not get as far as its evaluation$"],
        "",
    ),
    "silent and lying adversaries": (
        "uncoordinated",
        {
            "metrics": {
                "interposers": {"adversary_1": {"agreement": "silent"}, "adversary_2": {"agreement": "disagrees"}}
            }
        },
        [
            "adversary_1 changed messages and reported nothing.",
            "What adversary_2 reported does not match what was measured.",
        ],
        "",
    ),
    "braking because of attacks": (
        "uncoordinated",
        {"metrics": braking(needless=0.125, missed=0.0)},
        ["Because of attacks, the ego with the picture brakes needlessly in 12.5% of the scored frames."],
        "",
    ),
    "no braking because of attacks": ("uncoordinated", {"metrics": braking(needless=0.0, missed=0.0)}, [], "brake"),
    "half of the frames attacked": ("uncoordinated", {"metrics": {"scored_frames": [0, 29]}}, [], "scored frames"),
    "fewer than half of the frames attacked": (
        "uncoordinated",
        {"metrics": {"scored_frames": [0, 28]}},
        ["14 of the 29 scored frames are attacked."],
        "",
    ),
    "changes with a cause each": (
        "uncoordinated",
        {
            "metrics": of_ego(picture={"fn_split": {"fault": 0.5, "attack": 0.0, "natural": 0.7}}),
            "scenario": {"timeline": [{"label": "Partition infra_2", "kind": "fault", "at_s": 0.5, "until_s": 1.0}]},
        },
        [f"{DUE}$", "0.50 missed objects a frame in the common picture are due to Partition infra_2."],
        "",
    ),
    "changes with the same cause": (
        "uncoordinated",
        {"metrics": of_ego(picture={"fn_split": {"fault": 0.0, "attack": 0.5, "natural": 0.7}})},
        [f"{DUE}$", f"0.50 missed objects a frame in the common picture {DUE}."],
        "",
    ),
    "a picture changed in transit": (
        "",
        {"metrics": {"agents": {"ego": lambda ego: ego | {"picture_on_arrival": ego["picture"] | {"rmse_m": 0.9}}}}},
        ["The picture when it arrives has 0.49 m more RMSE than when the command centre sent it."],
        "",
    ),
    "what the ego acts on": (
        "uncoordinated",
        {"metrics": {"agents": {"ego": acting_on_misses}, "same_as": lambda _: {}}},
        [
            f"6.00 missed objects a frame in the picture that the ego receives {DUE}; in what the ego acts on, 1.10 "
            "missed objects a frame and 12 identity switches$"
        ],
        "",
    ),
}


@pytest.mark.parametrize(("attack", "changes", "sentences", "absent"), ALONE.values(), ids=ALONE)
def test_sentences_on_one_run(
    run_of: RunOf, attack: str, changes: dict[str, Any], sentences: list[str], absent: str
) -> None:
    text = text_of(run_of(attack, **changes))
    for sentence in sentences:
        assert sentence in text
    assert not absent or absent not in text


def test_sentences_give_the_numbers_of_the_table(run_of: RunOf) -> None:
    runs = {"baseline": run_of(), "uncoordinated": run_of("uncoordinated")}
    table = score_table({label: run.files.summary for label, run in runs.items()})
    rows = {(row.measure.label, row.run): row for row in table.rows}
    cells = rows["fn", "baseline"].cells
    missed = [number(cells[name].value, rows["fn", "baseline"].measure) for name in ("picture", "local", "mission")]
    assert re.findall(r"\d+\.\d+", headline(runs["baseline"])) == missed
    row = rows["fp", "uncoordinated"]
    more = signed(row.cells["picture"].change, row.measure).removeprefix("+")
    assert f"{more} more false objects" in headline(runs["uncoordinated"], Reference(runs["baseline"], "baseline"))
    assert f"{more} more false objects" in study_headline(runs, table)


def test_an_attack_in_a_single_frame_has_one_time(run_of: RunOf) -> None:
    run = run_of("uncoordinated", metrics={"interposers": {"adversary_2": ...}})
    assert run.files.effects is not None
    only = (run.files.effects["frame"] == 20) & (run.files.effects["interposer"] == "adversary_1")
    run = run.with_(effects={name: column[only] for name, column in run.files.effects.items()})
    assert "adversary_1 changed messages at t = 2.0 s; while it did, the picture has 10.00 false" in text_of(run)
    assert "adversary_1 changed messages in frame 20; while it did" in text_of(run.with_(scene=None))


def test_every_kind_of_change_in_every_estimate_is_reported(run_of: RunOf) -> None:
    attacked, reference = run_of("coordinated"), run_of()
    for key, phrase, more in (
        ("fn", "5.00 fewer missed", -5.0),
        ("fp", "5.00 more false", 5.0),
        ("rmse_m", "0.40 m more RMSE", 0.4),
        ("id_switches", "400 more identity switches", 400),
        ("length_error_m", "1.80 m more error in the lengths of matched objects", 1.8),
        ("width_error_m", "0.90 m less error in the widths of matched objects", -0.9),
        ("heading_error_deg", "60.0\u00b0 more error in the headings of matched objects", 60.0),
        ("velocity_error_mps", "5.00 m/s more error in the velocities of matched objects", 5.0),
    ):
        for estimate in ("local", "picture", "mission"):
            metrics = attacked.files.summary | {"agents": deepcopy(reference.files.summary["agents"])}
            summary = metrics["agents"]["ego"][estimate]
            summary[key] = {"mean": summary[key]["mean"] + more} if "mean" in str(summary[key]) else summary[key] + more
            assert phrase in headline(attacked.with_(summary=metrics), Reference(reference, "unattacked"))


def test_a_change_for_another_agent_is_named_when_the_ego_has_none(run_of: RunOf) -> None:
    reference = run_of(metrics={"agents": lambda agents: agents | {"infra_1": agents["ego"]}})
    agents = deepcopy(reference.files.summary["agents"])
    agents["infra_1"]["mission"]["fp"]["mean"] += 2.0
    text = text_of(run_of("coordinated", metrics={"agents": lambda _: agents}), reference)
    assert "2.00 more false objects a frame for infra_1 with the picture than unattacked" in text


_RECEIVES = (
    "4.00 more false objects a frame in the picture that the ego receives than unattacked, by no measured cause; "
)
IN_TRANSIT: dict[str, tuple[dict[str, float], str]] = {
    "the ego acts on it": (
        {"picture_received": 4.0, "picture_on_arrival": 4.0, "mission": 1.0},
        "1.00 more false objects a frame for the ego with the picture than unattacked, by no measured cause",
    ),
    "the ego acts on little of it": (
        {"picture_received": 4.0, "picture_on_arrival": 4.0, "mission": 0.5},
        f"{_RECEIVES}in what the ego acts on, 0.50 more false objects a frame",
    ),
    "the ego loses identities for it": (
        {"picture_received": 4.0, "picture_on_arrival": 4.0, "mission": 0.5, "switches": 2},
        f"{_RECEIVES}in what the ego acts on, 0.50 more false objects a frame and 2 more identity switches",
    ),
    "the ego acts on nothing of it": (
        {"picture_received": 4.0, "picture_on_arrival": 4.0},
        f"{_RECEIVES}what the ego acts on does not change",
    ),
    "only on the way": (
        {"picture_received": 4.0},
        f"{_RECEIVES}the picture on arrival and what the ego acts on do not change",
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
        assert headline(with_false_objects(added), Reference(with_false_objects({}), "unattacked")) == expected


def test_effects_without_a_change_of_scores_are_named(run_of: RunOf) -> None:
    reference = run_of()
    agents = {"agents": lambda _: reference.files.summary["agents"]}
    assert headline(run_of("uncoordinated", metrics=agents), Reference(reference, "unattacked")).startswith(
        "Interposers changed messages (adversary_1: 125 rows of objects inserted, 25 rows of objects removed"
    )
    passive = {"effects": lambda _: {}, "agreement": "nothing to report"}
    changes = {"interposers": {"adversary_1": passive, "adversary_2": passive}}
    assert "passed every message on unchanged" in headline(run_of("uncoordinated", metrics=agents | changes))
    assert "were not measured" in headline(run_of("uncoordinated", metrics=agents | {"interposers": ...}))
    silent = run_of("uncoordinated", metrics=changes)  # its errors differ, as with another defence
    assert headline(silent, Reference(reference, "unattacked")).startswith(
        "Adversaries on two of four roadside sensors passed every message on unchanged: 6.25 more false objects a frame"
    )
    one = run_of("uncoordinated", metrics={"interposers": {"adversary_1": passive}})
    assert headline(one).startswith("One of four roadside sensors compromised: ")


def test_difference_in_driving_alone_is_reported(run_of: RunOf) -> None:
    def with_braking(attack: str, share: float) -> Run:
        mission = {"needless_brake_share": share, "needless_brake_share_attack": share}
        agents = run_of().files.summary["agents"]
        return run_of(attack, metrics={"agents": lambda _: agents, "driving": {"ego": {"mission": mission}}})

    reference = with_braking("", 0.0)
    assert headline(with_braking("uncoordinated", 0.125), Reference(reference, "unattacked")).endswith(
        "but only driving differs from unattacked (because of attacks, the ego with the picture brakes "
        "needlessly in 12.5% of the scored frames)"
    )
    assert headline(reference, Reference(reference, "itself")).startswith("Every score equals that of itself")


def test_a_reference_that_ended_badly_is_named_first(run_of: RunOf) -> None:
    run, reference = run_of("uncoordinated"), run_of()
    for state, ended in (
        ("handler_failures", "failed"),
        ("failed", "failed"),
        ("running", "has not ended"),
        ("killed", "was cut off"),
    ):
        reference.files.record["status"] = state
        start = f"^Compared with unattacked, which {ended}: Two of four roadside sensors compromised: 6.2"
        assert text_of(run, reference).startswith(start)


def test_false_objects_during_the_attack_are_those_of_its_scored_frames(run_of: RunOf) -> None:
    base, run = run_of(), run_of("uncoordinated", metrics={"scored_frames": [0, 29]})
    assert while_attacked(run, "fp") == pytest.approx(10.0)
    assert while_attacked(run, "fn", base) == pytest.approx(0.0)
    assert while_attacked(base, "fp") is None
    assert run.files.counts is not None
    run.files.counts["fp"] = np.where(run.files.counts["frame"] >= 30, 1000, run.files.counts["fp"])
    assert while_attacked(run, "fp") == pytest.approx(10.0)
    assert "; while they did, the picture has 10.00 false objects a frame." in text_of(run)


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
    assert "0.50 more missed objects a frame in the common picture than" in text_of(
        with_changes(attacked, fp=-0.55, fn=0.5, attack=0.5), clean
    )
    assert "2.00 fewer false objects a frame in the common picture than" in headline(
        with_changes(attacked, fp=-2.0, fn=0.5, attack=0.5), Reference(clean, "unattacked")
    )


def test_the_score_during_an_attack_that_hides_objects_is_of_missed_ones(run_of: RunOf) -> None:
    hides = {"adversary_1": {"effects": lambda _: {"removed": 25}}, "adversary_2": {"effects": lambda _: {}}}
    unattacked = run_of().files.summary["agents"]
    attacked = run_of("uncoordinated", metrics={"interposers": hides, "agents": lambda _: unattacked})
    better = with_changes(attacked, fp=-0.5)
    missed = while_attacked(better, "fn")
    assert f"while it did, the picture has {missed:.2f} missed objects a frame." in text_of(better, run_of())


def test_an_attack_that_stays_out_of_the_picture_is_headed_by_the_picture(run_of: RunOf) -> None:
    clean = run_of(metrics={"agents": lambda agents: agents | {"infra_1": {"received": agents["ego"]["local"]}}})
    agents = {"agents": lambda _: clean.files.summary["agents"]}
    attacked = run_of("uncoordinated", metrics=agents, scenario=judged_by("FaultOrLie"))
    flooded = with_changes(attacked, "received", agent="infra_1", fp=20.0, attack=20.0)
    where = "false objects a frame in infra_1's tracks as they are received"
    assert headline(flooded) == (
        "Two of four roadside sensors compromised: after FaultOrLie, no error in the common picture is due to attacks; "
        f"20.00 {where} are due to adversary_1"
    )
    assert f"compromised: the common picture scores as in unattacked; 20.00 more {where} than unattacked" in headline(
        flooded, Reference(clean, "unattacked")
    )


def test_a_study_names_the_strongest_attack_and_every_run(run_of: RunOf) -> None:
    runs = {attack or "baseline": run_of(attack) for attack in ("", "uncoordinated", "coordinated")}
    table = score_table({label: run.files.summary for label, run in runs.items()})
    assert "(uncoordinated): 6.25 more false objects a frame in the common picture than baseline" in study_headline(
        runs, table
    )
    text = " ".join(study_reading(runs, table))
    assert "In run coordinated (two of four roadside sensors compromised), 2.50 more false" in text
    assert "(+4.00 while the attack lasts), due to adversary_1 and adversary_2" in text


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
    assert "than unattacked, due to adversary_1 and adversary_2$" in text_of(*runs)


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
        text = text_of(*runs, "other")
        assert f"than other; not attributed: the runs also differ in {name}" in text
        assert "due to" not in text


def test_causes_are_named_of_an_increase_that_adversaries_of_one_run_alone_can_reach(run_of: RunOf) -> None:
    attacked, clean = pair(run_of)
    weaker = run_of("coordinated", scenario=centre(2.0), metrics=of_ego(picture={"fp": {"mean": 0.0}}))
    edit(weaker.path, scenario={"nodes": {"adversary_1": {"role": "adversary", "config": {"metres": 1.5}}}})
    assert "not attributed: the runs differ in adversary_1.metres" in text_of(attacked, Run(weaker.path))
    more_false = of_ego(picture={"fp": {"mean": 30.0}})
    attacked, clean = pair(run_of, None, {"metrics": more_false})
    assert "not attributed: the runs differ in adversary_1, adversary_2 and coordinator" in text_of(clean, attacked)
    assert "due to" not in text_of(clean, attacked)
    assert "fewer false objects a frame in the common picture than unattacked$" in text_of(attacked, clean)
    attacked, clean = pair(run_of, {"metrics": of_ego(local={"fn": {"mean": 30.0}})})
    assert "more missed objects a frame in what the ego sees alone than unattacked, by no measured cause$" in text_of(
        attacked, clean
    )
    assert [reaches(attacked, "adversary_1", name) for name in ("local", "picture", "mission")] == [False, True, True]
    dropped = {"interposers": {"adversary_1": {"effects": lambda _: {"dropped": 8}}, "adversary_2": ...}}
    missed = of_ego(picture={"fn": {"mean": 30.0}, "fn_split": {"fault": 0.0, "attack": 0.0}})
    assert "more missed objects a frame in the common picture than unattacked, due to adversary_1$" in text_of(
        *pair(run_of, {"metrics": missed | dropped})
    )
    local = {"agents": {"ego": {"local": {"fn": {"mean": 30.0}}}}}
    expected = "^19.48 more missed objects a frame in what the ego sees alone than unattacked, by no measured cause$"
    assert expected in text_of(run_of(metrics=local), run_of())


LOST = {"churn": [{"frame": 40, "node": "infra_2", "what": "lost"}]}


@pytest.mark.parametrize("mode", ["realtime", "lockstep"])
def test_a_run_whose_node_died_says_so_first_and_names_it_as_the_cause(run_of: RunOf, mode: str) -> None:
    missed = of_ego(picture={"fn_split": {"fault": 0.5, "attack": 0.0, "natural": 0.7}})
    text = text_of(run_of(metrics=missed, run=LOST | {"mode": mode, "status": "ok"}))
    assert text.startswith("^infra_2 was lost before frame 40")
    assert text.count("infra_2 was lost") == 1
    assert "due to the loss of infra_2" in text


def test_a_run_that_failed_says_why(run_of: RunOf) -> None:
    run = run_of(run={"status": "failed", "message": "infra_1 ended with exit code 1\nsee its log"})
    assert headline(run) == "The run did not end well (failed): infra_1 ended with exit code 1"


def test_a_run_without_adversaries_says_so_and_names_its_faults(run_of: RunOf) -> None:
    faults = [{"label": f"loss {n}", "kind": "fault", "at_s": float(n), "until_s": None} for n in range(5)]
    # wiring.json names adversaries, in every run of these tests
    run = run_of(wiring=..., metrics={"interposers": ...}, scenario={"timeline": faults})
    assert attack_description(run) == [
        "No adversary took part in this run.",
        "The scenario also has faults: loss 0 from t = 0 s, loss 1 from t = 1 s, loss 2 from t = 2 s and 2 more.",
    ]


def test_every_kind_of_effect_is_described(run_of: RunOf) -> None:
    for effects, words in (
        ({"dropped": 3, "delayed": 1}, "delayed 1 message and dropped 3 messages"),
        ({"forged": 2}, "forged 2 messages"),
        ({"reframed": 2}, "changed the frame of reference of 2 messages"),
        ({"slandered": 2}, "changed the trust in agents that is told in 2 messages"),
        ({"moved": 7}, "moved objects (7 rows)"),
        ({"sung": 2}, "sung 2 messages"),
    ):
        run = run_of("uncoordinated")
        run.files.summary["interposers"]["adversary_1"]["effects"] = effects
        assert words in attack_description(run)[0]


def test_a_forged_view_is_described_as_what_the_agent_says_it_sees(run_of: RunOf) -> None:
    run = run_of("uncoordinated")
    run.files.summary["interposers"]["adversary_1"]["effects"] = {"reframed": 27}
    table = run.files.effects
    assert table is not None
    views = (table["interposer"] == "adversary_1") & (table["effect"] == "removed")
    table["message"] = np.where(views, "view", table["message"]).astype(object)
    table["wire"] = np.where(views, "agent/infra_1/view", table["wire"]).astype(object)
    table["effect"] = np.where(views, "reframed", table["effect"]).astype(object)
    words = "adversary_1 changed the frame of reference of 2 messages and changed what infra_1 says it sees in 25 views"
    assert words in attack_description(run)[0]
    (adversary,) = (each for each in interposers(run) if each.name == "adversary_1")
    assert effects_in_words(adversary) == "2 messages changed outside their objects, 25 views changed"
    assert adversary.other == "2 reframed, 25 views changed"
    assert "adversary_1 changes what infra_1 says it sees" in [event.text for event in first_changes(run)]


def test_idle_unmeasured_and_live_adversaries_are_distinguished(run_of: RunOf) -> None:
    idle = {"adversary_1": {"effects": lambda _: {}}, "adversary_2": {"effects": ...}}
    assert attack_description(run_of("uncoordinated", metrics={"interposers": idle})) == [
        "adversary_1 changed nothing.",
        "What adversary_2 did was not measured.",
    ]
    events = [
        {"action": "intercept", "node": "adversary_1", "frame": 15, "wires": ["agent/infra_1/detections"]},
        {"action": "release", "node": "adversary_1", "frame": 30, "wires": []},
    ]
    live = attack_description(run_of("coordinated", run={"interceptions": events}))[0]
    assert live.endswith("after it was inserted live in frame 15, and removed in frame 30.")


def test_a_coordinator_is_named_and_many_adversaries_are_summed_up(run_of: RunOf) -> None:
    def more(known: Metrics) -> Metrics:
        return known | {f"adversary_{number}": known["adversary_1"] for number in range(3, 9)}

    boss = {"nodes": {"boss": {"role": "coordinator"}}}
    sentences = attack_description(run_of("uncoordinated", metrics={"interposers": more}, scenario=boss, run=boss))
    assert sentences[3] == "Five other adversaries did the same kind of thing: see the table of interposers."
    assert sentences[4] == "boss directed the adversaries."

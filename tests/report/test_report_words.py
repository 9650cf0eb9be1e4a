"""Sentences of the report agree with the numbers."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mast_zenoh.report.comparison import Reference
from mast_zenoh.report.narrative.changes import join_names
from mast_zenoh.report.narrative.run import (
    compromised,
    headline,
    reading,
    study_headline,
    study_reading,
    while_attacked,
)
from mast_zenoh.report.tables.scores import number, score_table, signed
from mast_zenoh.viewer.run import RunRecord


def edit(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


def test_headline_of_an_unattacked_run_gives_missed_objects(run_folder: Callable[..., Path]) -> None:
    run = RunRecord.load(run_folder())
    expected = "The common picture misses 1.18 objects a frame, the ego alone 10.53, the ego with the picture 1.18"
    assert headline(run) == expected


def test_headline_of_an_attacked_run_names_largest_change_and_adversary(run_folder: Callable[..., Path]) -> None:
    run = RunRecord.load(run_folder("uncoordinated"))
    assert compromised(run) == "two of four roadside sensors"
    assert headline(run) == (
        "Two of four roadside sensors compromised: 6.25 false objects a frame in the common picture are due to "
        "adversary_1 and adversary_2"
    )
    text = " ".join(reading(run))
    assert (
        "adversary_1 and adversary_2 changed messages from t = 1.5 s to 3.9 s; while they did, the picture has" in text
    )
    assert "the picture has 10.00 false objects a frame." in text


def test_sentences_give_the_numbers_of_the_table(run_folder: Callable[..., Path]) -> None:
    runs = {"baseline": RunRecord.load(run_folder()), "uncoordinated": RunRecord.load(run_folder("uncoordinated"))}
    table = score_table({label: run.metrics for label, run in runs.items()})
    rows = {(row.measure.label, row.run): row for row in table.rows}
    cells = rows["fn", "baseline"].cells
    missed = [number(cells[name].value, rows["fn", "baseline"].measure) for name in ("picture", "local", "mission")]
    assert re.findall(r"\d+\.\d+", headline(runs["baseline"])) == missed
    row = rows["fp", "uncoordinated"]
    more = signed(row.cells["picture"].change, row.measure)
    reference = Reference(runs["baseline"], "baseline")
    assert f"{more.removeprefix('+')} more false objects" in headline(runs["uncoordinated"], reference)
    assert f"{more.removeprefix('+')} more false objects" in study_headline(runs, table)


def test_an_attack_in_a_single_frame_has_one_time(run_folder: Callable[..., Path]) -> None:
    run = RunRecord.load(run_folder("uncoordinated"))
    assert run.effects is not None
    only = (run.effects["frame"] == 20) & (run.effects["interposer"] == "adversary_1")
    object.__setattr__(run, "effects", {name: column[only] for name, column in run.effects.items()})
    del run.metrics["interposers"]["adversary_2"]
    text = " ".join(reading(run))
    assert "adversary_1 changed messages at t = 2.0 s; while it did, the picture has 10.00 false objects" in text
    object.__setattr__(run, "recording", None)
    assert "adversary_1 changed messages in frame 20; while it did" in " ".join(reading(run))


def test_a_comparison_headline_names_the_difference(run_folder: Callable[..., Path]) -> None:
    run, reference = RunRecord.load(run_folder("uncoordinated")), RunRecord.load(run_folder())
    assert "6.25 more false objects a frame in the common picture than unattacked, due to adversary_1 and" in headline(
        run, Reference(reference, "unattacked")
    )
    assert headline(reference, Reference(reference, "unattacked")).startswith("Every score equals that of unattacked")


SCORES = {
    "fn": ("5.00 fewer missed", {"mean": -5.0}),
    "fp": ("5.00 more false", {"mean": 5.0}),
    "rmse_m": ("0.40 m more RMSE", 0.4),
    "id_switches": ("400 more identity switches", 400),
}


@pytest.mark.parametrize("estimate", ["local", "picture", "mission"])
@pytest.mark.parametrize("key", sorted(SCORES))
def test_every_kind_of_change_in_every_estimate_is_reported(
    run_folder: Callable[..., Path], key: str, estimate: str
) -> None:
    folder, reference = run_folder("coordinated"), RunRecord.load(run_folder())
    phrase, more = SCORES[key]

    def change(metrics: dict[str, Any]) -> None:
        metrics["agents"]["ego"] = json.loads(json.dumps(reference.metrics["agents"]["ego"]))
        value = metrics["agents"]["ego"][estimate][key]
        metrics["agents"]["ego"][estimate][key] = (
            {"mean": value["mean"] + more["mean"], "std": 0.0} if isinstance(more, dict) else value + more
        )

    edit(folder / "metrics.json", change)
    assert phrase in headline(RunRecord.load(folder), Reference(reference, "unattacked"))


def test_a_change_for_another_agent_is_named_when_the_ego_has_none(run_folder: Callable[..., Path]) -> None:
    folder, reference = run_folder("coordinated"), run_folder()

    def change(more: float) -> Callable[[dict[str, Any]], None]:
        def apply(metrics: dict[str, Any]) -> None:
            ego = json.loads((reference / "metrics.json").read_text())["agents"]["ego"]
            other = json.loads(json.dumps(ego))
            other["mission"]["fp"]["mean"] += more
            metrics["agents"] = {"ego": ego, "infra_1": other}

        return apply

    edit(folder / "metrics.json", change(2.0))
    edit(reference / "metrics.json", change(0.0))
    text = headline(RunRecord.load(folder), Reference(RunRecord.load(reference), "unattacked"))
    assert "2.00 more false objects a frame for infra_1 with the picture than unattacked" in text


IN_TRANSIT: dict[str, tuple[dict[str, float], str]] = {
    "the ego acts on it": (
        {"picture_received": 4.0, "picture_on_arrival": 4.0, "mission": 1.0},
        "1.00 more false objects a frame for the ego with the picture than unattacked, by no measured cause",
    ),
    "the ego acts on little of it": (
        {"picture_received": 4.0, "picture_on_arrival": 4.0, "mission": 0.5},
        "4.00 more false objects a frame in the picture that the ego receives than unattacked, by no measured cause; "
        "in what the ego acts on, 0.50 more false objects a frame",
    ),
    "the ego loses identities for it": (
        {"picture_received": 4.0, "picture_on_arrival": 4.0, "mission": 0.5, "switches": 2},
        "4.00 more false objects a frame in the picture that the ego receives than unattacked, by no measured cause; "
        "in what the ego acts on, 0.50 more false objects a frame and 2 more identity switches",
    ),
    "the ego acts on nothing of it": (
        {"picture_received": 4.0, "picture_on_arrival": 4.0},
        "4.00 more false objects a frame in the picture that the ego receives than unattacked, by no measured cause; "
        "what the ego acts on does not change",
    ),
    "only on the way": (
        {"picture_received": 4.0},
        "4.00 more false objects a frame in the picture that the ego receives than unattacked, by no measured cause; "
        "the picture on arrival and what the ego acts on do not change",
    ),
}


@pytest.mark.parametrize(("more", "expected"), IN_TRANSIT.values(), ids=IN_TRANSIT)
def test_change_of_the_picture_in_transit_reports_what_the_ego_acts_on(
    run_folder: Callable[..., Path], more: dict[str, float], expected: str
) -> None:
    folder = run_folder()
    reference = folder.with_name("reference")
    shutil.copytree(folder, reference)

    def change(added: dict[str, float]) -> Callable[[dict[str, Any]], None]:
        def apply(metrics: dict[str, Any]) -> None:
            picture = metrics["agents"]["ego"]["picture"] | {"fp": {"mean": 0.0, "std": 0.0}}
            names = ("picture", "picture_received", "picture_on_arrival", "mission")
            estimates = {name: picture | {"fp": {"mean": added.get(name, 0.0), "std": 0.0}} for name in names}
            estimates["mission"]["id_switches"] = 1 + added.get("switches", 0)
            metrics["agents"] = {"ego": json.loads(json.dumps(estimates))}
            metrics["same_as"] = {}

        return apply

    edit(folder / "metrics.json", change(more))
    edit(reference / "metrics.json", change({}))
    text = headline(RunRecord.load(folder), Reference(RunRecord.load(reference), "unattacked"))
    assert text == expected


def test_effects_without_a_change_of_scores_are_named(run_folder: Callable[..., Path]) -> None:
    folder, reference = run_folder("uncoordinated"), RunRecord.load(run_folder())
    edit(folder / "metrics.json", lambda metrics: metrics.update(agents=reference.metrics["agents"]))
    text = headline(RunRecord.load(folder), Reference(reference, "unattacked"))
    assert text.startswith(
        "Interposers changed messages (adversary_1: 125 rows of objects inserted, 25 rows of objects removed"
    )
    assert "nothing" not in text


def test_difference_in_driving_alone_is_reported(run_folder: Callable[..., Path]) -> None:
    folder, other = run_folder("uncoordinated"), run_folder()
    agents = RunRecord.load(other).metrics["agents"]

    def braking(share: float) -> Callable[[dict[str, Any]], None]:
        mission = {"needless_brake_share": share, "needless_brake_share_attack": share}
        return lambda metrics: metrics.update(agents=agents, driving={"ego": {"mission": mission}})

    edit(folder / "metrics.json", braking(0.125))
    edit(other / "metrics.json", braking(0.0))
    run, reference = RunRecord.load(folder), Reference(RunRecord.load(other), "unattacked")
    assert headline(run, reference).endswith(
        "but only driving differs from unattacked (because of attacks, the ego with the picture brakes "
        "needlessly in 12.5% of the scored frames)"
    )
    same = Reference(reference.run, "itself")
    assert headline(reference.run, same).startswith("Every score equals that of itself")


def test_headline_of_a_failed_run_begins_with_the_failure(run_folder: Callable[..., Path]) -> None:
    folder = run_folder("uncoordinated")
    failure = {"handler": "on_detections", "count": 19, "frames": 19, "first_frame": 11, "last_frame": 29}
    failure |= {"exception": "ValueError: no", "where": "mine.py:3"}
    edit(folder / "run.json", lambda run: run["nodes"]["adversary_1"].update(failures=[failure]))
    run = RunRecord.load(folder)
    assert headline(run) == "Handlers of adversary_1 failed in 19 frames: the numbers may be wrong"
    assert "6.25 false objects" in reading(run)[0]
    assert "adversary_1's handlers failed in 19 frames." in reading(run)


@pytest.mark.parametrize(
    ("state", "ended"),
    [("handler_failures", "failed"), ("failed", "failed"), ("running", "has not ended"), ("killed", "was cut off")],
)
def test_a_reference_that_ended_badly_is_named_first(run_folder: Callable[..., Path], state: str, ended: str) -> None:
    run, other = RunRecord.load(run_folder("uncoordinated")), run_folder()
    edit(other / "run.json", lambda record: record.update(status=state))
    text = headline(run, Reference(RunRecord.load(other), "unattacked"))
    assert text.startswith(f"Compared with unattacked, which {ended}: Two of four roadside sensors compromised: 6.2")


def test_damaged_and_absent_metrics_are_distinguished(run_folder: Callable[..., Path]) -> None:
    folder = run_folder("uncoordinated")
    (folder / "metrics.json").write_text('{"agents": ')
    run = RunRecord.load(folder)
    assert headline(run) == "No scores: metrics.json is damaged"
    assert reading(run) == ["adversary_1 and adversary_2 changed messages from t = 1.5 s to 3.9 s."]
    (folder / "metrics.json").write_text('{"mine": 3}')
    assert headline(RunRecord.load(folder)) == "No scores: metrics.json holds none of the common picture"
    (folder / "metrics.json").unlink()
    assert headline(RunRecord.load(folder)) == "No scores: this run did not get as far as its evaluation"


def test_passive_and_unmeasured_adversaries_are_distinguished(
    run_folder: Callable[..., Path],
) -> None:
    folder, reference = run_folder("uncoordinated"), RunRecord.load(run_folder())

    def change(metrics: dict[str, Any]) -> None:
        metrics["agents"] = reference.metrics["agents"]
        for each in metrics["interposers"].values():
            each |= {"effects": {}, "agreement": "nothing to report"}

    edit(folder / "metrics.json", change)
    assert "passed every message on unchanged" in headline(RunRecord.load(folder))
    edit(folder / "metrics.json", lambda metrics: metrics.pop("interposers"))
    assert "were not measured" in headline(RunRecord.load(folder))


def test_silent_and_lying_adversaries_are_named(run_folder: Callable[..., Path]) -> None:
    folder = run_folder("uncoordinated")

    def change(metrics: dict[str, Any]) -> None:
        metrics["interposers"]["adversary_1"]["agreement"] = "silent"
        metrics["interposers"]["adversary_2"]["agreement"] = "disagrees"

    edit(folder / "metrics.json", change)
    sentences = reading(RunRecord.load(folder))
    assert "adversary_1 changed messages and reported nothing." in sentences
    assert "What adversary_2 reported does not match what was measured." in sentences


def test_false_objects_during_the_attack_are_also_counted(run_folder: Callable[..., Path]) -> None:
    base, run = RunRecord.load(run_folder()), RunRecord.load(run_folder("uncoordinated"))
    assert while_attacked(run, "fp") == pytest.approx(10.0)
    assert while_attacked(run, "fn", base) == pytest.approx(0.0)
    assert while_attacked(base, "fp") is None


def test_only_scored_frames_count_during_the_attack(run_folder: Callable[..., Path]) -> None:
    folder = run_folder("uncoordinated")
    edit(folder / "metrics.json", lambda metrics: metrics.update(scored_frames=[0, 29]))
    run = RunRecord.load(folder)
    assert run.counts is not None
    run.counts["fp"] = np.where(run.counts["frame"] >= 30, 1000, run.counts["fp"])
    assert while_attacked(run, "fp") == pytest.approx(10.0)
    assert "; while they did, the picture has 10.00 false objects a frame." in " ".join(reading(run))


def test_the_attack_is_described_by_the_kind_of_change_that_the_headline_names(
    run_folder: Callable[..., Path],
) -> None:
    folder, reference = run_folder("uncoordinated"), run_folder()
    edit(folder / "metrics.json", lambda metrics: metrics["agents"]["ego"]["picture"]["fn"].update(mean=50.0))
    run, other = RunRecord.load(folder), Reference(RunRecord.load(reference), "unattacked")
    missed = while_attacked(run, "fn")
    assert f"; while they did, the picture has {missed:.2f} missed objects a frame." in " ".join(reading(run, other))


@pytest.mark.parametrize(("last", "counted"), [(39, ""), (29, ""), (28, "14 of the 29 scored frames are attacked.")])
def test_attacked_frames_are_counted_if_fewer_than_half(
    run_folder: Callable[..., Path], last: int, counted: str
) -> None:
    folder = run_folder("uncoordinated")
    edit(folder / "metrics.json", lambda metrics: metrics.update(scored_frames=[0, last]))
    sentences = [each for each in reading(RunRecord.load(folder)) if "scored frames" in each]
    assert sentences == [counted] * bool(counted)


def test_braking_caused_by_attacks_is_mentioned(run_folder: Callable[..., Path]) -> None:
    run = RunRecord.load(run_folder("uncoordinated"))
    mission = {"needless_brake_share_attack": 0.125, "missed_brake_share_attack": 0.0}
    run.metrics["driving"] = {"ego": {"mission": mission}}
    sentence = "Because of attacks, the ego with the picture brakes needlessly in 12.5% of the scored frames."
    assert sentence in reading(run)
    mission["needless_brake_share_attack"] = 0.0
    assert not any("brake" in sentence for sentence in reading(run))


def test_a_study_names_the_strongest_attack_and_every_run(three_runs: dict[str, Path]) -> None:
    runs = {label: RunRecord.load(path) for label, path in three_runs.items()}
    table = score_table({label: run.metrics for label, run in runs.items()})
    assert "(uncoordinated): 6.25 more false objects a frame in the common picture than baseline" in study_headline(
        runs, table
    )
    text = " ".join(study_reading(runs, table))
    assert "In run coordinated (two of four roadside sensors compromised), 2.50 more false" in text
    assert "(+4.00 while the attack lasts), due to adversary_1 and adversary_2" in text


def test_names_are_joined_with_commas_and_and() -> None:
    assert [join_names(names) for names in ([], ["a"], ["a", "b"], ["a", "b", "c"])] == [
        "",
        "a",
        "a and b",
        "a, b and c",
    ]


def test_every_kind_of_change_is_named_with_its_own_cause(run_folder: Callable[..., Path]) -> None:
    folder = run_folder("uncoordinated")

    def change(metrics: dict[str, Any]) -> None:
        picture = metrics["agents"]["ego"]["picture"]
        picture["fn_split"] = {"fault": 0.5, "attack": 0.0, "natural": 0.7}

    edit(folder / "metrics.json", change)
    partition = {"label": "Partition infra_2", "kind": "fault", "at_s": 0.5, "until_s": 1.0}
    edit(folder / "scenario.json", lambda scenario: scenario.update(timeline=[partition]))
    run = RunRecord.load(folder)
    assert headline(run).endswith("are due to adversary_1 and adversary_2")
    assert "0.50 missed objects a frame in the common picture are due to Partition infra_2." in reading(run)


def test_the_causes_of_other_changes_are_named_again(run_folder: Callable[..., Path]) -> None:
    folder = run_folder("uncoordinated")
    split = {"fault": 0.0, "attack": 0.5, "natural": 0.7}
    edit(folder / "metrics.json", lambda metrics: metrics["agents"]["ego"]["picture"].update(fn_split=split))
    sentence = "0.50 missed objects a frame in the common picture are due to adversary_1 and adversary_2."
    assert sentence in reading(RunRecord.load(folder))


def test_changes_of_the_picture_in_transit_are_reported(run_folder: Callable[..., Path]) -> None:
    folder = run_folder()

    def change(metrics: dict[str, Any]) -> None:
        ego = metrics["agents"]["ego"]
        ego["picture_on_arrival"] = ego["picture"] | {"rmse_m": 0.9}

    edit(folder / "metrics.json", change)
    sentence = "The picture when it arrives has 0.49 m more RMSE than when the command centre sent it."
    assert sentence in reading(RunRecord.load(folder))


def test_difference_without_measured_cause_is_reported(run_folder: Callable[..., Path]) -> None:
    folder = run_folder()
    reference = RunRecord.load(folder)
    edit(folder / "metrics.json", lambda metrics: metrics["agents"]["ego"]["local"]["fn"].update(mean=30.0))
    text = headline(RunRecord.load(folder), Reference(reference, "the other"))
    assert text == "19.48 more missed objects a frame in what the ego sees alone than the other, by no measured cause"


def test_headline_without_reference_reports_attacks_on_what_the_ego_acts_on(
    run_folder: Callable[..., Path],
) -> None:
    folder = run_folder("uncoordinated")

    def change(metrics: dict[str, Any]) -> None:
        picture = metrics["agents"]["ego"]["picture"]
        none = {"fault": 0.0, "attack": 0.0, "natural": 0.0}
        clean = picture | {"fp_split": none, "fn_split": none, "id_switches_split": none}
        received = clean | {"fn_split": none | {"attack": 6.0}}
        mission = clean | {"fn_split": none | {"attack": 1.1}, "id_switches_split": none | {"attack": 12}}
        metrics["agents"]["ego"] = {"picture": clean, "picture_received": received, "mission": mission}
        metrics["same_as"] = {}

    edit(folder / "metrics.json", change)
    assert headline(RunRecord.load(folder)).endswith(
        "6.00 missed objects a frame in the picture that the ego receives are due to adversary_1 and adversary_2; "
        "in what the ego acts on, 1.10 missed objects a frame and 12 identity switches"
    )

"""What attacks do to a driven car, and what defences spare it, from pairs of the same scene and seed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from defence_outcomes import outcome

import mast_zenoh as mast
from mast_zenoh.api.comparisons import as_text
from mast_zenoh.config.scene_names import parse_scene
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.integrity.calibration import refuse_calibration_data
from mast_zenoh.metrics.driving_results import DRIVING_MEASURES, DrivingTable
from mast_zenoh.report.figures.driving_study import figure_of_driving
from mast_zenoh.report.tables.driving_study import conclusion, driving_tables, headline
from mast_zenoh.study import definition
from mast_zenoh.study.defences import DrivingCell
from mast_zenoh.study.defences.driving_matrix import Collection

SEEDS = 6


def trial(cell: DrivingCell, seed: int, collisions: int, needless: int, way_m: float) -> Any:
    """A trial; on odd seeds the car drives 10 m further, and brakes needlessly once more, with or without an attack."""
    odd = seed % 2
    driven = {
        "collisions": [{"object": number} for number in range(collisions)],
        "needless_brakes": needless + odd,
        "missed_brakes": 0,
        "hard_brakes": 0,
        "progress_m": way_m + 10.0 * odd,
    }
    return outcome(cell.label, "junction", seed, {"driven": {"ego": driven}, "defence": {}})


def table_of(happened: dict[tuple[str, str], tuple[int, int, float]], left_out: int = 0) -> DrivingTable:
    """The table of (attack, defence) with (collisions, needless brakes, way); the last seeds are left out."""
    cells = {key: DrivingCell(key[0], "picture" if key[0] else "", key[1]) for key in happened}
    collection = Collection({cell.label: cell for cell in cells.values()}, ["junction"], range(SEEDS))
    for key, cell in cells.items():
        for seed in range(SEEDS - left_out):
            collisions, needless, way_m = happened[key]
            spread = seed % 3 if key[0] and not key[1] else 0  # so that differences vary from seed to seed
            collection.add(trial(cell, seed, collisions, needless + spread, way_m - spread))
    return collection.table()


HAPPENED = {
    ("", ""): (0, 0, 100.0),
    ("", "veto"): (0, 0, 90.0),
    ("queue", ""): (0, 3, 40.0),
    ("queue", "veto"): (0, 0, 88.0),
    ("hidden", ""): (1, 0, 110.0),
    ("hidden", "veto"): (1, 0, 100.0),
}


def test_an_attack_is_compared_with_its_twin_and_a_defence_with_none() -> None:
    rows = {(row.attack, row.defence): row for row in table_of(HAPPENED).rows}
    assert rows["", ""].measures["progress_m"].value == 105.0
    assert rows["queue", ""].added["progress_m"].value == -61.0
    assert rows["queue", "veto"].added["progress_m"].value == -2.0, "the twin has the same defence"
    assert rows["queue", "veto"].spared["progress_m"].value == 49.0, "the same seeds and attack without a defence"
    assert rows["", "veto"].spared["progress_m"].value == -10.0
    added = rows["queue", ""].added["needless_brakes"]
    assert 3.0 < added.low < added.value == 4.0 < added.high < 5.0
    assert rows["hidden", ""].added["collisions"].value == 1.0
    assert rows["", ""].added == {}
    assert rows["queue", ""].spared == {}


def test_the_conclusion_says_what_helps_what_does_not_and_what_was_not_run() -> None:
    text = conclusion(table_of(HAPPENED))
    assert "Without a defence, queue on picture adds 4.00 [" in text
    assert "veto helps against queue on picture (" in text
    assert "Without a defence, hidden on picture adds 1.00 (all equal) collisions, " in text
    assert "Not run" not in text
    assert "Not run: no attack, none; no attack, veto; " in conclusion(table_of(HAPPENED, left_out=SEEDS))


def test_harm_in_too_few_trials_is_neither_shown_nor_denied() -> None:
    text = conclusion(table_of(HAPPENED, left_out=SEEDS - 2))
    assert (
        "Without a defence, hidden on picture adds 1.00 collisions, 0.50 needless brakes: too few trials to tell."
        in text
    )
    assert "Too few trials to tell what veto changes for queue on picture; hidden on picture." in text
    assert "no harm" not in text


def test_an_attack_that_changes_nothing_does_no_harm_and_its_defence_no_good() -> None:
    cells = [(attack, defence) for defence in ("", "veto") for attack in ("", "idle")]
    text = conclusion(table_of(dict.fromkeys(cells, (0, 0, 100.0)), left_out=SEEDS - 1))
    assert "veto changes nothing for idle on picture." in text
    better = conclusion(table_of({("", ""): (1, 4, 50.0), ("better", ""): (0, 0, 100.0)}))
    assert "Without a defence, better on picture does no harm." in better


def test_the_headline_names_collisions_then_needless_brakes_then_the_way() -> None:
    no_attack = {("", ""): (0, 0, 100.0)}
    assert headline(table_of(HAPPENED)) == ("The attack hidden on picture adds 1.00 (all equal) collisions a trial")
    queue = headline(table_of({**no_attack, ("queue", ""): (0, 3, 40.0)}))
    assert queue.startswith("The attack queue on picture adds 4.00 [")
    assert queue.endswith("] needless brakes a trial")
    slow = headline(table_of({**no_attack, ("", "veto"): (0, 0, 100.0), ("slow", "veto"): (0, 0, 40.0)}))
    assert slow == "The attack slow on picture, with veto, changes the way driven by \u221260.00 (all equal) m a trial"
    few = headline(table_of(HAPPENED, left_out=SEEDS - 2))
    assert few == "The attack hidden on picture adds 1.00 collisions a trial: too few trials to tell"
    good = {**no_attack, ("", "veto"): (0, 0, 100.0), ("good", "veto"): (0, 0, 120.0)}
    assert headline(table_of(good)) == "No attack adds collisions or needless brakes, or shortens the way"
    assert headline(table_of(no_attack)) == ""


def test_the_terminal_shows_every_measure() -> None:
    (brief,) = driving_tables(table_of(HAPPENED)).brief
    assert [*brief.headings[1:]] == [measure.heading for measure in DRIVING_MEASURES.values()]
    assert max(map(len, as_text(brief.as_rich()).splitlines())) <= 80


def test_trials_that_are_missing_are_counted_and_their_pairs_left_out() -> None:
    rows = table_of(HAPPENED, left_out=1).rows
    assert {(row.trials, row.missing) for row in rows} == {(SEEDS - 1, 1)}


def test_tables_and_a_figure_are_written(tmp_path: Path) -> None:
    for left_out in (0, SEEDS):
        table = table_of(HAPPENED, left_out)
        texts = driving_tables(table).texts("driving")
        assert "| queue | picture | veto | " in texts["driving.md"]
        assert "hidden,picture,none,mean,collisions," in texts["driving.csv"]
        figure_of_driving(table).save(tmp_path)
        assert (tmp_path / "driving.pdf").stat().st_size > 5_000


def test_the_shipped_study_pairs_every_attack_with_every_defence() -> None:
    study = definition.load("driving", ["attacks=cut_in@tracks,hidden_leader@detections+picture", "defences=none,veto"])
    assert [(cell.attack, cell.wire, cell.defence) for cell in study.cells.values()] == [
        (attack, wire, defence)
        for defence in ("", "veto")
        for attack, wire in (("", ""), ("cut_in", "tracks"), ("hidden_leader", "detections picture"))
    ]
    full = definition.load("driving")
    assert len(full.scenes) * (full.trials or 0) == 30, "pairs of each attack and defence"
    for scene in full.scenes:
        refuse_calibration_data([full.seed], parse_scene(scene.label), "the study of driving")


def test_an_attack_without_its_wire_is_named_with_the_nearest() -> None:
    with pytest.raises(ConfigurationError, match=r"attacks: found 'cut_in'.*cut_in@"):
        definition.load("driving", ["attacks=cut_in"])


@pytest.mark.heavy
def test_the_study_finds_that_own_sensors_protect_from_a_phantom_queue(tmp_path: Path) -> None:
    """Three seeds of one junction; the veto needs no defence of the command centre."""
    finished = mast.study(
        "driving",
        out=tmp_path / "study",
        trials=3,
        jobs=1,
        scenes="intersection:6",
        attacks="phantom_queue@picture",
        defences="none,veto",
    )
    text = (finished.path / "driving.csv").read_text()
    lines = [line.split(",") for line in text.splitlines()[1:]]
    values = {(line[0], line[2], line[3], line[4]): float(line[5]) for line in lines}
    assert set(DRIVING_MEASURES) == {measure for _, _, _, measure in values}
    assert values["phantom_queue", "none", "added", "progress_m"] < -20.0
    assert values["phantom_queue", "veto", "spared", "progress_m"] > 20.0
    assert (
        values["phantom_queue", "veto", "mean", "needless_brakes"]
        < values["phantom_queue", "none", "mean", "needless_brakes"]
    )
    assert (finished.path / "driving.png").stat().st_size > 10_000
    assert "<h1>The attack phantom_queue on picture adds " in (finished.path / "report.html").read_text()

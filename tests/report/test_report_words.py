"""The result in words says what the numbers say."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.table import summary_table
from mast_zenoh.report.words import (
    compromised,
    headline,
    listed,
    reading,
    study_headline,
    study_reading,
    while_attacked,
)


def row_of(run: RunFolder):
    return summary_table({"run": run.metrics})[0]


def test_an_unattacked_run_is_summed_up_by_what_it_misses(run_folder: Callable[..., Path]) -> None:
    run = RunFolder.load(run_folder())
    assert headline(run, row_of(run)) == "The common picture misses 1.2 objects a frame, the ego alone 10.5"
    assert "reports no false object." in reading(run, row_of(run))[0]


def test_an_attacked_run_is_summed_up_by_its_false_objects(run_folder: Callable[..., Path]) -> None:
    run = RunFolder.load(run_folder("uncoordinated"))
    assert compromised(run) == "two of four roadside sensors"
    assert headline(run, row_of(run)).startswith("Two of four roadside sensors compromised: 6.2 false objects a frame")
    assert "adversary_1 and adversary_2 changed messages from t = 1.5 s on" in " ".join(reading(run, row_of(run)))


def test_adversaries_that_change_nothing_are_told_apart(run_folder: Callable[..., Path]) -> None:
    folder = run_folder("uncoordinated")
    (folder / "attacks.parquet").unlink()
    run = RunFolder.load(folder)
    assert "changed nothing" in headline(run, row_of(run))


def test_who_is_compromised_is_put_in_words(run_folder: Callable[..., Path]) -> None:
    run = RunFolder.load(run_folder("uncoordinated"))
    every = dict.fromkeys(("ego", "infra_1", "infra_2", "infra_3", "infra_4"), ("adversary_1",))
    object.__setattr__(run, "adversaries", every)
    assert compromised(run) == "all four roadside sensors and the vehicle"
    object.__setattr__(run, "adversaries", {})
    assert compromised(run) == ""


def test_false_objects_are_also_counted_while_the_attack_lasts(run_folder: Callable[..., Path]) -> None:
    base, run = RunFolder.load(run_folder()), RunFolder.load(run_folder("uncoordinated"))
    assert while_attacked(run, "fp") == pytest.approx(10.0)
    assert while_attacked(run, "fn", base) == pytest.approx(0.0)
    assert while_attacked(base, "fp") is None


def test_a_study_names_the_strongest_attack_and_every_run(three_runs: dict[str, Path]) -> None:
    runs = {label: RunFolder.load(path) for label, path in three_runs.items()}
    rows = summary_table({label: run.metrics for label, run in runs.items()})
    assert "6.2 false objects a frame more than unattacked" in study_headline(runs, rows)
    text = " ".join(study_reading(runs, rows))
    assert "In run coordinated (two of four roadside sensors compromised) the picture has 2.5 more false" in text
    assert "(+10.0 while the attack lasts) and as many missed objects" in text


def test_lists_read_like_lists() -> None:
    assert [listed(names) for names in ([], ["a"], ["a", "b"], ["a", "b", "c"])] == ["", "a", "a and b", "a, b and c"]

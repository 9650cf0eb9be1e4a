"""The tables of a matrix of defences show every number with its interval."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import replace

import pytest
from defence_samples import SHARE, matrix, row, summary

from mast_zenoh.metrics.study_results import BINOMIAL, BOOTSTRAP, STUDENT, Statistic
from mast_zenoh.report.compare import as_text
from mast_zenoh.report.tables.text_table import measured, median_delay
from mast_zenoh.study.defences.matrix_tables import DEFENCE_MEASURES, MatrixTable, defence_tables


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (Statistic(4.2, 3.9, 4.6, 48), "4.20 [3.90, 4.60]"),
        (Statistic(4.2, trials=4), "4.20"),
        (Statistic(0.0, trials=9), "0.00 (all equal)"),
        (Statistic(), "\u2013"),
        (Statistic(math.inf, 1.2, math.inf, 48), "not reached [1.20, \u221e)"),
        (Statistic(math.inf, math.inf, math.inf, 48), "not reached"),
        (Statistic(0.3, 0.2, math.inf, 48), "0.30 [0.20, \u221e)"),
        (Statistic(0.9912, 0.991, 0.9916, 48), "0.9912 [0.9910, 0.9916]"),
    ],
)
def test_a_number_has_its_interval_or_why_there_is_none(number: Statistic, text: str) -> None:
    assert measured(number) == text


def test_the_headline_is_the_clearest_damage_that_remains_if_all_are_read_together() -> None:
    clear = Statistic(0.47, 0.24, 0.72, 10, 0, STUDENT, 0.001)
    unclear = Statistic(5.0, -1.0, 11.0, 10, 0, STUDENT, 0.09)
    rows = [row("Open", "Ghost", damage=unclear), row("Wall", "Ghost", damage=clear)]
    text = defence_tables(replace(matrix(), rows=rows)).headline
    assert text.startswith("The clearest damage: Ghost (1 agent, worst) against Wall adds 0.47 [0.24, 0.72] missed and")
    nothing = defence_tables(replace(matrix(), rows=[rows[0]])).headline
    assert nothing == "No adversary does distinguishable damage, in 1 comparison"
    assert defence_tables(matrix()).headline == "", "no cell has a test"


def test_users_metrics_have_a_table_and_lines_in_the_csv() -> None:
    mine = {"half": Statistic(3.0, 2.0, 4.0, 10), "half difference": Statistic(1.0, 0.5, 1.5, 10)}
    tables = defence_tables(replace(matrix(), own=[replace(row("Wall", "Ghost"), numbers=mine)]))
    (own,) = [each for each in tables.tables if each.title == "Your metrics"]
    assert own.lines == [["Wall", "Ghost", "1", "worst", "3.00 [2.00, 4.00]", "1.00 [0.50, 1.50]"]]
    assert "half difference,1.0,0.5,1.5" in tables.as_csv()


def test_text_and_terminal_end_with_the_summary() -> None:
    last = defence_tables(matrix()).as_markdown().split("\n\n")[-3:]
    assert last[0] == "## Summary"
    line = last[2].strip().splitlines()[-1]
    assert line.startswith("| Wall | 0.970 [0.950, 0.990] | 0.30 [0.20, 0.50] | 0.970 [0.950, 0.990] |")
    assert "| 0.40 [0.00, 1.20] | 108000 | 0.010 [0.000, 0.020] |" in line
    assert line.count("0.000 [0.000, 0.070] of 48") == 2
    text = as_text(defence_tables(matrix()).as_rich())
    assert text.index("Damage, worst") < text.index("Summary")
    assert "0.40 [0.00, 1.20]" in text
    assert "108000" in text


def test_runs_without_an_attack_alone_have_no_empty_tables() -> None:
    whole = matrix()
    quiet = replace(whole, rows=[row("Open", ""), row("Wall", "")], rocs=[], delays={}, state_shares={}, panels=[])
    text = defence_tables(quiet).as_markdown()
    assert "## Cost without an attack" in text
    assert "## Damage" not in text
    assert "## Detection" not in text
    assert "## Framing" not in text
    assert defence_tables(quiet).as_latex().count(r"\begin{tabular}") == 2


def test_a_delay_of_which_less_than_half_is_known_says_so() -> None:
    unknown = replace(
        matrix(), summaries=[summary(median_delay_s=Statistic(math.nan, 1.2, math.inf, 48, 0, BOOTSTRAP))]
    )
    assert "| not reached [1.20, \u221e) |" in defence_tables(unknown).as_markdown()
    assert r"not reached [1.20, $\infty$)" in defence_tables(unknown).as_latex()
    assert (
        median_delay(Statistic(math.nan, math.inf, math.inf, 48))
        == median_delay(Statistic(math.nan, trials=3))
        == "not reached"
    )


def section(table: MatrixTable, title: str) -> str:
    return defence_tables(table).as_markdown().split(f"## {title}\n")[1].split("## ")[0]


def test_a_row_whose_attack_never_took_place_stays_and_says_in_how_many_runs_it_did() -> None:
    silent = row("Wall", "Ghost", attacked=Statistic(0.0, 0.0, 0.1, 48, 0, BINOMIAL), lies_detected=Statistic())
    some = row("Wall", "Ghost", attacked=Statistic(0.25, 0.1, 0.4, 48, 0, BINOMIAL))
    whole = matrix()
    rows = [each for each in whole.rows if (each.of["defence"], each.of["attack"]) != ("Wall", "Ghost")]
    for own, lied in ((silent, "0 of 48"), (some, "12 of 48")):
        table = replace(whole, rows=[*rows, own])
        for title in ("Detection", "Framing"):
            assert f"| {lied} |" in section(table, title)
        assert ("(no lie)" in section(table, "Damage, worst")) == (own is silent)


def test_false_alarms_before_a_lie_are_explained_where_they_raise_a_share() -> None:
    early = row("Wall", "Ghost", suspended_before=Statistic(2.0))
    text = section(replace(matrix(), rows=[early]), "Detection")
    assert text.strip().endswith("| 3 of 5 | 2 |")
    assert "their lies count as detected: false alarms make this share greater" in text


def test_displaced_objects_show_in_the_distance_between_picture_and_truth() -> None:
    text = section(
        replace(matrix(), rows=[row("Wall", "Ghost", ospa_added_m=SHARE)]), "Distance between picture and truth, worst"
    )
    assert "| Ghost | 1 | 0.970 [0.950, 0.990] |" in text


def test_the_summary_has_no_columns_that_apply_to_no_defence() -> None:
    without_faults = replace(matrix(), summaries=[summary(faults_suspended=Statistic())])
    assert "runs with faults" in section(matrix(), "Summary")
    assert "runs with faults" not in section(without_faults, "Summary")
    assert "each with its most harmful budget" in section(matrix(), "Summary")
    single = replace(matrix(), rows=[replace(each, of=each.of | {"budgets": 1}) for each in matrix().rows])
    assert "budget" not in section(single, "Summary")


def test_one_line_says_that_few_trials_have_no_intervals() -> None:
    few = replace(matrix(), rows=[row("Wall", "Ghost", damage=Statistic(4.2, trials=4))])
    note = "Numbers without brackets are of fewer than 5 trials"
    assert as_text(defence_tables(few).as_rich()).count(note) == 1
    assert note in defence_tables(few).as_markdown()
    assert note not in defence_tables(matrix()).as_markdown()


def test_the_defence_that_judges_nobody_has_no_row_for_framing() -> None:
    text = section(matrix(), "Framing")
    assert "| Wall | Ghost |" in text
    assert "| Open |" not in text


def test_the_csv_has_every_measure_of_every_cell_with_bounds_and_method() -> None:
    lines = list(csv.DictReader(io.StringIO(defence_tables(matrix()).as_csv())))
    cell = [line for line in lines if (line["defence"], line["attack"]) == ("Wall", "Ghost")]
    assert [line["measure"] for line in cell] == list(DEFENCE_MEASURES)
    detected = next(line for line in cell if line["measure"] == "lies_detected")
    assert [detected[name] for name in ("value", "low", "high", "interval", "trials")] == [
        *("0.97", "0.95", "0.99", "bootstrap over trials", "48")
    ]
    (alarms,) = (line for line in lines if line["measure"] == "summary alarms_per_hour")
    assert (alarms["defence"], alarms["interval"]) == ("Wall", "exact Poisson")
    assert {line["measure"] for line in lines} >= {"auc", "partial_auc", "seconds faulty suspended"}


def test_latex_has_all_tables_with_escaped_text() -> None:
    latex = defence_tables(matrix()).as_latex()
    for title in ("Summary", "Detection", "ROC", "Framing", "Faults"):
        assert f"% {title}" in latex
    assert latex.count(r"\begin{tabular}") == latex.count(r"\end{tabular}") == 9
    for line in latex.splitlines():
        assert line.startswith("%") or "%" not in line.replace(r"\%", "")
        assert line.isascii() or line.startswith("%"), line

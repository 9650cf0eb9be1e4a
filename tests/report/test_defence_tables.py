"""The tables of a matrix of defences show every number with its interval."""

import csv
import io
import math
from dataclasses import replace

import pytest
from defence_samples import SHARE, matrix, row, summary
from kept_texts import assert_kept

from mast_zenoh.metrics.study_results import BINOMIAL, BOOTSTRAP, STUDENT, Statistic
from mast_zenoh.show.compare import as_text
from mast_zenoh.show.number_text import measured, median_delay
from mast_zenoh.study.defences.matrix_table import DEFENCE_MEASURES, MatrixTable
from mast_zenoh.study.defences.matrix_tables import matrix_tables


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


def test_all_tables_in_text_csv_latex_and_on_a_terminal() -> None:
    tables = matrix_tables(matrix())
    latex = tables.as_latex()
    assert_kept("defences", tables.as_markdown(), tables.as_csv(), latex, as_text(tables.as_rich()))
    lines = list(csv.DictReader(io.StringIO(tables.as_csv())))
    cell = [line["measure"] for line in lines if (line["defence"], line["attack"]) == ("Wall", "Ghost")]
    assert cell == list(DEFENCE_MEASURES)
    for line in latex.splitlines():
        assert line.startswith("%") or "%" not in line.replace(r"\%", "")
        assert line.isascii() or line.startswith("%"), line


def lied(share: float, **measures: Statistic) -> MatrixTable:
    """A matrix in which an adversary lied in a share of 48 runs."""
    rows = [each for each in matrix().rows if (each.of["defence"], each.of["attack"]) != ("Wall", "Ghost")]
    attacked = Statistic(share, share / 2, share + 0.1, 48, 0, BINOMIAL)
    return replace(matrix(), rows=[*rows, row("Wall", "Ghost", attacked=attacked, **measures)])


OWN = {"own half": Statistic(3.0, 2.0, 4.0, 10), "own half difference": Statistic(1.0, 0.5, 1.5, 10)}
CLEAR = row("Wall", "Ghost", damage=Statistic(0.47, 0.24, 0.72, 10, 0, STUDENT, 0.001))
UNCLEAR = row("Open", "Ghost", damage=Statistic(5.0, -1.0, 11.0, 10, 0, STUDENT, 0.09))
UNKNOWN = Statistic(math.nan, 1.2, math.inf, 48, 0, BOOTSTRAP)
CASES: dict[str, MatrixTable] = {
    "the clearest damage": replace(matrix(), rows=[UNCLEAR, CLEAR]),
    "no clear damage": replace(matrix(), rows=[UNCLEAR]),
    "metrics of the user": replace(matrix(), rows=[row("Wall", "Ghost", **OWN)]),
    "no attack": replace(matrix(), rows=[row("Open", ""), row("Wall", "")], rocs={}, delays={}, states=[], panels=[]),
    "an unknown delay": replace(matrix(), summaries=[summary(median_delay_s=UNKNOWN)]),
    "no lie": lied(0.0, lies_detected=Statistic()),
    "few lies": lied(0.25),
    "suspensions before a lie": replace(matrix(), rows=[row("Wall", "Ghost", suspended_before=Statistic(2.0))]),
    "displaced objects": replace(matrix(), rows=[row("Wall", "Ghost", ospa_added_m=SHARE)]),
    "no faults": replace(matrix(), summaries=[summary(faults_suspended=Statistic())]),
    "one budget": replace(matrix(), rows=[replace(each, of=each.of | {"budgets": 1}) for each in matrix().rows]),
    "few trials": replace(matrix(), rows=[row("Wall", "Ghost", damage=Statistic(4.2, trials=4))]),
}


def test_what_is_special_in_a_matrix_is_said_in_its_tables() -> None:
    """Kept are the titles of the tables, and the lines that the usual ones do not have."""
    usual, texts = set(matrix_tables(matrix()).as_markdown().splitlines()), []
    for name, case in CASES.items():
        tables = matrix_tables(case)
        titles = ", ".join(table.title for table in tables.tables)
        own = [line for line in tables.as_markdown().splitlines() if line not in usual]
        texts += [f"{name}: {tables.headline}", f"tables: {titles}", *own, ""]
    assert_kept("defences_special", *texts)
    assert r"reached [1.20, $\infty$)" in matrix_tables(CASES["an unknown delay"]).as_latex()
    assert median_delay(Statistic(math.nan, math.inf, math.inf, 48)) == "not reached"
    assert median_delay(Statistic(math.nan, trials=3)) == "not reached"
    assert as_text(matrix_tables(CASES["few trials"]).as_rich()).count("5 trials") == 1

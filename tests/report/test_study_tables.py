"""The tables and the figure of a study: the same numbers, in every form."""

from __future__ import annotations

import csv
import io
from itertools import pairwise

import pytest
from rich.console import Console

from mast_zenoh.report import study_table
from mast_zenoh.report.study_figure import increments_figure
from mast_zenoh.report.study_rows import Estimate, StudyRow, number, over_frames, over_trials, shares


def row(label: str, run: str, n: int | None, fp: float) -> StudyRow:
    estimates = {
        "fp_iob": Estimate(fp, 1.25, fp, fp - 0.5, fp + 0.5, 20),
        "fn_iob": Estimate(-0.004, 0.5, -0.004, -0.02, 0.01, 20),
        "fp": Estimate(3.0, 1.0, 3.0, 2.9, 3.1, 20),
        "fp inserted": Estimate(mean=2.0),
        "fp clutter": Estimate(mean=1.0),
        "fp lag": Estimate(mean=0.0),
    }
    return StudyRow(label, run, {} if n is None else {"n_adversaries": n}, estimates)


ROWS = [
    row("baseline", "baseline", None, 0.0),
    *(row(f"uncoordinated-{n}", "uncoordinated", n, 3.0 * n + 0.456) for n in (1, 2, 3)),
    *(row(f"coordinated-{n}", "coordinated", n, 2.0) for n in (1, 2, 3)),
]


def shown() -> str:
    page = io.StringIO()
    Console(file=page, width=80).print(study_table.as_rich(ROWS, "baseline"))
    return page.getvalue()


@pytest.mark.parametrize(
    ("value", "text"), [(1.005, "1.00"), (-0.5, "\u22120.50"), (-0.001, "0.00"), (float("nan"), "\u2013")]
)
def test_numbers_have_two_decimals_and_no_negative_zero(value: float, text: str) -> None:
    assert number(value) == text


def test_an_estimate_shows_either_of_its_spreads() -> None:
    both = Estimate(3.42, 1.2, 3.4, 3.1, 3.8, 20)
    assert over_frames(both) == "3.42 ± 1.20"
    assert over_trials(both) == "3.40 [3.10, 3.80]"
    assert over_trials(Estimate(3.4, 1.2, 3.4, trials=1)) == "3.40"
    assert over_frames(Estimate()) == over_trials(Estimate()) == "\u2013"


def test_the_terminal_table_fits_80_columns_and_has_both_spreads() -> None:
    text = shown()
    assert max(map(len, text.splitlines())) <= 80
    for part in ("9.46 ± 1.25", "[8.96, 9.96]", "coordinated-3", "66.7 %"):
        assert part in text
    assert "…" not in text


def test_a_mean_over_trials_that_differs_from_that_over_frames_is_shown() -> None:
    page = io.StringIO()
    odd = StudyRow("x", "x", {}, {"fp_iob": Estimate(3.0, 1.0, 2.5, 2.0, 3.0, 4)})
    Console(file=page, width=80).print(study_table.as_rich([odd], "baseline"))
    assert "2.50 [2.00, 3.00]" in page.getvalue()


def test_markdown_has_a_line_per_configuration_in_each_of_its_tables() -> None:
    lines = study_table.as_markdown(ROWS, "baseline").splitlines()
    assert sum(line.startswith("| uncoordinated-2 |") for line in lines) == 5
    assert sum(line.startswith("| baseline |") for line in lines) == 3
    for line, after in pairwise(lines):
        if after.startswith("|---"):
            assert line.count("|") == after.count("|")


def test_csv_has_all_digits_and_leaves_the_unknown_empty() -> None:
    found = list(csv.DictReader(io.StringIO(study_table.as_csv(ROWS))))
    assert len(found) == 7 * 6
    one = next(f for f in found if f["configuration"] == "uncoordinated-1" and f["metric"] == "fp_iob")
    assert (float(one["mean"]), one["trials"]) == (3.456, "20")
    assert next(f for f in found if f["metric"] == "fp inserted")["low"] == ""


def test_latex_has_as_many_cells_in_every_row_and_no_character_of_its_own() -> None:
    text = study_table.as_latex(ROWS, "baseline")
    body = [line for line in text.splitlines() if line.endswith(r"\\")][2:]
    assert len(body) == 2 * 6
    assert {line.count("&") for line in body} == {8}
    assert r"$9.46 \pm 1.25$" in text
    assert not set(text.split("\n", 1)[1]) - set(map(chr, range(128)))


def test_shares_add_up_to_one_over_the_causes_that_occur() -> None:
    assert shares(ROWS[0], "fp") == {"inserted": pytest.approx(2 / 3), "clutter": pytest.approx(1 / 3)}
    assert shares(ROWS[0], "fn") == {}


def test_the_figure_is_the_same_every_time_and_needs_a_number_of_adversaries() -> None:
    first = increments_figure(ROWS)
    assert first is not None
    assert first.startswith(b"\x89PNG")
    assert increments_figure(ROWS) == first
    assert increments_figure(ROWS[:1]) is None

"""The tables of the matrix of published methods, and of published figures next to ours."""

import csv
import io
from dataclasses import replace

import pytest
from field_samples import SCENES, field
from kept_texts import assert_kept

from mast_zenoh.show.compare import as_text
from mast_zenoh.study.defences.matrix_tables import FIELD_MEASURES, matrix_tables
from mast_zenoh.study.defences.scoreboard import published_tables


@pytest.mark.parametrize("idle", [False, True])
def test_all_tables_in_text_csv_latex_and_on_a_terminal(idle: bool) -> None:
    tables = matrix_tables(field(idle=idle))
    if idle:  # an attack that never took place
        assert_kept("field_idle", tables.as_markdown())
        return
    latex, terminal = tables.as_latex(), as_text(tables.as_rich())
    numbers = [line for line in tables.as_csv().splitlines() if "Wall" in line]
    assert_kept("field", tables.as_markdown(), *numbers, latex, terminal)
    assert max(map(len, terminal.splitlines())) <= 80
    assert all(line.isascii() for line in latex.splitlines() if not line.startswith("%"))
    rows = list(csv.DictReader(io.StringIO(tables.as_csv())))
    for name in FIELD_MEASURES:
        assert {row["scene"] for row in rows if row["measure"] == name} - {""} == {"all", *SCENES}


def test_published_figures_are_next_to_ours_and_a_method_without_a_known_one_says_so() -> None:
    whole = field()
    unknown = replace(whole, published=[(replace(whole.published[0][0], figure=""), [])])
    assert_kept("published", *(published_tables(each).as_markdown() for each in (whole, unknown)))

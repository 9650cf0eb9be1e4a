"""The tables of the matrix of published methods, and of published figures next to ours."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

from field_samples import SCENES, field

from mast_zenoh.report.compare import as_text
from mast_zenoh.report.tables.text_table import TextTable
from mast_zenoh.study.defences.field_tables import FIELD_MEASURES, field_tables, published_tables


def table_of(title: str) -> TextTable:
    return next(table for table in field_tables(field()).tables if table.title == title)


def test_the_summary_has_harm_breakdown_and_processor_time_of_each_defence() -> None:
    summary = field_tables(field()).tables[-1]
    assert summary.title == "Summary"
    values = {line[0]: dict(zip(summary.headings, line, strict=True)) for line in summary.lines}
    assert values["Wall"]["breaks at (adversaries)"] == "1.25 [1.10, 1.50]"
    assert values["Wall"]["weakest against"] == "Ghost (1.25)"
    assert values["Fence"]["breaks at (adversaries)"] == "> 2 [1.80, \u221e)"
    assert values["Fence"]["weakest against"] == "none"
    assert values["Wall"]["removed of what attacks add (share)"] == "0.750 [0.600, 0.900]"
    assert values["Wall"]["processor time under attack, relative to undefended"] == "1.20 [1.10, 1.30]"
    terminal = as_text(field_tables(field()).as_rich())
    assert "1.25 [1.10, 1.50]" in terminal
    assert max(map(len, terminal.splitlines())) <= 80


def test_harm_has_a_table_for_each_kind_of_scene_and_a_column_for_each_defence() -> None:
    titles = [table.title for table in field_tables(field()).tables]
    assert [title for title in titles if title.startswith("Harm")] == [
        f"Harm with and without defence, {scene}" for scene in SCENES
    ]
    harm = table_of("Harm with and without defence, 4 poles")
    assert list(harm.headings) == ["adversary", "n", "placement", "Wall", "Fence"]
    assert [line[0] for line in harm.lines] == ["none", "Ghost", "Flood"]
    assert harm.lines[1][3] == "\u22122.50 [\u22122.90, \u22122.10]"


def test_a_cell_whose_attack_never_took_place_says_so() -> None:
    tables = {table.title: table for table in field_tables(field(idle=True)).tables}
    harm = tables["Harm with and without defence, 4 poles"]
    assert harm.lines[1][3].endswith("(no lie)")
    assert not harm.lines[2][3].endswith("(no lie)")
    assert "(no lie): the adversaries, which hear how they are judged, lied in none" in harm.about
    assert "no lie" not in table_of("Harm with and without defence, 4 poles").about


def test_processor_time_and_breakdown_have_lines_for_the_undefended_too() -> None:
    assert {line[0] for line in table_of("Processor time").lines} == {"NoIntegrity", "Wall", "Fence"}
    broken = table_of("Breakdown")
    assert len(broken.lines) == 9, "three defences in two scenes and in all"
    lines = {(line[0], line[1]): line for line in broken.lines}
    assert lines["Wall", "4 poles"][3:7] == ["0 [0, 10]", "20 [10, 30]", "80 [60, 90]", "1.25 [1.10, 1.50]"]
    assert lines["Wall", "4 poles"][7] == "25 [22, 30]"
    assert lines["Fence", "4 poles"][7] == "> 40 [36, > 40]"


def test_the_csv_has_every_measure_by_scene_and_latex_is_ascii() -> None:
    tables = field_tables(field())
    rows = list(csv.DictReader(io.StringIO(tables.as_csv())))
    for name in FIELD_MEASURES:
        assert {row["scene"] for row in rows if row["measure"] == name} - {""} == {"all", *SCENES}
    (harm,) = (
        row
        for row in rows
        if (row["scene"], row["defence"], row["attack"], row["measure"]) == ("4 poles", "Wall", "Ghost", "harm")
    )
    assert (float(harm["value"]), harm["trials"]) == (-2.5, "30")
    assert any(row["measure"] == "breaks_at" and row["value"] == "inf" for row in rows)
    assert {row["scene"] for row in rows if row["measure"] == "damage"} == {""}
    assert all(line.isascii() for line in tables.as_latex().splitlines() if not line.startswith("%"))


def test_a_method_without_a_known_figure_says_so() -> None:
    whole = field()
    unknown = replace(whole, published=[(replace(whole.published[0][0], figure=""), [])])
    (line,) = published_tables(unknown).tables[0].lines
    assert line[2] == "none known to us"
    assert line[4] == "\u2013"
    (known,) = published_tables(whole).tables[0].lines
    assert known[4] == "observable lies detected (share): Wall 0.500 [0.400, 0.600], under Ghost"

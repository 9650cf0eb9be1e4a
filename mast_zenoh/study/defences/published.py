"""What papers report of the methods that our stages and attacks follow, next to our numbers, and why these differ.

published.toml is the only place of the texts about papers. A figure is one that was found in an abstract or in others'
notes (then it says so, and was not checked), in the authors' code, or in the paper. Ours are computed from the trials
of a study (`field_matrix`).
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import msgspec

from mast_zenoh.metrics.study_results import Row
from mast_zenoh.show.findings.words import paragraph
from mast_zenoh.show.tables.text_table import DASH, ResultTables, TextTable, measured, median_delay, numbers_of_rows
from mast_zenoh.study.defences.matrix_table import MatrixTable, Published

#: Our numbers next to published figures, and their headings.
QUANTITIES = {
    "lies_detected": "observable lies detected (share)",
    "harm_removed": "removed of what attacks add (share)",
    "honest_suspended_time": "time in which honest agents are suspended (share)",
    "median_delay_s": "median time to suspension (s)",
    "targets_suspended": "agents attacked that are suspended (share)",
    "fn_added_alone": "missed objects added per frame without an attack",
    "fp_added": "false objects added per frame",
    "damage": "missed and false objects added per frame",
    "ospa_vs_undefended_m": "OSPA, minus undefended (m)",
    "cpu_growth": "processor time, relative to the other attacks",
}

#: Attacks that move what is reported, so that there is nothing to withhold: only a suspension detects them.
BY_SUSPENSION = frozenset({"PosePert"})
#: Stages, then attacks.
PUBLISHED = msgspec.convert(
    tomllib.loads(Path(__file__).with_name("published.toml").read_text("utf-8"))["method"], tuple[Published, ...]
)

_PUBLISHED_TITLE = "The paper's figure, ours on tracks, why different"
_PUBLISHED_HEADINGS = (
    *("stage or attack", "after", "the paper's figure", "known from", "ours on tracks", "why different"),
)
#: Widths of columns in LaTeX, shares of the line.
_PUBLISHED_WIDTHS = (0.1, 0.13, 0.14, 0.1, 0.2, 0.2)
_NO_FIGURE = "none known to us"
#: Attacks that a cell names; more are counted, as the text above the table names them.
_MOST_NAMED = 4


def published_tables(table: MatrixTable) -> ResultTables:
    """The published figures of what was played, each with our numbers and why they differ."""
    if not table.published:
        about = "This study played no method of which a published figure is known, so there is nothing to compare."
        return ResultTables(_PUBLISHED_TITLE, about, table.size, [], numbers_of_rows([]), [])
    attacks = ", ".join(table.names("attack"))
    about = paragraph("field_published", size=table.size, attacks=attacks)
    lines = [
        [each.method, each.source, each.figure or _NO_FIGURE, each.basis, _ours(numbers), each.why]
        for each, numbers in table.published
    ]
    latex = "".join(rf"p{{{width:g}\linewidth}}" for width in _PUBLISHED_WIDTHS)
    page = TextTable("Published figures", "", _PUBLISHED_HEADINGS, lines, len(_PUBLISHED_HEADINGS), latex)
    rows = [replace(row, of=_of_paper(each) | row.of) for each, of_method in table.published for row in of_method]
    return ResultTables(_PUBLISHED_TITLE, about, table.size, [page], numbers_of_rows(rows), [])


def _of_paper(each: Published) -> dict[str, str]:
    return dict(
        method=each.method, source=each.source, figure=each.figure, known_from=each.basis, why_different=each.why
    )


def _ours(rows: Sequence[Row]) -> str:
    """`lies detected (share): Cad 0.50 [0.30, 0.70], under Flood; …`, by quantity and attacks."""
    texts: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        attacks = row.of["attack"]
        count = len(attacks.split(", "))
        under = f", under {attacks if count <= _MOST_NAMED else f'all {count} attacks'}" if attacks else ""
        for quantity, value in row.numbers.items():
            text = median_delay(value) if quantity == "median_delay_s" else measured(value, 3)
            texts.setdefault((QUANTITIES[quantity], under), []).append(f"{row.of['defence']} {text}")
    return "; ".join(f"{name}: {', '.join(values)}{under}" for (name, under), values in texts.items()) or DASH

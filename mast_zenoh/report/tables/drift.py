"""The tables of the study of displaced objects: Markdown, CSV and the terminal's."""

from __future__ import annotations

import csv
import io
import math

from rich.table import Table

from mast_zenoh.report.defence_rows import Measured
from mast_zenoh.report.limit_rows import DriftRow, DriftTable
from mast_zenoh.report.tables.scores import DASH
from mast_zenoh.report.tables.study_rows import number

_NOT_REACHED = "not reached"
_MEASURED = ("delay_s", "ratio", "offset_reached_m", "within", "noticed")
_PLAIN = ("floor_s", "floor_m")
#: The group of the terminal's table.
_MAJORITY = "2 or more"


def as_markdown(table: DriftTable) -> str:
    """All tables."""
    limit = f"{table.limit_s:g} s"
    runs = [row for row in table.rows if not row.viewers]
    objects = [row for row in table.rows if row.viewers]
    drifting = [row for row in objects if row.rate_mps is not None]
    parts = [
        "# Displaced objects",
        f"{table.size}. Medians by Kaplan and Meier with bootstrap 95 % intervals over trials; shares with the "
        "interval of Clopper and Pearson. The floor is the least delay that is possible at one false alarm per hour.",
        "## From the first lie to the suspension",
        "Whole runs, whoever saw the objects.",
        _lines(
            ["lie", "runs", "suspended", "median delay (s)", f"within {limit}"],
            [[r.label, str(r.trials), str(r.detected), text(r.delay_s), percent(r.within)] for r in runs],
        ),
        "## For each displaced object, by the number of honest agents that see it",
        _lines(list(_headings(limit)), [_line(row) for row in objects]),
    ]
    if drifting:
        parts += [
            "## Offset that a drift reaches",
            _lines(
                ["drift", "honest viewers", "median offset (m)", "at the floor (m)"],
                [[r.label, r.viewers, text(r.offset_reached_m), number(r.floor_m)] for r in drifting],
            ),
        ]
    return "\n\n".join(parts) + "\n"


def as_csv(table: DriftTable) -> str:
    """A row for each lie and number of viewers (empty: whole runs); `inf` is not reached, empty is unknown."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    counts = ("episodes", "detected", "trials", "judged")
    place = ("label", "offset_m", "rate_mps", "viewers")
    ends = [name for each in _MEASURED for name in (each, f"{each}_low", f"{each}_high")]
    writer.writerow([*place, *counts, *_PLAIN, *ends])
    for row in table.rows:
        values = ["" if getattr(row, name) is None else getattr(row, name) for name in (*place, *counts)]
        plain = [digits(getattr(row, name)) for name in _PLAIN]
        measured = [getattr(row, name) for name in _MEASURED]
        writer.writerow([*values, *plain, *(digits(x) for m in measured for x in (m.value, m.low, m.high))])
    return buffer.getvalue()


def as_rich(table: DriftTable) -> Table:
    """The rows with enough viewers for a majority, for the terminal."""
    title = "Displaced objects in view of two honest agents or more, until the liar is suspended"
    result = Table(title=title, title_justify="left")
    headings = ("lie", "detected", "delay (s)", "floor (s)", "delay / floor", f"within {table.limit_s:g} s")
    for index, heading in enumerate(headings):
        result.add_column(heading, justify="left" if index == 0 else "right")
    for row in table.rows:
        if row.viewers == _MAJORITY:
            detected = f"{row.detected} of {row.episodes}"
            numbers = (text(row.delay_s), number(row.floor_s), text(row.ratio), percent(row.noticed))
            result.add_row(row.label, detected, *numbers)
    return result


def _headings(limit: str) -> tuple[str, ...]:
    objects = ("objects", "runs", "detected", "median delay (s)", "floor (s)", "delay / floor")
    return ("lie", "honest viewers", *objects, f"within {limit}", f"within {limit}, short ones too")


def _line(row: DriftRow) -> list[str]:
    counts = [str(row.episodes), str(row.trials), str(row.detected)]
    shares = (percent(row.within, f" of {row.judged}"), percent(row.noticed))
    return [row.label, row.viewers, *counts, text(row.delay_s), number(row.floor_s), text(row.ratio), *shares]


def text(measured: Measured, digits: int = 2) -> str:
    """`5.10 [4.20, 6.30]`; `not reached` if fewer than half were detected; `∞` as an end of an interval."""
    if not measured.known:
        return DASH
    value = _NOT_REACHED if math.isinf(measured.value) else number(measured.value, digits)
    if math.isnan(measured.low):
        return value
    low, high = ("\u221e" if math.isinf(end) else number(end, digits) for end in (measured.low, measured.high))
    return f"{value} [{low}, {high}]"


def percent(share: Measured, size: str = "") -> str:
    """`83 % [52, 98]`, and its size."""
    if not share.known:
        return DASH
    value, low, high = (100.0 * each for each in (share.value, share.low, share.high))
    interval = "" if math.isnan(low) else f" [{low:.0f}, {high:.0f}]"
    return f"{value:.0f} %{interval}{size}"


def digits(value: float) -> str:
    """All digits of a number; empty if it is unknown."""
    return "" if math.isnan(value) else repr(float(value))


def _lines(headings: list[str], lines: list[list[str]]) -> str:
    rows = [headings, ["---"] * len(headings), *lines]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)

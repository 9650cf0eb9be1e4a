"""The estimates of a study as CSV, with all digits, and as LaTeX, for a paper."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence

from mast_zenoh.metrics.scores import COLUMNS
from mast_zenoh.report.narrative.study import titled
from mast_zenoh.report.narrative.study_comparisons import compare
from mast_zenoh.report.study_facts import StudyFacts
from mast_zenoh.report.tables.scores import DASH
from mast_zenoh.report.tables.study_rows import (
    ALL_SCORES,
    MOSTLY_ZERO,
    PAPER,
    Column,
    StudyRow,
    columns_of,
    over_frames,
    over_trials,
)

#: The numbers of an estimate in table.csv: heading and field.
_NUMBERS = {
    "mean": "mean",
    "std_over_frames": "std",
    "mean_over_trials": "trial_mean",
    "low": "low",
    "high": "high",
    "scenes_low": "scenes_low",
    "scenes_high": "scenes_high",
    "p": "p",
    "zero_share": "zero_share",
    "zero_low": "zero_low",
    "zero_high": "zero_high",
}

_MARK = "* differs significantly from 0 after Holm's correction"


def as_csv(rows: Sequence[StudyRow], facts: StudyFacts) -> str:
    """A line per configuration and series, with all digits; unknown numbers are empty.

    p_holm is p adjusted for all contrasts of the tables (`compare`), and empty for other series.
    """
    adjusted = compare(rows, facts.baseline).adjusted
    parameters = list(dict.fromkeys(name for row in rows for name in row.point))
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    series_names = ("who", "estimator", "metric")
    counts = ("scenes", "seeds", "seeds_left_out")
    writer.writerow(["configuration", *parameters, *series_names, *_NUMBERS, "p_holm", *counts])
    for row in rows:
        for series, estimate in row.estimates.items():
            values = [getattr(estimate, field) for field in _NUMBERS.values()]
            values.append(adjusted.get((row.label, series), float("nan")))
            texts = ["" if value != value else repr(float(value)) for value in values]
            point = [row.point.get(name, "") for name in parameters]
            row_counts = (estimate.scenes, estimate.seeds, estimate.left_out)
            writer.writerow([row.label, *point, *series, *texts, *row_counts])
    return buffer.getvalue()


def as_latex(rows: Sequence[StudyRow], facts: StudyFacts) -> str:
    """LaTeX tabulars with intervals below: the paper's increments, then all metrics of each estimate."""
    rows, facts = titled(rows, facts)
    columns, comparisons = columns_of(PAPER), compare(rows, facts.baseline)
    groups = " & ".join(rf"\multicolumn{{{len(columns_of_group)}}}{{c}}{{{name}}}" for name, columns_of_group in PAPER)
    size = facts.size.replace("\u00d7", "x")
    warning = MOSTLY_ZERO if any(column.of(row).mostly_zero for row in rows for column in columns) else ""
    comments = ["mean and std over the frames of all trials; below, mean over seeds [95 % interval], paired", size]
    lines = [
        *(
            f"% {comment}"
            for comment in (r"needs \usepackage{booktabs}", *comments, _MARK, warning, facts.failures)
            if comment
        ),
        *_tabular(
            [rf" & {groups} \\", " & " + " & ".join(_short(column.heading) for column in columns) + r" \\"],
            [row for row in rows if row.label != facts.baseline],
            columns,
            lambda row, column: "^{*}" if comparisons.remains(row, column) else "",
        ),
    ]
    for name, scores in ALL_SCORES:
        of_estimate = [*scores, *_of_users(rows, scores)]
        if any(column.of(row).seeds for row in rows for column in of_estimate):
            heading = " & " + " & ".join(_tex(column.heading) for column in of_estimate) + r" \\"
            lines += ["", f"% {name}: all metrics", *_tabular([heading], rows, of_estimate, lambda row, column: "")]
    return "\n".join([*lines, ""])


def _tabular(
    headings: Sequence[str],
    rows: Sequence[StudyRow],
    columns: Sequence[Column],
    mark: Callable[[StudyRow, Column], str],
) -> list[str]:
    """The lines of a tabular with two lines for each row: over frames, and over trials."""
    lines = [r"\begin{tabular}{l" + "r" * len(columns) + "}", r"\toprule", *headings, r"\midrule"]
    for row in rows:
        frame_cells = [_tex(over_frames(column.of(row))) + mark(row, column) for column in columns]
        trial_cells = [_tex(over_trials(column.of(row))) for column in columns]
        for label, texts in ((row.label, frame_cells), ("", trial_cells)):
            lines.append(" & ".join([_tex(label), *(f"${text}$" for text in texts)]) + r" \\")
    return [*lines, r"\bottomrule", r"\end{tabular}"]


def _of_users(rows: Sequence[StudyRow], scores: Sequence[Column]) -> list[Column]:
    """Columns of the metrics of an estimate that are not among its scores: the user's own."""
    known, estimator = {column.metric for column in scores} | set(COLUMNS), scores[0].estimator
    names = [
        series.metric
        for row in rows
        for series, each in row.estimates.items()
        if (series.owner, series.estimator) == (row.ego, estimator) and series.metric.isidentifier() and not each.rate
    ]
    own = [name for name in dict.fromkeys(names) if name not in known and not name.endswith("_iob")]
    return [Column(name, name, estimator) for name in own]


def _short(heading: str) -> str:
    """A heading without its group's name ("IoE"); CA headings stay whole ("CAFN IoB")."""
    kind, reference = heading.split()
    return heading if kind.startswith("CA") else reference


def _tex(text: str) -> str:
    """Text escaped for LaTeX."""
    for character, replacement in (
        ("\u2212", "-"),
        ("±", r"\pm"),
        (DASH, r"\mbox{--}"),
        ("all equal", r"\mbox{all equal}"),
        ("(0 in ", r"(0 \mbox{ in } "),
        ("_", r"\_"),
        ("%", r"\%"),
        ("&", r"\&"),
    ):
        text = text.replace(character, replacement)
    return text

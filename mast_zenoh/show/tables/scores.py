"""The score table: a row per metric and run, a column per estimate."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table

from mast_zenoh.metrics.estimates import (
    LOCAL,
    MAIN,
    PICTURE,
    PICTURE_ON_ARRIVAL,
    PICTURE_RECEIVED,
    column_name,
    rank_of,
)
from mast_zenoh.metrics.measures import COLUMNS, MEASURES, Quantity, metric_named, own_metrics
from mast_zenoh.show.tables.text_table import DASH


class Value(NamedTuple):
    """Mean and standard deviation over frames, or a run's value; None: unknown."""

    mean: float | None = None
    std: float | None = None

    @classmethod
    def of(cls, summary: object) -> Value:
        """From metrics.json: {"mean", "std"}, a number, or nothing."""
        if isinstance(summary, Mapping):
            return cls(summary.get("mean"), summary.get("std"))
        return cls(float(summary)) if isinstance(summary, (int, float)) else cls()


class Cell(NamedTuple):
    """A score of one estimate of one run, and its change over the reference run."""

    value: Value = Value()
    change: Value = Value()


@dataclass(frozen=True, slots=True)
class ScoreRow:
    """One metric of one run, with a cell per estimate.

    over_alone: the picture's increment over the ego alone (IoE)
    """

    measure: Quantity
    run: str
    cells: Mapping[str, Cell]
    over_alone: Value

    def cell(self, estimate: str) -> Cell:
        """The cell of an estimate; empty where there is none."""
        return self.cells.get(estimate, Cell())


@dataclass(frozen=True, slots=True)
class ScoreTable:
    """The rows by metric, then by run.

    estimates: that have a column, in the order of ESTIMATES
    runs:      labels, in order
    reference: the run that changes are over; None: there is none
    """

    rows: tuple[ScoreRow, ...]
    estimates: tuple[str, ...]
    runs: tuple[str, ...]
    reference: str | None

    def cell(self, key: str, run: str, estimate: str) -> Cell:
        """The cell of a metric, a run and an estimate; empty where there is none."""
        return next(row for row in self.rows if (row.measure.label, row.run) == (key, run)).cell(estimate)


#: The columns of metrics.parquet of a run.
Counts = Mapping[str, NDArray[Any]]


def score_table(
    metrics: Mapping[str, Mapping[str, Any]],
    *,
    counts: Mapping[str, Counts | None] | None = None,
    agent: str = "ego",
    reference: str | None = None,
) -> ScoreTable:
    """The scores of one agent in one run or several.

    metrics:   content of metrics.json by the run's label; `{}` gives rows of dashes
    counts:    columns of metrics.parquet by the run's label; needed for standard deviations of changes
    reference: label of the run that changes are over; by default, of several runs, `baseline` or else the first
    Raises ValueError when `reference` is not among the runs.
    """
    if reference is not None and reference not in metrics:
        raise ValueError(f"reference: found {reference!r}, expected one of {', '.join(metrics)}")
    if reference is None and len(metrics) > 1:
        reference = "baseline" if "baseline" in metrics else next(iter(metrics))
    scores = {label: summary.get("agents", {}).get(agent, {}) for label, summary in metrics.items()}
    series = {
        label: _scored(table, metrics[label], agent)
        for label, table in (counts or {}).items()
        if table is not None and label in metrics
    }
    rows = []
    for measure in measures(scores.values(), own_metrics(metrics.values())):
        for label, run_scores in scores.items():
            reference_scores = scores[reference] if reference not in (None, label) else {}
            spread = series.get(label, {}), series.get(reference or "", {})
            values = {name: Value.of(of_estimate.get(measure.label)) for name, of_estimate in run_scores.items()}
            cells = {}
            for name, value in values.items():
                before = Value.of(reference_scores.get(name, {}).get(measure.label))
                cells[name] = Cell(value, _difference(value, before, spread, (name, name), measure))
            alone, of_picture = values.get(LOCAL, Value()), values.get(PICTURE, Value())
            over_alone = _difference(of_picture, alone, (spread[0], spread[0]), (PICTURE, LOCAL), measure)
            rows.append(ScoreRow(measure, label, cells, over_alone))
    return ScoreTable(tuple(rows), shown_estimates(metrics.values(), agent), tuple(metrics), reference)


def measures(
    scores: Iterable[Mapping[str, Mapping[str, Any]]], described: Mapping[str, Mapping[str, Any]]
) -> list[Quantity]:
    """The metrics of runs: our own, then the user-defined ones that any of them has.

    described: `own_metrics` of metrics.json
    """
    own = [name for of_run in scores for of_one in of_run.values() for name in of_one if name not in COLUMNS]
    return [*MEASURES.values(), *(metric_named(name, described) for name in dict.fromkeys(own))]


def shown_estimates(metrics: Iterable[Mapping[str, Any]], agent: str) -> tuple[str, ...]:
    """Estimates with a column: those in MAIN, and any that differ from all others, also those of a user's own wires."""
    names = set(MAIN)
    for summary in metrics:
        same = summary.get("same_as", {}).get(agent, {})
        own = {name for name in summary.get("agents", {}).get(agent, {}) if name not in same}
        if same.get(PICTURE_RECEIVED) == PICTURE_ON_ARRIVAL:  # nothing was late: the cause is what was received
            own = own - {PICTURE_ON_ARRIVAL} | {PICTURE_RECEIVED}
        names |= own
    return tuple(sorted(sorted(names), key=rank_of))  # those of wires of a user's own last, by name


def _scored(counts: Counts, metrics: Mapping[str, Any], agent: str) -> dict[str, dict[str, NDArray[Any]]]:
    """An agent's rows in scored frames, by estimate, sorted by frame."""
    first, last = metrics.get("scored_frames") or (-np.inf, np.inf)
    selected = (counts["agent"] == agent) & (counts["frame"] >= first) & (counts["frame"] <= last)
    result = {}
    for estimate in dict.fromkeys(counts["estimator"][selected].tolist()):
        rows = np.flatnonzero(selected & (counts["estimator"] == estimate))
        rows = rows[np.argsort(counts["frame"][rows], kind="stable")]
        result[estimate] = {name: column[rows] for name, column in counts.items()}
    return result


def _difference(
    value: Value,
    other: Value,
    series: tuple[Mapping[str, Counts], Mapping[str, Counts]],
    estimates: tuple[str, str],
    measure: Quantity,
) -> Value:
    """`value` minus `other`, with the deviation over common frames if known."""
    if value.mean is None or other.mean is None:
        return Value()
    own_counts, other_counts = (of_run.get(name) for of_run, name in zip(series, estimates, strict=True))
    std = None
    both = measure.label in (own_counts or ()) and measure.label in (other_counts or ())
    if own_counts is not None and other_counts is not None and value.std is not None and both:
        _, here, there = np.intersect1d(own_counts["frame"], other_counts["frame"], return_indices=True)
        differences = own_counts[measure.label][here].astype(np.float64) - other_counts[measure.label][there]
        std = float(np.std(differences)) if len(differences) else None
    return Value(value.mean - other.mean, std)


def number(value: Value, measure: Quantity) -> str:
    """A value as text; a dash for what is not known."""
    return DASH if value.mean is None else f"{value.mean:.{measure.digits}f}"


def signed(value: Value, measure: Quantity) -> str:
    """A difference as `+1.70` or `\u22120.23`; a dash for what is not known."""
    if value.mean is None:
        return DASH
    rounded = round(value.mean, measure.digits) + 0.0  # not a negative zero
    return f"{rounded:+.{measure.digits}f}".replace("-", "\u2212")


NOTE = "FN, FP, TP: objects per frame, mean over the scored frames"


def as_rich(table: ScoreTable) -> Group:
    """Main metrics for a terminal of 80 columns, with changes over a reference if any."""
    if len(table.runs) < 2:
        return Group(_terminal_table(table, table.estimates, NOTE))
    others = [name for name in table.estimates if name not in MAIN]
    tables = [_terminal_table(table, MAIN, f"{NOTE}; in brackets: more than {table.reference}")]
    return Group(*tables, *([_terminal_table(table, others, "The same in transit")] if others else []))


def _terminal_table(table: ScoreTable, estimates: Sequence[str], title: str) -> Table:
    several = len(table.runs) > 1
    title = textwrap.fill(title, 79)
    result = Table(title=title, title_justify="left", title_style="dim", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    result.add_column("")
    if several:
        result.add_column("run", no_wrap=True)
    for name in estimates:
        result.add_column(column_name(name), justify="right")
    for index, row in enumerate(table.rows):
        if row.measure.brief:
            place = index % len(table.runs)
            texts = [_terminal_cell(row, name, changes=several) for name in estimates]
            last = several and place == len(table.runs) - 1
            result.add_row(row.measure.heading if place == 0 else "", *([row.run] * several), *texts, end_section=last)
    return result


def _terminal_cell(row: ScoreRow, estimate: str, *, changes: bool) -> str:
    cell = row.cell(estimate)
    text = number(cell.value, row.measure)
    return f"{text} ({signed(cell.change, row.measure)})" if changes and cell.change.mean is not None else text


def as_markdown(table: ScoreTable) -> str:
    """A Markdown table with all metrics; ends with a newline."""
    heads = ["metric", "run"]
    heads += [part for name in table.estimates for part in _heads(name, table)]
    heads += ["picture over ego alone"]
    lines = ["| " + " | ".join(heads) + " |", "|---|---|" + "---:|" * (len(heads) - 2)]
    for row in table.rows:
        texts = [row.measure.heading, row.run.replace("\\", "\\\\").replace("|", "\\|").replace("\n", " ")]
        for name in table.estimates:
            texts.append(number(row.cell(name).value, row.measure))
            texts += [signed(row.cell(name).change, row.measure)] if table.reference else []
        lines.append("| " + " | ".join([*texts, signed(row.over_alone, row.measure)]) + " |")
    return "\n".join(lines) + "\n"


def _heads(estimate: str, table: ScoreTable) -> Sequence[str]:
    name = column_name(estimate)
    return (name, f"{name} over {table.reference}") if table.reference else (name,)

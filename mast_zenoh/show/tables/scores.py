"""The scores of runs as tidy rows, one per metric, run and estimate, and as a table with a column per estimate."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from rich.console import Group

from mast_zenoh.metrics.estimates import (
    LOCAL,
    MAIN,
    PICTURE,
    PICTURE_ON_ARRIVAL,
    PICTURE_RECEIVED,
    column_name,
    rank_of,
)
from mast_zenoh.metrics.measures import MEASURES, SUMMARY_NAMES, Quantity, metric_named, own_metrics
from mast_zenoh.runs.run import Run
from mast_zenoh.show.number_text import DASH
from mast_zenoh.show.tables.text_table import TextTable

#: In the place of an estimate, the increment of the picture over the ego alone (IoE).
OVER_ALONE = "picture over\nego alone"


class ScoreRow(NamedTuple):
    """One metric of an estimate of a run; None: unknown.

    mean, std: mean and standard deviation over frames, or a run's value;  change: of the mean, over the reference run
    """

    measure: Quantity
    run: str = ""
    estimate: str = ""
    mean: float | None = None
    std: float | None = None
    change: float | None = None

    @property
    def number(self) -> str:
        """The mean as text; a dash if it is not known."""
        return DASH if self.mean is None else f"{self.mean:.{self.measure.digits}f}"

    def signed(self, value: float | None) -> str:
        """A difference as `+1.70` or `\u22120.23`; a dash for what is not known."""
        if value is None:
            return DASH
        rounded = round(value, self.measure.digits) + 0.0  # not a negative zero
        return f"{rounded:+.{self.measure.digits}f}".replace("-", "\u2212")

    @property
    def text(self) -> str:
        """The number with its change, and in a second line its standard deviation."""
        text = self.signed(self.mean) if self.estimate == OVER_ALONE else self.number
        text += "" if self.change is None else f" ({self.signed(self.change)})"
        return text if self.std is None else f"{text}\n± {self.std:.2f}"


def score_of(summary: object, measure: Quantity, run: str = "", estimate: str = "") -> ScoreRow:
    """From metrics.json: {"mean", "std"}, a number, or nothing."""
    if isinstance(summary, Mapping):
        return ScoreRow(measure, run, estimate, summary.get("mean"), summary.get("std"))
    return ScoreRow(measure, run, estimate, float(summary) if isinstance(summary, (int, float)) else None)


class ScoreTable(NamedTuple):
    """Scores by metric, then by run, then by estimate.

    estimates: that have a column, in the order of ESTIMATES;  runs: labels, in order
    reference: the run that changes are over; None: there is none
    """

    rows: list[ScoreRow]
    estimates: tuple[str, ...]
    runs: tuple[str, ...]
    reference: str | None

    def score(self, key: str, run: str, estimate: str) -> ScoreRow:
        """The row of a metric, a run and an estimate; without numbers where there is none."""
        wanted = (key, run, estimate)
        every = (row for row in self.rows if (row.measure.label, row.run, row.estimate) == wanted)
        return next(every, ScoreRow(MEASURES[key], run, estimate))

    def text(self, *, brief: bool = False) -> TextTable:
        """A line per metric and run, and a column per estimate. brief: main metrics, without what is over ego alone"""
        several = len(self.runs) > 1
        columns = self.estimates if brief else (*self.estimates, OVER_ALONE)
        by_line: dict[tuple[Quantity, str], dict[str, str]] = {}
        for row in self.rows:
            if row.measure.brief or not brief:
                by_line.setdefault((row.measure, row.run), {})[row.estimate] = row.text
        lines = [
            [measure.heading, *[run] * several, *(texts.get(name, DASH) for name in columns)]
            for (measure, run), texts in by_line.items()
        ]
        title = "FN, FP, TP: objects per frame, mean over the scored frames"
        title += f"; in brackets: more than {self.reference}" if several else ""
        headings = ["metric", *["run"] * several, *map(column_name, columns)]
        return TextTable(title, "", headings, lines, 1 + several, brief=brief)

    def as_rich(self) -> Group:
        """Main metrics for a terminal of 80 columns, with changes over a reference if any."""
        return self.text(brief=True).as_rich()


def score_table(runs: Mapping[str, Run], reference: str | None = None) -> ScoreTable:
    """The scores of the main agent in one run or several, by label; a run without metrics gets dashes.

    reference: label of the run that changes are over; by default, of several runs, `baseline` or else the first
    """
    if reference is None and len(runs) > 1:
        reference = "baseline" if "baseline" in runs else next(iter(runs))
    agent = next((run.ego for run in runs.values() if run.ego), "ego")
    metrics = [run.files.summary for run in runs.values()]
    summaries = {label: run.files.summary.get("agents", {}).get(agent, {}) for label, run in runs.items()}
    rows = []
    for measure in measures(summaries.values(), own_metrics(metrics)):
        for label, of_run in summaries.items():
            before = summaries[reference] if reference not in (None, label) else {}
            scores = {name: score_of(each.get(measure.label), measure, label, name) for name, each in of_run.items()}
            for name, score in scores.items():
                other = score_of(before.get(name, {}).get(measure.label), measure)
                rows.append(score._replace(change=_difference(score, other)))
            alone, picture = (scores.get(name, ScoreRow(measure)) for name in (LOCAL, PICTURE))
            std = None if picture.std is None else _spread(runs[label], agent, measure.label)
            rows.append(ScoreRow(measure, label, OVER_ALONE, _difference(picture, alone), std))
    return ScoreTable(rows, shown_estimates(metrics, agent), tuple(runs), reference)


def _difference(score: ScoreRow, other: ScoreRow) -> float | None:
    return None if score.mean is None or other.mean is None else score.mean - other.mean


def measures(
    scores: Iterable[Mapping[str, Mapping[str, Any]]], described: Mapping[str, Mapping[str, Any]]
) -> list[Quantity]:
    """The metrics of runs: our own, then the user-defined ones that any of them has.

    described: `own_metrics` of metrics.json
    """
    own = [name for of_run in scores for of_one in of_run.values() for name in of_one if name not in SUMMARY_NAMES]
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


def _spread(run: Run, agent: str, key: str) -> float | None:
    """Standard deviation over scored frames of a metric of an agent's picture less that of its own tracks."""
    counts, (first, last) = run.files.counts, run.scored_frames or (-np.inf, np.inf)
    if counts is None or key not in counts:
        return None
    scored = (counts["agent"] == agent) & (counts["frame"] >= first) & (counts["frame"] <= last)
    picture, alone = (np.flatnonzero(scored & (counts["estimator"] == name)) for name in (PICTURE, LOCAL))
    _, here, there = np.intersect1d(counts["frame"][picture], counts["frame"][alone], return_indices=True)
    differences = counts[key][picture[here]].astype(np.float64) - counts[key][alone[there]]
    return float(np.std(differences)) if len(differences) else None

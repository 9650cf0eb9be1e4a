"""The summary table of one or more runs: one row per run, for the terminal, Markdown and HTML alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table

from mast_zenoh.metrics import increments

#: Stands for a number that is not known.
DASH = "\u2013"


@dataclass(frozen=True, slots=True)
class Figures:
    """Mean and standard deviation over frames; None: not known."""

    mean: float | None = None
    std: float | None = None

    def __str__(self) -> str:
        return DASH if self.mean is None else f"{self.mean:.2f}"


@dataclass(frozen=True, slots=True)
class Scores:
    """What one estimator scored: objects per frame missed (fn), false (fp), matched (tp); RMSE of the matched, m."""

    fn: Figures = Figures()
    fp: Figures = Figures()
    tp: Figures = Figures()
    rmse_m: float | None = None
    id_switches: int | None = None

    @classmethod
    def of(cls, summary: Mapping[str, Any]) -> Scores:
        """From `metrics["agents"][agent][estimator]`; what is absent or null there is None here."""
        told = [summary.get(name, {}) for name in ("fn", "fp", "tp")]
        fn, fp, tp = (Figures(each.get("mean"), each.get("std")) for each in told)
        return cls(fn, fp, tp, summary.get("rmse_m"), summary.get("id_switches"))

    @property
    def rmse(self) -> str:
        """The RMSE as text, without its unit."""
        return DASH if self.rmse_m is None else f"{self.rmse_m:.2f}"


#: What is added to FN and FP per frame.
Increment = tuple[Figures, Figures]


@dataclass(frozen=True, slots=True)
class SummaryRow:
    """One run, seen from one agent.

    picture, local:  what the command centre's picture and the agent's own tracks scored
    over_baseline:   the picture less the baseline's picture (the paper's IoB); None in the baseline itself
    over_local:      the picture less the agent's own tracks in the same run (IoE)
    """

    run: str
    picture: Scores
    local: Scores
    over_baseline: Increment | None
    over_local: Increment


def summary_table(
    metrics: Mapping[str, Mapping[str, Any]],
    *,
    counts: Mapping[str, Mapping[str, NDArray[Any]] | None] | None = None,
    agent: str = "ego",
    baseline: str | None = None,
) -> list[SummaryRow]:
    """One row per run, in order.

    metrics:  by the run's label, what metrics.json holds; `{}` gives a row of dashes
    counts:   by the run's label, the columns of metrics.parquet: only these say how increments spread over frames
    agent:    whose scores
    baseline: label of the run that the others are compared with; by default `baseline` or, without it, the first
    Raises ValueError when `baseline` is not among the runs.
    """
    scores = {}
    for label, summary in metrics.items():
        mine = summary.get("agents", {}).get(agent, {})
        scores[label] = Scores.of(mine.get("picture", {})), Scores.of(mine.get("local", {}))
    reference = baseline or ("baseline" if "baseline" in scores else next(iter(scores), None))
    if baseline is not None and baseline not in scores:
        raise ValueError(f"baseline: found {baseline!r}, expected one of {', '.join(scores)}")
    scored = {label: _scored(table, metrics[label]) for label, table in (counts or {}).items() if table is not None}
    rows = []
    for label, (picture, local) in scores.items():
        over, alone = _difference(picture, scores[reference or label][0]), _difference(picture, local)
        if label in scored and reference in scored:
            over, alone = _with_spread(over, alone, scored[reference], scored[label], agent)
        rows.append(SummaryRow(label, picture, local, None if label == reference else over, alone))
    return rows


def _scored(counts: Mapping[str, NDArray[Any]], metrics: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """The rows of the frames that the means are over: `scored_frames`, first and last, where metrics.json has them."""
    first, last = metrics.get("scored_frames") or (-np.inf, np.inf)
    inside = (counts["frame"] >= first) & (counts["frame"] <= last)
    return {name: column[inside] for name, column in counts.items()}


def _difference(one: Scores, other: Scores) -> Increment:
    pairs = ((one.fn.mean, other.fn.mean), (one.fp.mean, other.fp.mean))
    fn, fp = (Figures(None if a is None or b is None else a - b) for a, b in pairs)
    return fn, fp


def _with_spread(
    over: Increment, alone: Increment, baseline: dict[str, NDArray[Any]], run: dict[str, NDArray[Any]], agent: str
) -> tuple[Increment, Increment]:
    """The two increments, with their standard deviation over frames where the counts tell."""
    try:
        spread = increments(baseline, run, agent=agent)
    except ValueError:  # an interrupted run may lack a series
        return over, alone
    pairs = [
        tuple(Figures(value.mean, spread[name][which]["std"]) for value, name in zip(pair, ("fn", "fp"), strict=True))
        for pair, which in ((over, "iob"), (alone, "ioe"))
    ]
    return (pairs[0][0], pairs[0][1]), (pairs[1][0], pairs[1][1])


#: Groups of columns and the columns in each; `cells` fills them.
HEADINGS = (
    ("picture", ("FN", "FP", "TP", "RMSE m", "ID sw.")),
    ("ego alone", ("FN", "FP", "TP")),
    ("over baseline", ("ΔFN", "ΔFP")),
    ("over ego alone", ("ΔFN", "ΔFP")),
)


def signed(value: float | None) -> str:
    """A difference as `+1.70` or `−0.23`; a dash for None."""
    return DASH if value is None else f"{value:+.2f}".replace("-", "\u2212")


def cells(row: SummaryRow) -> list[list[str]]:
    """The texts of a row, by the groups of HEADINGS."""
    p, q = row.picture, row.local
    switches = DASH if p.id_switches is None else str(p.id_switches)
    return [
        [str(p.fn), str(p.fp), str(p.tp), p.rmse, switches],
        [str(q.fn), str(q.fp), str(q.tp)],
        [signed(value.mean) for value in row.over_baseline or (Figures(), Figures())],
        [signed(value.mean) for value in row.over_local],
    ]


def as_rich(rows: Sequence[SummaryRow]) -> Group:
    """Two tables that fit a terminal of 80 columns: scores, then increments (left out when there is one run)."""
    tables = []
    for groups in ((0, 1), (2, 3)) if len(rows) > 1 else ((0, 1),):
        title = "FN, FP, TP: objects per frame, mean over frames" if groups[0] == 0 else None
        table = Table(title=title, title_justify="left", title_style="dim", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
        table.add_column("", justify="left", no_wrap=True)
        for group in groups:
            name, columns = HEADINGS[group]
            for index, column in enumerate(columns):
                table.add_column(f"{name if index == 0 else ''}\n{column}", justify="right")
        for row in rows:
            texts = cells(row)
            table.add_row(row.run, *(text for group in groups for text in texts[group]))
        tables.append(table)
    return Group(*tables)


def as_markdown(rows: Sequence[SummaryRow]) -> str:
    """A Markdown table with all columns; ends with a newline."""
    heads = ["run", *(f"{name} {column}" for name, columns in HEADINGS for column in columns)]
    lines = ["| " + " | ".join(heads) + " |", "|---|" + "---:|" * (len(heads) - 1)]
    for row in rows:
        label = row.run.replace("\\", "\\\\").replace("|", "\\|").replace("\n", " ")
        lines.append("| " + " | ".join([label, *(text for group in cells(row) for text in group)]) + " |")
    return "\n".join(lines) + "\n"

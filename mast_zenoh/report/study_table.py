"""The tables of a study: for the terminal, as Markdown, CSV and LaTeX. The same numbers everywhere."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table

from mast_zenoh.metrics import CAUSES
from mast_zenoh.report.study_rows import (
    INCREMENTS,
    PICTURE,
    Estimate,
    StudyRow,
    number,
    over_frames,
    over_trials,
    shares,
)
from mast_zenoh.report.table import DASH

CAPTION = "mean ± std over the frames of all trials; below, mean over trials [95 % bootstrap interval], paired"
_WHAT = {"fp": "false tracks", "fn": "missed objects"}


def as_rich(rows: Sequence[StudyRow], baseline: str) -> Group:
    """Tables that fit a terminal of 80 columns: increments, scores of the picture, shares of causes."""
    attacked = [row for row in rows if row.label != baseline]
    tables = []
    if attacked:
        for index, groups in enumerate((INCREMENTS[:2], INCREMENTS[2:])):
            metrics = [metric for _, columns in groups for metric in columns]
            title = f"What an attack adds, objects per frame: {CAPTION}" if index == 0 else None
            cells = [(row.label, [_both(row.get(metric)) for _, metric in metrics]) for row in attacked]
            tables.append(_rich(title, [heading for heading, _ in metrics], cells))
    metrics = list(PICTURE[0][1])
    cells = [(row.label, [number(row.get(metric).mean) for _, metric in metrics]) for row in rows]
    tables.append(_rich("The ego's picture, mean", [heading.replace(" ", "\n") for heading, _ in metrics], cells))
    for what, name in _WHAT.items():
        causes, parts = _shares(rows, what)
        headings = [cause.replace("occlusion or range", "out of\nsight") for cause in causes]
        tables.append(_rich(f"Causes of {name}, share", headings, parts))
    return Group(*tables)


def _both(estimate: Estimate) -> str:
    """The mean over trials is left out where it is that over frames: trials of one length."""
    trials = over_trials(estimate)
    return f"{over_frames(estimate)}\n{trials.removeprefix(number(estimate.mean)).strip()}"


def _rich(title: str | None, headings: Sequence[str], cells: Iterable[tuple[str, Sequence[str]]]) -> Table:
    table = Table(title=title, title_justify="left", title_style="dim", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("", no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right")
    for label, texts in cells:
        table.add_row(label, *texts)
    return table


def _shares(rows: Sequence[StudyRow], what: str) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """The causes that occur, and for each configuration their shares as text."""
    found = {row.label: shares(row, what) for row in rows}
    causes = [cause for cause in CAUSES if any(cause in mine for mine in found.values())]
    return causes, [
        (label, [f"{100.0 * mine[cause]:.1f} %" if cause in mine else DASH for cause in causes])
        for label, mine in found.items()
    ]


def as_markdown(rows: Sequence[StudyRow], baseline: str) -> str:
    """Markdown: increments over frames, increments over trials, scores of the picture, shares of causes."""
    attacked = [row for row in rows if row.label != baseline]
    metrics = [metric for _, columns in INCREMENTS for metric in columns]
    parts = []
    for title, text in (
        ("What an attack adds: mean ± standard deviation over the frames of all trials", over_frames),
        ("The same: mean over trials, each paired with its baseline, and 95 % bootstrap interval", over_trials),
    ):
        cells = [(row.label, [text(row.get(metric)) for _, metric in metrics]) for row in attacked]
        parts += [f"## {title}", "", *_markdown([heading for heading, _ in metrics], cells), ""]
    metrics = list(PICTURE[0][1])
    cells = [(row.label, [over_trials(row.get(metric)) for _, metric in metrics]) for row in rows]
    parts += ["## The ego's picture", "", *_markdown([heading for heading, _ in metrics], cells), ""]
    for what, name in _WHAT.items():
        causes, shared = _shares(rows, what)
        parts += [f"## Causes of {name}", "", *_markdown(causes, shared), ""]
    return "\n".join(parts)


def _markdown(headings: Sequence[str], cells: Iterable[tuple[str, Sequence[str]]]) -> list[str]:
    def line(texts: Sequence[str]) -> str:
        return "| " + " | ".join(text.replace("|", "\\|") for text in texts) + " |"

    rule = "|---|" + "---:|" * len(headings)
    return [line(["", *headings]), rule, *(line([label, *texts]) for label, texts in cells)]


def as_csv(rows: Sequence[StudyRow]) -> str:
    """A line for each configuration and metric, all digits; what is not known is empty."""
    page = io.StringIO()
    writer = csv.writer(page, lineterminator="\n")
    names = ("mean", "std", "trial_mean", "low", "high")
    writer.writerow(["configuration", "metric", "mean", "std_over_frames", "mean_over_trials", "low", "high", "trials"])
    for row in rows:
        for metric, estimate in row.estimates.items():
            values = [getattr(estimate, name) for name in names]
            texts = ["" if value != value else repr(float(value)) for value in values]
            writer.writerow([row.label, metric, *texts, estimate.trials])
    return page.getvalue()


def as_latex(rows: Sequence[StudyRow], baseline: str) -> str:
    """A tabular that needs no package: for each configuration what the attack adds, and its intervals below."""
    metrics = [metric for _, columns in INCREMENTS for metric in columns]
    groups = " & ".join(rf"\multicolumn{{{len(columns)}}}{{c}}{{{name}}}" for name, columns in INCREMENTS)
    lines = [
        f"% {CAPTION}",
        r"\begin{tabular}{l" + "r" * len(metrics) + "}",
        r"\hline",
        rf" & {groups} \\",
        " & " + " & ".join(_short(heading) for heading, _ in metrics) + r" \\",
        r"\hline",
    ]
    for row in (row for row in rows if row.label != baseline):
        above = [over_frames(row.get(metric)) for _, metric in metrics]
        below = [over_trials(row.get(metric)) for _, metric in metrics]
        for label, texts in ((row.label, above), ("", below)):
            lines.append(" & ".join([_tex(label), *(f"${_tex(text)}$" for text in texts)]) + r" \\")
    return "\n".join([*lines, r"\hline", r"\end{tabular}", ""])


def _short(heading: str) -> str:
    """A heading without what that of its group says already: "IoE", but "CAFN IoB"."""
    kind, which = heading.split()
    return heading if kind.startswith("CA") else which


def _tex(text: str) -> str:
    """Text that LaTeX prints as it is."""
    for plain, made in (("\u2212", "-"), ("±", r"\pm"), (DASH, r"\mbox{--}"), ("_", r"\_"), ("%", r"\%"), ("&", r"\&")):
        text = text.replace(plain, made)
    return text

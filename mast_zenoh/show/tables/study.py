"""The tables of a study, shared by terminal, Markdown, LaTeX, CSV and HTML."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from rich.console import Group
from rich.text import Text

from mast_zenoh.metrics import CAUSES
from mast_zenoh.metrics.measures import SUMMARY_NAMES
from mast_zenoh.metrics.study_results import Row, Statistic, StudyFacts, StudySeries, shares
from mast_zenoh.show.findings.of_study import (
    Comparisons,
    compare,
    comparisons_made,
    conclusions,
    reservations,
    titled,
)
from mast_zenoh.show.findings.words import paragraph
from mast_zenoh.show.number_text import DASH, digits, interval, number, over_frames, over_trials, value
from mast_zenoh.show.study_columns import (
    ACHIEVED,
    ADDED,
    ALL_SCORES,
    COOPERATION,
    DEFENCE,
    ESTIMATORS,
    MOSTLY_ZERO_NOTE,
    PAPER,
    SCORES,
    Groups,
    attacks_differ,
    present,
    series_of,
    unchanged,
)
from mast_zenoh.show.tables.text_table import ResultTables, TextTable, csv_text, wrapped

_ALL = "all"
_WRONG = {"fp": "false objects", "fn": "missed objects"}
_PAIRED = "Difference from the baseline of the same scene and seed; mean and 95 % interval over seeds of these scenes."


class Sections(NamedTuple):
    """The non-empty tables of a study: what is added to the baseline, the scores of each estimate, and all others."""

    added: list[TextTable]
    scores: list[TextTable]
    others: list[TextTable]

    @property
    def every(self) -> list[TextTable]:
        """All of them, one after the other."""
        return [*self.added, *self.scores, *self.others]


def sections(rows: Sequence[Row], facts: StudyFacts, comparisons: Comparisons) -> Sections:
    """All non-empty tables of a study."""
    attacked = [row for row in rows if row.configuration != facts.baseline]
    title = difference_title(rows, facts.baseline)
    defended, apart = (
        [row for row in rows if any(series.estimator in names for series in row.numbers)]
        for names in (("defence",), ("pictures", "channel"))
    )
    added = [_paper(title, attacked, comparisons), *_added(title, attacked, comparisons)]
    added += [
        _table(
            f"{title}, to other scenes: {group[0]}", _TO_OTHER_SCENES, (group,), attacked, _to_scenes, terminal=False
        )
        for group in ADDED
        if any(not math.isnan(row.get(series).scenes_low) for row in attacked for series in group[1].values())
    ]
    scores = [_table(f"Scores: {group[0]}", _SCORED, (group,), rows, _cell_of, brief=True) for group in ALL_SCORES]
    others = [*_achieved(attacked), _table("What the defence did", paragraph("defended"), DEFENCE, defended, _cell_of)]
    others += [
        _table("Pictures and radio channel", paragraph("pictures_and_channel"), COOPERATION, apart, _cell_of),
        _others(rows, facts.units),
    ]
    others += [_causes(rows, estimator, outcome) for estimator in ("picture", "mission") for outcome in _WRONG]
    return Sections(
        *([each for each in tables if each.lines and len(each.headings) > 1] for tables in (added, scores, others))
    )


_TO_OTHER_SCENES = "The same means, with the 95 % interval to other scenes drawn like these, and other seeds."
_PER_FRAME = "Mean and standard deviation over the frames of all trials; below, the mean over seeds and its interval."
_SCORED = "FN, FP, TP: objects per frame missed, false and matched. Mean and 95 % interval over seeds."


def difference_title(rows: Sequence[Row], baseline: str) -> str:
    """How the titles of tables of differences from the baseline begin."""
    return "What the attack adds" if attacks_differ(rows, baseline) else "Difference from the baseline"


def side_by_side(rows: Sequence[Row]) -> TextTable:
    """The scores of all estimates in one table, a group of columns for each."""
    return _table("", "", SCORES, rows, _cell_of)


def _paper(title: str, rows: Sequence[Row], comparisons: Comparisons) -> TextTable:
    caption = paragraph("paper_increments")

    def cell(row: Row, series: StudySeries) -> str:
        estimate = row.get(series)
        same = number(estimate.value) in (number(estimate.mean), DASH)
        below = interval(estimate) if same else over_trials(estimate)
        return _cell(over_frames(estimate), below, marked=comparisons.remains(row, series))

    return _table(f"{title}, in the paper's columns", caption, PAPER, rows, cell)


def _added(title: str, rows: Sequence[Row], comparisons: Comparisons) -> list[TextTable]:
    """A table per estimate that differs; the terminal shows the ego's."""
    return [
        _table(
            *(f"{title}: {group[0]}", _PAIRED, (group,), rows),
            lambda row, series: _over_trials(row.get(series), marked=comparisons.remains(row, series)),
            terminal=estimator != "picture",
        )
        for estimator, group in zip(ESTIMATORS, ADDED, strict=True)
        if not unchanged(rows, group[1])
    ]


def _achieved(rows: Sequence[Row]) -> list[TextTable]:
    """Achievements of all adversaries together, and of each one."""
    series = list(dict.fromkeys(each for row in rows for each in row.numbers if each.estimator == ACHIEVED))
    names = list(dict.fromkeys(each.metric for each in series))
    all_adversaries = [each.owner for each in series if each.owner == _ALL][:1]
    single_adversaries = list(dict.fromkeys(each.owner for each in series if each.owner != _ALL))
    caption = "Mean over trials, or success rate of yes-or-no values; 95 % interval over seeds of these scenes."
    headings = ["", *(name.replace("_", " ") for name in names)]
    tables = []
    for title, group in (
        ("What the attack achieved", all_adversaries),
        ("What each adversary achieved", single_adversaries),
    ):
        lines = [
            [row.configuration if owner == _ALL else f"{row.configuration}: {owner}", *cells]
            for row in rows
            for owner in group
            if {*(cells := [_over_trials(row.get(StudySeries(owner, ACHIEVED, name))) for name in names])} != {DASH}
        ]
        terminal = group is all_adversaries or not all_adversaries
        tables.append(TextTable(title, caption, headings, lines, 1, terminal=terminal))
    return tables


def _others(rows: Sequence[Row], units: Mapping[str, str]) -> TextTable:
    """Other numbers of the ego, such as user-defined metrics, a line each."""
    in_tables = {(each.estimator, each.metric) for each in series_of((*ALL_SCORES, *ADDED, *PAPER))}
    series = [
        each
        for each in dict.fromkeys(each for row in rows for each in row.numbers)
        if not each.owner and (each.estimator, each.metric) not in in_tables and " " not in each.metric
    ]
    lines = [
        [f"{each.estimator} {each.metric}{units.get(each.metric, '')}", *(_over_trials(row.get(each)) for row in rows)]
        for each in series
        if not (each.metric.endswith("_iob") and all(row[each].unchanged for row in rows if each in row.numbers))
    ]
    caption = paragraph("other_numbers")
    if any(row.get(each).mostly_zero for row in rows for each in series):
        caption = f"{caption} {MOSTLY_ZERO_NOTE}"
    headings = ["", *(row.configuration for row in rows)]
    return TextTable("Other numbers of the ego", caption, headings, lines, 1, terminal=False)


def _causes(rows: Sequence[Row], estimator: str, outcome: str) -> TextTable:
    """The causes that occur, with their shares."""
    parts = {row.configuration: shares(row, outcome, estimator) for row in rows}
    causes = [cause for cause in CAUSES if any(cause in row_shares for row_shares in parts.values())]
    lines = [
        [label, *(f"{100.0 * of_row[cause]:.1f} %" if cause in of_row else DASH for cause in causes)]
        for label, of_row in parts.items()
    ]
    title = f"Causes of {_WRONG[outcome]}, share: {ESTIMATORS[estimator]}"
    return TextTable(title, "", ["", *causes], lines, 1, terminal=estimator == "picture")


def _over_trials(estimate: Statistic, *, marked: bool = False) -> str:
    return _cell(value(estimate), interval(estimate), marked=marked)


def _cell_of(row: Row, series: StudySeries) -> str:
    return _over_trials(row.get(series))


def _to_scenes(row: Row, series: StudySeries) -> str:
    """With the interval to other scenes."""
    return _cell(value(row.get(series)), interval(row.get(series), scenes=True))


def _cell(text: str, below: str, *, marked: bool = False) -> str:
    """A number, with a mark if it is distinguishable from 0, and the text below it."""
    return f"{text}{'*' if marked else ''}\n{below}".rstrip("\n")


def _table(
    title: str,
    caption: str,
    groups: Groups,
    rows: Sequence[Row],
    cell: Callable[[Row, StudySeries], str],
    *,
    terminal: bool = True,
    brief: bool = False,
) -> TextTable:
    """A table with a line per configuration, without empty groups."""
    groups = present(rows, groups)
    columns = series_of(groups)
    lines = [[row.configuration, *(cell(row, series) for series in columns)] for row in rows]
    headings = ["", *(heading for _, group_columns in groups for heading in group_columns)]
    of_columns = ["", *(name for name, group_columns in groups for _ in group_columns)]
    if any(row.get(series).mostly_zero for row in rows for series in columns):
        caption = f"{caption} {MOSTLY_ZERO_NOTE}"
    return TextTable(
        title, caption, headings, lines if groups else [], 1, groups=of_columns, terminal=terminal, brief=brief
    )


def as_rich(rows: Sequence[Row], facts: StudyFacts) -> Group:
    """Failures, the result in words, and tables for a terminal of 80 columns."""
    comparisons = compare(rows, facts.baseline)
    parts: list[Text | Group] = [Text("")]
    if facts.failures:
        parts.append(_wrapped(f"{facts.failures}.", "bold red"))
    titled_rows, titled_facts = titled(rows, facts)
    sentences = _sentences(titled_rows, titled_facts, compare(titled_rows, titled_facts.baseline))
    parts += [_wrapped(sentence) for sentence in (*sentences, *_labels(rows))]
    for table in sections(rows, facts, comparisons).every:
        if table.terminal:
            brief = table._replace(title=f"{table.title}, mean", about="") if table.brief else table
            parts += [Text(""), brief.as_rich()]
    return Group(*parts, Text(""), _wrapped(comparisons_made(comparisons)))


def _labels(rows: Sequence[Row]) -> list[str]:
    """Explains the numbers in the labels of terminal tables."""
    names = dict.fromkeys((row.run, *row.point) for row in rows if row.point)
    return [f"Labels in tables: {'-'.join(parts)}." for parts in names]


def _sentences(rows: Sequence[Row], facts: StudyFacts, comparisons: Comparisons) -> list[str]:
    """The result in words, a paragraph each."""
    headline, reading, _ = conclusions(rows, facts, comparisons)
    return [" ".join([f"{facts.size}.", f"{headline}.", *reading]), *reservations(rows, facts)]


def _wrapped(text: str, style: str = "") -> Text:
    return Text(wrapped(text), style=style)


def as_markdown(rows: Sequence[Row], facts: StudyFacts) -> str:
    """All tables as Markdown, failed trials first; ends with a newline."""
    rows, facts = titled(rows, facts)
    comparisons = compare(rows, facts.baseline)
    sentences = [*_sentences(rows, facts, comparisons), comparisons_made(comparisons)]
    if facts.failed:
        cells = [[f.configuration, f.scene, str(f.seed), f.error, f"`{f.command}`"] for f in facts.failed]
        failed = TextTable("", "", ["", "scene", "seed", "error", "run it alone"], cells, 5)
        sentences = [f"## {facts.failures}", failed.markdown(), *sentences]
    tables = sections(rows, facts, comparisons).every
    return ResultTables(facts.name, "\n\n".join(sentences), facts.size, tables, ((), ()), []).as_markdown()


#: The numbers of an estimate in table.csv: heading and field.
_NUMBERS = {"mean": "mean", "std_over_frames": "std", "mean_over_trials": "value"} | {
    name: name for name in ("low", "high", "scenes_low", "scenes_high", "p", "zero_share", "zero_low", "zero_high")
}


def as_csv(rows: Sequence[Row], facts: StudyFacts) -> str:
    """A line per configuration and series, with all digits; unknown numbers are empty.

    p_holm is p adjusted for all contrasts of the tables (`compare`), and empty for other series.

    Columns:
    configuration: label; a column for each parameter of a grid follows it
    who, estimator, metric: as in results.parquet
    mean, std_over_frames: over the frames of all trials
    mean_over_trials, low, high: mean over seeds, and its 95 % interval
    scenes_low, scenes_high: the same interval, to other scenes as well; from five scenes on
    p: of a difference from the baseline, see docs/how-to-studies.md
    zero_share, zero_low, zero_high: share of the trials in which a difference is 0, and its exact 95 % interval
    p_holm: p adjusted for all contrasts of the tables
    scenes, seeds, seeds_left_out: how many count; seeds without a value in some scene
    """
    adjusted = compare(rows, facts.baseline).adjusted
    parameters = list(dict.fromkeys(name for row in rows for name in row.point))
    series_names = ("who", "estimator", "metric")
    counts = ("scenes", "seeds", "seeds_left_out")
    headings = ["configuration", *parameters, *series_names, *_NUMBERS, "p_holm", *counts]
    lines = [
        [
            *(row.configuration, *(row.of.get(name, "") for name in parameters)),
            *(series.owner or facts.ego, series.estimator, series.metric),
            *digits(*(getattr(each, field) for field in _NUMBERS.values())),
            *digits(adjusted.get((row.configuration, series), math.nan)),
            *(each.scenes, each.seeds, each.seeds_left_out(len(facts.seeds))),
        ]
        for row in rows
        for series, each in row.numbers.items()
    ]
    return csv_text(headings, lines)


def as_latex(rows: Sequence[Row], facts: StudyFacts) -> str:
    """The paper's increments, then all metrics of each estimate: over frames, and below over trials."""
    rows, facts = titled(rows, facts)
    attacked = [row for row in rows if row.configuration != facts.baseline]
    paper = _paper(difference_title(rows, facts.baseline), attacked, compare(rows, facts.baseline))
    every = [
        _table(
            f"{name}: all metrics",
            _PER_FRAME,
            ((name, {**scores, **_of_users(rows, scores, facts.units)}),),
            rows,
            _both_spreads,
        )
        for name, scores in ALL_SCORES
    ]
    size = "; ".join(filter(None, (facts.size, facts.failures)))
    return ResultTables(facts.name, "", size, [each for each in (paper, *every) if each.lines], ((), ()), []).as_latex()


def _both_spreads(row: Row, series: StudySeries) -> str:
    return f"{over_frames(row.get(series))}\n{over_trials(row.get(series))}"


def _of_users(
    rows: Sequence[Row], scores: Mapping[str, StudySeries], units: Mapping[str, str]
) -> dict[str, StudySeries]:
    """Columns of the metrics of an estimate that are not among its scores: the user's own."""
    estimator = next(iter(scores.values())).estimator
    known = {series.metric for series in scores.values()} | set(SUMMARY_NAMES)
    own = dict.fromkeys(
        series
        for row in rows
        for series, each in row.numbers.items()
        if (series.owner, series.estimator) == ("", estimator) and series.metric.isidentifier() and not each.rate
    )
    return {
        f"{series.metric}{units.get(series.metric, '')}": series
        for series in own
        if series.metric not in known and not series.metric.endswith("_iob")
    }

"""The tables of a study as cells of text, shared by terminal, Markdown and HTML."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from mast_zenoh.metrics import CAUSES
from mast_zenoh.report.narrative.study_comparisons import Comparisons
from mast_zenoh.report.tables.scores import DASH
from mast_zenoh.report.tables.study_rows import (
    ADDED,
    ALL_SCORES,
    DEFENCE,
    ESTIMATORS,
    MOSTLY_ZERO,
    PAPER,
    SCORES,
    Column,
    Estimate,
    Groups,
    Series,
    StudyRow,
    bounds,
    columns_of,
    number,
    over_frames,
    over_trials,
    present,
    shares,
    value,
)

_ACHIEVED, _ALL = "achieved", "all"
_WRONG = {"fp": "false objects", "fn": "missed objects"}
_PAIRED = "Difference from the baseline of the same scene and seed; mean and 95 % interval over seeds of these scenes."


@dataclass(frozen=True, slots=True)
class Cell:
    """A number as text.

    below: the text below it; marked: whether it is distinguishable from 0
    """

    text: str = DASH
    below: str = ""
    marked: bool = False


@dataclass(frozen=True, slots=True)
class Section:
    """One table.

    groups:   of columns: a name ("" where there is one group) and the headings
    lines:    a label, and a cell for each column
    terminal: whether the terminal shows it; brief: whether it does so without the text below numbers
    """

    title: str
    caption: str
    groups: tuple[tuple[str, tuple[str, ...]], ...]
    lines: tuple[tuple[str, tuple[Cell, ...]], ...]
    terminal: bool = True
    brief: bool = False

    @property
    def headings(self) -> list[str]:
        """The headings of all columns."""
        return [heading for _, headings in self.groups for heading in headings]


def sections(rows: Sequence[StudyRow], baseline: str, comparisons: Comparisons) -> list[Section]:
    """All non-empty tables of a study."""
    attacked = [row for row in rows if row.label != baseline]
    tables = [_paper(attacked, comparisons), *_added(attacked, comparisons), *_to_other_scenes(attacked)]
    tables += [_scores(rows, group) for group in ALL_SCORES]
    tables += [*_achieved(attacked), _defence(rows), _others(rows)]
    tables += [_causes(rows, estimator, outcome) for estimator in ("picture", "mission") for outcome in _WRONG]
    return [section for section in tables if section.lines and section.headings]


def side_by_side(rows: Sequence[StudyRow]) -> Section:
    """The scores of all estimates in one table, a group of columns for each."""
    return _table("", "", SCORES, rows, lambda row, column: _over_trials(column.of(row)))


def _paper(rows: Sequence[StudyRow], comparisons: Comparisons) -> Section:
    caption = (
        "Objects per frame: mean ± standard deviation over the frames of all trials; below it the 95 % interval of the "
        "mean over seeds of these scenes, each trial paired with its baseline, after that mean where it differs."
    )

    def cell(row: StudyRow, column: Column) -> Cell:
        estimate = column.of(row)
        same = number(estimate.trial_mean) in (number(estimate.mean), DASH)
        below = bounds(estimate) if same else over_trials(estimate)
        return Cell(over_frames(estimate), below, comparisons.remains(row, column))

    return _table("What the attack adds, in the paper's columns", caption, PAPER, rows, cell)


def _added(rows: Sequence[StudyRow], comparisons: Comparisons) -> list[Section]:
    """A table per estimate that an attack changes; the terminal shows the ego's."""
    tables = []
    for estimator, group in zip(ESTIMATORS, ADDED, strict=True):
        section = _table(
            f"What the attack adds: {group[0]}",
            _PAIRED,
            (group,),
            rows,
            lambda row, column: replace(_over_trials(column.of(row)), marked=comparisons.remains(row, column)),
        )
        if not all(column.of(row).unchanged for row in rows for column in group[1]):
            tables.append(replace(section, terminal=estimator != "picture"))
    return tables


def _to_other_scenes(rows: Sequence[StudyRow]) -> list[Section]:
    """Increments with intervals to other scenes, for estimates that have them."""
    caption = "The same means, with the 95 % interval to other scenes drawn like these, and other seeds."
    groups = [group for group in ADDED if any(not math.isnan(c.of(row).scenes_low) for row in rows for c in group[1])]
    return [
        _table(
            f"What the attack adds, to other scenes: {group[0]}",
            caption,
            (group,),
            rows,
            lambda row, column: Cell(value(column.of(row)), bounds(column.of(row), scenes=True)),
            terminal=False,
        )
        for group in groups
    ]


def _scores(rows: Sequence[StudyRow], group: tuple[str, tuple[Column, ...]]) -> Section:
    caption = "FN, FP, TP: objects per frame missed, false and matched. Mean and 95 % interval over seeds."
    title = f"Scores: {group[0]}"
    return _table(title, caption, (group,), rows, lambda row, column: _over_trials(column.of(row)), brief=True)


def _achieved(rows: Sequence[StudyRow]) -> list[Section]:
    """Achievements of all adversaries together, and of each one."""
    series = list(dict.fromkeys(each for row in rows for each in row.estimates if each.estimator == _ACHIEVED))
    names = list(dict.fromkeys(each.metric for each in series))
    all_adversaries = [each.owner for each in series if each.owner == _ALL][:1]
    single_adversaries = list(dict.fromkeys(each.owner for each in series if each.owner != _ALL))
    caption = "Mean over trials, or success rate of yes-or-no values; 95 % interval over seeds of these scenes."
    headings = (("", tuple(name.replace("_", " ") for name in names)),)
    tables = []
    for title, group in (
        ("What the attack achieved", all_adversaries),
        ("What each adversary achieved", single_adversaries),
    ):
        cells = {
            row.label if owner == _ALL else f"{row.label}: {owner}": tuple(
                _over_trials(row.get(name, _ACHIEVED, owner)) for name in names
            )
            for row in rows
            for owner in group
        }
        lines = [(label, line) for label, line in cells.items() if any(cell != Cell() for cell in line)]
        tables.append(
            Section(title, caption, headings, tuple(lines), terminal=group is all_adversaries or not all_adversaries)
        )
    return tables


def _defence(rows: Sequence[StudyRow]) -> Section:
    caption = (
        "Agents suspended, and objects per frame withheld from the picture; mean and 95 % interval over seeds of these "
        "scenes. The delay is from an agent's first lie to its suspension, in trials in which one is suspended."
    )
    defended = [row for row in rows if any(series.estimator == "defence" for series in row.estimates)]
    return _table("What the defence did", caption, DEFENCE, defended, lambda row, column: _over_trials(column.of(row)))


def _others(rows: Sequence[StudyRow]) -> Section:
    """Other numbers of the ego, such as user-defined metrics, a line each."""
    table_series = {(column.estimator, column.metric) for column in columns_of((*ALL_SCORES, *ADDED, *PAPER))}
    series = [
        each
        for each in dict.fromkeys(each for row in rows for each in row.estimates)
        if each.owner == rows[0].ego and (each.estimator, each.metric) not in table_series and " " not in each.metric
    ]

    def cells(each: Series) -> tuple[Cell, ...]:
        return tuple(_over_trials(row.estimates.get(each, Estimate())) for row in rows)

    lines = [
        (f"{each.estimator} {each.metric}", cells(each))
        for each in series
        if not (
            each.metric.endswith("_iob") and all(row.estimates[each].unchanged for row in rows if each in row.estimates)
        )
    ]
    caption = (
        "Mean and 95 % interval over seeds of these scenes. Names that end in _iob are differences from the baseline, "
        "left out where there is none in any trial."
    )
    if any(row.estimates[each].mostly_zero for row in rows for each in series if each in row.estimates):
        caption = f"{caption} {MOSTLY_ZERO}"
    return Section(
        "Other numbers of the ego", caption, (("", tuple(row.label for row in rows)),), tuple(lines), terminal=False
    )


def _causes(rows: Sequence[StudyRow], estimator: str, outcome: str) -> Section:
    """The causes that occur, with their shares."""
    parts = {row.label: shares(row, outcome, estimator) for row in rows}
    causes = [cause for cause in CAUSES if any(cause in row_shares for row_shares in parts.values())]
    lines = tuple(
        (
            label,
            tuple(Cell(f"{100.0 * row_shares[cause]:.1f} %") if cause in row_shares else Cell() for cause in causes),
        )
        for label, row_shares in parts.items()
    )
    title = f"Causes of {_WRONG[outcome]}, share: {ESTIMATORS[estimator]}"
    return Section(title, "", (("", tuple(causes)),), lines, terminal=estimator == "picture")


def _over_trials(estimate: Estimate) -> Cell:
    return Cell(value(estimate), bounds(estimate))


def _table(
    title: str,
    caption: str,
    groups: Groups,
    rows: Iterable[StudyRow],
    cell: Callable[[StudyRow, Column], Cell],
    *,
    terminal: bool = True,
    brief: bool = False,
) -> Section:
    """A table with a line per configuration, without empty groups."""
    rows = list(rows)
    groups = present(rows, groups)
    columns = columns_of(groups)
    lines = tuple((row.label, tuple(cell(row, column) for column in columns)) for row in rows)
    headings = tuple((name, tuple(column.heading for column in group_columns)) for name, group_columns in groups)
    if any(column.of(row).mostly_zero for row in rows for column in columns):
        caption = f"{caption} {MOSTLY_ZERO}"
    return Section(title, caption, headings, lines if groups else (), terminal, brief)

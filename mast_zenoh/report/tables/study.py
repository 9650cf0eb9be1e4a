"""The tables of a study, shared by terminal, Markdown, LaTeX, CSV and HTML."""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table
from rich.text import Text

from mast_zenoh.metrics import CAUSES
from mast_zenoh.metrics.measures import COLUMNS
from mast_zenoh.metrics.study_results import Estimate, Series, StudyFacts, StudyRow, shares
from mast_zenoh.report.narrative.study import (
    Comparisons,
    compare,
    comparisons_made,
    other_changes,
    reservations,
    result,
    titled,
)
from mast_zenoh.report.tables.study_rows import (
    ACHIEVED,
    ADDED,
    ALL_SCORES,
    COOPERATION,
    DEFENCE,
    ESTIMATORS,
    MOSTLY_ZERO,
    PAPER,
    SCORES,
    Column,
    Groups,
    attacks_differ,
    bounds,
    columns_of,
    over_frames,
    over_trials,
    present,
    unchanged,
    value,
)
from mast_zenoh.report.tables.text_table import DASH, csv_text, digits, number

_ALL = "all"
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

    def parts(self, most: int) -> list[Section]:
        """The table in parts of at most so many columns, of whole groups if possible; the caption is below the last."""
        starts, end = [0], 0
        for _, headings in self.groups:
            wide = math.ceil(len(headings) / math.ceil(len(headings) / most))
            for start in range(0, len(headings), wide):
                size = min(wide, len(headings) - start)
                starts += [end] * (end + size - starts[-1] > most)
                end += size
        columns = [(name, heading) for name, headings in self.groups for heading in headings]
        result = []
        for start, until in itertools.pairwise([*starts, end]):
            groups = itertools.groupby(columns[start:until], key=lambda column: column[0])
            named = tuple((name, tuple(heading for _, heading in of_group)) for name, of_group in groups)
            lines = tuple((label, cells[start:until]) for label, cells in self.lines)
            result.append(replace(self, groups=named, lines=lines, caption=self.caption if until == end else ""))
        return result


def sections(rows: Sequence[StudyRow], baseline: str, comparisons: Comparisons) -> list[Section]:
    """All non-empty tables of a study."""
    attacked = [row for row in rows if row.label != baseline]
    title = difference_title(rows, baseline)
    tables = [_paper(title, attacked, comparisons), *_added(title, attacked, comparisons)]
    tables += _to_other_scenes(title, attacked)
    tables += [_scores(rows, group) for group in ALL_SCORES]
    tables += [*_achieved(attacked), _defence(rows), _cooperation(rows), _others(rows)]
    tables += [_causes(rows, estimator, outcome) for estimator in ("picture", "mission") for outcome in _WRONG]
    return [section for section in tables if section.lines and section.headings]


def difference_title(rows: Sequence[StudyRow], baseline: str) -> str:
    """How the titles of tables of differences from the baseline begin."""
    return "What the attack adds" if attacks_differ(rows, baseline) else "Difference from the baseline"


def side_by_side(rows: Sequence[StudyRow]) -> Section:
    """The scores of all estimates in one table, a group of columns for each."""
    return _table("", "", SCORES, rows, lambda row, column: _over_trials(column.of(row)))


def _paper(title: str, rows: Sequence[StudyRow], comparisons: Comparisons) -> Section:
    caption = (
        "Objects per frame: mean ± standard deviation over the frames of all trials; below it the 95 % interval of the "
        "mean over seeds of these scenes, each trial paired with its baseline, after that mean where it differs."
    )

    def cell(row: StudyRow, column: Column) -> Cell:
        estimate = column.of(row)
        same = number(estimate.trial_mean) in (number(estimate.mean), DASH)
        below = bounds(estimate) if same else over_trials(estimate)
        return Cell(over_frames(estimate), below, comparisons.remains(row, column))

    return _table(f"{title}, in the paper's columns", caption, PAPER, rows, cell)


def _added(title: str, rows: Sequence[StudyRow], comparisons: Comparisons) -> list[Section]:
    """A table per estimate that differs; the terminal shows the ego's."""
    tables = []
    for estimator, group in zip(ESTIMATORS, ADDED, strict=True):
        section = _table(
            f"{title}: {group[0]}",
            _PAIRED,
            (group,),
            rows,
            lambda row, column: replace(_over_trials(column.of(row)), marked=comparisons.remains(row, column)),
        )
        if not unchanged(rows, group[1]):
            tables.append(replace(section, terminal=estimator != "picture"))
    return tables


def _to_other_scenes(title: str, rows: Sequence[StudyRow]) -> list[Section]:
    """Increments with intervals to other scenes, for estimates that have them."""
    caption = "The same means, with the 95 % interval to other scenes drawn like these, and other seeds."
    groups = [group for group in ADDED if any(not math.isnan(c.of(row).scenes_low) for row in rows for c in group[1])]
    return [
        _table(
            f"{title}, to other scenes: {group[0]}",
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
    series = list(dict.fromkeys(each for row in rows for each in row.estimates if each.estimator == ACHIEVED))
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
                _over_trials(row.get(name, ACHIEVED, owner)) for name in names
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


def _cooperation(rows: Sequence[StudyRow]) -> Section:
    caption = "Shares of the agents, of the time, of the frames and of the messages; mean and 95 % interval over seeds."
    apart = [row for row in rows if any(series.estimator in ("pictures", "channel") for series in row.estimates)]
    title = "Pictures and radio channel"
    return _table(title, caption, COOPERATION, apart, lambda row, column: _over_trials(column.of(row)))


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


_WIDTH = 80


def as_rich(rows: Sequence[StudyRow], facts: StudyFacts) -> Group:
    """Failures, the result in words, and tables for a terminal of 80 columns."""
    comparisons = compare(rows, facts.baseline)
    parts: list[Text | Table] = [Text("")]
    if facts.failures:
        parts.append(_wrapped(f"{facts.failures}.", "bold red"))
    titled_rows, titled_facts = titled(rows, facts)
    sentences = _sentences(titled_rows, titled_facts, compare(titled_rows, titled_facts.baseline))
    parts += [_wrapped(sentence) for sentence in (*sentences, *_labels(rows))]
    for section in sections(rows, facts.baseline, comparisons):
        if section.terminal:
            parts += _rich(section)
    return Group(*parts, Text(""), _wrapped(comparisons_made(comparisons)))


def _labels(rows: Sequence[StudyRow]) -> list[str]:
    """Explains the numbers in the labels of terminal tables."""
    names = dict.fromkeys((row.run, *row.point) for row in rows if row.point)
    return [f"Labels in tables: {'-'.join(parts)}." for parts in names]


def _sentences(rows: Sequence[StudyRow], facts: StudyFacts, comparisons: Comparisons) -> list[str]:
    """The result in words, a paragraph each."""
    first = [f"{facts.size}.", result(rows, facts, comparisons), *other_changes(rows, facts, comparisons)]
    return [" ".join(first), *reservations(rows, facts)]


def _wrapped(text: str, style: str = "") -> Text:
    return Text(textwrap.fill(text, _WIDTH), style=style)


def _rich(section: Section) -> Iterator[Text | Table]:
    """A section as tables with as many columns as fit."""
    label_width = max(len(label) for label, _ in section.lines)
    widths = [
        max([len(word) for word in heading.split()] + [_width(cells[index], section) for _, cells in section.lines])
        for index, heading in enumerate(section.headings)
    ]
    yield Text(f"\n{section.title}{', mean' if section.brief else ''}", style="bold")
    if section.caption and not section.brief:
        yield _wrapped(section.caption, "dim")
    start = 0
    while start < len(widths):
        end = start + 1
        while end < len(widths) and label_width + 3 + sum(width + 2 for width in widths[start : end + 1]) <= _WIDTH:
            end += 1
        table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
        table.add_column("", overflow="fold")
        for heading, width in zip(section.headings[start:end], widths[start:end], strict=True):
            table.add_column(Text(heading), justify="right", width=width, no_wrap=False)
        for label, cells in section.lines:
            table.add_row(Text(label), *(_text(cell, section) for cell in cells[start:end]))
        yield table
        start = end


def _text(cell: Cell, section: Section) -> Text:
    number = cell.text + ("*" if cell.marked else "")
    return Text(number if section.brief or not cell.below else f"{number}\n{cell.below}")


def _width(cell: Cell, section: Section) -> int:
    return max(len(line) for line in _text(cell, section).plain.split("\n"))


def as_markdown(rows: Sequence[StudyRow], facts: StudyFacts) -> str:
    """All tables as Markdown, failed trials first; ends with a newline."""
    rows, facts = titled(rows, facts)
    comparisons = compare(rows, facts.baseline)
    page = [f"# {facts.name}", ""]
    if facts.failed:
        cells = [(f.configuration, [f.scene, str(f.seed), f.error, f"`{f.command}`"]) for f in facts.failed]
        page += [f"## {facts.failures}", "", *_markdown(["scene", "seed", "error", "run it alone"], cells, "---|"), ""]
    for sentence in (*_sentences(rows, facts, comparisons), comparisons_made(comparisons)):
        page += [sentence, ""]
    for section in sections(rows, facts.baseline, comparisons):
        lines = [(label, [_one_line(cell) for cell in cells]) for label, cells in section.lines]
        caption = [section.caption, ""] if section.caption else []
        page += [f"## {section.title}", "", *caption, *_markdown(section.headings, lines), ""]
    return "\n".join(page)


def _one_line(cell: Cell) -> str:
    return f"{cell.text}{'*' if cell.marked else ''} {cell.below}".strip()


def _markdown(headings: Sequence[str], cells: Sequence[tuple[str, Sequence[str]]], align: str = "---:|") -> list[str]:
    def line(texts: Sequence[str]) -> str:
        escaped = (text.replace("\\", "\\\\").replace("|", "\\|").replace("\n", " ") for text in texts)
        return "| " + " | ".join(escaped) + " |"

    rule = "|---|" + align * len(headings)
    return [line(["", *headings]), rule, *(line([label, *texts]) for label, texts in cells)]


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
    series_names = ("who", "estimator", "metric")
    counts = ("scenes", "seeds", "seeds_left_out")
    headings = ["configuration", *parameters, *series_names, *_NUMBERS, "p_holm", *counts]
    lines = []
    for row in rows:
        point = [row.point.get(name, "") for name in parameters]
        for series, estimate in row.estimates.items():
            values = [getattr(estimate, field) for field in _NUMBERS.values()]
            texts = digits(*values, adjusted.get((row.label, series), float("nan")))
            lines.append([row.label, *point, *series, *texts, estimate.scenes, estimate.seeds, estimate.left_out])
    return csv_text(headings, lines)


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
        ("\u00b0", r"$^\circ$"),
        ("%", r"\%"),
        ("&", r"\&"),
    ):
        text = text.replace(character, replacement)
    return text

"""Tables of text, as Markdown, LaTeX and for the terminal."""

from __future__ import annotations

import csv
import io
import itertools
import math
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from mast_zenoh.metrics.study_results import Row, Statistic
from mast_zenoh.show.number_text import DASH, digits, measured

_TERMINAL = 80  # columns


class Head(NamedTuple):
    """A column of a table on a page: its heading, the group that it is in, and its kind: num, text, words or code."""

    text: str
    group: str
    kind: str


class TextTable(NamedTuple):
    """A table: its title, sentences about it, its headings and lines; the first column names the lines.

    A cell can have two lines: a number, and below it its interval.
    texts: number of text columns, which come first;  latex: column types of LaTeX, "": these to the left, others to
           the right
    groups: of each heading, the name of its group; (): there are none
    terminal: whether the terminal shows it;  brief: whether it does so without the second lines
    kinds: on a page, by heading, what is neither a name nor a number: text, words or code;  bad: lines that are marked
    """

    title: str
    about: str
    headings: Sequence[str]
    lines: Sequence[Sequence[str]]
    texts: int = 1
    latex: str = ""
    groups: Sequence[str] = ()
    terminal: bool = True
    brief: bool = False
    kinds: Mapping[str, str] = {}
    bad: Sequence[bool] = ()

    @property
    def heads(self) -> list[Head]:
        """The columns on a page; a group that all numbers are in needs no name."""
        grouped = len({*self.groups[self.texts :]}) > 1
        groups = self.groups if grouped else [""] * len(self.headings)
        kinds = ["text"] * self.texts + ["num"] * (len(self.headings) - self.texts)
        return [
            Head(text, group, self.kinds.get(text, kind))
            for text, group, kind in zip(self.headings, groups, kinds, strict=True)
        ]

    @property
    def grouped(self) -> list[tuple[str, list[Head]]]:
        """The columns on a page in groups; those without a group have an empty name."""
        return [(name, list(heads)) for name, heads in itertools.groupby(self.heads, key=lambda head: head.group)]

    @property
    def classes(self) -> list[str]:
        """The style of each column on a page: its kind, and whether a group begins, or ends before it."""
        heads = self.heads
        result = [heads[0].kind]
        for before, head in itertools.pairwise(heads):
            ends = any(each.group for each in heads) and not (head.group and head.group == before.group)
            result.append(f"{head.kind} first" if ends else head.kind)
        return [kind.removeprefix("text").strip() for kind in result]

    def columns(self, chosen: Sequence[int]) -> TextTable:
        """The table with some of its columns."""
        lines = [[line[index] for index in chosen] for line in self.lines]
        groups = [self.groups[index] for index in chosen] if self.groups else ()
        return self._replace(headings=[self.headings[index] for index in chosen], lines=lines, groups=groups)

    def parts(self, most: int) -> list[TextTable]:
        """The table in parts of at most so many numbers, of whole groups if possible; `about` is below the last."""
        starts, end = [self.texts], self.texts
        for _, heads in itertools.groupby(self.groups[self.texts :] or [""] * (len(self.headings) - self.texts)):
            size = len(list(heads))
            wide = math.ceil(size / math.ceil(size / most))
            for start in range(0, size, wide):
                width = min(wide, size - start)
                starts += [end] * (end + width - starts[-1] > most)
                end += width
        ranges = itertools.pairwise([*starts, end])
        named = range(self.texts)
        return [
            self.columns([*named, *range(start, until)])._replace(about=self.about if until == end else "")
            for start, until in ranges
        ]

    def markdown(self) -> str:
        """The headings and lines as Markdown."""
        rule = ["---"] * self.texts + ["---:"] * (len(self.headings) - self.texts)
        lines = [[_one_line(text) for text in line] for line in (self.headings, *self.lines)]
        return "\n".join(f"| {' | '.join(line)} |" for line in (lines[0], rule, *lines[1:]))

    def as_rich(self) -> Group:
        """For a terminal of 80 columns: cells are wrapped between words, or wide tables with intervals are cut."""
        table = self
        if self.brief:
            table = self._replace(lines=[[cell.partition("\n")[0] for cell in line] for line in self.lines])
        if not (self.groups or any("\n" in cell for line in self.lines for cell in line)):
            return Group(table._on_terminal(None))
        columns = [*zip(table._terminal_headings, *table.lines, strict=True)]
        widths = [max(map(_length, cells)) for cells in columns]
        if not _fits(widths):  # headings are broken between words
            widths = [max(map(_length, [*heading.split(), *cells]), default=0) for heading, *cells in columns]
        parts = [[*range(self.texts)]]
        for at in range(self.texts, len(widths)):
            if parts[-1][self.texts :] and not _fits([widths[index] for index in (*parts[-1], at)]):
                parts.append([*range(self.texts)])
            parts[-1].append(at)
        cut = (table.columns(part)._replace(title="", about="") for part in parts)
        of_parts = ([widths[index] for index in part] for part in parts)
        tables = [each._on_terminal(of_part) for each, of_part in zip(cut, of_parts, strict=True)]
        above = [Text(self.title, style="bold"), *([Text(wrapped(self.about), style="dim")] if self.about else [])]
        return Group(*above, *tables)

    @property
    def _terminal_headings(self) -> list[str]:
        """The headings; where some are equal, below the name of the group that begins with them."""
        if len({*self.headings}) == len(self.headings):
            return list(self.headings)
        begins = [head.group if at == 0 else "" for _, heads in self.grouped for at, head in enumerate(heads)]
        return [f"{group}\n{text}" for group, text in zip(begins, self.headings, strict=True)]

    def _on_terminal(self, widths: Sequence[int] | None) -> Table:
        """widths: of columns; None: wrapped between words, which are never cut"""
        result = Table(
            title=escape(wrapped(self.title)) or None,
            title_justify="left",
            caption=escape(wrapped(self.about)) or None,
            caption_justify="left",
            box=SIMPLE_HEAD,
            padding=(0, 1, 0, 0),
        )
        widths = widths or _widths(list(zip(self.headings, *self.lines, strict=True)))
        for index, (heading, width) in enumerate(zip(self._terminal_headings, widths, strict=True)):
            result.add_column(heading, justify="left" if index < max(1, self.texts) else "right", width=width)
        for above, line in itertools.pairwise([(), *self.lines]):
            again = self.texts > 1 and line[:1] == above[:1]  # what several lines are about is said once
            if above and self.texts > 1 and not again:
                result.add_section()
            result.add_row(*map(escape, ["", *line[1:]] if again else line))
        return result


class ResultTables(NamedTuple):
    """All tables of a study of defences, in every format.

    title: of the page;  about: sentences about it;  size: seeds and scenes;  tables: of the page and of LaTeX
    numbers: the headings and lines of the CSV file, with all digits;  brief: for the terminal
    note: what applies to the numbers of all tables;  headline: of the page, without a full stop; empty: the usual one
    reading: sentences at the beginning of the page, before those about errors of estimates
    """

    title: str
    about: str
    size: str
    tables: Sequence[TextTable]
    numbers: tuple[Sequence[str], Sequence[Sequence[object]]]
    brief: Sequence[TextTable]
    note: str = ""
    headline: str = ""
    reading: Sequence[str] = ()

    def texts(self, name: str) -> dict[str, str]:
        """The contents of name.md, name.csv and name.tex."""
        return {f"{name}.md": self.as_markdown(), f"{name}.csv": self.as_csv(), f"{name}.tex": self.as_latex()}

    def as_markdown(self) -> str:
        """A page with a title, and all tables."""
        parts = [f"# {self.title}", f"{self.about} {self.note}".rstrip()]
        for table in self.tables:
            parts += [f"## {table.title}", *([table.about] if table.about else []), table.markdown()]
        return "\n\n".join(parts) + "\n"

    def as_latex(self) -> str:
        """All tables as LaTeX tabulars, with booktabs."""
        size = self.size.replace("\u00d7", "x")
        parts = [
            r"% needs \usepackage{booktabs}",
            f"% brackets: 95 % intervals; {size}",
        ]
        for table in self.tables:
            columns = table.latex or "l" * table.texts + "r" * (len(table.headings) - table.texts)
            below = [
                part for line in table.lines for part in itertools.zip_longest(*(cell.split("\n") for cell in line))
            ]
            lines = [" & ".join(_tex(cell or "") for cell in line) + r" \\" for line in (table.headings, *below)]
            parts += [f"% {table.title}. {table.about}".rstrip(), r"\begin{tabular}{" + columns + "}", r"\toprule"]
            parts += [lines[0], r"\midrule", *lines[1:], r"\bottomrule", r"\end{tabular}"]
        return "\n".join([*parts, ""])

    def as_csv(self) -> str:
        """All numbers with all digits; None is empty, `inf` is not reached."""
        return csv_text(*self.numbers)

    def as_rich(self) -> Group:
        """The brief tables for the terminal."""
        return Group(*(table.as_rich() for table in self.brief), *([wrapped(self.note)] if self.note else []))


def _one_line(text: str) -> str:
    return text.replace("\\", "\\\\").replace("|", "\\|").replace("\n", " ")


def csv_text(headings: Sequence[str], lines: Iterable[Sequence[object]]) -> str:
    """Lines of values as CSV; None is empty."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(headings)
    writer.writerows(["" if value is None else value for value in line] for line in lines)
    return buffer.getvalue()


def _widths(columns: Sequence[Sequence[str]]) -> list[int]:
    """Widths of columns that fit a terminal of 80 columns, none less than its longest word if that is possible.

    Rich would share the width out without regard to words.
    """
    widths = [max(map(len, cells)) for cells in columns]
    least = [max((len(word) for cell in cells for word in cell.split()), default=0) for cells in columns]
    while not _fits(widths) and widths != least:
        widest = max((index for index in range(len(widths)) if widths[index] > least[index]), key=widths.__getitem__)
        widths[widest] -= 1
    return widths


def _length(cell: str) -> int:
    """The length of the longest line of a cell."""
    return max(map(len, cell.split("\n")))


def _fits(widths: Sequence[int]) -> bool:
    """Whether columns of these widths fit the terminal."""
    return sum(widths) + 2 * len(widths) + 1 <= _TERMINAL


def wrapped(sentences: str) -> str:
    """Sentences above or below a table, for a terminal of 80 columns."""
    return "\n".join(textwrap.wrap(sentences, _TERMINAL))


def bounds(each: Statistic) -> list[str]:
    """A number in a CSV file, see BOUNDS."""
    tested = digits(each.p, each.zero_share, each.zero_low, each.zero_high)
    return [*digits(*each[:3]), each.interval, *tested, str(each.trials), str(each.left_out)]


def shown(measure: str, show: Callable[[Statistic], str] = measured) -> Callable[[Row], str]:
    """The text of a measure of a row, also of one that lacks it."""
    return lambda row: show(row.get(measure))


def table_of_rows(
    title: str,
    about: str,
    rows: Sequence[Row],
    columns: Mapping[str, Callable[[Row], str]],
    names: Mapping[str, str] | None = None,
    *,
    texts: int = 1,
) -> TextTable:
    """What rows are of, then columns by heading.

    names: by heading, of what rows are of; None: all, by their own names;  texts: number of text columns
    """
    shown_names = {name: name for name in (rows[0].of if rows else ())} if names is None else names
    lines = [
        [*(_named(row.of[name]) for name in shown_names.values()), *(show(row) for show in columns.values())]
        for row in rows
    ]
    return TextTable(title, about, [*shown_names, *columns], lines, texts)


def _named(value: object) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    return DASH if value in ("", None) else str(value)


def numbers_of_rows(rows: Sequence[Row]) -> tuple[Sequence[str], Sequence[Sequence[object]]]:
    """The headings and lines of a CSV file with a line for each row and measure.

    The first row has all names of what rows are of; those that others lack are empty.

    Columns:
    measure: what is measured; a column for each name of what a row is of, such as a factor, precedes it
    value: over the trials
    low, high: bounds of its interval; empty: too few trials
    interval: how the interval was computed
    p: of a difference
    zero_share, zero_low, zero_high: share of the trials in which a difference is 0, and its exact 95 % interval
    trials, trials_left_out: number of trials that count, and of those without a value
    """
    names = [*rows[0].of] if rows else []
    lines = [
        [*(row.of.get(name, "") for name in names), measure, *bounds(each)]
        for row in rows
        for measure, each in row.numbers.items()
    ]
    return [*names, "measure", *BOUNDS], lines


#: Columns of `bounds`: a number, its interval, and how that was computed; of a difference its p-value, and the share of
#: trials in which it is 0; and the number of trials.
BOUNDS = (
    *("value", "low", "high", "interval", "p", "zero_share", "zero_low", "zero_high"),
    *("trials", "trials_left_out"),
)


def _tex(text: str) -> str:
    replacements = (
        *(("\u2212", "$-$"), ("\u221e", r"$\infty$"), (DASH, "--"), ("_", r"\_"), ("%", r"\%"), ("&", r"\&")),
        *(("<", "$<$"), (">", "$>$"), ("\u2264", r"$\leq$"), ("\u00b1", r"$\pm$"), ("\u00b0", r"$^\circ$")),
    )
    for character, replacement in replacements:
        text = text.replace(character, replacement)
    return text

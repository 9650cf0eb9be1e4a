"""The tables of a study, for the terminal and as Markdown."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table
from rich.text import Text

from mast_zenoh.report.narrative.study import comparisons_made, other_changes, reservations, result, titled
from mast_zenoh.report.narrative.study_comparisons import Comparisons, compare
from mast_zenoh.report.study_facts import StudyFacts
from mast_zenoh.report.tables.study_rows import StudyRow
from mast_zenoh.report.tables.study_sections import Cell, Section, sections

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

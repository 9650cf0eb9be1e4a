"""The table of attempts by security level, for terminal, Markdown and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import NamedTuple

from rich.box import SIMPLE_HEAD
from rich.table import Table

#: The row of messages that belong to no attempt; their number should be 0.
STRAY = "(anything else)"


class AttemptRow(NamedTuple):
    """One attempt of an outsider, or one insider, at one level of security.

    admitted:  whether the attacker got a session on the mesh
    sent:      messages sent; reached: deliveries to nodes' hosts; expected: deliveries if none is lost
    heard:     samples overheard; lured: nodes that connected to the outsider's router
    succeeded: whether it had any effect; of an insider, whether its verdict is a success
    verdict:   of an insider, its effect in words
    """

    run: str
    level: str
    attempt: str
    admitted: bool = False
    sent: int = 0
    reached: int = 0
    expected: int = 0
    heard: int = 0
    lured: int = 0
    succeeded: bool = False
    verdict: str = ""


def as_rich(rows: Sequence[AttemptRow]) -> Table:
    """Attempts by level, for a terminal."""
    headers, lines = _grid(rows, "\n")
    table = Table(title=CAPTION, title_justify="left", title_style="dim", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for header in headers:
        table.add_column(header, vertical="top")
    for line in lines:
        table.add_row(*line)
    return table


def as_markdown(rows: Sequence[AttemptRow]) -> str:
    """Attempts by level as Markdown; ends with a newline."""
    headers, lines = _grid(rows, " ")
    table = [headers, ["---"] * len(headers), *lines]
    return "\n".join("| " + " | ".join(line) + " |" for line in table) + f"\n\n{CAPTION}.\n"


def as_csv(rows: Sequence[AttemptRow]) -> str:
    """All counts, one line per attempt and level."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(AttemptRow._fields)
    writer.writerows([int(value) if isinstance(value, bool) else value for value in row] for row in rows)
    return buffer.getvalue()


CAPTION = "in: forged messages that reached a node; out: samples overheard; lured: nodes at the outsider's router"


def _grid(rows: Sequence[AttemptRow], separator: str) -> tuple[list[str], list[list[str]]]:
    levels = list(dict.fromkeys(row.level for row in rows))
    runs = list(dict.fromkeys(row.run for row in rows))
    cells = {(row.run, row.attempt, row.level): _cell(row, separator) for row in rows}
    names = list(dict.fromkeys((row.run, row.attempt) for row in rows))
    lines = [
        [
            attempt if len(runs) == 1 else f"{run}: {attempt}",
            *(cells.get((run, attempt, level), "") for level in levels),
        ]
        for run, attempt in names
    ]
    return ["attempt", *levels], lines


def _cell(row: AttemptRow, separator: str) -> str:
    """Verdict and counts of an attempt, with a separator between them."""
    if row.verdict:
        return f"{row.verdict}{separator}(sent {row.sent})"
    counts = []
    if row.expected or row.attempt == STRAY:
        counts.append(f"in {row.reached}" + (f"/{row.expected}" if row.expected else ""))
    if row.heard or (not row.expected and row.attempt != STRAY):
        counts.append(f"out {row.heard}")
    if row.lured:
        counts.append(f"lured {row.lured}")
    failed = "none" if row.attempt == STRAY else "no effect" if row.admitted else "refused"
    verdict = "succeeds" if row.succeeded else failed
    return f"{verdict}{separator}({', '.join(counts)})"

"""The table of endings in docs/endings.md, for the tests that verify it."""

import re
from pathlib import Path
from typing import NamedTuple

PAGE = Path(__file__).parents[2] / "docs" / "endings.md"


class Ending(NamedTuple):
    """A row: status in run.json ("": no folder) and exit code (None: by signal)."""

    status: str
    code: int | None


def table() -> dict[str, Ending]:
    """Every ending by its first column."""
    rows = {}
    for line in PAGE.read_text("utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("| ") and len(cells) == 4 and cells[0] != "what happened":
            status = re.fullmatch(r"`(\w+)`.*", cells[1])
            code = re.match(r"\d+", cells[2])
            rows[cells[0]] = Ending(status[1] if status else "", int(code[0]) if code else None)
    return rows


def ending(what: str) -> Ending:
    """The row that begins with this text."""
    return table()[what]

"""The pages docs/ref-*.md, which are made from code, and what they are made with.

    classes, messages, maps, command_line, exit_codes, run_folder, scenario, metrics, python_api
                    one page each
    docstrings      sentences, sources and entries of docstrings

`page`, `table` and `parameter_table` write Markdown.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from mast_zenoh.api.catalogue import Parameter

_GENERATED = "<!-- Written by `make docs` from {source}; do not edit. -->"


def page(title: str, source: str, introduction: str, sections: Iterable[str]) -> str:
    """A page. source: what it is made from; introduction: what a reader can look up"""
    return "\n".join([f"# {title}\n", _GENERATED.format(source=source), f"\n{introduction}\n", *filter(None, sections)])


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table, and a blank line; "" without rows."""
    lines = ["| " + " | ".join(_cell(text) for text in row) + " |" for row in rows]
    return "\n".join(["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|", *lines, ""]) if lines else ""


def parameter_table(parameters: Iterable[Parameter]) -> str:
    """Parameters with default, unit and meaning."""
    rows = (
        (f"`{each.name}`", f"`{each.default}`" if each.default else "required", each.unit, each.words)
        for each in parameters
    )
    return table(("parameter", "default", "unit", "meaning"), rows)


def linked(text: str) -> str:
    """A text of a docstring, in which names of pages become links."""
    return re.sub(r"docs/([\w-]+\.md)(#[\w-]+)?", r"[\1](\1\2)", text)


def _cell(text: str) -> str:
    """A text in a cell: in one line, without what would end the cell."""
    return linked(re.sub(r"(?<!\\)\|", r"\\|", " ".join(text.split())))

"""What docstrings say of sources, and of the keys and columns that a function writes.

A function that writes a document or a table describes each key or column in its docstring, after a line `Keys:` or
`Columns:`, and a module its `Files:`, as `name: text` or `name, name: text`; further lines of an entry are indented.
"""

from __future__ import annotations

import inspect
import re
from pkgutil import resolve_name
from typing import NamedTuple

from mast_zenoh.api.catalogue import unit_of
from reference import table

_ENTRY = re.compile(r"^(?=\S)([^:\n]+):\s+(.*(?:\n +.*)*)$", re.MULTILINE)
_UNIT = re.compile(r"(0 to 1|m/s[²³]?|rad|ms|m|s), ")
#: The end of a sentence: not that of "et al.", "e.g." or an initial.
_END = re.compile(r"(?<!\bal)(?<!\bno)(?<!\b[A-Z])\.\s+(?=[A-Z\"])")
_IS_SOURCE = re.compile(r"^Sources?: |\b(?:19|20)\d\d\b|arXiv")


class Described(NamedTuple):
    """A key, a column or a file, or several of one kind."""

    names: tuple[str, ...]
    unit: str
    meaning: str


def entries(of: object, head: str) -> list[Described]:
    """The entries after the line `head` of a docstring, up to the next blank line. Raises ValueError without any."""
    _, _, block = (inspect.getdoc(of) or "").partition(f"{head}:\n")
    found = [_described(names, " ".join(words.split())) for names, words in _ENTRY.findall(block.partition("\n\n")[0])]
    if not found:
        raise ValueError(f"{of}: found no `{head}:` with entries in the docstring")
    return found


def _described(names: str, meaning: str) -> Described:
    parts = tuple(names.split(", "))
    if leading := _UNIT.match(meaning):
        return Described(parts, leading[1], meaning[leading.end() :])
    units = filter(None, (unit_of(name.rpartition(".")[2], "") for name in parts))
    return Described(parts, ", ".join(dict.fromkeys(units)), meaning)


def described_table(head: str, *places: str) -> str:
    """A table of the entries of the docstrings at some places, as `module:name`."""
    every = [each for place in places for each in entries(resolve_name(place), head)]
    rows = [(", ".join(f"`{name}`" for name in each.names), each.unit, each.meaning) for each in every]
    if head == "Files":
        return table(("file", "content"), ((names, meaning) for names, _, meaning in rows))
    return table((head.lower().removesuffix("s"), "unit", "meaning"), rows)


def sources(cls: type) -> list[str]:
    """The sentences of a class's docstring that name a publication, without descriptions of parameters."""
    text = inspect.cleandoc(vars(cls).get("__doc__") or "")
    paragraphs = [part for part in text.split("\n\n")[1:] if not re.match(r"(?!Sources?:)\w+(, \w+)*: ", part)]
    sentences = [sentence for part in paragraphs for sentence in _END.split(" ".join(part.split()))]
    return [sentence.rstrip(".:") + "." for sentence in sentences if _IS_SOURCE.search(sentence)]

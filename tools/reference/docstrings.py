"""What docstrings say of sources, and of the keys and columns that a function writes.

A function that writes a document or a table describes each key or column in its docstring, after a line `Keys:` or
`Columns:`, as `name: text` or `name, name: text`; further lines of an entry are indented.
"""

from __future__ import annotations

import inspect
import re
from typing import NamedTuple

from mast_zenoh.api.catalogue import unit_of

_ENTRY = re.compile(r"^(?=\S)([^:\n]+):\s+(.*(?:\n +.*)*)$", re.MULTILINE)
#: The end of a sentence: not that of "et al.", "e.g." or an initial.
_END = re.compile(r"(?<!\bal)(?<!\bno)(?<!\b[A-Z])\.\s+(?=[A-Z\"])")
_IS_SOURCE = re.compile(r"^Sources?: |\b(?:19|20)\d\d\b|arXiv")


class Described(NamedTuple):
    """A key or a column, or several of one kind."""

    names: tuple[str, ...]
    unit: str
    meaning: str


def entries(of: object, head: str) -> list[Described]:
    """The entries after the line `head` of a docstring, up to the next blank line. Raises ValueError without any."""
    text = inspect.getdoc(of) or ""
    _, found, block = text.partition(f"{head}:\n")
    described = []
    for names, words in _ENTRY.findall(block.partition("\n\n")[0]):
        meaning = " ".join(words.split())
        parts = tuple(names.split(", "))
        unit = unit_of(parts[0].rpartition(".")[2], meaning)
        described.append(Described(parts, unit, meaning.removeprefix(f"{unit}, ") if unit else meaning))
    if not found or not described:
        raise ValueError(f"{of}: found no `{head}:` with entries in the docstring")
    return described


def sources(cls: type) -> list[str]:
    """The sentences of a class's docstring that name a publication, without descriptions of parameters."""
    text = inspect.cleandoc(vars(cls).get("__doc__") or "")
    paragraphs = [part for part in text.split("\n\n")[1:] if not re.match(r"\w+(, \w+)*: ", part)]
    sentences = [sentence for part in paragraphs for sentence in _END.split(" ".join(part.split()))]
    return [sentence.rstrip(".:") + "." for sentence in sentences if _IS_SOURCE.search(sentence)]

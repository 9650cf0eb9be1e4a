"""Sphinx extension: a page for each module with public names, made from its docstrings (`make site`)."""

from __future__ import annotations

import re
import shutil
import textwrap
from importlib import import_module
from inspect import getdoc, isroutine
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from surface import BASE_CLASSES, OF_A_RUN

import mast_zenoh

if TYPE_CHECKING:
    from sphinx.application import Sphinx

_PARAMETER = re.compile(r"^([a-z_]\w*(?:, [a-z_]\w*)*):\s+", re.MULTILINE)
DOCS = Path(__file__).parents[1] / "docs"


def public_names() -> dict[str, list[str]]:
    """The names that users may import, by module."""
    page = (DOCS / "how-to-write-a-part.md").read_text("utf-8")
    rows = re.findall(r"^\| `(mast_\w[\w.]*)` \| (`.*`) \|$", page, flags=re.M)
    names = {"mast_zenoh": set(mast_zenoh.__all__)} | {module: set(re.findall(r"\w+", row)) for module, row in rows}
    for places in BASE_CLASSES.values():
        for module, _, name in (place.rpartition(".") for place in places):
            names.setdefault(module, set()).add(name)
    names["mast_zenoh"].add("study.interface.carry_out")  # what a call of `mast_zenoh.study`, a package, calls
    modules = sorted(names, key=lambda module: (not module.startswith("mast_zenoh"), module))
    return {module: sorted(names[module]) for module in modules}


def public_thing(module: str, name: str) -> object:
    """What a public name stands for: a module need not be imported yet."""
    inner, _, last = f"{module}.{name}".rpartition(".")
    try:
        return getattr(import_module(inner), last)
    except AttributeError:
        return import_module(f"{module}.{name}")


def write_pages(_: Sphinx) -> None:
    """Write docs/modules/*.rst, which Sphinx fills with the docstrings."""
    mast_zenoh.Run.__name__ = "Run"  # Sphinx shows the members of a class only under its own name
    public = public_names()
    first: dict[int, str] = {}
    contents = "\n   ".join(["Public names\n============\n\n.. toctree::", ":maxdepth: 1\n", *public])
    pages = {"index": contents}
    for module, names in public.items():
        directives = []
        for name in names:
            place = f"{module}.{name}"
            elsewhere = f":py:mod:`{place}`" if place in public else None
            directives.append(elsewhere or _directive(place, public_thing(module, name), first))
        pages[module] = "\n\n".join([f"{module}\n{'=' * len(module)}", f".. automodule:: {module}", *directives, ""])
    shutil.rmtree(DOCS / "modules", ignore_errors=True)
    (DOCS / "modules").mkdir()
    for name, page in pages.items():
        (DOCS / "modules" / f"{name}.rst").write_text(page, "utf-8")


def _directive(place: str, thing: object, first: dict[int, str]) -> str:
    """What shows the docstring of a module, class, function or value, or refers to where it is shown."""
    if isinstance(thing, type) and (shown := first.setdefault(id(thing), place)) != place:
        return f":py:obj:`{place} <{shown}>`"
    if isinstance(thing, ModuleType):
        return f".. automodule:: {place}\n   :members:"
    if isinstance(thing, type):
        members = f" {', '.join(OF_A_RUN)}\n   :inherited-members:" if thing is mast_zenoh.Run else ""
        bases = "" if thing.__bases__ == (object,) else "\n   :show-inheritance:"
        return f".. autoclass:: {place}{bases}\n   :members:{members}"
    return f".. autofunction:: {place}" if isroutine(thing) else f".. autodata:: {place}\n   :no-value:"


def as_rst(_app: Sphinx, what: str, _name: str, thing: object, _options: object, lines: list[str]) -> None:
    """Docstrings are Markdown, in which a paragraph of `name: description` is a list of parameters."""
    text = "\n".join(lines).strip()
    if what == "data" and text == getdoc(thing):
        text = ""  # that of its type, such as dict
    text = re.sub(rf"(?<=[.:;])\n(?={_PARAMETER.pattern[1:]})", "\n\n", text)
    paragraphs = []
    for paragraph in text.split("\n\n"):
        if re.match(_PARAMETER, paragraph):
            _, *parts = re.split(_PARAMETER, paragraph)
            entries = zip(parts[::2], parts[1::2], strict=True)
            paragraphs += [f"**{name}**\n   {_inline(about)}" for name, about in entries]
        elif not re.search(r"^\s", paragraph, flags=re.MULTILINE):
            paragraphs.append(_inline(paragraph))
        elif what != "module":  # whose files are for developers
            paragraphs.append(".. code-block:: text\n\n" + textwrap.indent(paragraph, "   "))
    lines[:] = "\n\n".join(paragraphs).split("\n")


def _inline(text: str) -> str:
    """A paragraph in one line: code, links to pages, and everything else as it is."""
    parts = re.split(r"`+([^`]+)`+", " ".join(text.split()))
    parts[::2] = [re.sub(r"([*_|\\])", r"\\\1", words) for words in parts[::2]]
    parts[::2] = [re.sub(r"docs/([\w\\-]+)\.md", _link, words) for words in parts[::2]]
    parts[1::2] = [rf"\ ``{code}``\ " for code in parts[1::2]]
    return "".join(parts)


def _link(page: re.Match[str]) -> str:
    return rf"\ :doc:`/{page[1]}`\ ".replace("\\_", "_")


def shorten(_app: Sphinx, _what: str, _name: str, _of: object, _options: object, *texts: str | None) -> Any:
    """Parameters and result: types of arrays as the code has them, and defaults that Sphinx can read."""
    if texts[0] is None:
        return None  # neither a class nor a function
    array = r"~?numpy\.ndarray\[tuple\[[\w.~]+, \.\.\.\], ~?numpy\.dtype\[~?(?:numpy\.)?(\w+)\]\]"
    short = [text and re.sub(array, r"NDArray[\1]", text.replace("<factory>", "...")) for text in texts]
    return tuple(text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text) for text in short)


def setup(app: Sphinx) -> None:
    app.connect("autodoc-process-signature", shorten)
    app.connect("builder-inited", write_pages)
    app.connect("autodoc-process-docstring", as_rst)

"""docs/ref-python.md: every public name of the Python API."""

from __future__ import annotations

import inspect
import pkgutil
import re
from collections.abc import Callable
from functools import cached_property
from typing import Any

from surface import BASE_CLASSES, OF_A_RUN

import mast_zenoh
from mast_zenoh.api.catalogue import Entry, Parameter
from mast_zenoh.api.scenes import PreparedAgent
from mast_zenoh.runs.messages import WireMessage
from mast_zenoh.runs.run import AgentMessages
from mast_zenoh.show.figures.plots import Plots
from mast_zenoh.study.interface import carry_out
from reference import linked, page, table
from reference.exit_codes import first_line


def python_page() -> str:
    """Public names with signatures and docstrings, and base classes."""
    introduction = (
        "Look up every public name here. [how-to-python.md](how-to-python.md) shows how they work together,\n"
        "[stability.md](stability.md) lists what is stable."
    )
    return page("Python", "mast_zenoh/__init__.py and tools/surface.py", introduction, _sections())


def _sections() -> list[str]:
    lines = ["## import mast_zenoh as mast", ""]
    functions = [name for name in mast_zenoh.__all__ if name[0].islower()]
    named = {name: getattr(mast_zenoh, name) for name in mast_zenoh.__all__ if name[0].isupper()}
    named |= {cls.__name__: cls for cls in (AgentMessages, PreparedAgent, Plots, WireMessage, Entry, Parameter)}
    for name in functions:
        function = carry_out if name == "study" else getattr(mast_zenoh, name)
        lines += [f"### `mast.{name}{_signature(function)}`", "", *_text(function), ""]
    lines += ["### `mast.__version__`", "", "Version of the package, as text.", ""]
    for title, cls in named.items():
        lines += [f"## `{title}`", "", *_text(cls), ""]
        members = {name: getattr(cls, name) for name in OF_A_RUN} if cls is mast_zenoh.Run else vars(cls)
        for name, member in members.items():
            if not name.startswith("_") and (callable(member) or isinstance(member, (property, cached_property))):
                heading = f"{name}{_signature(member)}" if callable(member) else name
                lines += [f"### `{title}.{heading}`", "", *_text(member), ""]
    bases = [
        (purpose, f"`{place}`", first_line(pkgutil.resolve_name(place)))
        for purpose, places in BASE_CLASSES.items()
        for place in places
    ]
    return [*lines, "## Base classes", "", table(("to write a", "derive from, or use", "which is"), bases)]


def _signature(function: Callable[..., Any]) -> str:
    """The parameters of a function and their defaults, without annotations."""
    signature = inspect.signature(function)
    plain = [each.replace(annotation=inspect.Parameter.empty) for name, each in signature.parameters.items()]
    plain = plain[1:] if plain and plain[0].name == "self" else plain
    return str(signature.replace(parameters=plain, return_annotation=inspect.Signature.empty))


def _text(of: object) -> list[str]:
    """A docstring: paragraphs as they are, descriptions of parameters as a block."""
    first, *others = (inspect.getdoc(of) or "").split("\n\n")
    lines = [*linked(first).split("\n"), ""]
    for paragraph in others:
        block = re.match(r"[a-z_]\w*(, [a-z_]\w*)*:\s", paragraph)
        lines += ["```text", *paragraph.split("\n"), "```", ""] if block else [*linked(paragraph).split("\n"), ""]
    return lines[:-1]

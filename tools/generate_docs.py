"""Generates pages and examples from code: `python tools/generate_docs.py docs`."""

from __future__ import annotations

import inspect
import pkgutil
import re
import sys
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

from compose_examples import EXAMPLES, example
from surface import BASE_CLASSES, OF_A_RUN

import mast_zenoh
from mast_zenoh import errors
from mast_zenoh.api.catalogue import Entry, Parameter
from mast_zenoh.api.scenes import PreparedAgent
from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.layers import LAYERS
from mast_zenoh.messages.schemas import SCHEMAS
from mast_zenoh.runs.messages import WireMessage
from mast_zenoh.runs.run import AgentMessages
from mast_zenoh.show.figures.plots import Plots
from mast_zenoh.study.interface import carry_out

_PACKAGE = Path(mast_zenoh.__file__).parent

_GENERATED = "<!-- Written by `make docs` from {source}; do not edit. -->\n"


def messages_page() -> str:
    """docs/messages.md: every message type with its columns, dtypes, shapes and units."""
    lines = [
        "# Messages",
        "",
        _GENERATED.format(source="mast_zenoh/messages/schemas.py"),
        "Look up here what each message contains, and which messages a node refuses. Your nodes can declare",
        "[message types of their own](extending.md#a-message-type).",
        "",
        "A message is a MessagePack map: a header (`schema`, `version`, `source`, `frame`, `time_ns`, `seq`) and a",
        "`body` that maps each column to `[dtype, shape, data]`, the data being raw little-endian bytes in C order.",
        "In a shape, `n`, `m` and `k` are numbers of objects and `a` is a number of agents. Equal letters in one",
        "message are equal numbers. `time_ns` is nanoseconds since the scene began: the time of the frame, and in",
        "`detections` [the time of the measurement](sensors.md#how-times-flow).",
        "",
        "Coordinate frames are right-handed: x forward (world: east), y left (north), z up. Quaternions are",
        "(w, x, y, z) of the active rotation into the world.",
        "",
        f"Classes, by `class_id`: {', '.join(f'{i} {name}' for i, name in enumerate(CLASSES))}.",
        "",
        "A subscriber refuses, counts and drops a message if",
        "",
        "- it is truncated, oversized, or of another schema or version,",
        "- it has a missing or an additional column, another dtype or another shape,",
        "- a number is not finite or implausibly large, or a class is out of range,",
        "- in tracks and pictures, an id occurs twice.",
        "",
        "A covariance may be any finite matrix. Filters and fusion make it usable.",
        "",
    ]
    for schema in SCHEMAS.values():
        lines += [
            f"## `{schema.name}` (version {schema.version})",
            "",
            f"{schema.meaning[0].upper()}{schema.meaning[1:]}.",
            "",
        ]
        if not schema.columns:
            lines += ["It has no columns, only a header.", ""]
            continue
        lines += ["| column | dtype | shape | unit | meaning |", "|---|---|---|---|---|"]
        for column in schema.columns:
            shape = "(" + ", ".join(map(str, column.shape)) + ("," if len(column.shape) == 1 else "") + ")"
            lines.append(f"| `{column.name}` | {column.dtype} | {shape} | {column.unit} | {column.meaning} |")
        lines.append("")
    return "\n".join(lines)


def exit_codes_page() -> str:
    """docs/exit_codes.md: what each exit code of `mast` means."""
    lines = [
        "# Exit codes",
        "",
        _GENERATED.format(source="mast_zenoh/errors.py"),
        "Look up what a command's exit code means. [troubleshooting.md](troubleshooting.md) explains what to do.",
        "",
        "| code | error | meaning |",
        "|---:|---|---|",
    ]
    rows = [(error.exit_code, f"`{error.__name__}`", _first_line(error)) for error in error_types()]
    rows += [(0, "", "Success"), (2, "", "Usage error")]
    lines += [f"| {code} | {name} | {meaning} |" for code, name, meaning in sorted(rows)]
    return "\n".join(
        [
            *lines,
            "",
            "`mast diff` exits with 0 if two runs are equal, 1 if they differ, 2 if it cannot compare them. "
            "`mast doctor` exits with 0 if this machine has what runs need, 1 if not; optional parts may be missing.",
            "",
            _ENDINGS,
            "",
        ]
    )


_ENDINGS = (
    "[endings.md](endings.md) lists, for each way in which a run can end, its status and what is left on the disk."
)


def error_types(base: type[errors.MastError] = errors.MastError) -> list[type[errors.MastError]]:
    """The whole error tree."""
    return [base, *(error for child in base.__subclasses__() for error in error_types(child))]


def _first_line(of: type) -> str:
    return (of.__doc__ or "").strip().splitlines()[0].rstrip(".")


_LAYERS = re.compile(r"(<!-- Written by `make docs` from mast_zenoh/layers.py. -->\n).*?(<!-- end -->\n)", re.DOTALL)


def architecture_page() -> str:
    """docs/explanation-architecture.md with an updated list of layers."""
    names = {name: f"{name}/" if (_PACKAGE / name).is_dir() else f"{name}.py" for name in LAYERS}
    width = max(map(len, names.values()))
    listing = "".join(f"{names[name]:{width}}  {holds}\n" for name, holds in LAYERS.items())
    page = (_PACKAGE.parent / "docs" / "explanation-architecture.md").read_text(encoding="utf-8")
    return _LAYERS.sub(lambda match: f"{match[1]}\n```text\n{listing}```\n\n{match[2]}", page)


def api_page() -> str:
    """docs/api.md: public names with signatures and docstrings, and base classes."""
    lines = [
        "# API",
        "",
        _GENERATED.format(source="mast_zenoh/__init__.py and tools/surface.py"),
        "After reading this page you know every public name. [python.md](python.md) shows how they work together,",
        "[stability.md](stability.md) lists what is stable.",
        "",
        "## import mast_zenoh as mast",
        "",
    ]
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
    lines += ["## Base classes", "", "| to write a | derive from, or use | which is |", "|---|---|---|"]
    for purpose, places in BASE_CLASSES.items():
        for place in places:
            lines.append(f"| {purpose} | `{place}` | {_first_line(pkgutil.resolve_name(place))} |")
    return "\n".join([*lines, ""])


def _signature(function: Callable[..., Any]) -> str:
    """The parameters of a function and their defaults, without annotations."""
    signature = inspect.signature(function)
    plain = [each.replace(annotation=inspect.Parameter.empty) for name, each in signature.parameters.items()]
    plain = plain[1:] if plain and plain[0].name == "self" else plain
    return str(signature.replace(parameters=plain, return_annotation=inspect.Signature.empty))


def _text(of: object) -> list[str]:
    """A docstring: paragraphs as they are, descriptions of parameters as a block."""
    first, *others = (inspect.getdoc(of) or "").split("\n\n")
    lines = [*first.split("\n"), ""]
    for paragraph in others:
        block = re.match(r"[a-z_]\w*(, [a-z_]\w*)*:\s", paragraph)
        lines += ["```text", *paragraph.split("\n"), "```", ""] if block else [*paragraph.split("\n"), ""]
    return lines[:-1]


PAGES = {
    "api.md": api_page,
    "explanation-architecture.md": architecture_page,
    "messages.md": messages_page,
    "exit_codes.md": exit_codes_page,
}


def main(folder: Path) -> None:
    """Write all pages, and the examples in deploy/compose/ next to the folder."""
    for name, page in PAGES.items():
        (folder / name).write_text(page(), encoding="utf-8")
    for name in EXAMPLES:
        (folder.parent / "deploy" / "compose" / f"{name}.yml").write_text(example(name), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))

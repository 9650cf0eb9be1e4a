"""Writes the pages and examples that repeat what the code says: `python tools/generate_docs.py docs`."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import mast_zenoh
from mast_zenoh import errors
from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.deploy.compose.examples import EXAMPLES, example
from mast_zenoh.layers import LAYERS
from mast_zenoh.messages.schemas import SCHEMAS

_PACKAGE = Path(mast_zenoh.__file__).parent

_GENERATED = "<!-- Written by `make docs` from {source}; do not edit. -->\n"


def messages_page() -> str:
    """docs/messages.md: every message type with its columns, dtypes, shapes and units."""
    lines = [
        "# Messages",
        "",
        _GENERATED.format(source="mast_zenoh/messages/schemas.py"),
        "Look up here what each message contains, and which messages a node refuses.",
        "",
        "A message is a MessagePack map: a header (`schema`, `version`, `source`, `frame`, `time_ns`, `seq`) and a",
        "`body` that maps each column to `[dtype, shape, data]`, the data being raw little-endian bytes in C order.",
        "In a shape, `n`, `m` and `k` are numbers of objects and `a` is a number of agents. Equal letters in one",
        "message are equal numbers. `time_ns` is nanoseconds since the scene began.",
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
        "Look up here what the exit code of a command means. [troubleshooting.md](troubleshooting.md) says what to do.",
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
            "`mast diff` exits with 0 if two runs are equal, 1 if they differ, 2 if it cannot compare them.",
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
    return [base, *(found for child in base.__subclasses__() for found in error_types(child))]


def _first_line(error: type[errors.MastError]) -> str:
    return (error.__doc__ or "").strip().splitlines()[0].rstrip(".")


_LAYERS = re.compile(r"(<!-- Written by `make docs` from mast_zenoh/layers.py. -->\n).*?(<!-- end -->\n)", re.DOTALL)


def architecture_page() -> str:
    """docs/architecture.md with its list of layers written anew."""
    names = {name: f"{name}/" if (_PACKAGE / name).is_dir() else f"{name}.py" for name in LAYERS}
    width = max(map(len, names.values()))
    listing = "".join(f"{names[name]:{width}}  {holds}\n" for name, holds in LAYERS.items())
    page = (_PACKAGE.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    return _LAYERS.sub(lambda match: f"{match[1]}\n```text\n{listing}```\n\n{match[2]}", page)


PAGES = {"architecture.md": architecture_page, "messages.md": messages_page, "exit_codes.md": exit_codes_page}


def main(folder: Path) -> None:
    """Write all pages, and the examples in deploy/compose/ beside the folder."""
    for name, page in PAGES.items():
        (folder / name).write_text(page(), encoding="utf-8")
    for name in EXAMPLES:
        (folder.parent / "deploy" / "compose" / f"{name}.yml").write_text(example(name), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""docs/ref-maps.md: what a key-expression map may say, and the shipped ones."""

from __future__ import annotations

import inspect
import json
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from mast_zenoh.api.catalogue import parameters_of
from mast_zenoh.config import bundle
from mast_zenoh.wiring import maps
from mast_zenoh.wiring.model import Traits
from reference import page, parameter_table, table

_INTRODUCTION = """\
Look up here what a [key-expression map](glossary.md#key-expression-map) may say, and what the shipped ones add.
[how-to-scenarios.md](how-to-scenarios.md#key-expression-maps) shows how to use them; `mast wiring SCENARIO` prints the
result."""
_COMMENT = re.compile(r"\A((?:#.*\n)+)")
#: Keys of an entry that have a column of their own.
_IN_COLUMNS = ("key", "message", "from", "wire", "role", "codec")


def maps_page() -> str:
    """What the code that reads maps says of them, and each shipped file."""
    shipped = [bundle.find("keyexpr_maps", name) for name in bundle.names("keyexpr_maps")]
    return page("Key-expression maps", "mast_zenoh/wiring/maps.py and keyexpr_maps/", _INTRODUCTION, _sections(shipped))


def _sections(files: list[Path]) -> Iterator[str]:
    yield "## What a map says\n"
    yield from _with_blocks(inspect.getdoc(maps) or "")
    keys = ((f"`[[{kind}]]`", *map(_names, keys)) for kind, keys in maps.KEYS.items())
    yield table(("entry", "keys", "optional keys"), keys)
    yield "## Properties of a wire\n"
    yield parameter_table(parameters_of(Traits))
    yield "## The shipped maps\n"
    for file in sorted(files, key=lambda file: (file.name != "testbed.toml", file.name)):
        text = file.read_text(encoding="utf-8")
        comment = _COMMENT.match(text)
        about = re.sub(r"^# ?", "", comment[1], flags=re.MULTILINE) if comment else ""
        yield f"### {file.name}\n\n{about}"
        content = tomllib.loads(text)
        wires = ((f"`{each['key']}`", each["message"], each["from"], _others(each)) for each in content.get("wire", ()))
        yield table(("wire", "message", "from", "to, properties"), wires)
        changes = [
            (kind, f"`{each['wire']}`", each.get("role") or each["codec"], _others(each))
            for kind in ("insert", "listen", "codec")
            for each in content.get(kind, ())
        ]
        yield table(("entry", "wire", "role or codec", "other keys"), changes)


def _with_blocks(text: str) -> Iterator[str]:
    """Paragraphs as they are, indented ones as TOML; the first one is a title."""
    blocks: list[str] = []
    for paragraph in [*text.split("\n\n")[1:], ""]:
        if paragraph.startswith("    "):
            blocks.append(inspect.cleandoc(paragraph))
        else:
            if blocks:
                yield "```toml\n" + "\n\n".join(blocks) + "\n```\n"
            blocks = []
            yield paragraph and f"{paragraph}\n"


def _names(keys: Iterable[str]) -> str:
    return ", ".join(f"`{key}`" for key in keys)


def _others(entry: Mapping[str, Any]) -> str:
    """The keys that have no column; of a wire, `to` without its name."""
    others = {key: value for key, value in entry.items() if key not in _IN_COLUMNS}
    receivers = others.pop("to") if "key" in entry else []
    written = [f"`{key} = {json.dumps(value)}`" for key, value in others.items()]
    return "; ".join([", ".join(receivers)] * bool(receivers) + written)

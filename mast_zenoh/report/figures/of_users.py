"""User-defined figures in the report of a run.

They are drawn if their files are loaded; otherwise the report shows the pictures drawn before.

A report never runs the files that a run folder names, which may come from somebody else. They are loaded in the process
that ran the scenario; a later report shows what that process drew, unless it is told which file to load.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mast_zenoh.config import loading
from mast_zenoh.control.failures import described, location
from mast_zenoh.errors import RunFolderError
from mast_zenoh.report.figures.drawing import RenderedFigure
from mast_zenoh.report.figures.of_run import OURS, rendered
from mast_zenoh.report.run_figure import SECTIONS, FigureContext, RunFigure
from mast_zenoh.run_files import check_plain, read_json, write_bytes

FILE = "user_figures.json"
_KEYS = ("name", "heading", "after", "alt", "caption")
_PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True, slots=True)
class UserFigure:
    """A user's figure on the page.

    name, heading, after: see `RunFigure`
    picture: None where it could not be drawn
    problem: why not; "" where it could
    """

    name: str
    heading: str
    after: str
    picture: RenderedFigure | None
    problem: str = ""


def user_figures(context: FigureContext, files: Sequence[Path] = ()) -> list[UserFigure]:
    """The figures of users for the report of a run, by their names.

    files: files to load; the scenario's files that are already loaded are searched too
    Raises ConfigurationError for a file that cannot be loaded.
    """
    named = context.run.scenario.get("modules", ())
    modules = [loading.loaded_module(Path(name)) for name in named if isinstance(name, str)]
    modules += [loading.module(file) for file in files]
    kinds = loading.concrete((module for module in modules if module is not None), RunFigure)
    if kinds:
        context = copy.deepcopy(context)  # so that no figure can change the rest of the page
    drawn: dict[str, UserFigure] = {}
    for kind in kinds:
        if (each := _drawn(kind, context, drawn)) is not None:
            drawn[each.name] = each
    figures = {each.name: each for each in _stored(context.folder / "figures")} | drawn
    return [figures[name] for name in sorted(figures)]


def save(figures: Iterable[UserFigure], folder: Path) -> None:
    """Write the pictures and their texts into a folder, if there are any."""
    pictures = [(each, each.picture) for each in figures if each.picture is not None]
    for _, picture in pictures:
        picture.save(folder)
    if pictures:
        rows = [(each.name, each.heading, each.after, made.alt, made.caption) for each, made in pictures]
        content = [dict(zip(_KEYS, row, strict=True)) for row in rows]
        write_bytes(folder / FILE, (json.dumps(content, indent=2) + "\n").encode())


def _drawn(kind: type[RunFigure], context: FigureContext, taken: Container[str]) -> UserFigure | None:
    """A figure, or why it could not be drawn; None: it had nothing to draw.

    taken: the names of other figures
    """
    try:
        name, heading = _names(kind)
        if name in taken or name in {ours.label() for ours in OURS}:
            raise ValueError(f"name: found {name!r}, which another figure has")
        if kind.after not in SECTIONS:
            raise ValueError(f"after: found {kind.after!r}, expected one of {', '.join(SECTIONS)}")
        picture = rendered(kind(), context)
        if picture is not None and not (isinstance(picture.alt, str) and isinstance(picture.caption, str)):
            raise ValueError("alt and caption: expected a string")
    except (Exception, SystemExit) as error:
        problem = f"{kind.__name__} could not be drawn: {described(error)} ({location(error, kind.draw)})"
        return UserFigure(f"{kind.__module__}.{kind.__name__}", kind.__name__, RunFigure.after, None, problem)
    return None if picture is None else UserFigure(name, heading, kind.after, picture)


def _names(kind: type[RunFigure]) -> tuple[str, str]:
    """The name and the heading of a figure; raises ValueError for invalid ones."""
    for text in (kind.name, kind.heading):
        if not isinstance(text, str) or not text.isprintable():
            raise ValueError(f"name and heading: found {text!r}, expected printable text")
    name = kind.label()
    if not name.isidentifier():
        raise ValueError(f"name: found {name!r}, expected letters, digits and _")
    return name, kind.heading or name.replace("_", " ").capitalize()


def _stored(folder: Path) -> list[UserFigure]:
    """The figures that an earlier report has drawn; a broken one is left out."""
    try:
        content = read_json(folder / FILE)
    except RunFolderError:
        return []
    figures = []
    for entry in content if isinstance(content, list) else ():
        try:
            name, heading, after, alt, caption = (_text(entry, key) for key in _KEYS)
            png = check_plain(folder / f"{name}.png").read_bytes() if name.isidentifier() else b""
        except (OSError, ValueError, RunFolderError):
            continue
        if png.startswith(_PNG) and len(png) > 24 and after in SECTIONS:
            figures.append(UserFigure(name, heading, after, RenderedFigure(name, png, alt, caption)))
    return figures


def _text(entry: Any, key: str) -> str:
    value = entry.get(key) if isinstance(entry, dict) else None
    if not isinstance(value, str):
        raise ValueError(f"{key}: found {value!r:.40}, expected a string")
    return value

"""User-defined figures in the report of a run.

They are drawn if their files are loaded; otherwise the report shows the pictures drawn before.

A report never runs the files that a run folder names, which may come from somebody else. They are loaded in the process
that has run the scenario; a later report shows what that one has drawn, unless it is told which file to load.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mast_zenoh.config import loading
from mast_zenoh.control.failures import described, location
from mast_zenoh.report.figures.drawing import RenderedFigure
from mast_zenoh.report.figures.of_run import OURS, rendered
from mast_zenoh.report.run_figure import SECTIONS, FigureContext, RunFigure

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

    files: to load; besides, those of the scenario that are loaded already are looked at
    Raises ConfigurationError for a file that cannot be loaded.
    """
    named = context.run.scenario.get("modules", ())
    modules = [loading.loaded_module(Path(name)) for name in named if isinstance(name, str)]
    modules += [loading.module(file) for file in files]
    kinds = loading.concrete((module for module in modules if module is not None), RunFigure)
    drawn = {each.name: each for kind in kinds if (each := _drawn(kind, context)) is not None}
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
        (folder / FILE).write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def _drawn(kind: type[RunFigure], context: FigureContext) -> UserFigure | None:
    """A figure, or why it could not be drawn; None: it had nothing to draw."""
    name = kind.label()
    place = name, kind.heading or name.replace("_", " ").capitalize(), kind.after
    try:
        if not name.isidentifier() or name in {ours.label() for ours in OURS}:
            raise ValueError(f"name: found {name!r}, expected a plain one that none of our figures has")
        if kind.after not in SECTIONS:
            raise ValueError(f"after: found {kind.after!r}, expected one of {', '.join(SECTIONS)}")
        picture = rendered(kind(), context)
    except Exception as error:
        problem = f"{kind.__name__} could not be drawn: {described(error)} ({location(error, kind.draw)})"
        return UserFigure(name, place[1], kind.after if kind.after in SECTIONS else RunFigure.after, None, problem)
    return None if picture is None else UserFigure(*place, picture)


def _stored(folder: Path) -> list[UserFigure]:
    """The figures that a report before this one has drawn; a broken one is left out."""
    try:
        content = json.loads((folder / FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    figures = []
    for entry in content if isinstance(content, list) else ():
        try:
            name, heading, after, alt, caption = (_text(entry, key) for key in _KEYS)
            png = (folder / f"{name}.png").read_bytes() if name.isidentifier() else b""
        except (OSError, ValueError):
            continue
        if png.startswith(_PNG) and len(png) > 24 and after in SECTIONS:
            figures.append(UserFigure(name, heading, after, RenderedFigure(name, png, alt, caption)))
    return figures


def _text(entry: Any, key: str) -> str:
    value = entry.get(key) if isinstance(entry, dict) else None
    if not isinstance(value, str):
        raise ValueError(f"{key}: found {value!r:.40}, expected text")
    return value

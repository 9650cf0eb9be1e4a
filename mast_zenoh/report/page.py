"""Renders self-contained HTML pages from templates."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from mast_zenoh.version import __version__


def render(template: str, content: Mapping[str, Any], folder: Path) -> Path:
    """Write `report.html` into a folder, which is created if needed; returns the path."""
    page = environment().get_template(template).render(content, version=__version__)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "report.html"
    try:
        path.write_text(page, "utf-8", errors="surrogateescape")  # paths that are not UTF-8
    except BaseException:
        path.unlink(missing_ok=True)  # a partial page could be taken for a complete one
        raise
    return path


@cache
def environment() -> Environment:
    """The templates of this package, with HTML escaping."""
    return Environment(
        loader=PackageLoader("mast_zenoh.report"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )

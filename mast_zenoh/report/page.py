"""Renders self-contained HTML pages from templates."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from mast_zenoh.run_files import write_bytes
from mast_zenoh.version import __version__

#: Where a template wants its table of contents, and a heading that it lists.
_CONTENTS = "<!-- contents -->"
_HEADING = re.compile(r'<h2 id="([\w-]+)">(.*?)</h2>')


def render(template: str, content: Mapping[str, Any], folder: Path) -> Path:
    """Write `report.html` into a folder, which is created if needed; returns the path."""
    page = page_text(template, content)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "report.html"
    write_bytes(path, page.encode("utf-8", "surrogateescape"))  # paths that are not UTF-8
    return path


def page_text(template: str, content: Mapping[str, Any]) -> str:
    """The page as text."""
    page = environment().get_template(template).render(content, version=__version__)
    return page.replace(_CONTENTS, _table_of_contents(page), 1)


def _table_of_contents(page: str) -> str:
    """Links to all sections of a page; empty for fewer than three."""
    links = [f'<li><a href="#{name}">{title}</a></li>' for name, title in _HEADING.findall(page)]
    return f'<nav class="contents" aria-label="contents"><ul>{"".join(links)}</ul></nav>' if len(links) > 2 else ""


@cache
def environment() -> Environment:
    """The templates of this package, with HTML escaping."""
    return Environment(
        loader=PackageLoader("mast_zenoh.report"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )

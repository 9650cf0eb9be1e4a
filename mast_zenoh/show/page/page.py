"""The page that plays runs: the modules of js/ joined to one script, its style and its security policy.

Browsers refuse to import modules from files, so a page that is opened from a disk needs them inline. They are joined
in the order of their imports, which makes one module: no names may repeat between files.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterable, Sequence
from functools import cache
from html import escape
from importlib import resources
from pathlib import Path
from string import Template
from typing import NamedTuple

from mast_zenoh.errors import NotComparable, RunFolderError
from mast_zenoh.runs.run import Run
from mast_zenoh.show.page.block import run_block
from mast_zenoh.show.palette import GROUNDS

_FOLDER = resources.files("mast_zenoh.show.page")
_IMPORT = re.compile(r'^import \{[^}]*\} from "\./([\w.]+)";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:function|class|const)\b)", re.MULTILINE)
_NAME = re.compile(r"^(?:async )?(?:function|class|const|let) (\w+)", re.MULTILINE)
#: The modules with which the scripts begin: of pages with finished runs, and of the page of a running run.
_FINISHED, _LIVE = "main.js", "live.js"


class ViewerParts(NamedTuple):
    """What a page needs for one viewer: its section, script and style as they stand in HTML, and its policy."""

    section: str
    script: str
    style: str
    policy: str


def viewer_parts(blocks: Iterable[bytes]) -> ViewerParts:
    """The parts of a viewer of finished runs. blocks: from `run_block`, one or two"""
    # Base64 needs no escaping inside a page.
    data = [
        f'<script type="application/x-mast-run" data-run>{base64.b64encode(block).decode()}</script>\n'
        for block in blocks
    ]
    return ViewerParts(_section("", "".join(data)), script(), style(), policy())


def live_parts(frames: str) -> ViewerParts:
    """The parts of a viewer of a running run. frames: path of the WebSocket, on the server of the page"""
    section = _section(f' data-live="{escape(frames)}"', "")
    return ViewerParts(section, script(_LIVE), style(), f"{policy(_LIVE)}; connect-src 'self'")


def _section(attributes: str, content: str) -> str:
    return (
        f'<section class="viewer" aria-label="the run, from above and over time"{attributes}>\n'
        '<p class="v-wait"><noscript>The moving picture needs JavaScript. The figures on this page do not.</noscript>'
        f"</p>\n{content}</section>"
    )


def page_of(title: str, parts: ViewerParts) -> bytes:
    """A page with nothing but a viewer."""
    template = Template((_FOLDER / "viewer.html").read_text("utf-8"))
    text = template.substitute(parts._asdict(), title=escape(title), policy=escape(parts.policy))
    return text.encode("utf-8", "surrogateescape")  # paths that are not UTF-8


@cache
def script(entry: str = _FINISHED) -> str:
    """All modules that an entry needs, as one module.

    Raises ValueError if a name is declared in two files, or if an import or export remains.
    """
    order: dict[str, str] = {}
    _collect(entry, order)
    owners: dict[str, str] = {}
    parts = []
    for name, source in order.items():
        text = _EXPORT.sub("", _IMPORT.sub("", source))
        for declared in _NAME.findall(text):
            if owners.setdefault(declared, name) != name:
                raise ValueError(f"js/{name}: {declared} is also declared in js/{owners[declared]}")
        parts.append(f"// {name}\n{text}")
    joined = "\n".join(parts)
    if remaining := re.search(r"^(import|export) .*|</script", joined, re.MULTILINE):
        raise ValueError(f"js: {remaining[0]!r} cannot be joined")
    return joined


def _collect(name: str, order: dict[str, str]) -> None:
    """Add a module after all that it imports."""
    source = (_FOLDER / "js" / name).read_text("utf-8")
    for imported in _IMPORT.findall(source):
        if imported not in order:
            _collect(imported, order)
    order[name] = source


@cache
def style() -> str:
    """The style of the viewer, with the colours of its panels."""
    themes = {".viewer": GROUNDS["light"], ".viewer[data-theme=dark]": GROUNDS["dark"]}
    colours = [
        f"{selector} {{ --v-ground: {theme.ground}; --v-ink: {theme.ink}; --v-soft: {theme.faint}; }}\n"
        for selector, theme in themes.items()
    ]
    return "".join(colours) + (_FOLDER / "js" / "viewer.css").read_text("utf-8")


@cache
def policy(entry: str = _FINISHED) -> str:
    """The content security policy of a page: this script alone, and nothing from any network."""
    digest = base64.b64encode(hashlib.sha256(script(entry).encode()).digest()).decode()
    return (
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )


def viewer_page(folders: Sequence[Path], frame: int | None = None) -> bytes:
    """The page with the runs in these folders, one or two.

    frame: to show first
    Raises RunFolderError for a folder that holds no run, or nothing to show; NotComparable for two runs without a
    common agent.
    """
    runs = [Run(folder, frame) for folder in folders]
    blocks = []
    for run in runs:
        try:
            block = run_block(run, frame)
        except ValueError as error:
            raise RunFolderError(f"{run.path}: cannot be shown: {error}") from None
        if block is None:
            raise RunFolderError(f"{run.path}: expected objects.parquet or scene.npz: the run has nothing to show")
        blocks.append(block)
    agents = [set(run.agents) for run in runs]
    if not set.intersection(*agents) and len(runs) > 1:
        names = " and ".join(", ".join(sorted(each)) for each in agents)
        raise NotComparable(
            f"{runs[0].path} and {runs[1].path}: found the agents {names}, expected runs with a common agent"
        )
    title = " and ".join(run.name if run.name != runs[0].name or run is runs[0] else run.path.name for run in runs)
    return page_of(title, viewer_parts(blocks))

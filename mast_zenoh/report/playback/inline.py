"""The viewer as parts of one page: the modules of page/ joined to one script, its style, and a security policy.

Browsers refuse to import modules from files, so a page that is opened from a disk needs them inline. They are joined
in the order of their imports, which makes one module: no names may repeat between files.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterable
from functools import cache
from importlib import resources
from typing import Any

from mast_zenoh.report.playback.columns import as_text

_FOLDER = resources.files("mast_zenoh.report.playback") / "page"
_IMPORT = re.compile(r'^import \{[^}]*\} from "\./([\w.]+)";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:function|class|const)\b)", re.MULTILINE)
_NAME = re.compile(r"^(?:async )?(?:function|class|const|let) (\w+)", re.MULTILINE)


#: The modules with which the scripts begin: of pages with finished runs, and of the page of a running run.
_FINISHED, _LIVE = "main.js", "live_page.js"


def viewer_parts(blocks: Iterable[bytes]) -> dict[str, Any]:
    """What a template needs for one viewer: script, style, policy and the data of its runs.

    blocks: from `run_block`, one or two
    """
    parts = {"script": script(), "style": style(), "policy": policy()}
    return {**parts, "live": "", "blocks": [as_text(each) for each in blocks]}


def live_parts(frames: str) -> dict[str, Any]:
    """The same for a running run. frames: path of the WebSocket, on the server of the page"""
    parts = {"script": script(_LIVE), "style": style(), "policy": f"{policy(_LIVE)}; connect-src 'self'"}
    return {**parts, "live": frames, "blocks": []}


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
                raise ValueError(f"page/{name}: {declared} is also declared in page/{owners[declared]}")
        parts.append(f"// {name}\n{text}")
    joined = "\n".join(parts)
    if remaining := re.search(r"^(import|export) .*|</script", joined, re.MULTILINE):
        raise ValueError(f"page: {remaining[0]!r} cannot be joined")
    return joined


def _collect(name: str, order: dict[str, str]) -> None:
    """Add a module after all that it imports."""
    source = (_FOLDER / name).read_text("utf-8")
    for imported in _IMPORT.findall(source):
        if imported not in order:
            _collect(imported, order)
    order[name] = source


@cache
def style() -> str:
    """The style of the viewer."""
    return (_FOLDER / "viewer.css").read_text("utf-8")


@cache
def policy(entry: str = _FINISHED) -> str:
    """The content security policy of a page: this script alone, and nothing from any network."""
    digest = base64.b64encode(hashlib.sha256(script(entry).encode()).digest()).decode()
    return (
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )

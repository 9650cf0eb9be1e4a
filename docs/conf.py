"""The site of these pages and of the public names: `make site`."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from sphinx.application import Sphinx

import mast_zenoh

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS.parent / "tools"))

project, version = "mast-zenoh", mast_zenoh.__version__
extensions = ["myst_parser", "sphinxcontrib.mermaid", "sphinx.ext.autodoc", "api_pages"]
exclude_patterns = ["**.ipynb"]
myst_heading_anchors = 6
smartquotes = False  # `--option` keeps its dashes
myst_fence_as_directive = ["mermaid"]
mermaid_fullscreen, mermaid_height = False, "auto"
autodoc_member_order = "bysource"
autodoc_type_aliases = {name: name for name in ("Bools", "Floats", "Ints")}
python_maximum_signature_line_length = 80
html_theme = "furo"
html_title = f"mast-zenoh {version}"
html_copy_source = html_show_copyright = False
html_static_path = ["site"]
html_css_files = ["site.css"]

# The kind of a page: how its name begins, or else the list that has it.
KINDS = {
    "Tutorials": (
        "tutorial-",
        "tutorial-first-attack tutorial-defence tutorial-driving tutorial-own-data tutorial-own-detector",
    ),
    "How-to guides": ("how-to-", "troubleshooting"),
    "Explanation": ("explanation-", "known_limits roadmap"),
    "Results": ("results/", ""),
    "Reference": ("ref-", "glossary stability"),
}


def title_links(_: Sphinx, page: str, source: list[str]) -> None:
    """Show the titles of pages where a link shows the name of its file: that helps only in a checkout."""
    source[0] = re.sub(r"\[[\w-]+\.md\]\(((?:results/)?[\w-]+\.md(?:#[\w-]+)?)\)", r"[](\1)", source[0])


def add_navigation(_: Sphinx, page: str, source: list[str]) -> None:
    """Append the tables of contents to the start page: they are not for its readers elsewhere."""
    if page != "index":
        return
    files = [*DOCS.glob("*.md"), *DOCS.glob("results/*.md")]
    pages = {path.relative_to(DOCS).with_suffix("").as_posix() for path in files} - {"index"}
    for kind, (beginning, listed) in KINDS.items():
        named = sorted(name for name in pages if name.startswith(beginning) and name not in listed.split())
        entries = [*named, *(name for name in listed.split() if name in pages)]
        if kind == "Reference":
            entries.append("modules/index")
        source[0] += "\n".join(["", "```{toctree}", ":hidden:", f":caption: {kind}", "", *entries, "```", ""])


def setup(app: Sphinx) -> None:
    app.connect("source-read", title_links)
    app.connect("source-read", add_navigation)
    app.connect("env-get-outdated", lambda *_: ["index"])  # there may be a new page

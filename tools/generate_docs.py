"""Generates pages and examples from code: `python tools/generate_docs.py docs`.

The pages of reference are made in `reference`, a module for each.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from compose_examples import EXAMPLES, example
from reference.classes import classes_page
from reference.command_line import command_line_page
from reference.exit_codes import exit_codes_page
from reference.maps import maps_page
from reference.messages import messages_page
from reference.metrics import metrics_page
from reference.python_api import python_page
from reference.run_folder import run_folder_page
from reference.scenario import scenario_page

import mast_zenoh
from mast_zenoh.layers import LAYERS

_PACKAGE = Path(mast_zenoh.__file__).parent

_LAYERS = re.compile(r"(<!-- Written by `make docs` from mast_zenoh/layers.py. -->\n).*?(<!-- end -->\n)", re.DOTALL)


def architecture_page() -> str:
    """docs/explanation-architecture.md with an updated list of layers."""
    names = {name: f"{name}/" if (_PACKAGE / name).is_dir() else f"{name}.py" for name in LAYERS}
    width = max(map(len, names.values()))
    listing = "".join(f"{names[name]:{width}}  {holds}\n" for name, holds in LAYERS.items())
    page = (_PACKAGE.parent / "docs" / "explanation-architecture.md").read_text(encoding="utf-8")
    return _LAYERS.sub(lambda match: f"{match[1]}\n```text\n{listing}```\n\n{match[2]}", page)


PAGES = {
    "explanation-architecture.md": architecture_page,
    "ref-classes.md": classes_page,
    "ref-command-line.md": command_line_page,
    "ref-exit-codes.md": exit_codes_page,
    "ref-maps.md": maps_page,
    "ref-messages.md": messages_page,
    "ref-metrics.md": metrics_page,
    "ref-python.md": python_page,
    "ref-run-folder.md": run_folder_page,
    "ref-scenario.md": scenario_page,
}


def main(folder: Path) -> None:
    """Write all pages, and the examples in deploy/compose/ next to the folder."""
    for name, page in PAGES.items():
        (folder / name).write_text(page(), encoding="utf-8")
    for name in EXAMPLES:
        (folder.parent / "deploy" / "compose" / f"{name}.yml").write_text(example(name), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))

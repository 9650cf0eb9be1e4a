"""`mast wiring`, `mast list` and `mast scene`: what a scenario connects and can name, and what a scene contains."""

from __future__ import annotations

import json
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import typer

from mast_zenoh.cli import completion
from mast_zenoh.cli.options import Frames, Scenario, Seed, Settings
from mast_zenoh.cli.options import out as _out

_CHAIN_COLUMN = 37  # of `to_text`: nodes are to the right of it
_LEG_INDENT = 10


def wiring(
    scenario_file: Scenario,
    settings: Settings = None,
    format: Annotated[Literal["text", "json", "mermaid"], typer.Option(help="How to print it.")] = "text",
) -> None:
    """Show the publishers and subscribers of every key, with rewrites marked."""
    from mast_zenoh import scenario
    from mast_zenoh.wiring.model import Wiring, to_mermaid, to_text

    path, loaded = scenario.load(scenario_file, settings or ())
    resolved = scenario.resolve(path, loaded, record=True)
    resolved_wiring = Wiring.from_json(resolved.wiring)
    if format == "json":
        text = json.dumps(resolved_wiring.to_json(), indent=2)
    elif format == "mermaid":
        text = to_mermaid(resolved_wiring)
    else:
        text = to_text(resolved_wiring)
        if _out().is_terminal:  # elsewhere each wire is one line, for other programs
            text = "\n".join(_wrapped(text, _out().width))
    sys.stdout.write(text + "\n")


def _wrapped(text: str, width: int) -> Iterator[str]:
    """The lines of `to_text` for a terminal, continued below the nodes."""
    for line in text.splitlines():
        indent = _LEG_INDENT if line.startswith("   ") else _CHAIN_COLUMN
        yield from textwrap.wrap(
            line, width, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False
        ) or [""]


_WIDTH = 80
_HELP = f"{', '.join(completion.KINDS[:-1])} or {completion.KINDS[-1]}. Default: all their names."


def list_kind(
    kind: Annotated[str | None, typer.Argument(help=_HELP, autocompletion=completion.kinds)] = None,
    name: Annotated[str | None, typer.Argument(help="One entry of this kind; shows only that entry.")] = None,
    file: Annotated[Path | None, typer.Option(help="Your own Python file: its definitions are listed too.")] = None,
) -> None:
    """List what a scenario can name, with parameters, defaults and units."""
    from mast_zenoh.api import catalogue  # every package of algorithms: commands that need none do not load them
    from mast_zenoh.config import loading

    if file is not None:
        loading.module(file)
    if kind is None:
        for each in catalogue.KINDS:
            names = ", ".join(catalogue.list_kind(each).names)
            lines = textwrap.wrap(f"{each}: {names}", _WIDTH, subsequent_indent="    ", break_on_hyphens=False)
            _out().plain("\n".join(lines))
        return
    listing = catalogue.list_kind(kind)
    _out().plain(str(listing if name is None else listing[name]))


app = typer.Typer(help="Look into a scene, and write it to files.", no_args_is_help=True)

Place = Annotated[
    str, typer.Argument(metavar="SCENE", help="intersection:2, av2:PATH, … (`mast list scenes`), or a file or folder.")
]


@app.command()
def check(
    scene: Place,
    settings: Settings = None,
    frames: Frames = None,
    seed: Seed = None,
    draw: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the first frame.")] = None,
) -> None:
    """Say what a scene contains, and what is suspicious about it."""
    from mast_zenoh.api import scenes

    prepared = scenes.named(scene, settings or (), seed=seed, frames=frames)
    _out().plain(prepared.description)
    if draw is not None:
        prepared.birdseye().savefig(draw)
        _out().plain(f"frame 0: {draw}")


@app.command()
def convert(
    scene: Place,
    target: Annotated[
        Path, typer.Argument(metavar="FILE.npz", help="The file to write (docs/ref-detections-and-arrays.md).")
    ],
    settings: Settings = None,
    frames: Frames = None,
    seed: Seed = None,
) -> None:
    """Write a scene to a file of our own format, which `recording:FILE.npz` plays."""
    from mast_zenoh.api import scenes

    prepared = scenes.named(scene, settings or (), seed=seed, frames=frames)
    _out().plain(f"{prepared.save(target)}: {len(prepared)} frames")


@app.command()
def detections(
    scene: Place,
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="New or empty; gets a file for each agent.")],
    settings: Settings = None,
    frames: Frames = None,
    seed: Seed = None,
) -> None:
    """Write a scene's detections as KITTI text, which `scene.detections=FOLDER` replays."""
    from mast_zenoh.api import scenes

    prepared = scenes.named(scene, settings or (), seed=seed, frames=frames)
    for file in prepared.save_detections(folder):
        _out().plain(str(file))

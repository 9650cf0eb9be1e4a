"""`mast scene`: look into a scene, and write it or its detections to files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mast_zenoh.cli.options import Frames, Seed, Settings
from mast_zenoh.cli.options import out as _out

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
    _out.print(prepared.description, markup=False, highlight=False)
    if draw is not None:
        prepared.birdseye().savefig(draw)
        _out.print(f"frame 0: {draw}", markup=False, highlight=False)


@app.command()
def convert(
    scene: Place,
    target: Annotated[Path, typer.Argument(metavar="FILE.npz", help="The file to write, see docs/scene_arrays.md.")],
    settings: Settings = None,
    frames: Frames = None,
    seed: Seed = None,
) -> None:
    """Write a scene to a file of our own format, which `recording:FILE.npz` plays."""
    from mast_zenoh.api import scenes

    prepared = scenes.named(scene, settings or (), seed=seed, frames=frames)
    _out.print(f"{prepared.save(target)}: {len(prepared)} frames", markup=False, highlight=False)


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
        _out.print(str(file), markup=False, highlight=False)

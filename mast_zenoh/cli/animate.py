"""`mast animate` and `mast snapshot`: films and stills of a finished run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mast_zenoh.cli import completion
from mast_zenoh.cli.options import out as _out
from mast_zenoh.run_files import reading

if TYPE_CHECKING:
    from mast_zenoh.report.film.look import Look

RunRecord = Annotated[
    Path,
    typer.Argument(metavar="RUN", help="The folder of a finished run.", autocompletion=completion.run_folders),
]
Agent = Annotated[str | None, typer.Option(help="Whose estimates to show. Default: the main agent.")]
Estimates = Annotated[
    list[str] | None,
    typer.Option("--estimate", metavar="NAME", help="Up to three, side by side: local, picture, mission, truth, …"),
]
Beside = Annotated[
    Path | None, typer.Option("--against", metavar="OTHER", help="Another run, beside the first at the same time.")
]
Camera = Annotated[bool, typer.Option("--camera", help="Add the agent's camera view.")]
Window = Annotated[
    str, typer.Option(metavar="fit|follow[:HALF]|X,Y,HALF", help="Which part of the scene; half of its height in m.")
]
Theme = Annotated[str, typer.Option(metavar="dark|light", help="The ground.")]
Size = Annotated[str | None, typer.Option(metavar="WIDTHxHEIGHT[px|in|cm|mm]", help="Of the image: 1280x720, 18x10cm.")]
Dpi = Annotated[int, typer.Option(help="Pixels per inch; text keeps its size in points.")]
Plain = Annotated[bool, typer.Option("--plain", help="Panels and legend alone: no title, numbers, strips or caption.")]
Title = Annotated[str | None, typer.Option(help="In place of the run's name and the agent's.")]
Captions = Annotated[
    list[str] | None,
    typer.Option("--caption", metavar="FRAME:TEXT", help="A caption from this frame until the next event."),
]


def animate(
    run_folder: RunRecord,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="A new file: .mp4, .gif or .webm.")],
    agent: Agent = None,
    estimates: Estimates = None,
    against: Beside = None,
    camera: Camera = False,
    window: Window = "fit",
    theme: Theme = "dark",
    size: Size = None,
    dpi: Dpi = 100,
    plain: Plain = False,
    title: Title = None,
    captions: Captions = None,
    start: Annotated[int | None, typer.Option("--from", metavar="FRAME", help="The first frame.")] = None,
    end: Annotated[int | None, typer.Option("--to", metavar="FRAME", help="The last frame.")] = None,
    speed: Annotated[float, typer.Option(help="Speed over that of the scene.")] = 1.0,
    fps: Annotated[float | None, typer.Option(help="Images per second. Default: every frame, at most 30.")] = None,
) -> None:
    """Write a film of a finished run."""
    from mast_zenoh.report.film import writing  # drawing libraries are slow to load

    look = _look(
        estimates,
        captions,
        agent=agent,
        camera=camera,
        window=window,
        theme=theme,
        size=size,
        dpi=dpi,
        plain=plain,
        title=title,
    )
    with reading(run_folder):
        images = writing.animate(run_folder, out, look, against, start=start, end=end, speed=speed, fps=fps)
    _out.print(f"film: {out} ({images} images, {out.stat().st_size / 1e6:.1f} MB)", markup=False, highlight=False)


def snapshot(
    run_folder: RunRecord,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="A new file: .pdf, .svg or .png.")],
    frame: Annotated[int | None, typer.Option(help="The frame. Default: the one that the report shows.")] = None,
    agent: Agent = None,
    estimates: Estimates = None,
    against: Beside = None,
    camera: Camera = False,
    window: Window = "fit",
    theme: Theme = "light",
    size: Size = None,
    dpi: Dpi = 100,
    plain: Plain = False,
    title: Title = None,
    captions: Captions = None,
) -> None:
    """Write one frame of a finished run as a figure."""
    from mast_zenoh.report.film import writing

    look = _look(
        estimates,
        captions,
        agent=agent,
        camera=camera,
        window=window,
        theme=theme,
        size=size,
        dpi=dpi,
        plain=plain,
        title=title,
    )
    with reading(run_folder):
        shown = writing.snapshot(run_folder, out, look, frame, against)
    _out.print(f"frame {shown}: {out}", markup=False, highlight=False)


def _look(estimates: list[str] | None, captions: list[str] | None, **options: Any) -> Look:
    from mast_zenoh.report.film.look import Look

    return Look(estimates=tuple(estimates or ("picture",)), captions=tuple(captions or ()), **options)

"""Renders the figures of a report as PNG (the wiring also as SVG), with alt texts."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib import figure as figures
from matplotlib.axes import Axes

from mast_zenoh.metrics.estimates import ESTIMATES
from mast_zenoh.run_folder import subfolder, write_bytes
from mast_zenoh.runs.frame import Frame
from mast_zenoh.show.figures.birdseye import BirdseyePanel
from mast_zenoh.show.figures.camera import draw_camera, ego_eye
from mast_zenoh.show.figures.legend import draw_legend, legend_entries
from mast_zenoh.show.figures.style import THEMES, Figure, pdf, plain, png, svg
from mast_zenoh.show.figures.view import Window, window_of
from mast_zenoh.show.tables.scores import ScoreTable

_THEME = THEMES["dark"]


@dataclass(frozen=True, slots=True)
class RenderedFigure:
    """A figure as it goes into the page.

    name:    of the file under figures/, without extension
    alt:     alternative text
    caption: how to read it
    files:   contents by extension: png; svg, where the page shows that; pdf, of a figure of a study
    """

    name: str
    alt: str
    caption: str
    files: Mapping[str, bytes]

    @property
    def png(self) -> bytes:
        """The PNG."""
        return self.files["png"]

    @property
    def source(self) -> str:
        """A data URI of the figure, for `img src`."""
        kind = "svg" if "svg" in self.files else "png"
        data = base64.b64encode(self.files[kind]).decode()
        return f"data:image/{_TYPES[kind]};base64,{data}"

    @property
    def pixels(self) -> tuple[int, int]:
        """Width and height of the PNG."""
        return int.from_bytes(self.png[16:20]), int.from_bytes(self.png[20:24])

    def save(self, folder: Path) -> None:
        """Write `folder/<name>.png`, and `.svg` and `.pdf` where there are any."""
        folder = subfolder(folder.parent, folder.name)
        for extension, data in self.files.items():
            write_bytes(folder / f"{self.name}.{extension}", data)

    @property
    def names(self) -> list[str]:
        """The names of the files that `save` writes."""
        return [f"{self.name}.{extension}" for extension in self.files]


_TYPES = {"png": "png", "svg": "svg+xml"}


def render(
    name: str, figure: figures.Figure, alt: str, caption: str, *, vector: bool = False, printed: bool = False
) -> RenderedFigure:
    """Render a figure. vector: also as SVG, for the page; printed: also as PDF, for papers"""
    files = {"png": png(figure)}  # sets the resolution, before other formats are drawn
    files |= {"svg": svg(figure)} if vector else {}
    files |= {"pdf": pdf(figure)} if printed else {}
    return RenderedFigure(name, alt, caption, files)


def _dark_figure(views: Sequence[Frame], width: float, height: float, *, camera: bool = False) -> Figure:
    """An empty dark figure with the legend of `views` below.

    height: inches, without the legend
    """
    figure = Figure(figsize=(width, height), facecolor=_THEME.ground)
    figure.set_figheight(height + draw_legend(figure, legend_entries(views, _THEME, camera=camera), _THEME, 10.5))
    return figure


def _draw_birdseye(axes: Axes, view: Frame, estimate: str, window: Window, *, leftmost: bool) -> None:
    BirdseyePanel(axes, view.run, estimate, _THEME).show(view, window)
    axes.set_xlabel("x, east (m)", color=_THEME.faint, fontsize=10, labelpad=2)
    if leftmost:
        axes.set_ylabel("y, north (m)", color=_THEME.faint, fontsize=10, labelpad=-2)


def birdseye_figure(view: Frame) -> Figure:
    """Bird's-eye views of the ego's own tracks, the picture, and both together."""
    window, pitch = window_of([view]), 14.4 / len(view.boxes)
    side = pitch - 0.74
    figure = _dark_figure([view], 14.4, side + 1.06)
    for index, estimate in enumerate(view.boxes):
        axes = figure.place(0.66 + pitch * index, 0.4, side, side)
        _draw_birdseye(axes, view, estimate, window, leftmost=index == 0)
        _title(axes, ESTIMATES[estimate].panel, view, when=index == 0)
    return figure


def _title(axes: Axes, title: str, view: Frame, size: float = 12.5, *, when: bool = True) -> None:
    axes.set_title(plain(view.run.worded(title)), color=_THEME.ink, fontsize=size, loc="left", pad=6)
    if when:
        axes.set_title(view.time_label, color=_THEME.faint, fontsize=10.5, loc="right", pad=6)


def camera_figure(view: Frame) -> Figure | None:
    """Camera views of the ego alone and of what it acts on; None: ego not in scene."""
    eye = ego_eye(view)
    if eye is None:
        return None
    height = 11.7 * eye.crop_aspect
    first, *_, last = view.boxes
    figure = _dark_figure([view], 12.0, 2 * (height + 0.42) + 0.14, camera=True)
    for index, estimate in enumerate((first, last)):
        axes = figure.place(0.15, 0.36 + index * (height + 0.42), 11.7, height)
        draw_camera(axes, view, estimate, eye, _THEME)
        _title(axes, ESTIMATES[estimate].panel, view)
    return figure


def side_by_side_figure(views: Mapping[str, Frame], table: ScoreTable, estimate: str = "picture") -> Figure:
    """One estimate of several runs in the same frame with scores, three runs per row."""
    columns = min(len(views), 3)
    window, pitch = window_of(views.values()), 14.4 / columns
    side, foot = pitch - 0.74, 1.62
    lines = -(-len(views) // columns)
    figure = _dark_figure(list(views.values()), 14.4, lines * (side + foot) + 0.2)
    for index, (label, view) in enumerate(views.items()):
        line, column = divmod(index, columns)
        left, top = 0.66 + column * pitch, 0.38 + line * (side + foot)
        axes = figure.place(left, top, side, side)
        _draw_birdseye(axes, view, estimate, window, leftmost=column == 0)
        _title(axes, label, view, 14.0)
        if label in table.runs:
            _numbers(figure, (table, label, estimate), left, top + side + 0.6, side)
    return figure


def _numbers(figure: Figure, selection: tuple[ScoreTable, str, str], left: float, top: float, width: float) -> None:
    """Write scores under a panel in the legend's colours.

    left, top, width: inches from the upper left
    selection: the table, the run and the estimate
    """
    table, run, estimate = selection
    outcomes = _THEME.outcomes
    columns = (
        ("fn", "missed", outcomes["truth missed"]),
        ("fp", "false", outcomes["track false"]),
        ("tp", "matched", outcomes["track matched"]),
        ("rmse_m", "RMSE (m)", _THEME.ink),
    )
    style = {"ha": "center", "va": "top"}
    step = width / len(columns)
    for index, (key, name, colour) in enumerate(columns):
        x, value = left + step * (index + 0.5), table.score(key, run, estimate).number
        figure.write(x, top, value, color=colour, fontsize=17, fontweight="bold", **style)
        figure.write(x, top + 0.32, name, color=_THEME.ink, fontsize=10, **style)
    figure.write(left + step * 1.5, top + 0.51, "objects per frame", color=_THEME.faint, fontsize=9.5, **style)

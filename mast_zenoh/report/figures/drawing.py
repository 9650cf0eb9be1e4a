"""Renders the figures of a report as PNG (the wiring also as SVG), with alt texts."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from matplotlib import figure as figures
from matplotlib.axes import Axes

from mast_zenoh.metrics.estimates import ESTIMATES
from mast_zenoh.metrics.measures import MEASURES
from mast_zenoh.report.figures.birdseye import draw_birdseye, key
from mast_zenoh.report.figures.camera import draw_camera, ego_eye
from mast_zenoh.report.figures.style import Figure, pdf, plain, png, svg
from mast_zenoh.report.figures.view import window
from mast_zenoh.report.tables.scores import ScoreTable, number
from mast_zenoh.run_folder import subfolder, write_bytes
from mast_zenoh.runs.frame import Frame
from mast_zenoh.viewer.palette import FAINT, GROUND

_WHITE = "#f2f5f9"


@dataclass(frozen=True, slots=True)
class RenderedFigure:
    """A figure as it goes into the page.

    name:    of the file under figures/, without extension
    png:     bytes
    alt:     alternative text
    caption: how to read it
    svg:     bytes, where the page shows the SVG
    pdf:     bytes, of a figure of a study
    """

    name: str
    png: bytes
    alt: str
    caption: str
    svg: bytes | None = None
    pdf: bytes | None = None

    @property
    def source(self) -> str:
        """A data URI of the figure, for `img src`."""
        kind, data = ("svg+xml", self.svg) if self.svg else ("png", self.png)
        return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"

    @property
    def pixels(self) -> tuple[int, int]:
        """Width and height of the PNG."""
        return int.from_bytes(self.png[16:20]), int.from_bytes(self.png[20:24])

    def save(self, folder: Path) -> None:
        """Write `folder/<name>.png`, and `.svg` and `.pdf` where there are any."""
        folder = subfolder(folder.parent, folder.name)
        for suffix, data in self._files.items():
            write_bytes(folder / f"{self.name}.{suffix}", data)

    @property
    def names(self) -> list[str]:
        """The names of the files that `save` writes."""
        return [f"{self.name}.{suffix}" for suffix in self._files]

    @property
    def _files(self) -> dict[str, bytes]:
        files = {"png": self.png, "svg": self.svg, "pdf": self.pdf}
        return {suffix: data for suffix, data in files.items() if data}


def render(
    name: str, figure: figures.Figure, alt: str, caption: str, *, vector: bool = False, printed: bool = False
) -> RenderedFigure:
    """Render a figure. vector: also as SVG, for the page; printed: also as PDF, for papers"""
    picture = png(figure)  # sets the resolution, before other formats are drawn
    return RenderedFigure(
        name, picture, alt, caption, svg(figure) if vector else None, pdf(figure) if printed else None
    )


def _dark_figure(views: Sequence[Frame], width: float, height: float, *, agents: bool = True) -> Figure:
    """An empty dark figure with the legend of `views` below.

    height: inches, without the legend
    """
    handles = key(views, agents=agents)
    lines = 1 if len(handles) <= 6 else -(-len(handles) // 7) if len(handles) > 12 else 2
    figure = Figure(figsize=(width, height + 0.24 + 0.22 * lines), facecolor=GROUND)
    figure.legend(
        handles=handles,
        loc="lower center",
        ncols=-(-len(handles) // lines),
        frameon=False,
        labelcolor=_WHITE,
        fontsize=10.5,
        handlelength=1.4,
        columnspacing=1.8,
        borderaxespad=0.3,
    )
    return figure


def _panel(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Axes placed in inches from the upper left corner."""
    w, h = figure.get_size_inches()
    return figure.add_axes((left / w, 1 - (top + height) / h, width / w, height / h))


def birdseye_figure(view: Frame) -> Figure:
    """Bird's-eye views of the ego's own tracks, the picture, and both together."""
    shared_window = window([view])
    view = replace(view, window=shared_window)
    width = 14.4
    pitch = width / len(view.boxes)
    side = pitch - 0.74
    figure = _dark_figure([view], width, side + 0.82)
    for index, estimator in enumerate(view.boxes):
        axes = _panel(figure, 0.66 + pitch * index, 0.4, side, side)
        draw_birdseye(axes, view, estimator, shared_window)
        if index:
            axes.set_ylabel("")
        _title(axes, ESTIMATES[estimator].panel, view, when=index == 0)
    return figure


def _title(axes: Axes, title: str, view: Frame, size: float = 12.5, *, when: bool = True) -> None:
    axes.set_title(plain(view.run.worded(title)), color=_WHITE, fontsize=size, loc="left", pad=6)
    if when:
        axes.set_title(view.time_label, color=FAINT, fontsize=10.5, loc="right", pad=6)


def camera_figure(view: Frame) -> Figure | None:
    """Camera views of the ego alone and of what it acts on; None: ego not in scene."""
    eye = ego_eye(view)
    if eye is None:
        return None
    height = 11.7 * eye.crop_aspect
    view = replace(view, window=window([view]), arrows=False)  # which are not readable in perspective
    first, *_, last = view.boxes
    estimates = first, last
    figure = _dark_figure([view], 12.0, 2 * (height + 0.42) + 0.1, agents=False)
    for index, estimator in enumerate(estimates):
        axes = _panel(figure, 0.15, 0.36 + index * (height + 0.42), 11.7, height)
        draw_camera(axes, view, estimator, eye)
        _title(axes, ESTIMATES[estimator].panel, view)
    return figure


def side_by_side_figure(views: Mapping[str, Frame], table: ScoreTable, estimate: str = "picture") -> Figure:
    """One estimate of several runs in the same frame with scores, three runs per row."""
    columns = min(len(views), 3)
    shared_window = window(list(views.values()))
    views = {label: replace(view, window=shared_window) for label, view in views.items()}
    pitch = 14.4 / columns
    side, foot = pitch - 0.74, 1.62
    lines = -(-len(views) // columns)
    figure = _dark_figure(list(views.values()), 14.4, lines * (side + foot) + 0.05)
    for index, (label, view) in enumerate(views.items()):
        line, column = divmod(index, columns)
        left, top = 0.66 + column * pitch, 0.38 + line * (side + foot)
        axes = _panel(figure, left, top, side, side)
        draw_birdseye(axes, view, estimate, shared_window)
        _title(axes, label, view, 14.0)
        if column:
            axes.set_ylabel("")
        if label in table.runs:
            _numbers(figure, (table, label, estimate), left, top + side + 0.6, side)
    return figure


def _numbers(figure: Figure, selection: tuple[ScoreTable, str, str], left: float, top: float, width: float) -> None:
    """Write scores under a panel in the legend's colours.

    left, top, width: inches from the upper left
    selection: the table, the run and the estimate
    """
    table, run, estimate = selection
    w, h = figure.get_size_inches()
    columns = (
        ("fn", "missed", "#ffd60a"),
        ("fp", "false", "#ff6b6b"),
        ("tp", "matched", "#7db2ff"),
        ("rmse_m", "RMSE (m)", _WHITE),
    )
    values = [
        (number(table.cell(key, run, estimate).value, MEASURES[key]), name, colour) for key, name, colour in columns
    ]
    for index, (value, name, colour) in enumerate(values):
        x = (left + width * (index + 0.5) / len(values)) / w
        figure.text(x, 1 - top / h, value, color=colour, fontsize=17, ha="center", va="top", fontweight="bold")
        figure.text(x, 1 - (top + 0.32) / h, name, color=_WHITE, fontsize=10, ha="center", va="top")
    x = (left + width * 1.5 / len(values)) / w
    figure.text(x, 1 - (top + 0.51) / h, "objects per frame", color=FAINT, fontsize=9.5, ha="center", va="top")

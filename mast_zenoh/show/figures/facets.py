"""Figures of the rows of a study: panels of curves with intervals, and panels of numbers as colours."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, SymLogNorm
from matplotlib.figure import SubFigure
from matplotlib.patches import Polygon, Rectangle
from matplotlib.ticker import NullFormatter, ScalarFormatter
from numpy.typing import ArrayLike

from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.metrics.study_results import Row, Statistic
from mast_zenoh.show.figures.style import LINE_STYLES, MARKERS, Figure, light_axes, plain
from mast_zenoh.show.number_text import number
from mast_zenoh.show.palette import INK, LOCAL, PALE, RUN_COLOURS

#: Share of the axis by which the points of neighbouring curves are moved apart, so that bars do not overlap.
_APART = 0.012
#: Factor between the ends of the axis of positive numbers from which it is logarithmic.
_LOG = 10.0
_SIZE = 9.5
#: Up to so many numbers, each has its tick.
_TICKS = 12


class Axis(NamedTuple):
    """What one panel, or one column of panels, shows: a measure of rows, the label of its axis, and its factor.

    log: whether the axis may be logarithmic;  title: of its panels
    """

    measure: Any
    label: str
    factor: float = 1.0
    log: bool = False
    title: str = ""


def facet(
    rows: Sequence[Row],
    x: str,
    y: Sequence[Axis],
    hue: str,
    *,
    by: str = "",
    columns: int = 0,
    label: str = "",
    size: tuple[float, float] = (4.6, 3.4),
    log: bool = False,
    into: SubFigure | None = None,
    title: str = "",
) -> Figure:
    """Curves of rows in a panel for each measure, or for each value of a name. Raises ConfigurationError.

    x, hue, by: names of what rows are of: a number or a text, along the axis; what curves differ by, and panels
    y: the measures; one if there is `by`;  columns: of panels, 0: one line;  label: of x, "": its name
    size: inches of a panel;  log: whether x is on a logarithmic axis
    into: what it is drawn into, None: a new figure;  title: above the names of curves, "": `hue` if they are numbers
    Texts of x are on lines below each other, and their numbers along the other axis.
    """
    _check_arguments(rows, y, {"x": x, "hue": hue} | ({"by": by} if by else {}))
    groups = _values(rows, by) if by else [None]
    panels = [(axis, group) for axis in y for group in groups]
    columns = columns or len(panels)
    lines = -(-len(panels) // columns)
    # A part of a figure has all that is used of it here.
    inches = size[0] * columns, size[1] * lines
    figure = cast(Figure, into or Figure(figsize=inches, layout="constrained", facecolor="white"))
    ticks, hues = _values(rows, x), _values(rows, hue)
    across = any(isinstance(tick, str) for tick in ticks)
    places = {tick: float(at if across else tick) for at, tick in enumerate(ticks if across else sorted(ticks))}
    positions = np.array([*places.values()] or [0.0])
    spread = np.ptp(np.log(positions) if log else positions) or 1.0
    grid = figure.subplots(lines, columns, squeeze=False, sharex=not across, sharey=across).ravel()
    for axes, (axis, group) in zip(grid, panels, strict=False):
        light_axes(axes)
        for index, each in enumerate(hues):
            chosen = [row for row in rows if row.of[hue] == each and group in (None, row.of.get(by))]
            shift = (index - (len(hues) - 1) / 2.0) * (0.2 if across else _APART * spread)
            at = np.array([places[row.of[x]] for row in chosen])
            at = at * math.exp(shift) if log else at + shift
            if chosen:
                curve(axes, at, [row[axis.measure] for row in chosen], index, str(each), axis.factor, across=across)
            for place, row in zip(at, chosen, strict=True):
                if row.idle:
                    axes.plot(place, axis.factor * row[axis.measure].value, color="white", marker=".", zorder=5)
        if across:
            axes.grid(visible=False, axis="y")
            axes.grid(axis="x", color=PALE, linewidth=0.8)
            axes.axvline(0.0, color=INK, linewidth=0.8)
            axes.set_ylim(max(len(ticks), 1) - 0.5, -0.5)
            axes.set_xlabel(axis.label, fontsize=_SIZE, color=INK)
        else:
            _number_axis(axes, axis, positions, log)
            axes.set_ylabel(axis.label if axes is grid[0] or not by else "", fontsize=_SIZE, color=INK)
        if by or axis.title:
            axes.set_title(plain(group if by else axis.title), fontsize=_SIZE, color=INK, loc="left")
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    if across:
        grid[0].set_yticks(range(len(ticks)), labels=[plain(tick) for tick in ticks])
    else:
        figure.supxlabel(label or x, fontsize=_SIZE, color=INK)
    legend_above(figure, title=title or (hue if hues and not any(isinstance(each, str) for each in hues) else ""))
    return figure


def _check_arguments(rows: Sequence[Row], y: Sequence[Axis], names: Mapping[str, str]) -> None:
    """Raise ConfigurationError for axes that are none, and names and measures that rows lack. names: by argument"""
    if isinstance(y, (str, Axis)) or not all(isinstance(axis, Axis) for axis in y):
        raise ConfigurationError(f"facet: y: found {y!r:.120}, expected a list of Axis(measure, label), one a panel")
    for row in rows:
        if not isinstance(row, Row):
            raise ConfigurationError(f"facet: rows: found {row!r:.120}, expected a Row")
        for argument, name in names.items():
            if name not in row.of:
                raise ConfigurationError(f"facet: {argument}: found {name!r}{nearest(str(name), row.of)}")
        for axis in y:
            if row.numbers and axis.measure not in row.numbers:
                raise ConfigurationError(f"facet: y: found {axis.measure!r}{nearest(str(axis.measure), row.numbers)}")


def _values(rows: Sequence[Row], name: str) -> list[Any]:
    return list(dict.fromkeys(row.of[name] for row in rows))


def _number_axis(axes: Axes, axis: Axis, positions: Any, log: bool) -> None:
    """The scales of a panel with numbers along x."""
    if log:
        axes.set_xscale("log")
        axes.set_xticks(positions, labels=[f"{at:g}" for at in positions], minor=False)
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.tick_params(axis="x", which="minor", length=0)
    elif len(positions) <= _TICKS:
        axes.set_xticks(positions, labels=[f"{at:g}" for at in positions])
    bottom, top = axes.get_ylim()
    if axis.log and bottom > 0.0 and top > _LOG * bottom:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(ScalarFormatter())
        axes.yaxis.set_minor_formatter(NullFormatter())
    elif bottom < 0.0:
        axes.axhline(0.0, color=LOCAL, linewidth=0.8)
    else:
        axes.set_ylim(0.0, 1.05 * top)


def curve(
    axes: Axes,
    x: ArrayLike,
    numbers: Sequence[Statistic],
    index: int,
    label: str,
    factor: float = 1.0,
    *,
    across: bool = False,
) -> None:
    """Numbers with their intervals, in the colour, with the marker and the line of an index.

    across: numbers are along x, and not joined
    """
    values = factor * np.array([(each.value, each.low, each.high) for each in numbers]).reshape(-1, 3)
    bars = np.nan_to_num(np.abs(values[:, 1:].T - values[:, 0]))
    axes.errorbar(
        values[:, 0] if across else x,
        x if across else values[:, 0],
        xerr=bars if across else None,
        yerr=None if across else bars,
        color=RUN_COLOURS[index % len(RUN_COLOURS)],
        marker=MARKERS[index % len(MARKERS)],
        linestyle="none" if across else LINE_STYLES[index % len(LINE_STYLES)],
        markersize=4.5,
        linewidth=1.6,
        elinewidth=0.9,
        capsize=2.0,
        label=plain(label),
    )


def legend_above(figure: Figure, *others: Artist, title: str = "") -> None:
    """The legend of the curves of all panels and of others, above all panels."""
    named = {
        label: handle for axes in figure.axes for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    named |= {str(other.get_label()): other for other in others}
    named.pop("", None)
    inches = figure.bbox.width / figure.dpi
    handles, labels = [*named.values()], [*named]
    for legend in list(figure.legends):
        legend.remove()
    if not (named or title):
        return
    figure.legend(
        handles,
        labels,
        loc="outside upper left",
        ncols=max(1, min(len(labels), int(inches / (0.7 + 0.075 * max(map(len, labels), default=1))))),
        frameon=False,
        fontsize=9,
        labelcolor=INK,
        title=title or None,
        title_fontproperties={"weight": "bold", "size": 10.5},
        alignment="left",
    )


# -- numbers as colours ------------------------------------------------------------------------------------------------

#: Inches at which heat maps are drawn; a paper prints a column at half of this width, so that 12 pt become 6 pt.
_WIDTH, _CELL_WIDTH, _CELL_HEIGHT = 7.0, 0.46, 0.28
#: Inches: of a wide cell, where columns are few; and of the narrowest figure, with its scale and its key.
_WIDEST_CELL, _LEAST_WIDTH = 0.8, 5.8
_CELL_SIZE, _TITLE_SIZE, _KEY_SIZE = 12.0, 13.0, 10.5
#: Inches of a letter of a label, and between parts of the figure.
_LETTER, _GAP = 0.105, 0.1
#: Inches of a panel's title, of the scale with its label, below, and of a line of the key, at the bottom.
_TITLE, _SCALE, _KEY_LINE = 0.32, 0.9, 0.19
#: Diverging, and safe for colour-blind readers: blue helps, red harms; and the colour of a cell without a number.
_COLOURS, _UNKNOWN = "RdBu_r", "#e0e0e0"
#: Numbers up to which colours are linear; beyond, they are logarithmic, so that one flood hides nothing.
_LINEAR = 1.0
#: Numbers on the scale, at one of which it ends.
_ROUND = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
#: Share of the colour scale beyond which letters are white.
_DARK = 0.55
#: Share of runs that suspend an honest agent from which the mark is large; sides of the marks, in cells' heights.
_OFTEN, _SMALL, _LARGE = 0.5, 0.27, 0.48


class HeatMap(NamedTuple):
    """One panel: its title, the names of its lines, and their cells; None: there is none."""

    title: str
    lines: Sequence[str]
    cells: Sequence[Sequence[Row | None]]


def heat_facet(maps: Sequence[Sequence[HeatMap]], columns: Sequence[str], measure: str, label: str) -> Figure:
    """A measure of rows as colours and numbers, in lines of panels; the first panel of a line has the most lines.

    columns: names of the columns of all panels;  label: of the scale
    """
    first = maps[0][0].lines
    left = _LETTER * max(len(name) for name in first) + 2 * _GAP
    longest = max(len(each.title) for line in maps for each in line)
    across = len(maps[0])
    wide = min((_WIDTH - left - _GAP) / across - _GAP, _WIDEST_CELL * len(columns))
    panel_width = max(wide, _CELL_WIDTH * len(columns))
    pitch = max(panel_width, _LETTER * longest) + _GAP
    panel_height = _CELL_HEIGHT * len(first)
    below = _LETTER * 0.71 * max(map(len, columns)) + _GAP  # of slanted labels
    width = max(left + across * pitch + _GAP, _LEAST_WIDTH)
    rows = [row for line in maps for each in line for cells in each.cells for row in cells if row is not None]
    letters = int((width - 2 * _GAP) / (_LETTER * 0.76))
    key = [line for mark in marks(rows) for line in textwrap.wrap(mark, letters)]
    height = len(maps) * (panel_height + _TITLE + _GAP) + below + _SCALE + _KEY_LINE * len(key) + _GAP
    figure = Figure(figsize=(width, height), facecolor="white")
    norm = _norm([row[measure].value for row in rows if row[measure].known and not row.idle])
    for at, line in enumerate(maps):
        for column, each in enumerate(line):
            bottom = at * (panel_height + _TITLE + _GAP) + _TITLE + panel_height
            high = _CELL_HEIGHT * len(each.lines)
            place = (left + column * pitch) / width, 1.0 - bottom / height, panel_width / width, high / height
            axes = figure.add_axes(place)
            colour_panel(axes, each.cells, measure, norm)
            pad = 4 + 72.0 * (panel_height - high)  # all titles of a line at one height
            axes.set_title(plain(each.title), fontsize=_TITLE_SIZE, color=INK, loc="left", pad=pad)
            axes.set_yticks(range(len(each.lines)), [plain(name) for name in each.lines] if not column else [])
            named = [plain(name) for name in columns] if line is maps[-1] else []
            axes.set_xticks(range(len(columns)) if named else [], named)
            for text in axes.get_xticklabels():
                text.set(rotation=45, ha="right", rotation_mode="anchor")
    foot = _KEY_LINE * len(key) + _GAP
    long = min(max(across * pitch, _LETTER * len(label)), width - left - 3 * _GAP)
    scale = figure.add_axes((left / width, (foot + 0.52) / height, long / width, 0.13 / height))
    bar = figure.colorbar(ScalarMappable(norm, _COLOURS), cax=scale, orientation="horizontal")
    bar.set_ticks(_ticks(norm), labels=[f"{tick:g}".replace("-", "\u2212") for tick in _ticks(norm)])
    bar.ax.minorticks_off()
    bar.ax.tick_params(labelsize=_CELL_SIZE - 1, length=3, colors=INK)
    bar.outline.set_visible(False)
    bar.set_label(label, fontsize=_CELL_SIZE, color=INK)
    figure.text(_GAP / width, 0.5 * _GAP / height, "\n".join(key), fontsize=_KEY_SIZE, color=INK, linespacing=1.25)
    return figure


def marks(rows: Sequence[Row]) -> list[str]:
    """What the marks of cells mean, a sentence for each mark; and how colours are."""
    texts = ["Italic: the 95 % interval contains 0, or there is none."]
    if any("honest_suspended" in row.numbers for row in rows):
        texts.append(
            "Corner: an honest agent is suspended in some of the runs (small), or in half of them or more (large)."
        )
    idle = "Hatched: the adversaries lied in none of the runs, so the number is no effect of an attack."
    return texts + [idle] * any(row.idle for row in rows)


def _norm(values: Sequence[float]) -> Normalize:
    """Colours around 0, symmetric."""
    most = max([_LINEAR, *map(abs, values)])
    if most <= _LINEAR:
        return Normalize(-_LINEAR, _LINEAR)
    most = next((size for size in _ROUND if size >= most), most)
    return SymLogNorm(_LINEAR, vmin=-most, vmax=most, base=10)


def _ticks(norm: Normalize) -> list[float]:
    """Round numbers on both sides of 0."""
    most = float(norm.vmax or _LINEAR)
    sizes = [size for size in _ROUND if size <= most]
    return [*(-size for size in reversed(sizes)), 0.0, *sizes]


def shortened(each: Statistic) -> str:
    """A number with one decimal, or with none if it is large."""
    return number(each.value, 1 if abs(each.value) < 9.95 else 0)


def colour_panel(
    axes: Axes,
    cells: Sequence[Sequence[Row | None]],
    measure: object,
    norm: Normalize,
    text: Callable[[Statistic], str] = shortened,
    size: float = _CELL_SIZE,
) -> None:
    """A measure of rows as colours and numbers, in lines from above; None: there is none. size: points, of letters"""
    values = np.array([[math.nan if row is None or row.idle else row[measure].value for row in line] for line in cells])
    axes.set_facecolor(_UNKNOWN)
    axes.imshow(values, cmap=_COLOURS, norm=norm, aspect="auto")
    for y, line in enumerate(cells):
        for x, row in enumerate(line):
            if row is not None and row[measure].known:
                dark = abs(float(norm(row[measure].value)) - 0.5) > 0.5 * _DARK and not row.idle
                colour = "white" if dark else INK
                if row.idle:
                    cell = Rectangle((x - 0.5, y - 0.5), 1.0, 1.0, fill=False, hatch="///", edgecolor="white", lw=0.0)
                    axes.add_patch(cell)
                style: dict[str, Any] = {"fontsize": size, "ha": "center", "va": "center", "color": colour}
                style["fontstyle"] = "normal" if row[measure].differs else "italic"
                axes.text(x, y + 0.04, text(row[measure]), **style)
                _mark(axes, x, y, row, colour)
    axes.set_xticks(np.arange(values.shape[1] + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(values.shape[0] + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=0.8)
    axes.tick_params(which="both", length=0, labelsize=size, colors=INK)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _mark(axes: Axes, x: int, y: int, row: Row, colour: str) -> None:
    """The mark of a cell in its upper left corner, if an honest agent is suspended."""
    share = row.numbers["honest_suspended"].value if "honest_suspended" in row.numbers else 0.0
    if share > 0.0:
        box = axes.get_window_extent()
        columns, rows = axes.get_xlim()[1] + 0.5, axes.get_ylim()[0] + 0.5
        side = _LARGE if share >= _OFTEN else _SMALL
        wide = side * (box.height / rows) / (box.width / columns)  # as long on paper
        corner = (x - 0.5, y - 0.5)
        points = [corner, (corner[0] + wide, corner[1]), (corner[0], corner[1] + side)]
        axes.add_patch(Polygon(points, facecolor=colour, edgecolor="none"))

"""The figure of the matrix for a paper: harm with each defence relative to none, by kind of scene."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, SymLogNorm
from matplotlib.patches import Polygon

from mast_zenoh.metrics.field_results import FieldMatrix
from mast_zenoh.metrics.study_results import Row
from mast_zenoh.report.figures.drawing import RenderedFigure, render
from mast_zenoh.report.figures.style import UNKNOWN, Figure, hatch_cell, plain
from mast_zenoh.report.tables.text_table import number
from mast_zenoh.viewer.palette import INK

#: Inches at which the figure is drawn; a paper prints a column of it at half of this width, so that 12 pt become 6 pt.
_WIDTH, _CELL_WIDTH, _CELL_HEIGHT = 7.0, 0.46, 0.28
#: Inches: of a wide cell, where defences are few; and of the narrowest figure, with its scale and its key.
_WIDEST_CELL, _LEAST_WIDTH = 0.8, 5.8
_SIZE, _TITLE_SIZE, _KEY_SIZE = 12.0, 13.0, 10.5
#: Inches of a letter of a label, and between parts of the figure.
_LETTER, _GAP = 0.105, 0.1
#: Inches of a panel's title, of the scale with its label, below, and of a line of the key, at the bottom.
_TITLE, _SCALE, _KEY_LINE = 0.32, 0.9, 0.19
#: Diverging, and safe for colour-blind readers: blue helps, red harms.
_COLOURS = "RdBu_r"
#: Objects per frame up to which colours are linear; beyond, they are logarithmic, so that one flood hides nothing.
_LINEAR = 1.0
_SCALE_LABEL = "wrong objects per frame, minus no defence"
#: Numbers on the scale, at one of which it ends.
_ROUND = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
#: Share of the colour scale beyond which letters are white.
_DARK = 0.55
#: Share of runs that suspend an honest agent from which the mark is large; sides of the marks, in cells' heights.
_OFTEN, _SMALL, _LARGE = 0.5, 0.27, 0.48

Cells = Sequence[Sequence[Row]]


def figures_of_field(table: FieldMatrix) -> dict[str, RenderedFigure]:
    """The figure by file name; {} without a defence or an attack."""
    if len(table.matrix.names("defence")) < 2 or not table.matrix.names("attack"):
        return {}
    return {"harm_by_scene": _harm_by_scene(table)}


def _harm_by_scene(table: FieldMatrix) -> RenderedFigure:
    """A panel for each kind of scene (lines), and each number and placement of the adversaries (columns)."""
    defences = table.matrix.names("defence")[1:]
    attacks = ["", *table.matrix.names("attack")]
    places = list(
        dict.fromkeys((row.of["n_adversaries"], row.of["placement"]) for row in table.rows if row.of["attack"])
    )
    lines, columns, placements = len(table.scenes), len(places), len({placement for _, placement in places})
    left = _LETTER * max(len(name) for name in (*attacks, "no attack")) + 2 * _GAP
    titles = [[_title(scene, *place, placements > 1, columns > 1) for place in places] for scene in table.scenes]
    longest = max(len(title) for each in titles for title in each)
    wide = min((_WIDTH - left - _GAP) / columns - _GAP, _WIDEST_CELL * len(defences))
    panel_width = max(wide, _CELL_WIDTH * len(defences))
    pitch = max(panel_width, _LETTER * longest) + _GAP
    panel_height = _CELL_HEIGHT * len(attacks)
    below = _LETTER * 0.71 * max(map(len, defences)) + _GAP  # of slanted labels
    width = max(left + columns * pitch + _GAP, _LEAST_WIDTH)
    key = _key(table, width)
    height = lines * (panel_height + _TITLE + _GAP) + below + _SCALE + _KEY_LINE * len(key) + _GAP
    figure = Figure(figsize=(width, height), facecolor="white")
    norm = _norm(table)
    for line, scene in enumerate(table.scenes):
        for column, (count, placement) in enumerate(places):
            x = left + column * pitch
            bottom = line * (panel_height + _TITLE + _GAP) + _TITLE + panel_height
            shown = attacks[bool(column) :]  # without an attack, the numbers are the same in all columns
            high = _CELL_HEIGHT * len(shown)
            axes = figure.add_axes((x / width, 1.0 - bottom / height, panel_width / width, high / height))
            cells = [[_row(table, scene, name, attack, count, placement) for name in defences] for attack in shown]
            _panel(axes, cells, norm)
            pad = 4 + 72.0 * (panel_height - high)  # all titles of a line at one height
            axes.set_title(plain(titles[line][column]), fontsize=_TITLE_SIZE, color=INK, loc="left", pad=pad)
            axes.set_yticks(range(len(shown)), [plain(name or "no attack") for name in shown] if not column else [])
            axes.set_xticks(range(len(defences)), [plain(name) for name in defences] if line == lines - 1 else [])
            for text in axes.get_xticklabels():
                text.set(rotation=45, ha="right", rotation_mode="anchor")
    foot = _KEY_LINE * len(key) + _GAP
    long = min(max(columns * pitch, _LETTER * len(_SCALE_LABEL)), width - left - 3 * _GAP)
    scale = figure.add_axes((left / width, (foot + 0.52) / height, long / width, 0.13 / height))
    bar = figure.colorbar(ScalarMappable(norm, _COLOURS), cax=scale, orientation="horizontal")
    bar.set_ticks(_ticks(norm), labels=[f"{tick:g}".replace("-", "\u2212") for tick in _ticks(norm)])
    bar.ax.minorticks_off()
    bar.ax.tick_params(labelsize=_SIZE - 1, length=3, colors=INK)
    bar.outline.set_visible(False)
    bar.set_label(_SCALE_LABEL, fontsize=_SIZE, color=INK)
    figure.text(_GAP / width, 0.5 * _GAP / height, "\n".join(key), fontsize=_KEY_SIZE, color=INK, linespacing=1.25)
    caption = (
        "Missed and false objects per frame in the ego's picture, with minus without the defence, under the same "
        f"attack ({table.matrix.size}"
        f"{_adversaries(places)}). "
        f"Blue: the defence helps. Red: it does harm. {' '.join(_marks(table))} Colours are linear up to 1, then "
        "logarithmic."
    )
    return render(
        "harm_by_scene", figure, f"Heat maps of harm relative to no defence. {_best(table)}", caption, printed=True
    )


def _marks(table: FieldMatrix) -> list[str]:
    """What the marks of cells mean, a sentence for each mark."""
    marks = [
        "Italic: the 95 % interval contains 0, or there is none.",
        "Corner: an honest agent is suspended in some of the runs (small), or in half of them or more (large).",
    ]
    idle = "Hatched: the adversaries lied in none of the runs, so the number is no effect of an attack."
    return marks + [idle] * any(row.idle for row in table.rows if row.of["scene"])


def _key(table: FieldMatrix, width: float) -> list[str]:
    """The lines of the key below the figure; width: inches."""
    letters = int((width - 2 * _GAP) / (_LETTER * 0.76))
    return [line for mark in _marks(table) for line in textwrap.wrap(mark, letters)]


def _title(scene: str, count: int, placement: str, placements: bool, counts: bool) -> str:
    """The title of a panel; placements, counts: whether there are several."""
    return ", ".join([scene, *([f"n = {count}"] if counts else []), *([placement] if placements else [])])


def _adversaries(places: Sequence[tuple[int, str]]) -> str:
    """What the caption says of the adversaries."""
    if len(places) > 1:
        return "; n: number of adversaries"
    (count, placement) = places[0]
    return f"; {count} adversar{'y' if count == 1 else 'ies'}, {placement}"


def _row(table: FieldMatrix, scene: str, defence: str, attack: str, count: int, placement: str) -> Row | None:
    try:
        return table.row(scene, defence, attack, *((count, placement) if attack else (0, "")))
    except KeyError:
        return None


def _norm(table: FieldMatrix) -> Normalize:
    """Colours around 0, symmetric."""
    sizes = [abs(row["harm"].value) for row in table.rows if row.of["scene"] and row["harm"].known and not row.idle]
    most = max([_LINEAR, *sizes])
    if most <= _LINEAR:
        return Normalize(-_LINEAR, _LINEAR)
    most = next((size for size in _ROUND if size >= most), most)
    return SymLogNorm(_LINEAR, vmin=-most, vmax=most, base=10)


def _ticks(norm: Normalize) -> list[float]:
    """Round numbers on both sides of 0."""
    most = float(norm.vmax or _LINEAR)
    sizes = [size for size in _ROUND if size <= most]
    return [*(-size for size in reversed(sizes)), 0.0, *sizes]


def _panel(axes: Axes, cells: Sequence[Sequence[Row | None]], norm: Normalize) -> None:
    values = np.array([[math.nan if row is None or row.idle else row["harm"].value for row in line] for line in cells])
    axes.set_facecolor(UNKNOWN)
    axes.imshow(values, cmap=_COLOURS, norm=norm, aspect="auto")
    for y, line in enumerate(cells):
        for x, row in enumerate(line):
            if row is not None and row["harm"].known:
                dark = abs(float(norm(row["harm"].value)) - 0.5) > 0.5 * _DARK and not row.idle
                if row.idle:
                    hatch_cell(axes, x, y)
                _cell(axes, x, y, row, "white" if dark else INK)
    axes.set_xticks(np.arange(values.shape[1] + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(values.shape[0] + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=0.8)
    axes.tick_params(which="both", length=0, labelsize=_SIZE, colors=INK)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _cell(axes: Axes, x: int, y: int, row: Row, colour: str) -> None:
    """The number of a cell, and its mark in the upper left corner."""
    value = row["harm"].value
    style = "normal" if row["harm"].differs else "italic"
    axes.text(
        *(x, y + 0.04, number(value, 1 if abs(value) < 9.95 else 0)),
        ha="center",
        va="center",
        fontsize=_SIZE,
        fontstyle=style,
        color=colour,
    )
    share = row["honest_suspended"].value
    if share > 0.0:
        box = axes.get_window_extent()
        columns, rows = axes.get_xlim()[1] + 0.5, axes.get_ylim()[0] + 0.5
        side = _LARGE if share >= _OFTEN else _SMALL
        across = side * (box.height / rows) / (box.width / columns)  # as long on paper
        corner = (x - 0.5, y - 0.5)
        points = [corner, (corner[0] + across, corner[1]), (corner[0], corner[1] + side)]
        axes.add_patch(Polygon(points, facecolor=colour, edgecolor="none"))


def _best(table: FieldMatrix) -> str:
    """By scene, the cells in which a defence helps and harms most."""
    parts = []
    for scene in table.scenes:
        rows = [row for row in table.rows if row.of["scene"] == scene and row["harm"].known and not row.idle]
        rows = [row for row in rows if row.of["defence"] in table.matrix.names("defence")[1:]]
        if rows:
            least, most = (choose(rows, key=lambda row: row["harm"].value) for choose in (min, max))
            texts = (
                f"{number(each['harm'].value)} by {each.of['defence']} against {each.of['attack'] or 'no attack'}"
                for each in (least, most)
            )
            parts.append(f"{scene}: {' to '.join(texts)}")
    return f"{'; '.join(parts)}." if parts else ""

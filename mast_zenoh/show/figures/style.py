"""Style of all figures, and rendering to PNG and SVG.

Figures use only matplotlib's object interface, so no global state changes.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from matplotlib import figure as figures
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text
from PIL import Image

from mast_zenoh.show.palette import GROUNDS, INK, KEYS, PALE, Ground, Key

DPI = 110
#: Of PNG files, 0 to 9: higher levels take twice as long for little gain.
COMPRESSION = 3


@dataclass(frozen=True)
class Theme(Ground, Key):
    """The colours of pictures of frames: what is behind the objects, and what colours mean."""


#: By name. Light pictures are for paper, so their ground is white.
THEMES = {
    "dark": Theme(**vars(GROUNDS["dark"]) | vars(KEYS["paper"]["dark"])),
    "light": Theme(**vars(GROUNDS["light"]) | vars(KEYS["paper"]["light"]) | {"ground": "#ffffff"}),
}


class Figure(figures.Figure):
    """A figure that a notebook shows even without pyplot."""

    def place(self, left: float, top: float, width: float, height: float) -> Axes:
        """Add axes, placed in inches from the upper left corner."""
        w, h = self.get_size_inches()
        return self.add_axes((left / w, 1 - (top + height) / h, width / w, height / h))

    def write(self, left: float, top: float, text: str, **style: Any) -> Text:
        """Add text, placed in inches from the upper left corner."""
        w, h = self.get_size_inches()
        return self.text(left / w, 1 - top / h, plain(text), **style)

    def _repr_png_(self) -> bytes:
        return png(self)


def light_axes(axes: Axes) -> None:
    """Make axes a plain light chart: no box, faint horizontal lines."""
    axes.tick_params(colors=INK, labelsize=9.5, length=3)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(INK)
    axes.grid(axis="y", color=PALE, linewidth=0.8)
    axes.set_axisbelow(True)


#: Of curves that one chart shows.
LINE_STYLES = ("-", (0, (6, 1.5)), (0, (2, 1)), (0, (6, 1, 1, 1)))
MARKERS = ("o", "s", "^", "D", "v", "P", "X")


def plain(text: object) -> str:
    """Text escaped for matplotlib, which reads `$…$` as mathematics."""
    return str(text).replace("$", r"\$")


def png(figure: figures.Figure) -> bytes:
    """The figure as PNG; the bytes are reproducible."""
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(DPI)
    canvas.draw()  # type: ignore[no-untyped-call]  # matplotlib has no types here
    # Figures are opaque: without the alpha channel they are smaller and faster to encode.
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(buffer, format="png", compress_level=COMPRESSION)
    return buffer.getvalue()


#: Of files: neither dates nor versions, so that equal figures are equal files.
_LEFT_OUT = {"pdf": ("CreationDate",), "svg": ("Date", "Creator", "Format", "Type"), "png": ("Software",)}


def save(figure: figures.Figure, file: Path | BinaryIO, kind: str, *, text: bool = False) -> None:
    """Write a figure as `pdf`, with fonts that a journal accepts, `svg` or `png`; the bytes are reproducible.

    text: in SVG, text stays text; otherwise letters are outlines, so that it looks the same everywhere
    """
    no_metadata = dict.fromkeys(_LEFT_OUT[kind])
    with rc_context({"pdf.fonttype": 42, "svg.hashsalt": "mast-zenoh", "svg.fonttype": "none" if text else "path"}):
        figure.savefig(file, format=kind, facecolor=figure.get_facecolor(), metadata=no_metadata)


def svg(figure: figures.Figure) -> bytes:
    """The figure as SVG."""
    buffer = io.BytesIO()
    save(figure, buffer, "svg")
    return buffer.getvalue()


def pdf(figure: figures.Figure) -> bytes:
    """The figure as PDF."""
    buffer = io.BytesIO()
    save(figure, buffer, "pdf")
    return buffer.getvalue()

"""Colours of all figures, and rendering to PNG and SVG.

Figures use only matplotlib's object interface, so no global state changes.
"""

from __future__ import annotations

import io

import numpy as np
from matplotlib import figure as figures
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.backends.backend_svg import FigureCanvasSVG
from PIL import Image

from mast_zenoh.viewer.palette import ADVERSARY as ADVERSARY
from mast_zenoh.viewer.palette import ADVERSARY_ON_LIGHT as ADVERSARY_ON_LIGHT
from mast_zenoh.viewer.palette import AGENT as AGENT
from mast_zenoh.viewer.palette import BUILDING as BUILDING
from mast_zenoh.viewer.palette import BUILDING_EDGE as BUILDING_EDGE
from mast_zenoh.viewer.palette import FAINT as FAINT
from mast_zenoh.viewer.palette import FAULT_ON_LIGHT as FAULT_ON_LIGHT
from mast_zenoh.viewer.palette import GRID as GRID
from mast_zenoh.viewer.palette import GROUND as GROUND
from mast_zenoh.viewer.palette import INK as INK
from mast_zenoh.viewer.palette import LOCAL as LOCAL
from mast_zenoh.viewer.palette import OUTCOME_COLOURS as OUTCOME_COLOURS
from mast_zenoh.viewer.palette import OUTCOME_LABELS as OUTCOME_LABELS
from mast_zenoh.viewer.palette import PALE as PALE
from mast_zenoh.viewer.palette import RUN_COLOURS as RUN_COLOURS
from mast_zenoh.viewer.palette import STATES as STATES
from mast_zenoh.viewer.palette import STATES_ON_LIGHT as STATES_ON_LIGHT
from mast_zenoh.viewer.palette import WITHHELD as WITHHELD

DPI = 110
#: Of PNG files, 0 to 9: higher levels take twice as long for little gain.
COMPRESSION = 3


class Figure(figures.Figure):
    """A figure that a notebook shows even without pyplot."""

    def _repr_png_(self) -> bytes:
        return png(self)


def dark_axes(axes: Axes) -> None:
    """Make axes a dark panel."""
    axes.set_facecolor(GROUND)
    axes.tick_params(colors=FAINT, labelsize=9, length=3)
    for spine in axes.spines.values():
        spine.set_color(BUILDING_EDGE)


def light_axes(axes: Axes) -> None:
    """Make axes a plain light chart: no box, faint horizontal lines."""
    axes.tick_params(colors=INK, labelsize=9.5, length=3)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(INK)
    axes.grid(axis="y", color=PALE, linewidth=0.8)
    axes.set_axisbelow(True)


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


def svg(figure: figures.Figure) -> bytes:
    """The figure as SVG, letters as outlines so that it looks the same everywhere."""
    buffer = io.BytesIO()
    FigureCanvasSVG(figure)
    no_metadata = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with rc_context({"svg.hashsalt": "mast-zenoh"}):  # makes the ids inside reproducible
        figure.savefig(buffer, format="svg", facecolor=figure.get_facecolor(), metadata=no_metadata)
    return buffer.getvalue()


def pdf(figure: figures.Figure) -> bytes:
    """The figure as PDF, with fonts that a journal accepts; the bytes are reproducible."""
    buffer = io.BytesIO()
    FigureCanvasPdf(figure)
    with rc_context({"pdf.fonttype": 42}):
        figure.savefig(buffer, format="pdf", facecolor=figure.get_facecolor(), metadata={"CreationDate": None})
    return buffer.getvalue()

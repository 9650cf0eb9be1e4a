"""The images of a film as pixels. What never changes is drawn once, the rest is drawn on top of a copy of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray

from mast_zenoh.report.film.sheet import Sheet

#: (height, width, 3) red, green and blue.
Pixels = NDArray[np.uint8]


def images(sheet: Sheet, frames: Iterable[int]) -> Iterator[Pixels]:
    """Draw frames one after the other."""
    canvas = FigureCanvasAgg(sheet.figure)
    for artist in sheet.changing:
        artist.set_animated(True)
    background = None
    for frame in frames:
        sheet.show(frame)
        if background is None:
            canvas.draw()  # type: ignore[no-untyped-call]  # matplotlib has no types here
            background = canvas.copy_from_bbox(sheet.figure.bbox)  # type: ignore[no-untyped-call]
        canvas.restore_region(background)  # type: ignore[no-untyped-call]
        for artist in sheet.changing:
            sheet.figure.draw_artist(artist)
        yield np.array(np.asarray(canvas.buffer_rgba())[..., :3])  # type: ignore[no-untyped-call]

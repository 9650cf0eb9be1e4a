"""Animated GIF: one palette for all images, and of each image only what differs from the one before."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray
from PIL import GifImagePlugin, Image

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.report.film.pixels import Pixels

#: Browsers play faster films slowly: their shortest duration is 0.02 s.
MOST_FPS = 50.0
#: The index that stands for the colour in the image before.
_SAME = 255
#: Number of images from which the palette is made; of each, every second pixel of every second line.
_SAMPLES = 12

#: (height, width) rows of the palette.
_Indices = NDArray[np.uint8]


def write_gif(
    path: Path, draw: Callable[[Sequence[int]], Iterable[Pixels]], frames: Sequence[int], fps: float, key: Iterable[str]
) -> None:
    """Write a film that repeats for ever.

    draw: the images of some frames;  key: colours that are kept exactly
    Raises ConfigurationError for more than 50 images per second.
    """
    if fps > MOST_FPS:
        raise ConfigurationError(f"fps: found {fps:g}, expected at most {MOST_FPS:g} in a GIF")
    samples = np.unique(np.linspace(0, len(frames) - 1, _SAMPLES).astype(int))
    palette = _palette(draw([frames[place] for place in samples]), key)
    before: _Indices | None = None
    with path.open("wb") as file:
        for number, pixels in enumerate(draw(frames)):
            indices = _indices(pixels, palette)
            changed, corner = (indices, (0, 0)) if before is None else _difference(indices, before)
            image = Image.fromarray(changed, mode="P")
            image.putpalette(palette.getpalette() or [])
            if before is None:
                header = GifImagePlugin.getheader(image, info={"loop": 0, "optimize": False})[0]
                file.writelines(header)
            # Durations are hundredths of a second: they are rounded so that no error adds up.
            start, end = (round(100 * (number + ahead) / fps) for ahead in (0, 1))
            options = {"duration": 10 * (end - start), "disposal": 1, "optimize": False}
            if before is not None:
                options["transparency"] = _SAME
            file.writelines(GifImagePlugin.getdata(image, corner, **options))
            before = indices
        file.write(b";")


def _palette(images: Iterable[Pixels], key: Iterable[str]) -> Image.Image:
    """An image with the palette of a film: the key, then the commonest colours, and the last for `_SAME`."""
    exact = np.array([np.round(np.multiply(to_rgb(colour), 255)) for colour in dict.fromkeys(key)], np.uint8)
    sampled = np.concatenate([image[::2, ::2].reshape(-1, 3) for image in images])
    common = Image.fromarray(sampled[None]).quantize(_SAME - len(exact), Image.Quantize.MEDIANCUT)
    colours = np.array(common.getpalette() or [], np.uint8).reshape(-1, 3)[: _SAME - len(exact)]
    table = np.concatenate([exact, colours])
    table = np.concatenate([table, np.repeat(table[:1], 256 - len(table), axis=0)])
    result = Image.new("P", (1, 1))
    result.putpalette(table.tobytes())
    return result


def _indices(pixels: Pixels, palette: Image.Image) -> _Indices:
    """The nearest colours of the palette."""
    image = Image.fromarray(pixels).quantize(palette=palette, dither=Image.Dither.NONE)
    indices = np.array(image, np.uint8)
    indices[indices == _SAME] = 0  # the same colour
    return indices


def _difference(image: _Indices, before: _Indices) -> tuple[_Indices, tuple[int, int]]:
    """The part of an image that differs from the one before, and its upper left corner (x, y) in px."""
    differs = image != before
    rows, columns = np.flatnonzero(differs.any(axis=1)), np.flatnonzero(differs.any(axis=0))
    if not len(rows):
        return np.full((1, 1), _SAME, np.uint8), (0, 0)
    part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    return np.where(differs[part], image[part], np.uint8(_SAME)), (int(columns[0]), int(rows[0]))

"""Encodes images: animated GIF, and MP4 (H.264) and WebM (VP9) by ffmpeg, which imageio-ffmpeg carries."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from numpy.typing import NDArray
from PIL import GifImagePlugin, Image

from mast_zenoh.errors import ConfigurationError, ExportError
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


#: By kind of file. The number of threads is fixed, because encoders divide their work by it.
_ENCODERS = {
    "mp4": shlex.split("-c:v libx264 -preset medium -crf 18 -threads 2 -movflags +faststart"),
    "webm": shlex.split("-c:v libvpx-vp9 -crf 24 -b:v 0 -deadline realtime -cpu-used 6 -row-mt 1 -threads 2"),
}
_COLOURS = shlex.split(
    "-vf scale=out_color_matrix=bt709:out_range=tv -colorspace bt709 -color_primaries bt709 -color_trc bt709 "
    "-color_range tv -pix_fmt yuv420p"
)
#: Neither dates nor versions, so that equal images give equal files.
_NO_METADATA = ("-map_metadata", "-1", "-fflags", "+bitexact", "-flags:v", "+bitexact")


def ffmpeg() -> str:
    """The path of ffmpeg: that of the package imageio-ffmpeg, or else the one on PATH.

    Raises ExportError if there is neither.
    """
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):  # the package is there, but without a program for this machine
        path = shutil.which("ffmpeg")
    if path is None:
        raise ExportError(
            "found neither the package imageio-ffmpeg nor ffmpeg on PATH: expected one of them for MP4 and WebM: "
            "pip install 'mast-zenoh[film]'; a name that ends with .gif needs neither"
        )
    return path


def write_video(path: Path, images: Iterable[Pixels], size: tuple[int, int], fps: float) -> None:
    """Write a film. size: width and height in px, both even

    Raises ExportError if ffmpeg is absent or fails, for example because it lacks the encoder.
    """
    width, height = size
    source = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{fps:.6g}", "-i", "-")
    encoder = _ENCODERS[path.suffix.lower().removeprefix(".")]
    program = ffmpeg()
    command = [program, "-nostdin", "-v", "error", "-y", *source, "-an", *_COLOURS, *encoder, *_NO_METADATA, str(path)]
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=errors)
        assert process.stdin is not None
        try:
            for image in images:
                process.stdin.write(image.tobytes())
            process.stdin.close()
        except BrokenPipeError:  # it has ended: its error output says why
            pass
        except BaseException:
            process.kill()
            raise
        finally:
            code = process.wait()
        if code:
            errors.seek(0)
            words = errors.read().decode(errors="replace").strip().splitlines()
            raise ExportError(f"{path.name}: {program} failed with exit code {code}: {' '.join(words[-3:])}")

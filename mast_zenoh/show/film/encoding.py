"""Encodes films: animated GIF by Pillow, and MP4 (H.264) and WebM (VP9) by ffmpeg, which imageio-ffmpeg carries."""

from __future__ import annotations

import shlex
import shutil
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from PIL import GifImagePlugin, Image, ImageChops

from mast_zenoh.errors import ExportError
from mast_zenoh.show.film.sheet import Sheet
from mast_zenoh.show.palette import rgb

#: Codec and its options by kind of file. The number of threads is fixed, because encoders divide their work by it.
_CODECS = {
    ".mp4": ("libx264", "-preset medium -crf 18 -threads 2 -movflags +faststart"),
    ".webm": ("libvpx-vp9", "-crf 24 -b:v 0 -deadline realtime -cpu-used 6 -row-mt 1 -threads 2"),
}
_COLOURS = (
    "-vf scale=out_color_matrix=bt709:out_range=tv -colorspace bt709 -color_primaries bt709 -color_trc bt709 "
    "-color_range tv -pix_fmt yuv420p"
)
#: Neither dates nor versions, so that equal images give equal files.
_NO_METADATA = "-map_metadata -1 -fflags +bitexact -flags:v +bitexact"
#: Number of images from which the palette of a GIF is made, at least, and the index for the colour in the image before.
_SAMPLES, _SAME = 12, 255


def write_film(path: Path, sheet: Sheet, frames: Sequence[int], fps: float) -> None:
    """Write a film that ends with .gif, .mp4 or .webm.

    Raises ExportError if ffmpeg is absent or fails, for example because it lacks the encoder.
    """
    writer: AbstractMovieWriter = (
        _VideoWriter(path.suffix.lower(), fps) if path.suffix.lower() in _CODECS else _GifWriter(sheet, frames, fps)
    )
    writer.setup(sheet.figure, str(path))
    try:
        with suppress(BrokenPipeError):  # ffmpeg has ended: `finish` says why
            for frame in frames:
                sheet.show(frame)
                writer.grab_frame()
    except BaseException:
        with suppress(ExportError):
            writer.finish()  # no ffmpeg is left behind
        raise
    writer.finish()


class _VideoWriter(FFMpegWriter):
    """Writes MP4 and WebM. kind: a key of _CODECS"""

    _proc: subprocess.Popen[bytes]

    def __init__(self, kind: str, fps: float) -> None:
        codec, options = _CODECS[kind]
        arguments = shlex.split(f"-an -c:v {codec} {_COLOURS} {options} {_NO_METADATA}")
        super().__init__(codec=codec, bitrate=-1, extra_args=arguments)
        self.fps = fps  # type: ignore[assignment]  # it may be a fraction

    @classmethod
    def bin_path(cls) -> str:
        """The path of ffmpeg."""
        return ffmpeg()

    def finish(self) -> None:
        """End ffmpeg; raises ExportError if it has failed."""
        _, errors = self._proc.communicate()
        if code := self._proc.returncode:
            reason = " ".join(errors.decode(errors="replace").strip().splitlines()[-3:])
            raise ExportError(f"{Path(self.outfile).name}: {ffmpeg()} failed with exit code {code}: {reason}")


class _GifWriter(PillowWriter):
    """Writes a film that repeats for ever: of each image, what differs from the one before, in colours of one palette.

    Pillow by itself would hold all images in memory until the end, and choose colours for each.
    """

    _frames: list[Image.Image]

    def __init__(self, sheet: Sheet, frames: Sequence[int], fps: float) -> None:
        super().__init__()
        self.fps = fps  # type: ignore[assignment]  # it may be a fraction
        self._sheet, self._samples = sheet, frames[:: max(len(frames) // _SAMPLES, 1)]
        self._number, self._before = 0, np.array(-1)

    def setup(self, fig: Any, outfile: Any, dpi: float | None = None) -> None:
        """Choose the palette: the key of the film, and the commonest colours of some of its images."""
        super().setup(fig, outfile, dpi)
        for frame in self._samples:
            self._sheet.show(frame)
            super().grab_frame()
        pixels = np.concatenate([np.asarray(image)[::2, ::2] for image in self._frames])
        self._frames.clear()
        key = [value for colour in self._sheet.key for value in rgb(colour)]
        common = Image.fromarray(pixels).quantize(_SAME - len(key) // 3).getpalette() or []
        self._palette = Image.new("P", self.frame_size)
        self._palette.putpalette([*key, *common][: 3 * _SAME])
        self._append(GifImagePlugin.getheader(self._palette, info={"loop": 0, "optimize": False})[0])

    def grab_frame(self, **options: Any) -> None:
        """Append an image to the file."""
        super().grab_frame(**options)
        image = self._frames.pop().quantize(palette=self._palette, dither=Image.Dither.NONE)
        indices = np.array(image)
        same = Image.fromarray(indices == self._before)
        image.paste(_SAME, mask=same)
        box = ImageChops.invert(same).getbbox() or (0, 0, 1, 1)
        # Durations are hundredths of a second: they are rounded so that no error adds up.
        start, end = (round(100 * (self._number + ahead) / self.fps) for ahead in (0, 1))
        how = {"duration": 10 * (end - start), "disposal": 1, "optimize": False, "transparency": _SAME}
        self._append(GifImagePlugin.getdata(image.crop(box), box[:2], **how))
        self._number, self._before = self._number + 1, indices

    def finish(self) -> None:
        """End the file."""
        self._append([b";"])

    def _append(self, parts: Sequence[bytes]) -> None:
        with open(self.outfile, "ab") as file:
            file.writelines(parts)


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

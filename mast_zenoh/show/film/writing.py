"""Writes films and stills: `mast animate`, `mast snapshot`, and the encoders."""

from __future__ import annotations

import math
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from PIL import GifImagePlugin, Image, ImageChops

from mast_zenoh.errors import ConfigurationError, ExportError, RunFolderError
from mast_zenoh.launch.liveness import finished_record
from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.run_folder import check_free, write_new
from mast_zenoh.runs.run import Run
from mast_zenoh.show.figures.style import save
from mast_zenoh.show.figures.view import choose_frame
from mast_zenoh.show.film.sheet import Sheet
from mast_zenoh.show.film.takes import Look, Take
from mast_zenoh.show.palette import rgb

#: Frames of a film, at most, unless the user asks for more.
MOST_FRAMES = 3000
#: Images per second at most, unless the user asks for more.
_SMOOTH_FPS = 30.0
_MOST_FPS = 120.0
#: Browsers play faster films slowly: their shortest duration is 0.02 s.
_MOST_GIF_FPS = 50.0


class FilmSchedule(NamedTuple):
    """frames: of the run, one for each image of the film;  fps: images per second"""

    frames: Sequence[int]
    fps: float


def schedule(take: Take, start: int | None, end: int | None, speed: float, fps: float | None) -> FilmSchedule:
    """The frames of a film.

    start, end: first and last frame, None: of the run, but at most MOST_FRAMES
    speed:      of the film over that of the scene
    fps:        images per second; None: every frame once, but at most 30

    Raises RunFolderError for frames that the run does not have, ConfigurationError for an invalid speed or rate.
    """
    first = take.first if start is None else check_in_take(take, start)
    last = min(take.last, first + MOST_FRAMES - 1) if end is None else check_in_take(take, end)
    if last < first:
        raise ConfigurationError(f"frames: found {first} to {last}, expected the first not to be after the last")
    if not (math.isfinite(speed) and 0.01 <= speed <= 100):
        raise ConfigurationError(f"speed: found {speed:g}, expected 0.01 to 100")
    if fps is not None and not (math.isfinite(fps) and 0.1 <= fps <= _MOST_FPS):
        raise ConfigurationError(f"fps: found {fps:g}, expected 0.1 to {_MOST_FPS:g}")
    native = speed / take.run.period_s
    if fps is None and native <= _SMOOTH_FPS:
        return FilmSchedule(range(first, last + 1), native)
    fps = fps or _SMOOTH_FPS
    count = max(1, math.ceil((last + 1 - first) / native * fps - 1e-9))
    return FilmSchedule([min(first + math.floor(k * native / fps + 1e-9), last) for k in range(count)], fps)


def check_in_take(take: Take, frame: int) -> int:
    """Return a frame; raises RunFolderError if the run does not have it."""
    if not take.first <= frame <= take.last:
        raise RunFolderError(f"{take.run.path}: found frame {frame}, expected one of {take.first} to {take.last}")
    return frame


#: What the names of films end with.
FILMS = ("mp4", "gif", "webm")
#: What the names of stills end with.
STILLS = ("pdf", "svg", "png")


def animate(
    run: Path,
    out: Path,
    look: Look,
    against: Path | None = None,
    *,
    start: int | None = None,
    end: int | None = None,
    speed: float = 1.0,
    fps: float | None = None,
) -> int:
    """Write a film of a finished run; returns the number of its images.

    out:        a new file that ends with .mp4, .gif or .webm; it is complete or not there at all
    against:    another run to show beside it
    start, end: first and last frame, by default of the run, at most MOST_FRAMES
    speed:      over that of the scene;  fps: images per second

    Raises ExportError for the file, RunFolderError for the run or a frame that it does not have, ConfigurationError for
    an option, DiskFull.
    """
    kind = _kind_of(out, FILMS)
    if kind != "gif":
        ffmpeg()
    takes = open_takes(run, look, against)
    plan = schedule(takes[0], start, end, speed, fps)
    if kind == "gif" and plan.fps > _MOST_GIF_FPS:
        raise ConfigurationError(f"fps: found {plan.fps:g}, expected at most {_MOST_GIF_FPS:g} in a GIF")
    shown = sorted(set(plan.frames))
    sheet = Sheet(takes, look, shown, (shown[0], shown[-1]))
    write_new(out, lambda path: write_film(path, sheet, plan.frames, plan.fps))
    return len(plan.frames)


def snapshot(run: Path, out: Path, look: Look, frame: int | None = None, against: Path | None = None) -> int:
    """Write one frame of a finished run; returns which.

    out:   a new file that ends with .pdf, .svg or .png;  frame: None: the one that the report shows
    Raises as `animate` does.
    """
    kind = _kind_of(out, STILLS)
    takes = open_takes(run, look, against)
    if frame is None:
        chosen = choose_frame(takes[0].run)
        frame = takes[0].first if chosen is None else chosen
    check_in_take(takes[0], frame)
    sheet = Sheet(takes, look, [frame], (takes[0].first, takes[0].last))  # its strips show the whole run
    sheet.show(frame)
    write_new(out, lambda path: save(sheet.figure, path, kind, text=True))
    return frame


def open_takes(run: Path, look: Look, against: Path | None = None) -> list[Take]:
    """The panels of a film, checked: estimates of one run, or one estimate of two.

    Raises RunFolderError for a run that is in progress or has nothing to show, ConfigurationError for an option.
    """
    count = 1 if look.estimates is None else len(look.estimates)
    if against is not None and count != 1:
        raise ConfigurationError(f"found {count} estimates of two runs, expected one")
    look.check(2 if against is not None else count)
    first = _opened(run, look.agent)
    estimates = look.estimates or [first.believed or PICTURE]
    if against is None:
        return [Take(first, estimate) for estimate in estimates]
    second = _opened(against, look.agent)
    alike = first.name == second.name
    return [Take(each, estimates[0], each.path.name if alike else each.name) for each in (first, second)]


def _kind_of(out: Path, kinds: Sequence[str]) -> str:
    """The kind of a new file by its name, one of `kinds`; raises ExportError for another, or if it is not new."""
    kind = out.suffix.lower().removeprefix(".")
    if kind not in kinds:
        names = [f".{name}" for name in kinds]
        raise ExportError(f"{out}: expected a name that ends with {', '.join(names[:-1])} or {names[-1]}")
    check_free(out)
    return kind


def _opened(path: Path, agent: str | None) -> Run:
    run = Run(path)
    finished_record(path, run.files.record)
    return run if agent is None else run.seen_by(agent)


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

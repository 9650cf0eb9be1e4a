"""Writes films and stills of finished runs: `mast animate` and `mast snapshot`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib import figure as figures
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.backends.backend_svg import FigureCanvasSVG

from mast_zenoh.errors import ConfigurationError, ExportError, RunFolderError
from mast_zenoh.launch.ending import RUNNING
from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.report.figures.view import choose_frame
from mast_zenoh.report.film.encoding import ffmpeg, images, write_gif, write_video
from mast_zenoh.report.film.look import Look
from mast_zenoh.report.film.sheet import Sheet
from mast_zenoh.report.film.takes import Take
from mast_zenoh.run_folder import check_free, write_new
from mast_zenoh.runs.files import MOST_FRAMES
from mast_zenoh.runs.run import Run

#: Images per second at most, unless the user asks for more.
_SMOOTH_FPS = 30.0
_MOST_FPS = 120.0


class Schedule(NamedTuple):
    """frames: of the run, one for each image of the film;  fps: images per second"""

    frames: Sequence[int]
    fps: float


def schedule(take: Take, start: int | None, end: int | None, speed: float, fps: float | None) -> Schedule:
    """The frames of a film.

    start, end: first and last frame, None: of the run, but at most MOST_FRAMES
    speed:      of the film over that of the scene
    fps:        images per second; None: every frame once, but at most 30

    Raises RunFolderError for frames that the run does not have, ConfigurationError for an invalid speed or rate.
    """
    first = take.first if start is None else check_frame(take, start)
    last = min(take.last, first + MOST_FRAMES - 1) if end is None else check_frame(take, end)
    if last < first:
        raise ConfigurationError(f"frames: found {first} to {last}, expected the first not to be after the last")
    if not (math.isfinite(speed) and 0.01 <= speed <= 100):
        raise ConfigurationError(f"speed: found {speed:g}, expected 0.01 to 100")
    if fps is not None and not (math.isfinite(fps) and 0.1 <= fps <= _MOST_FPS):
        raise ConfigurationError(f"fps: found {fps:g}, expected 0.1 to {_MOST_FPS:g}")
    native = speed / take.run.period_s
    if fps is None and native <= _SMOOTH_FPS:
        return Schedule(range(first, last + 1), native)
    fps = fps or _SMOOTH_FPS
    count = max(1, math.ceil((last + 1 - first) / native * fps - 1e-9))
    return Schedule([min(first + math.floor(k * native / fps + 1e-9), last) for k in range(count)], fps)


def check_frame(take: Take, frame: int) -> int:
    """Return a frame; raises RunFolderError if the run does not have it."""
    if not take.first <= frame <= take.last:
        raise RunFolderError(f"{take.run.path}: found frame {frame}, expected one of {take.first} to {take.last}")
    return frame


#: What the names of films end with.
FILMS = ("mp4", "gif", "webm")
#: What the names of stills end with, and their canvases.
STILLS = {"pdf": FigureCanvasPdf, "svg": FigureCanvasSVG, "png": FigureCanvasAgg}
#: Text stays text, in TrueType fonts that any printer takes, and ids are reproducible.
_TEXT: dict[Any, Any] = {"pdf.fonttype": 42, "svg.fonttype": "none", "svg.hashsalt": "mast-zenoh"}
#: Without dates, so that equal stills are equal files.
_METADATA: dict[str, dict[str, None]] = {
    "pdf": {"CreationDate": None, "ModDate": None},
    "svg": dict.fromkeys(("Date", "Creator", "Format", "Type")),
    "png": {"Software": None},
}


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
    start, end: first and last frame;  speed: over that of the scene;  fps: images per second

    Raises ExportError for the file, RunFolderError for the run or a frame that it does not have, ConfigurationError for
    an option, DiskFull.
    """
    kind = _kind_of(out, FILMS)
    if kind != "gif":
        ffmpeg()
    takes = open_takes(run, look, against)
    plan = schedule(takes[0], start, end, speed, fps)
    shown = sorted(set(plan.frames))
    sheet = Sheet(takes, look, shown, (shown[0], shown[-1]))

    def write(path: Path) -> None:
        if kind == "gif":
            theme = look.colours
            key = (theme.ground, theme.ink, theme.adversary, theme.building, *theme.outcomes.values())
            write_gif(path, lambda frames: images(sheet, frames), plan.frames, plan.fps, key)
        else:
            write_video(path, images(sheet, plan.frames), look.pixels(len(takes)), plan.fps)

    write_new(out, write)
    return len(plan.frames)


def snapshot(run: Path, out: Path, look: Look, frame: int | None = None, against: Path | None = None) -> int:
    """Write one frame of a finished run; returns which.

    out:   a new file that ends with .pdf, .svg or .png;  frame: None: the one that the report shows
    Raises as `animate` does.
    """
    kind = _kind_of(out, tuple(STILLS))
    takes = open_takes(run, look, against)
    if frame is None:
        chosen = choose_frame(takes[0].run)
        frame = takes[0].first if chosen is None else chosen
    check_frame(takes[0], frame)
    figure = still(takes, look, frame)

    def write(path: Path) -> None:
        STILLS[kind](figure)
        with rc_context(_TEXT):
            figure.savefig(path, format=kind, facecolor=figure.get_facecolor(), metadata=_METADATA[kind])

    write_new(out, write)
    return frame


def still(takes: Sequence[Take], look: Look, frame: int) -> figures.Figure:
    """One frame as a figure; its strips show the whole run."""
    sheet = Sheet(takes, look, [frame], (takes[0].first, takes[0].last))
    sheet.show(frame)
    return sheet.figure


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
    folder = Run(path)
    if folder.files.record.get("status") == RUNNING:
        raise RunFolderError(f"{path}: the run is still in progress: expected a finished run")
    return folder if agent is None else folder.seen_by(agent)

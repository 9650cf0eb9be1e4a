"""Which frame of the run each image of a film shows, and how fast the film is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from mast_zenoh.errors import ConfigurationError, RunFolderError
from mast_zenoh.report.film.takes import Take

#: Images per second at most, unless the user asks for more.
_SMOOTH_FPS = 30.0
_MOST_FPS = 120.0


class Schedule(NamedTuple):
    """frames: of the run, one for each image of the film;  fps: images per second"""

    frames: Sequence[int]
    fps: float


def schedule(take: Take, start: int | None, end: int | None, speed: float, fps: float | None) -> Schedule:
    """The frames of a film.

    start, end: first and last frame, None: of the run;  speed: of the film over that of the scene
    fps:        images per second; None: every frame once, but at most 30

    Raises RunFolderError for frames that the run does not have, ConfigurationError for an invalid speed or rate.
    """
    first, last = (default if given is None else check_frame(take, given)
                   for given, default in ((start, take.first), (end, take.last)))  # fmt: skip
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

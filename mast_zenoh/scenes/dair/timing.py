"""Checks of the times of frames, and of agents with clocks of their own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.errors import ConfigurationError, SceneError


def check_limit(owner: str, name: str, value: float) -> float:
    """A limit above 0 as a float. Raises ConfigurationError for anything else.

    owner: type of the scene; name: of its parameter
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < float("inf"):
        raise ConfigurationError(f"{owner}: {name} is {value!r}, expected a number above 0")
    return float(value)


def check_times(path: Path, names: Sequence[str], times_ns: Ints, max_gap_s: float) -> None:
    """Raise SceneError if frames are not in the order of their times, or if some are missing between two.

    path: of the file or folder that gives the times; names: (F,) of the frames; times_ns: (F,)
    """
    step = np.diff(times_ns) / 1e9
    late = np.flatnonzero(step <= 0)
    if len(late):
        before, after = names[late[0]], names[late[0] + 1]
        raise SceneError(f"{path}: frame {after}: time is not later than that of frame {before} before it")
    gaps = np.flatnonzero(step > max_gap_s)
    if len(gaps):
        before, after = names[gaps[0]], names[gaps[0] + 1]
        raise SceneError(
            f"{path}: frame {after}: found a gap of {step[gaps[0]]:.3f} s after frame {before}, "
            f"expected at most {max_gap_s:g} s (max_gap_s)"
        )


def check_differences(path: Path, names: Sequence[str], agent: str, difference_s: Floats, limit_s: float) -> None:
    """Raise SceneError if an agent's frame is too far from the scene's in time.

    difference_s: (F,) s, time of the agent's frame minus that of the scene's
    """
    far = np.flatnonzero(np.abs(difference_s) > limit_s)
    if len(far):
        raise SceneError(
            f"{path}: frame {names[far[0]]}: the frame of {agent} is {difference_s[far[0]]:+.3f} s away, "
            f"expected at most {limit_s:g} s (max_time_difference_s)"
        )

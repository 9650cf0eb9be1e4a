"""Episodes: how long a displaced object was in view of witnesses before its liar was suspended. Pure.

The clock of an object starts at the first frame in which enough honest agents see it while it is displaced, so that
nothing was known of it before. It stops when the liar is suspended: a detection. It ends without a detection (censored)
when the object is no longer displaced, when the number of honest viewers leaves the range, or with the run.
Interruptions up to GAP_S do not count, as five returns come and go, and tracks outlive them.

When an episode ends does not depend on the defence, as the attack does not hear of its suspension. So nothing is
selected by leaving out episodes that could not last long enough.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.study.defences.drift.floor import speed_up

#: s, longest interruption within an episode.
GAP_S = 0.5
#: Honest viewers from which a majority against the liar is possible: evidence before counts for nobody.
DECISIVE = 2
_ROUNDING_S = 1e-6


@dataclass(frozen=True, slots=True)
class ViewerRange:
    """A range of numbers of honest viewers: at least `least`, at most `most` (None: any number)."""

    least: int
    most: int | None

    @property
    def title(self) -> str:
        """How tables call it."""
        if self.most is None:
            return f"{self.least} or more"
        return str(self.least)


@dataclass(frozen=True, slots=True)
class Episode:
    """An object that was displaced in view of witnesses.

    length_s:  for how long, whether the liar was suspended or not
    watched_s: until the suspension, or else `length_s`;  detected: whether the liar was suspended
    speed_up:  mean of `floor.speed_up` over the watched time: one witness alone would need that much longer
    offset_m:  largest offset in the watched time
    """

    length_s: float
    watched_s: float
    detected: bool
    speed_up: float
    offset_m: float

    def judged_within(self, limit_s: float) -> bool:
        """Whether it lasted long enough to say if it is detected within a time."""
        return self.length_s >= limit_s - _ROUNDING_S

    def detected_within(self, limit_s: float) -> bool:
        """Whether its liar was suspended within a time."""
        return self.detected and self.watched_s <= limit_s + _ROUNDING_S


def episodes(
    time_s: ArrayLike,
    track: ArrayLike,
    viewers: ArrayLike,
    offset_m: ArrayLike,
    suspended_s: float | None,
    viewer_range: ViewerRange,
) -> list[Episode]:
    """The episodes of one run in order of their beginning, at most one for each track of the liar.

    time_s, track, viewers, offset_m: (n,) a row for each displaced track and frame: s, id, honest viewers, and m
    suspended_s: time at which the liar was suspended; None: never. Tracks displaced later are left out.
    """
    times, ids = np.asarray(time_s, np.float64), np.asarray(track)
    seen_by, offset = np.asarray(viewers, np.int64), np.asarray(offset_m, np.float64)
    end_s = math.inf if suspended_s is None else suspended_s
    result = []
    for each in dict.fromkeys(ids.tolist()):
        rows = np.flatnonzero(ids == each)
        rows = rows[np.argsort(times[rows], kind="stable")]
        period = _period(times, rows, seen_by[rows], viewer_range)
        if period is not None and times[period[0]] < end_s - _ROUNDING_S:
            result.append((float(times[period[0]]), _episode(times[period], seen_by[period], offset[period], end_s)))
    return [episode for _, episode in sorted(result, key=lambda pair: pair[0])]


def _period(times: Floats, rows: Ints, seen_by: Ints, viewer_range: ViewerRange) -> Ints | None:
    """The rows of a track's episode; None if it has none, or was known before."""
    inside = seen_by >= viewer_range.least
    if viewer_range.most is not None:
        inside &= seen_by <= viewer_range.most
    if not inside.any():
        return None
    first = int(inside.argmax())
    if (seen_by[:first] >= min(DECISIVE, viewer_range.least)).any():
        return None
    last = first
    for index in _followers(inside, first):
        if times[rows[index]] - times[rows[last]] > GAP_S + _ROUNDING_S:
            break
        last = index
    return rows[first : last + 1]


def _followers(inside: Bools, first: int) -> Iterator[int]:
    return iter(np.flatnonzero(inside[first + 1 :]) + first + 1)


def _episode(times: Floats, seen_by: Ints, offset: Floats, end_s: float) -> Episode:
    length_s = float(times[-1] - times[0])
    detected = bool(end_s <= times[-1] + _ROUNDING_S)
    watched = times <= end_s + _ROUNDING_S
    return Episode(
        round(length_s, 9),
        round(float(end_s - times[0]) if detected else length_s, 9),
        detected,
        float(speed_up(seen_by[watched]).mean()),
        float(offset[watched].max()),
    )

"""Which part of the scene panels show: what matters, and not a single distant false track."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.report.figures.view import ego_position
from mast_zenoh.report.film.look import WindowChoice
from mast_zenoh.report.film.takes import Take

#: m: agents and objects farther than this from the agent do not matter.
_MATTERS_M = 105.0
#: Share of the objects on either side that may lie outside.
_OUTLIERS = 0.04
#: m: free space around what matters; half of the shorter side, at least.
_MARGIN_M, _LEAST_HALF_M = 8.0, 20.0


class Window(NamedTuple):
    """A rectangle of the scene, m. x, y: its centre;  across, up: half of its width and height"""

    x: float
    y: float
    across: float
    up: float

    @property
    def half(self) -> float:
        """m, half of the shorter side."""
        return min(self.across, self.up)

    @property
    def corners(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """m, the lower left corner and the upper right one."""
        return (self.x - self.across, self.y - self.up), (self.x + self.across, self.y + self.up)

    def contains(self, position: Floats) -> bool:
        """Whether a position (2,) or (3,) m is inside."""
        return bool(abs(position[0] - self.x) <= self.across and abs(position[1] - self.y) <= self.up)


@dataclass(frozen=True)
class Framing:
    """The window of every frame; the same size in all of them.

    fixed:  in the middle of the film's window, or relative to the followed agent
    follow: the take whose agent is followed
    """

    fixed: Window
    follow: Take | None = None

    def window(self, frame: int) -> Window:
        """The window in a frame."""
        at = None if self.follow is None else ego_position(self.follow.run, frame)
        return self.fixed if at is None else self.fixed._replace(x=float(at[0]), y=float(at[1]))


def framing(choice: WindowChoice, takes: Sequence[Take], frames: Sequence[int], aspect: float) -> Framing:
    """The window that a user chose for panels of one shape.

    frames: of the first take, all that the film shows;  aspect: width by height of a panel
    """
    across, up = (aspect, 1.0) if aspect >= 1.0 else (1.0, 1.0 / aspect)
    if choice.centre is not None and choice.half is not None:
        return Framing(Window(*choice.centre, choice.half * across, choice.half * up))
    always, mostly = _places(takes, frames, relative=choice.follow)
    if choice.follow:
        sides = np.array([_limits(np.abs(always[:, axis]), np.abs(mostly[:, axis]))[1] for axis in (0, 1)])
        middle = np.zeros(2)
    else:
        limits = np.array([_limits(always[:, axis], mostly[:, axis]) for axis in (0, 1)])
        middle, sides = limits.mean(axis=1), np.diff(limits, axis=1)[:, 0] / 2
    needed = (sides + _MARGIN_M) / [across, up]
    half = choice.half or max(float(needed.max()), _LEAST_HALF_M)
    fixed = Window(float(middle[0]), float(middle[1]), half * across, half * up)
    return Framing(fixed, takes[0] if choice.follow else None)


def _places(takes: Sequence[Take], frames: Sequence[int], *, relative: bool) -> tuple[Floats, Floats]:
    """(a, 2) m, where agents are, and (n, 2) m, where boxes and manipulations are; of those that matter.

    relative: to the agent
    """
    always, mostly = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for take in takes:
        for frame in frames:
            shown = take.frame_at(takes[0].seconds(frame))
            own = ego_position(take.run, shown)
            view = take.view(shown)
            marks = view.marks(take.estimate)
            boxes = [each.position[:, :2] for each in view.boxes[take.estimate].values()]
            for places, result in (
                (take.agent_positions(shown), always),
                (np.concatenate([*boxes, marks.added[:, :2], marks.removed[:, :2]]), mostly),
            ):
                if own is not None:
                    places = places[np.hypot(*(places - own[:2]).T) <= _MATTERS_M]
                result.append(places - own[:2] if relative and own is not None else places)
    return np.concatenate(always), np.concatenate(mostly)


def _limits(always: Floats, mostly: Floats) -> tuple[float, float]:
    """Between which all of `always` are, and all but few of `mostly`; (0, 0) without any."""
    ordered = np.sort(mostly)
    cut = int(len(ordered) * _OUTLIERS)
    inner = np.concatenate([always, ordered[cut : len(ordered) - cut]])
    return (float(inner.min()), float(inner.max())) if len(inner) else (0.0, 0.0)

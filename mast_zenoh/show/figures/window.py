"""Which part of a scene a picture shows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from mast_zenoh.arrays.states import Floats
from mast_zenoh.runs.frame import Frame, ego_position

#: m: agents and objects farther than this from the ego do not matter.
_MATTERS_M = 105.0
#: m: free space around what matters; half of the shorter side, at least.
_MARGIN_M, _LEAST_HALF_M = 8.0, 20.0


class Window(NamedTuple):
    """A rectangle of the scene, m. x, y: its centre;  across, up: half of its width and height"""

    x: float
    y: float
    across: float
    up: float

    @classmethod
    def of(cls, centre: Sequence[float] | Floats, half: float, aspect: float = 1.0) -> Window:
        """A window of a shape. centre: x and y, m;  half: m, of the shorter side;  aspect: width by height"""
        return cls(float(centre[0]), float(centre[1]), half * max(aspect, 1.0), half / min(aspect, 1.0))

    @classmethod
    def around(cls, places: Floats, aspect: float = 1.0) -> Window:
        """The window that shows all places (n, 2) m with free space around them."""
        low, high = (places.min(axis=0), places.max(axis=0)) if len(places) else np.zeros((2, 2))
        across, up = (high - low) / 2 + _MARGIN_M
        half = max(across / max(aspect, 1.0), up * min(aspect, 1.0), _LEAST_HALF_M)
        return cls.of((low + high) / 2, half, aspect)

    def apply(self, axes: Axes) -> None:
        """Show this part of the scene on axes."""
        axes.set(xlim=(self.x - self.across, self.x + self.across), ylim=(self.y - self.up, self.y + self.up))

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


def window_of(frames: Iterable[Frame], aspect: float = 1.0, outliers: float = 0.0, *, follow: bool = False) -> Window:
    """The window of all frames: it shows the agents, boxes and manipulations around the ego.

    aspect:   its width by its height
    outliers: share of the boxes and manipulations on either side that may lie outside
    follow:   with the ego in the middle; x and y are relative to it
    """
    always, mostly = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for frame in frames:
        scene, ego = frame.run.files.scene, ego_position(frame.run, frame.index)
        if scene is not None and len(scene):
            always.append(_near(scene.agent_position[scene.nearest(frame.index)], ego, relative=follow))
        for estimate, by_outcome in frame.boxes.items():
            marks, positions = frame.marks(estimate), [boxes.position for boxes in by_outcome.values()]
            mostly.append(_near(np.concatenate([*positions, marks.added, marks.removed]), ego, relative=follow))
    inner = np.sort(np.concatenate(mostly), axis=0)  # by x and by y
    cut = int(len(inner) * outliers)
    places = np.concatenate([*always, inner[cut : len(inner) - cut]])
    return Window.around(np.concatenate([places, -places]) if follow else places, aspect)


def _near(places: Floats, ego: Floats | None, *, relative: bool) -> Floats:
    """(k, 2) m, those of the places (n, 3) m that matter. ego: (3,) m, None: all matter;  relative: to the ego"""
    if ego is None:
        return places[:, :2]
    offsets = (places - ego)[:, :2]
    near = np.hypot(*offsets.T) <= _MATTERS_M
    return np.asarray(offsets[near] if relative else places[near, :2])

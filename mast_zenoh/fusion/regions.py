"""Regions of centres: which objects a centre is responsible for."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats


class ServedArea(ABC):
    """An area of the ground."""

    follows: ClassVar[bool] = False  #: whether it must be told where its agent is

    @abstractmethod
    def contains(self, position: Floats, margin_m: float = 0.0) -> Bools:
        """(n,) whether positions (n, 2 or 3), m, world frame, are in the region or less than `margin_m` outside."""

    def move_to(self, position: Floats) -> None:  # noqa: B027 (a hook: most regions stand still)
        """Follow the agent that carries the centre. position: (3,) m, world frame"""


@dataclass
class Rectangle(ServedArea):
    """All that is between two lines from north to south, and two from west to east.

    x_min_m, x_max_m, y_min_m, y_max_m: m, world frame; None: without limit on that side. The upper limits are outside,
    so that neighbours share no point.
    """

    x_min_m: float | None = None
    x_max_m: float | None = None
    y_min_m: float | None = None
    y_max_m: float | None = None

    def __post_init__(self) -> None:
        low = [-np.inf if value is None else value for value in (self.x_min_m, self.y_min_m)]
        high = [np.inf if value is None else value for value in (self.x_max_m, self.y_max_m)]
        for axis, least, most in zip("xy", low, high, strict=True):
            if not least < most:
                raise ValueError(f"{axis}_min_m, {axis}_max_m: found {least}, {most}, expected ascending numbers")
        self._low, self._high = np.array(low), np.array(high)

    def contains(self, position: Floats, margin_m: float = 0.0) -> Bools:
        place = position[:, :2]
        return np.asarray(((place >= self._low - margin_m) & (place < self._high + margin_m)).all(axis=1))


@dataclass
class Around(ServedArea):
    """A circle around the agent that carries the centre; empty until its pose is known.

    radius_m: m, of the circle
    """

    follows: ClassVar[bool] = True

    radius_m: float = 100.0

    def __post_init__(self) -> None:
        check("more than 0", radius_m=self.radius_m)
        self._centre: Floats | None = None

    def contains(self, position: Floats, margin_m: float = 0.0) -> Bools:
        if self._centre is None:
            return np.zeros(len(position), np.bool_)
        return np.asarray(np.hypot(*(position[:, :2] - self._centre).T) <= self.radius_m + margin_m)

    def move_to(self, position: Floats) -> None:
        self._centre = position[:2].copy()

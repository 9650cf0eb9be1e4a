"""Random numbers of objects for the errors of one sensor, which go on from frame to frame."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.streams import stream

#: Harmonics of an error over the viewing angle, besides its mean: enough for angles of 30 degrees and more.
_HARMONICS = 6


class WanderingNumbers:
    """Standard normal numbers of objects, each a stationary first-order autoregressive process.

    Uhlenbeck and Ornstein, On the theory of the Brownian motion, 1930. An object that was out of view begins anew.

    keep: (k,) correlation of each number with that of the frame before
    """

    def __init__(self, keep: Floats) -> None:
        self._keep = keep
        self._ids: Ints = np.zeros(0, np.int64)
        self._numbers: Floats = np.zeros((0, len(keep)))

    def step(self, ids: Ints, fresh: Floats) -> Floats:
        """The numbers (n, k) in the next frame. ids: (n,) ascending; fresh: (n, k) independent standard normal"""
        row = np.minimum(np.searchsorted(self._ids, ids), max(len(self._ids) - 1, 0))
        known = self._ids[row] == ids if len(self._ids) else np.zeros(len(ids), np.bool_)
        numbers = fresh.copy()
        numbers[known] = self._keep * self._numbers[row[known]] + np.sqrt(1.0 - self._keep**2) * fresh[known]
        self._ids, self._numbers = ids.copy(), numbers
        return numbers


class ViewErrors:
    """Standard normal numbers of objects that are smooth functions of the viewing angle, each object with its own.

    At two viewing angles, they correlate by about exp(-(difference / width)^2 / 2).

    count: numbers of an object; width_rad: rad
    """

    def __init__(self, count: int, width_rad: float) -> None:
        self._count = count
        order = np.arange(_HARMONICS + 1)
        power = np.exp(-((order * width_rad) ** 2) / 2.0) * np.where(order == 0, 1.0, 2.0)
        self._amplitude = np.sqrt(power / power.sum())
        self._key: int | None = None
        self._functions: dict[int, Floats] = {}

    def at(self, ids: Ints, angle: Floats, random: np.random.Generator) -> Floats:
        """The numbers (n, count) of objects with `ids` (n,), seen at an `angle` (n,) rad. random: of the frame

        An object has the same function whenever it is seen: it follows from its id and the `random` of the first frame.
        """
        if self._key is None:
            self._key = int(random.spawn(1)[0].integers(2**63))  # spawned, so that no other draw is another one
        known = self._functions
        self._functions = {each: known[each] if each in known else self._function(each) for each in ids.tolist()}
        if not len(ids):
            return np.zeros((0, self._count))
        phase = np.arange(_HARMONICS + 1) * angle[:, None]
        waves = np.concatenate([self._amplitude * np.cos(phase), self._amplitude * np.sin(phase)], axis=1)
        return np.asarray(np.einsum("ncw,nw->nc", np.stack(list(self._functions.values())), waves))

    def _function(self, number: int) -> Floats:
        """(count, waves) coefficients of an object."""
        assert self._key is not None
        return stream(self._key, number).standard_normal((self._count, 2 * (_HARMONICS + 1)))

"""Does the tracked object exist?

Log-odds, as in integrated probabilistic data association (Musicki, Evans, Stankovic, IEEE Transactions on Automatic
Control, 1994).
"""

from __future__ import annotations

import math

import numpy as np

from mast_zenoh.states import Floats, Ints
from mast_zenoh.tracking.tracks import HITS, MISSES, Tracks

#: Log-odds are kept within these, so that exp() of them stays finite.
LIMIT = 30.0


def survive(tracks: Tracks, dt: float, lifetime_s: float, memory_s: float) -> None:
    """Take `dt` s off: objects leave after `lifetime_s` s on average; counts fade with the time constant `memory_s`."""
    # p' = s p, in odds o = p / (1 - p): o' = s o / (1 + (1 - s) o), which bounds the odds by s / (1 - s).
    stays = math.exp(-dt / lifetime_s)
    odds = np.exp(np.minimum(np.maximum(tracks["odds"], -LIMIT), LIMIT))
    tracks["odds"] = np.log(stays * odds / (1.0 + (1.0 - stays) * odds))
    tracks["record"] *= math.exp(-dt / memory_s)


def detection_probability(tracks: Tracks, prior: float, weight: float) -> Floats:
    """(n,) how often each object is detected when it could be: its record, and `prior` for `weight` frames' worth.

    An object that is only just in sight is detected now and then: a miss says little against it. A spotless record
    counts no more than the prior, or the first miss after it would be the end.
    """
    hits, misses = tracks["record"][:, HITS], tracks["record"][:, MISSES]
    return np.asarray(np.minimum((hits + prior * weight) / (hits + misses + weight), prior))


def hit(tracks: Tracks, detected: Floats, log_ratio: Floats) -> None:
    """Tracks were measured; `log_ratio` (n,): ln of the density of the measurement over that of clutter."""
    tracks["odds"] += np.logaddexp(np.log(detected) + log_ratio, np.log1p(-detected))
    tracks["record"][:, HITS] += 1.0


def miss(tracks: Tracks, rows: Ints, detected: Floats, expected: Floats, birth: float) -> None:
    """Tracks at `rows` were not measured, though to be `expected` (k,), 0 to 1: what cannot be seen is not missed.

    A confirmed one never becomes less likely than a new object, of log-odds `birth`: it may come back.
    """
    odds = tracks["odds"][rows] + np.log1p(-detected * expected)
    tracks["odds"][rows] = np.where(tracks["confirmed"][rows] > 0, np.maximum(odds, birth), odds)
    tracks["record"][rows, MISSES] += expected

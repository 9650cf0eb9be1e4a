"""Does the tracked object exist?

Odds p / (1 - p), as in integrated probabilistic data association (Musicki, Evans, Stankovic, IEEE Transactions on
Automatic Control, 1994).
"""

from __future__ import annotations

import math

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.tracks import AGE, CONFIRMED, HITS, MISSES, ODDS, RECORD, XX, YY, planar

#: Nothing is surer than this: products of odds stay finite, however many measurements come in no time at all.
MOST = 1e12


@kernel
def survive(tracks: Floats, dt: float, lifetime_s: float, memory_s: float) -> None:
    """Take `dt` s off: objects leave after `lifetime_s` s on average; counts fade with the time constant `memory_s`."""
    # p' = s p, in odds o = p / (1 - p): o' = s o / (1 + (1 - s) o), which bounds the odds by s / (1 - s).
    leaves = math.exp(dt / lifetime_s)
    odds = tracks[:, ODDS]
    odds /= leaves + (leaves - 1.0) * odds
    tracks[:, RECORD] *= math.exp(-dt / memory_s)


def detection_probability(tracks: Floats, prior: float, weight: float) -> Floats:
    """(n,) how often each object is detected when it could be: its record, and `prior` for `weight` frames' worth.

    An object that is only just in sight is detected now and then: a miss says little against it. A spotless record
    counts no more than the prior, or the first miss after it would be the end.
    """
    hits = tracks[:, HITS]
    return np.asarray(np.minimum((hits + prior * weight) / (hits + tracks[:, MISSES] + weight), prior))


@kernel
def hit(tracks: Floats, detected: Floats, log_ratio: Floats, most: float) -> None:
    """Tracks were measured; `log_ratio` (n,): ln of the density of the measurement over that of clutter.

    most: what the odds may become
    """
    tracks[:, ODDS] = np.minimum(tracks[:, ODDS] * (detected * np.exp(log_ratio) + (1.0 - detected)), most)
    tracks[:, HITS] += 1.0


@kernel
def miss(tracks: Floats, detected: Floats, expected: Floats, birth: float) -> None:
    """Tracks were not measured, though to be `expected` (n,), 0 to 1: what cannot be seen, or was seen, is not missed.

    A confirmed one never becomes less likely than a new object, of odds `birth`: it may come back.
    """
    odds = tracks[:, ODDS] * (1.0 - detected * expected)
    tracks[:, ODDS] = np.maximum(odds, birth * tracks[:, CONFIRMED])
    tracks[:, MISSES] += expected


@kernel
def kept(
    tracks: Floats,
    confirm: float,
    report: float,
    doubtful: float,
    max_age_s: float,
    max_variance: float,
    max_speed: float,
    max_reported_variance: float,
) -> tuple[Bools, Bools]:
    """(n,) which tracks to keep, and which to report; those of odds above `confirm` are confirmed.

    report: odds above which a confirmed track is told of; doubtful: odds below which one that is not is given up
    max_age_s: s without a measurement; max_variance, max_reported_variance: m^2, of the horizontal position, both axes
    together; max_speed: m/s
    """
    odds, confirmed = tracks[:, ODDS], tracks[:, CONFIRMED]
    np.maximum(confirmed, odds > confirm, out=confirmed)
    variance = tracks[:, XX] + tracks[:, YY]
    keep = odds >= doubtful * (1.0 - confirmed)
    keep &= tracks[:, AGE] <= max_age_s
    keep &= variance <= max_variance
    keep &= np.abs(planar(tracks[:, 6:8])) <= max_speed
    return keep, (confirmed > 0.0) & (odds > report) & (variance <= max_reported_variance)

"""Existence probabilities of tracked objects.

Odds p / (1 - p), as in integrated probabilistic data association (Musicki, Evans, Stankovic, IEEE Transactions on
Automatic Control, 1994).
"""

from __future__ import annotations

import math

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.kalman import BOX
from mast_zenoh.tracking.tracks import AGE, CONFIRMED, HITS, MISSES, ODDS, RECORD, ROW, XX, YAW_VARIANCE, YY, planar

#: Upper limit of the odds; keeps products of odds finite for any number of measurements.
MAX_ODDS = 1e12


@kernel
def begin_step(tracks: Floats, dt: float, yaw_drift: float, lifetime_s: float, memory_s: float) -> None:
    """Let the tracks coast for `dt` s: all of them but their mean and covariance.

    yaw_drift: rad^2/s, growth of the variance of a heading; lifetime_s: average time that an object exists
    memory_s: time constant of counts
    """
    tracks[:, ROW] = -1.0
    tracks[:, YAW_VARIANCE] += yaw_drift * dt
    tracks[:, AGE] += dt
    # p' = s p, in odds o = p / (1 - p): o' = s o / (1 + (1 - s) o), which bounds the odds by s / (1 - s).
    growth = math.exp(dt / lifetime_s)
    odds = tracks[:, ODDS]
    odds /= growth + (growth - 1.0) * odds
    tracks[:, RECORD] *= math.exp(-dt / memory_s)


@kernel
def detection_probability(tracks: Floats, prior: float, weight: float) -> Floats:
    """Detection probability (n,) of each object: its hit rate combined with a prior.

    prior: probability; weight: of the prior, in frames

    A miss is weak evidence against a rarely detected object. The result never exceeds the prior; otherwise one miss
    after a perfect hit rate would end a track.
    """
    hits = tracks[:, HITS]
    return np.asarray(np.minimum((hits + prior * weight) / (hits + tracks[:, MISSES] + weight), prior))


def update_detected(tracks: Floats, detected: Floats, log_ratio: Floats, most: float) -> None:
    """Update existence of measured tracks.

    log_ratio: (n,) ln of the density of the measurement over the density of clutter; most: upper limit of the odds
    """
    tracks[:, ODDS] = np.minimum(tracks[:, ODDS] * (detected * np.exp(log_ratio) + (1.0 - detected)), most)
    tracks[:, HITS] += 1.0


@kernel
def update_missed(tracks: Floats, detected: Floats, coasting: Ints, visible: Floats, birth: float) -> None:
    """Update existence of unmeasured tracks.

    coasting: (k,) their rows, ascending; visible: (k,) their visible fractions, 0 to 1. The odds of a
    confirmed track stay at least at `birth`, those of a new object, so that it can be recovered.
    """
    tracks[coasting, ODDS] *= 1.0 - detected[coasting] * visible
    tracks[coasting, MISSES] += visible
    tracks[:, ODDS] = np.maximum(tracks[:, ODDS], birth * tracks[:, CONFIRMED])


@kernel
def coasting_tracks(tracks: Floats, report_odds: float) -> tuple[Ints, Floats, Floats]:
    """Rows (k,) and boxes (k, 6) of the tracks without a measurement in this step; boxes of those that may occlude.

    report_odds: odds above which a confirmed track counts as an object
    """
    occluding = (tracks[:, CONFIRMED] > 0.0) & (tracks[:, ODDS] > report_odds)
    rows, boxes = (tracks[:, ROW] < 0.0).nonzero()[0], tracks[:, BOX]
    return rows, boxes[rows], boxes[occluding]


@kernel
def track_status(
    tracks: Floats,
    confirm: float,
    report: float,
    doubtful: float,
    max_age_s: float,
    max_variance: float,
    max_speed: float,
    max_reported_variance: float,
) -> tuple[Bools, Bools]:
    """Tracks (n,) to keep, and tracks (n,) to report.

    Confirms tracks with odds above `confirm`.

    report: odds above which a confirmed track is reported; doubtful: odds below which an unconfirmed one is dropped
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

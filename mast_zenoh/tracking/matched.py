"""What a measurement changes in the track that it matches, except for the Kalman correction."""

from __future__ import annotations

from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.evidence import add_scores
from mast_zenoh.tracking.existence import update_detected
from mast_zenoh.tracking.gating import gaussian
from mast_zenoh.tracking.heading import correct_heading
from mast_zenoh.tracking.tracks import AGE, CONFIRMED, COVARIANCE, ROW, XX, XY, YY, update_class


@kernel
def matched_tracks(
    tracks: Floats,
    match: tuple[Ints, Ints, Floats, Floats],
    detected: Floats,
    measured: tuple[Any, ...],
    yaw_variance: float,
    most: float,
) -> tuple[Floats, Floats, Floats, Floats, tuple[float, int], tuple[float, int]]:
    """The k matched ones of n tracks and their measurements, ready for the Kalman correction.

    match: rows of the tracks and of the measurements, log density ratios to clutter, and variances of jumps m^2: (k,)
    detected: (n,) detection probabilities; measured: the fields of `Measured`
    yaw_variance: rad^2, of a measured heading; most: upper limit of the odds

    Returns a copy (k, WIDTH) of the tracks, updated by their measurements except for mean and covariance; the states
    and noises of the measurements; innovations (k, 2) m; `innovation_sum` and `excess_sum`. Where the measurements are
    full states, which are estimates themselves, covariances of both are wider, see `widen`.
    """
    track, measurement, log_ratio, jump = match
    row, state, noise, yaw, class_id, score = (column.take(measurement, 0) for column in measured)
    updated = tracks.take(track, 0)
    updated[:, XX] += jump
    updated[:, YY] += jump
    correct_heading(updated, yaw, yaw_variance)
    update_class(updated, class_id)
    update_detected(updated, detected.take(track), log_ratio, most)
    add_scores(updated, score)
    updated[:, AGE], updated[:, ROW] = 0.0, row
    if state.shape[1] == 9:
        widen(updated, noise)
    innovation = state[:, :2] - updated[:, :2]
    steady = jump == 0.0
    sums = innovation_sum(updated, innovation, noise, steady), excess_sum(updated, innovation, steady)
    return updated, state, noise, innovation, *sums


def widen(tracks: Floats, noise: Floats) -> None:
    """Widen the covariances of k tracks and of their measurements (k, 9, 9) so that correlated errors count once.

    Successive outputs of a filter are correlated. Covariance intersection of track and measurement avoids double
    counting; weights by the trace of the position covariance (Niehsen, FUSION 2002).
    """
    track_variance, measured_variance = tracks[:, XX] + tracks[:, YY], noise[:, 0, 0] + noise[:, 1, 1]
    weight = (measured_variance / (track_variance + measured_variance))[:, None]
    tracks[:, COVARIANCE] /= weight
    noise /= 1.0 - weight[:, None]


def innovation_sum(tracks: Floats, innovation: Floats, noise: Floats, steady: Bools) -> tuple[float, int]:
    """Sum of normalised innovations squared of k matched pairs, and how many they are.

    Of the horizontal position; pairs with a sudden displacement are left out.
    tracks: (k, WIDTH) predicted; innovation: (k, 2) m; noise: (k, m, m), the first two rows and columns are x and y
    steady: (k,) whether there is no sudden displacement
    """
    a, b, c = tracks[:, XX] + noise[:, 0, 0], tracks[:, XY] + noise[:, 0, 1], tracks[:, YY] + noise[:, 1, 1]
    distance = gaussian(innovation[:, 0], innovation[:, 1], a, b, c)[1]
    return float(distance[steady].sum()), int(np.count_nonzero(steady))


def excess_sum(tracks: Floats, innovation: Floats, steady: Bools) -> tuple[float, int]:
    """Squared innovations of confirmed tracks beyond the variances of their predictions, m^2, and how many they are.

    See `innovation_sum`. The velocity of tracks that are not confirmed is not known yet.
    """
    rows = (steady & (tracks[:, CONFIRMED] > 0.0)).nonzero()[0]
    innovation, t = innovation.take(rows, 0), tracks.take(rows, 0)
    return float(np.square(innovation).sum() - t[:, XX].sum() - t[:, YY].sum()), len(rows)

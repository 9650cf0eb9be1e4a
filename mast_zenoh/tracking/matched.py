"""What a measurement changes in the track that it matches, except for the Kalman correction."""

from __future__ import annotations

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.evidence import add_scores
from mast_zenoh.tracking.existence import update_detected
from mast_zenoh.tracking.heading import correct_heading
from mast_zenoh.tracking.tracks import AGE, COVARIANCE, ROW, XX, YY, update_class


@kernel
def matched_tracks(
    tracks: Floats,
    match: tuple[Ints, Ints, Floats, Floats],
    detected: Floats,
    measured: tuple[Ints, Floats, Ints, Floats],
    yaw_variance: float,
    most: float,
) -> Floats:
    """A copy (k, WIDTH) of the matched ones of n tracks, updated by their measurements.

    match: rows of the tracks and of the measurements, log density ratios to clutter, and variances of jumps m^2: (k,)
    detected: (n,) detection probabilities; measured: `row`, `yaw`, `class_id` and `score` of `Measured`, (m,)
    yaw_variance: rad^2, of a measured heading; most: upper limit of the odds
    """
    track, measurement, log_ratio, jump = match
    row, yaw, class_id, score = measured
    updated = tracks.take(track, 0)
    updated[:, XX] += jump
    updated[:, YY] += jump
    correct_heading(updated, yaw.take(measurement), yaw_variance)
    update_class(updated, class_id.take(measurement))
    update_detected(updated, detected.take(track), log_ratio, most)
    add_scores(updated, score.take(measurement))
    updated[:, AGE], updated[:, ROW] = 0.0, row.take(measurement)
    return updated


@kernel
def widen(tracks: Floats, noise: Floats) -> None:
    """Widen the covariances of k tracks and of their measurements (k, 9, 9) so that correlated errors count once.

    Successive outputs of a filter are correlated. Covariance intersection of track and measurement avoids double
    counting; weights by the trace of the position covariance (Niehsen, FUSION 2002).
    """
    track_variance, measured_variance = tracks[:, XX] + tracks[:, YY], noise[:, 0, 0] + noise[:, 1, 1]
    weight = (measured_variance / (track_variance + measured_variance))[:, None]
    tracks[:, COVARIANCE] /= weight
    noise /= 1.0 - weight[:, None]

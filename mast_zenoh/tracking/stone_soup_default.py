"""The default Stone Soup tracker, from Stone Soup's own components; an example for builders of your own."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

import numpy as np
from scipy.spatial import KDTree
from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
from stonesoup.deleter.time import UpdateTimeDeleter, UpdateTimeStepsDeleter
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.initiator.simple import MultiMeasurementInitiator
from stonesoup.measures import Mahalanobis
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity, RandomWalk
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState
from stonesoup.types.track import Track
from stonesoup.updater.kalman import KalmanUpdater

from mast_zenoh.tracking.classes import SIZE_DRIFT, SPEED_VERTICAL, VERTICAL_ACCELERATION

#: The order of the state vector: that of Stone Soup's combined models.
STATE = ("x", "vx", "y", "vy", "z", "vz", "l", "w", "h")
#: m/s, standard deviation of a new object's horizontal speed per axis.
SPEED = 10.0


class NearbyGNN(GNNWith2DAssignment):
    """Global nearest neighbours, without the pairs that are too far apart in the plane to be within the gate.

    The result is that of `GNNWith2DAssignment` with a Mahalanobis distance, which computes the distances of all pairs:
    that takes most of the time. The first two components of a detection must be its position, as they are here.
    """

    def generate_hypotheses(
        self, tracks: set[Track], detections: set[Detection], timestamp: datetime, **options: Any
    ) -> dict[Track, Any]:
        hypothesise, near = self.hypothesiser.hypothesise, list(detections)
        if not near:
            return {track: hypothesise(track, near, timestamp, **options) for track in tracks}
        tree = KDTree([detection.state_vector[:2, 0] for detection in near])
        noise = max(np.trace(detection.measurement_model.noise_covar[:2, :2]) for detection in near)
        xy = list(near[0].measurement_model.mapping[:2])
        hypotheses = {}
        for track in tracks:
            prediction = self.hypothesiser.predictor.predict(track, timestamp=timestamp, **options)
            variance = noise + np.trace(prediction.covar[np.ix_(xy, xy)])
            reach = 1.001 * self.hypothesiser.missed_distance * np.sqrt(variance)
            rows = tree.query_ball_point(np.asarray(prediction.mean, float)[xy, 0], reach, return_sorted=True)
            hypotheses[track] = hypothesise(track, [near[row] for row in rows], timestamp, **options)
        return hypotheses


def build(
    acceleration: float = 3.0, gate: float = 4.0, confirm_detections: int = 3, coast_s: float = 1.0
) -> dict[str, Any]:
    """A Kalman filter of constant velocity with global nearest neighbour assignment, from Stone Soup's own parts.

    acceleration: m^2/s^3, spectral density; gate: Mahalanobis distance of position and size
    confirm_detections: detections that make a track; coast_s: s without a detection that end it
    """
    planar, vertical, size = (
        ConstantVelocity(acceleration),
        ConstantVelocity(VERTICAL_ACCELERATION),
        RandomWalk(SIZE_DRIFT),
    )
    predictor = KalmanPredictor(CombinedLinearGaussianTransitionModel([planar, planar, vertical, size, size, size]))
    updater = KalmanUpdater(None)  # every detection has its own measurement model
    hypothesiser = DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=gate)
    deviation = {"vx": SPEED, "vy": SPEED, "vz": SPEED_VERTICAL}  # what a detection has replaces the others
    prior = GaussianState(np.zeros((9, 1)), np.diag([deviation.get(name, 1.0) ** 2 for name in STATE]))
    initiator = MultiMeasurementInitiator(
        prior_state=prior,
        deleter=UpdateTimeStepsDeleter(2),
        data_associator=NearbyGNN(hypothesiser),
        updater=updater,
        min_points=confirm_detections,
    )
    return dict(
        initiator=initiator,
        deleter=UpdateTimeDeleter(timedelta(seconds=coast_s)),
        data_associator=NearbyGNN(hypothesiser),
        updater=updater,
        state=STATE,
    )

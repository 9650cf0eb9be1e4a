"""The box tracker with interacting multiple models: straight on, or turning left or right.

Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001: the estimator in section
11.6.6, motion at a known turn rate in section 11.7.1.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.tracking import kalman
from mast_zenoh.tracking.box_tracker import KalmanBoxTracker3D
from mast_zenoh.tracking.tracks import COVARIANCE, ID, MEAN, YAW, classes_of, covariances


class InteractingModels(kalman.BoxFilter):
    """A Kalman filter for each of m = 3 models and each track, and the probabilities of the models.

    The table of tracks has the mean and covariance of each track over all models. What else changes them there (an
    inflated covariance, for example) is added to every model.

    turn_rate: rad/s, of the model that turns left; the one that turns right has the negative one
    straight_s, turn_s: s, average time that an object drives straight on, and that it turns
    """

    def __init__(self, turn_rate: float, straight_s: float, turn_s: float) -> None:
        self._rates = np.array([0.0, turn_rate, -turn_rate])
        begin, end = 0.5 / straight_s, 1.0 / turn_s
        self._leaving = np.array([[-2 * begin, begin, begin], [end, -end, 0.0], [end, 0.0, -end]])
        chances = np.array([straight_s, 0.5 * turn_s, 0.5 * turn_s])
        self._prior = chances / chances.sum()
        self._dt = np.nan
        self._transitions, self._switching = np.zeros((3, 9, 9)), np.eye(3)
        self._id: Ints = np.zeros(0, np.int64)
        self.mean, self.covariance, self.probability = np.zeros((0, 3, 9)), np.zeros((0, 3, 9, 9)), np.zeros((0, 3))

    def predict(self, t: Floats, dt: float, noise: Floats) -> None:
        self._restrict_to(t)
        rows = self._rows(t)
        if dt != self._dt:
            self._dt, self._transitions = dt, np.stack([_turn(rate, dt) for rate in self._rates])
            self._switching = _markov(self._leaving, dt)
        before, F = self.probability[rows], self._transitions
        self.probability[rows] = after = before @ self._switching
        share = before[:, :, None] * self._switching / after[:, None, :]  # (n, from, to)
        x, P = self.mean[rows], self.covariance[rows]
        mixed = share.transpose(0, 2, 1) @ x
        offset = x[:, :, None] - mixed[:, None]  # (n, from, to, 9)
        spread = np.einsum("nft,nfta,nftb->ntab", share, offset, offset)
        P = np.einsum("nft,nfab->ntab", share, P) + spread
        self.mean[rows] = (F @ mixed[..., None])[..., 0]
        self.covariance[rows] = F @ P @ F.transpose(0, 2, 1) + noise[classes_of(t)][:, None]
        t[:, YAW] += dt * (after @ self._rates)
        t[:, MEAN], t[:, COVARIANCE] = self._combined(rows)

    def correct(self, t: Floats, measured: Floats, noise: Floats) -> None:
        observation = np.eye(9)[: measured.shape[1]]
        self._correct(t, measured, np.broadcast_to(observation, (len(t), *observation.shape)), noise)

    def correct_speed(self, t: Floats, direction: Floats, noise: Floats) -> None:
        observation = np.zeros((len(t), 1, 9))
        observation[:, 0, 6:8] = direction
        self._correct(t, np.zeros((len(t), 1)), observation, noise[:, None, None])

    def _correct(self, t: Floats, measured: Floats, observation: Floats, noise: Floats) -> None:
        """Correct every model by measurements z (n, k) = H (n, k, 9) x + noise (n, k, k)."""
        rows = self._rows(t)
        x, P, H = self.mean[rows], self.covariance[rows], observation[:, None]
        cross = P @ H.swapaxes(2, 3)
        total = H @ cross + noise[:, None]
        innovation = measured[:, None, :, None] - H @ x[..., None]
        weighted = np.linalg.solve(total, np.concatenate([innovation, cross.swapaxes(2, 3)], axis=3))
        self.mean[rows] = x + (cross @ weighted[..., :1])[..., 0]
        corrected = P - cross @ weighted[..., 1:]
        self.covariance[rows] = 0.5 * (corrected + corrected.swapaxes(2, 3))
        distance = (innovation.swapaxes(2, 3) @ weighted[..., :1])[..., 0, 0]
        log_density = -0.5 * (distance + np.linalg.slogdet(total).logabsdet)
        probability = self.probability[rows] * np.exp(log_density - log_density.max(axis=1, keepdims=True))
        self.probability[rows] = probability / probability.sum(axis=1, keepdims=True)
        t[:, MEAN], t[:, COVARIANCE] = self._combined(rows)

    def _restrict_to(self, t: Floats) -> None:
        """Forget tracks that are not in the table."""
        kept = np.isin(self._id, t[:, ID].astype(np.int64), assume_unique=True)
        self._keep(kept.nonzero()[0])

    def _rows(self, t: Floats) -> Ints:
        """Rows (n,) of the tracks of a table, whose means and covariances the models take on."""
        ids = t[:, ID].astype(np.int64)
        new = ~np.isin(ids, self._id, assume_unique=True)
        if new.any():
            k = int(new.sum())
            self._id = np.concatenate([self._id, ids[new]])
            self.mean = np.concatenate([self.mean, np.repeat(t[new, None, MEAN], 3, axis=1)])
            self.covariance = np.concatenate([self.covariance, np.repeat(covariances(t)[new, None], 3, axis=1)])
            self.probability = np.concatenate([self.probability, np.tile(self._prior, (k, 1))])
            self._keep(np.argsort(self._id))
        rows = np.searchsorted(self._id, ids)
        mean, covariance = self._combined(rows)
        self.mean[rows] += (t[:, MEAN] - mean)[:, None]
        self.covariance[rows] += (t[:, COVARIANCE] - covariance).reshape(-1, 1, 9, 9)
        return rows

    def _keep(self, rows: Ints) -> None:
        self._id, self.probability = self._id[rows], self.probability[rows]
        self.mean, self.covariance = self.mean[rows], self.covariance[rows]

    def _combined(self, rows: Ints) -> tuple[Floats, Floats]:
        """Means (n, 9) and covariances (n, 81) over all models."""
        weight, x = self.probability[rows], self.mean[rows]
        mean = (weight[:, None] @ x)[:, 0]
        offset = x - mean[:, None]
        within = np.einsum("nm,nmab->nab", weight, self.covariance[rows])
        between = (weight[:, :, None] * offset).swapaxes(1, 2) @ offset
        return mean, (within + between).reshape(-1, 81)


class InteractingModelsTracker3D(KalmanBoxTracker3D):
    """`KalmanBoxTracker3D` for objects that turn: its filter weighs straight motion against turns.

    turn_rate_rad_s: rad/s, turn rate of the two models that turn
    straight_s: s, average time that an object drives straight on
    turn_s: s, average duration of a turn

    Other parameters, and errors, are those of `KalmanBoxTracker3D`.
    """

    def __init__(
        self,
        *,
        turn_rate_rad_s: float = 0.6,
        straight_s: float = 10.0,
        turn_s: float = 3.0,
        **others: Any,
    ) -> None:
        check("more than 0", turn_rate_rad_s=turn_rate_rad_s, straight_s=straight_s, turn_s=turn_s)
        self._motion = turn_rate_rad_s, straight_s, turn_s
        super().__init__(**others)

    def reset(self) -> None:
        self.filter = InteractingModels(*self._motion)
        super().reset()


def _turn(rate: float, dt: float) -> Floats:
    """(9, 9) transition matrix of motion at constant speed and turn rate."""
    F = np.eye(9)
    angle = rate * dt
    sine, cosine = (dt, 0.0) if rate == 0.0 else (np.sin(angle) / rate, (1.0 - np.cos(angle)) / rate)
    F[0:2, 6:8] = [[sine, -cosine], [cosine, sine]]
    F[6:8, 6:8] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    F[2, 8] = dt
    return F


def _markov(leaving: Floats, dt: float) -> Floats:
    """(m, m) probabilities of going from the model of a row to that of a column within dt s."""
    from scipy.linalg import expm  # here, because it takes a tenth of a second

    return np.asarray(expm(leaving * dt))

"""Objects as detections and tracks of Stone Soup.

Only `stone_soup_tracker` imports this module, when such a tracker is built: importing stonesoup takes about a second.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.types.detection import Detection
from stonesoup.types.track import Track

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import CLASSES, COVARIANCE_ORDER, Floats, Ints, ObjectStates
from mast_zenoh.tracking.association import MeasurementBatch

_EPOCH = datetime(1970, 1, 1)
#: (m/s)^2 horizontally and vertically: variances of a velocity that was not measured.
_SPEED_VARIANCE = (100.0, 100.0, 1.0)
#: m/s, speed above which the velocity determines which end of an object is the front.
_FRONT_MPS = 2.0
#: Metadata of a track without any detection, such as one that a user's initiator has invented.
_NO_DETECTION: dict[str, Any] = {
    "step": -1, "row": -1, "class_id": 0, "yaw": 0.0, "state": np.zeros(9), "covariance": np.diag(np.full(9, 100.0)),
}  # fmt: skip


def timestamp(time_ns: int) -> datetime:
    """The time of a message as Stone Soup's timestamp, which has whole microseconds."""
    return _EPOCH + timedelta(microseconds=time_ns // 1000)


class NumberedDetection(Detection):
    """A detection whose hash is its place in the frame: the order of sets depends on it."""

    def __hash__(self) -> int:
        return int(self.metadata["order"])


def detections_of(
    time_ns: int, step: int, measured: MeasurementBatch, score: Floats, state: Sequence[str]
) -> list[Detection]:
    """Stone Soup's detections (m) of measurements, each with its own measurement model.

    step: number of the tracker's step; score: (m,); state: components of the tracker's state vector

    A detection's vector has the measured components that are also in the state, in the order of COVARIANCE_ORDER.
    """
    k = measured.state.shape[1]
    columns = [column for column, name in enumerate(COVARIANCE_ORDER[:k]) if name in state]
    mapping = [list(state).index(COVARIANCE_ORDER[column]) for column in columns]
    models: dict[bytes, LinearGaussian] = {}
    full_state, full_covariance = np.zeros(9), np.diag([0.0] * 6 + list(_SPEED_VARIANCE))
    detections = []
    for order in range(len(measured.row)):
        noise = measured.noise[order][np.ix_(columns, columns)]
        # Stone Soup caches predicted measurements by model.
        model = models.setdefault(
            noise.tobytes(), LinearGaussian(ndim_state=len(state), mapping=mapping, noise_covar=noise)
        )
        full_state[:k], full_covariance[:k, :k] = measured.state[order], measured.noise[order]
        class_id = int(measured.class_id[order])
        metadata = {
            "step": step,
            "order": order,
            "row": int(measured.row[order]),
            "class": CLASSES[class_id],
            "class_id": class_id,
            "size": tuple(measured.state[order, 3:6].tolist()),
            "yaw": float(measured.yaw[order]),
            "score": float(score[order]),
            "state": full_state.copy(),
            "covariance": full_covariance.copy(),
        }
        vector = measured.state[order, columns][:, None]
        detections.append(NumberedDetection(vector, timestamp(time_ns), measurement_model=model, metadata=metadata))
    return detections


def object_states(
    tracks: Sequence[Track], estimates: Sequence[Any], ids: Ints, state: Sequence[str], score: float
) -> ObjectStates:
    """The object states (n) of Stone Soup tracks.

    estimates: (n) their states; ids: (n,); state: components of the state vector; score: of all

    What is not in the state vector is that of the last detection: class, heading, and perhaps sizes or height. The
    heading is turned by half a turn if the object moves backwards.
    """
    n = len(tracks)
    last = [_NO_DETECTION | track.metadata for track in tracks]
    mean = np.array([each["state"] for each in last]).reshape(n, 9)
    covariance = np.array([each["covariance"] for each in last]).reshape(n, 9, 9)
    rows = [row for row, name in enumerate(state) if name in COVARIANCE_ORDER]
    ours = [COVARIANCE_ORDER.index(state[row]) for row in rows]
    covariance[:, ours, :] = 0.0
    covariance[:, :, ours] = 0.0
    for each, estimate in enumerate(estimates):
        mean[each, ours] = np.asarray(estimate.mean, float)[rows, 0]
        covariance[each][np.ix_(ours, ours)] = np.asarray(estimate.covar, float)[np.ix_(rows, rows)]
    yaw = np.array([each["yaw"] for each in last])
    forward = mean[:, 6] * np.cos(yaw) + mean[:, 7] * np.sin(yaw)
    return ObjectStates.of(
        mean[:, :3].copy(),
        id=ids,
        velocity=mean[:, 6:].copy(),
        size=mean[:, 3:6].copy(),
        yaw=wrap_angle(np.where(forward < -_FRONT_MPS, yaw + np.pi, yaw)),
        covariance=0.5 * (covariance + covariance.transpose(0, 2, 1)),
        score=np.full(n, score),
        class_id=np.array([each["class_id"] for each in last], np.uint8),
    )


def matched_rows(tracks: Sequence[Track], step: int) -> Ints:
    """Input row (n,) that updated each track in a step, the most likely one of several; -1: none."""
    last = [_NO_DETECTION | track.metadata for track in tracks]
    return np.array([each["row"] if each["step"] == step else -1 for each in last], np.int64)


@dataclass
class Repeatable:
    """What Stone Soup takes from the process, and must take from the tracker instead, to give the same result again.

    random: state of NumPy's global generator; created: number of tracks created so far
    """

    random: Any
    created: int = 0

    @classmethod
    def seeded(cls, seed: int) -> Repeatable:
        return cls(np.random.RandomState(seed).get_state())

    @contextmanager
    def used(self) -> Iterator[None]:
        """Replace the process's generator and numbering of tracks by these."""
        global _numbering
        numbering, random = _numbering, np.random.get_state()  # noqa: NPY002 (Stone Soup draws from this generator)
        _numbering = self
        np.random.set_state(self.random)  # noqa: NPY002
        try:
            yield
        finally:
            self.random = np.random.get_state()  # noqa: NPY002
            np.random.set_state(random)  # noqa: NPY002
            _numbering = numbering


_numbering = Repeatable.seeded(0)


def _number(track: Track) -> int:
    """Hash of a track: its number in order of creation.

    Stone Soup keeps tracks in sets. Their order would follow the tracks' addresses, which differ between runs.
    """
    number = vars(track).get("_number")
    if number is None:
        number = vars(track)["_number"] = _numbering.created
        _numbering.created += 1
    return int(number)


type.__setattr__(Track, "__hash__", _number)

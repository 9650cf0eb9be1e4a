"""The tracker of AB3DMOT, as a reference for comparisons.

Weng, Wang, Held and Kitani, "3D Multi-Object Tracking: A Baseline and New Evaluation Metrics", IROS 2020
(arXiv 1907.03961), section III, with the constants of the authors' implementation: a Kalman filter with constant
velocity per frame, and the Hungarian method on the overlap of boxes or on the distance of their centres.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import Detections, Floats, Ints
from mast_zenoh.metrics.assignment import Boxes, iou_3d

# State: x y z yaw l w h, and the change of x y z per frame.
TRANSITION = np.eye(10)
TRANSITION[[0, 1, 2], [7, 8, 9]] = 1.0
FIRST_VARIANCE = np.array([10.0] * 7 + [10_000.0] * 3)
PROCESS_NOISE = np.diag([1.0] * 7 + [0.01] * 3)
MEASUREMENT_NOISE = np.eye(7)
FIRST_HITS, MAX_MISSES = 3, 2


@dataclass(frozen=True)
class Matching:
    """How detections are matched with tracks.

    overlap: least intersection over union of the volumes; 0.01 for cars in the authors' configuration for KITTI
    distance_m: instead of that, greatest distance of the centres; 1 to 2 m for pedestrians and cyclists there
    """

    overlap: float = 0.01
    distance_m: float | None = None

    def pairs(self, boxes: Floats, others: Floats) -> tuple[Ints, Ints]:
        """Rows of pairs of boxes (n, 7) and (m, 7): the greatest total overlap, or the least total distance."""
        distance = np.linalg.norm(boxes[:, None, :3] - others[None, :, :3], axis=2)
        if self.distance_m is not None:
            rows, columns = linear_sum_assignment(distance)
            good = distance[rows, columns] <= self.distance_m
            return rows[good], columns[good]
        overlap = overlaps(boxes, others)
        rows, columns = linear_sum_assignment(-overlap)
        good = overlap[rows, columns] >= self.overlap
        return rows[good], columns[good]


class Ab3dmot:
    """Tracks boxes (n, 7): x y z yaw l w h, m and rad."""

    def __init__(self, matching: Matching) -> None:
        self._matching = matching
        self._mean, self._covariance = np.zeros((0, 10)), np.zeros((0, 10, 10))
        self._id, self._hits, self._misses = (np.zeros(0, np.int64) for _ in range(3))
        self._frames = self._next_id = 0

    def step(self, boxes: Floats) -> tuple[Ints, Floats]:
        """The ids (k,) and boxes (k, 7) of the tracks that it reports in the next frame."""
        self._frames += 1
        self._mean = self._mean @ TRANSITION.T
        self._mean[:, 3] = wrap_angle(self._mean[:, 3])
        self._covariance = TRANSITION @ self._covariance @ TRANSITION.T + PROCESS_NOISE
        self._misses = self._misses + 1
        detection, track = self._matching.pairs(boxes, self._mean[:, :7])
        self._correct(track, boxes[detection])
        self._begin(np.delete(boxes, detection, 0))
        alive = self._misses < MAX_MISSES
        reported = alive & ((self._hits >= FIRST_HITS) | (self._frames <= FIRST_HITS))
        result = self._id[reported], self._mean[reported, :7]
        for name in ("_mean", "_covariance", "_id", "_hits", "_misses"):
            setattr(self, name, getattr(self, name)[alive])
        return result

    def _correct(self, track: Ints, boxes: Floats) -> None:
        mean, covariance = self._mean[track], self._covariance[track]
        difference = boxes - mean[:, :7]
        turn = wrap_angle(difference[:, 3])
        difference[:, 3] = np.where(np.abs(turn) > np.pi / 2, wrap_angle(turn + np.pi), turn)
        mean[:, 3] = boxes[:, 3] - difference[:, 3]  # a track with the opposite heading is turned round
        gain = covariance[:, :, :7] @ np.linalg.inv(covariance[:, :7, :7] + MEASUREMENT_NOISE)
        mean += (gain @ difference[:, :, None])[:, :, 0]
        mean[:, 3] = wrap_angle(mean[:, 3])
        self._mean[track], self._covariance[track] = mean, covariance - gain @ covariance[:, :7]
        self._hits[track] += 1
        self._misses[track] = 0

    def _begin(self, boxes: Floats) -> None:
        n = len(boxes)
        self._mean = np.concatenate([self._mean, np.hstack([boxes, np.zeros((n, 3))])])
        self._covariance = np.concatenate([self._covariance, np.tile(np.diag(FIRST_VARIANCE), (n, 1, 1))])
        self._id = np.concatenate([self._id, np.arange(self._next_id, self._next_id + n)])
        self._hits = np.concatenate([self._hits, np.ones(n, np.int64)])
        self._misses = np.concatenate([self._misses, np.zeros(n, np.int64)])
        self._next_id += n


def overlaps(boxes: Floats, others: Floats) -> Floats:
    """Intersection over union (n, m) of the volumes of boxes (n, 7) and (m, 7)."""
    distance = np.linalg.norm(boxes[:, None, :2] - others[None, :, :2], axis=2)
    reach = np.linalg.norm(boxes[:, 4:6], axis=1)[:, None] + np.linalg.norm(others[:, 4:6], axis=1)
    result = np.zeros(distance.shape)
    i, j = (distance < reach / 2).nonzero()
    result[i, j] = iou_3d(_as_boxes(boxes[i]), _as_boxes(others[j]))
    return result


def _as_boxes(boxes: Floats) -> Boxes:
    none = np.zeros(len(boxes), np.int64)
    return Boxes(none, none, boxes[:, :3], boxes[:, 4:7], boxes[:, 3])


def merged(detections: list[Detections], same: Matching, least_score: float = 0.0) -> Floats:
    """The boxes (n, 7) of the detections of several cars, world frame, without those that a better one suppresses.

    same: when two boxes are of one object (non-maximum suppression, as in late fusion of two cars' detections);
    least_score: of the detections that are used
    """
    boxes = np.concatenate([np.column_stack([d.position, d.yaw, d.size]) for d in detections])
    score = np.concatenate([d.score for d in detections])
    order = np.lexsort((boxes[:, 0], -score))
    boxes = boxes[order[score[order] >= least_score]]
    if same.distance_m is None:
        same_object = overlaps(boxes, boxes) >= same.overlap
    else:
        same_object = np.linalg.norm(boxes[:, None, :2] - boxes[None, :, :2], axis=2) <= same.distance_m
    kept = np.ones(len(boxes), bool)
    for row in range(len(boxes)):
        if kept[row]:
            kept[row + 1 :] &= ~same_object[row, row + 1 :]
    return boxes[kept]

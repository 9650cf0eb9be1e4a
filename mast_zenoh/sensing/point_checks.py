"""Checks of detections against the points that they come from: what a spoofed object cannot show.

A check gets nothing but the points and the detections of one lidar, scan by scan, in the frame of
`PointDetector.detect`. It knows neither the truth nor its own motion.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import angles_of, wrap_angle
from mast_zenoh.arrays.matching import greedy_matching
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Detections, Floats
from mast_zenoh.sensing.point_detector import PointDetector
from mast_zenoh.sensing.points import Points
from mast_zenoh.sensing.sectors import chords

#: Classes whose bodies let no light through, and the shares of their height between which that is certain.
_SOLID = [CLASS_INDEX[name] for name in ("car", "truck", "bus")]
_BODY = (0.30, 0.50)
#: Share of the length and width of a box that a body certainly fills; m that it is smaller still, for errors of boxes.
_FILLED, _BOX_ERROR_M = 0.8, 0.2
#: m behind a box from which a return is certainly not its own.
_BEHIND_M = 0.5
#: Least number of beams that say anything.
_FEW = 5


class PointCheck(ABC):
    """Base class of checks. A check may remember earlier scans: each lidar has its own.

    least: 0 to 1, plausibility below which a detection is refused
    """

    def __init__(self, least: float) -> None:
        check("0 to 1", least=least)
        self.least = least

    @abstractmethod
    def check(self, points: Points, detections: Detections) -> Floats:
        """(n,) plausibility, 0 to 1, of the detections of one scan; called once for each scan, in order."""

    def keep(self, points: Points, detections: Detections) -> Bools:
        """(n,) whether the detections are plausible enough. Counts as a call of `check`."""
        return self.check(points, detections) >= self.least


class OcclusionCheck(PointCheck):
    """Refuses vehicles through which beams pass: no light gets through a body of steel.

    Plausibility is the share of the beams into the middle of a box's body that end at it or in it: laser penetration
    detection of CARLO (Sun et al., USENIX Security 2020, section 6.1), whose attacks it reduces from 80 to 5.5 %. 1 for
    other classes, and for boxes that fewer than 5 beams meet.

    least: 0 to 1, share below which a vehicle is refused; 0.8 refuses under 3 % of true cars around one lidar 1.8 m
           high, on junctions 3 % at the ego, and at poles 3.5 % of cars and 6 % of trucks (docs/explanation-points.md)
    """

    def __init__(self, *, least: float = 0.8) -> None:
        super().__init__(least)

    def check(self, points: Points, detections: Detections) -> Floats:
        return 1.0 - penetration(points, detections)


def penetration(points: Points, detections: Detections) -> Floats:
    """(n,) share of the beams into the body of a vehicle that return from behind it; 0: none, or too few."""
    shares = np.zeros(len(detections))
    solid = np.flatnonzero(np.isin(detections.class_id, _SOLID))
    if not len(solid) or not len(points):
        return shares
    low, high = (detections.position[solid, 2] + (share - 0.5) * detections.size[solid, 2] for share in _BODY)
    size = np.column_stack([np.maximum(detections.size[solid, :2] * _FILLED - _BOX_ERROR_M, 0.2), high - low])
    middle = np.column_stack([detections.position[solid, :2], (low + high) / 2])
    yaw, range_m = detections.yaw[solid], points.range_m().astype(np.float64)
    bearing, azimuth = np.arctan2(points.position[:, 1], points.position[:, 0]), angles_of(middle)[0]
    for k, row in enumerate(solid):
        aside = np.hypot(*size[k, :2]) / 2 / max(float(np.hypot(*middle[k, :2])), 0.1)
        near = np.flatnonzero(np.abs(wrap_angle(bearing - azimuth[k])) <= 1.6 * aside)
        beam = points.position[near] / np.maximum(range_m[near, None], 1e-9)
        boxes = middle[k, None], size[k, None], yaw[k, None]
        enter, leave = (each[:, 0] for each in chords(beam, *boxes))
        surface_m = float(np.hypot(*(detections.size[row, :2] - size[k, :2]))) + _BOX_ERROR_M  # at most before the body
        reached = (enter <= leave) & (enter > 0.0) & (range_m[near] > enter - surface_m)
        if np.count_nonzero(reached) >= _FEW:
            shares[row] = np.mean(range_m[near][reached] > leave[reached] + _BEHIND_M)
    return shares


class ShadowCheck(PointCheck):
    """Refuses objects in whose shadow there are points: a real one hides the ground behind it.

    The shadow is what lies on the ground of the box and behind it, in the inner part of its angle, below the line over
    its body. Each point in it counts by how deep it lies: near the object and its middle line most
    (weights of Shadow-Catcher, Hau et al., ESORICS 2021, section 5.2). Plausibility is the share of the object's own
    points among these and its own. Theirs is over 94 % accurate.

    least: 0 to 1, share below which an object is refused; 0.85 refuses under 1 % of true cars around one lidar 1.8 m
           high, but on junctions 3 % at the ego, and at poles 16 % of cars, 91 % of bicycles, 44 % of trucks and 17 %
           of pedestrians (docs/explanation-points.md)
    length_m: m, of the shadow that is looked at
    """

    #: Share of the angle of a box that counts, and of its height.
    inner: ClassVar[float] = 0.6
    body: ClassVar[float] = 0.5

    def __init__(self, *, least: float = 0.85, length_m: float = 20.0) -> None:
        super().__init__(least)
        check("more than 0, finite", length_m=length_m)
        self._length_m = length_m

    def check(self, points: Points, detections: Detections) -> Floats:
        plausible = np.ones(len(detections))
        position = points.position.astype(np.float64)
        flat, bearing = np.hypot(position[:, 0], position[:, 1]), angles_of(position)[0]
        slope = position[:, 2] / np.maximum(flat, 1e-9)
        for row in range(len(detections)):
            middle, size = detections.position[row], detections.size[row]
            turned = detections.yaw[row] - np.arctan2(middle[1], middle[0])
            across = np.abs(np.sin(turned)) * size[0] + np.abs(np.cos(turned)) * size[1]
            deep = np.abs(np.cos(turned)) * size[0] + np.abs(np.sin(turned)) * size[1]
            away = float(np.hypot(*middle[:2]))
            near, far = max(away - deep / 2, 0.1), away + deep / 2
            aside = np.abs(wrap_angle(bearing - np.arctan2(middle[1], middle[0]))) / np.arctan2(across / 2, away)
            bottom = middle[2] - size[2] / 2
            top, low = (bottom + self.body * size[2]) / far, (bottom + 0.3 * size[2]) / near
            within = (aside <= self.inner) & (slope <= max(top, low)) & (slope >= min(top, low))
            raised = position[:, 2] > bottom + 0.2 * size[2]
            own = within & raised & (flat > near - 0.5) & (flat <= far + _BEHIND_M)
            shadow = within & ~own & (flat > near) & (flat <= far + self._length_m)
            weight = np.exp(-np.maximum(flat[shadow] - far, 0.0) / self._length_m - aside[shadow])
            if np.count_nonzero(own | shadow) >= _FEW:
                plausible[row] = np.count_nonzero(own) / (np.count_nonzero(own) + weight.sum())
        return plausible


class TemporalCheck(PointCheck):
    """Refuses vehicles that appear where the scan before saw free space.

    A detection that continues an earlier one, moved on with its velocity, is as plausible as that. A new one is
    plausible unless beams of the scan before went through its body: no vehicle enters the middle of a free street
    within a tenth of a second. It stays implausible for `forgive` scans. Source: 3D-TC2 (You et al., 2021), which
    predicts detections from earlier ones: over 98 % of attacks, recall of real objects 91 %.

    least:   0 to 1; a new vehicle is refused if a share above 1 - least of the beams went through its body
    gate_m:  m, from the predicted position within which a detection continues an earlier one
    fastest_m: m, that an object without a known velocity may move from one scan to the next
    memory:  scans for which an object that is not detected is remembered
    forgive: scans after which an object that appeared in free space is plausible
    """

    def __init__(
        self, *, least: float = 0.5, gate_m: float = 1.5, fastest_m: float = 4.0, memory: int = 5, forgive: int = 50
    ) -> None:
        super().__init__(least)
        check("more than 0, finite", gate_m=gate_m, fastest_m=fastest_m)
        check("1 or more", memory=memory, forgive=forgive)
        self._gate_m, self._fastest_m, self._memory, self._forgive = gate_m, fastest_m, memory, forgive
        #: (k, 7): x, y m, step x, y m per scan (NaN: unknown), plausibility, scans since detected, scans in all
        self._tracks = np.zeros((0, 7))
        self._before: Points | None = None

    def check(self, points: Points, detections: Detections) -> Floats:
        tracks, before, self._before = self._tracks, self._before, points
        plausible = np.ones(len(detections))
        moved = tracks[:, :2] + np.nan_to_num(tracks[:, 2:4]) * (1.0 + tracks[:, 5:6])
        gate = np.where(np.isnan(tracks[:, 2]), self._fastest_m, self._gate_m) * (1.0 + 0.5 * tracks[:, 5])
        apart = np.linalg.norm(detections.position[:, None, :2] - moved[None], axis=2)
        row, track = np.nonzero(apart <= gate)
        pairs = greedy_matching(row, track, apart[row, track])
        rows = np.full(len(detections), -1)
        rows[row[pairs]] = track[pairs]
        new = rows < 0
        if before is not None:
            plausible[new] = 1.0 - penetration(before, detections.select(new))
        old = tracks[rows[~new]]
        plausible[~new] = np.where(old[:, 6] >= self._forgive, 1.0, old[:, 4])
        unknown, none = np.full((len(detections), 2), np.nan), np.zeros((len(detections), 2))
        current = np.column_stack([detections.position[:, :2], unknown, plausible, none])
        step = (current[~new, :2] - old[:, :2]) / (1.0 + old[:, 5:6])
        current[~new, 2:4] = np.where(np.isnan(old[:, 2:4]), step, 0.5 * old[:, 2:4] + 0.5 * step)
        current[~new, 6] = old[:, 6] + 1
        lost = np.setdiff1d(np.arange(len(tracks)), rows)
        left = tracks[lost] + np.array([0, 0, 0, 0, 0, 1, 0])
        self._tracks = np.concatenate([current, left[left[:, 5] <= self._memory]])
        return plausible


class CheckedDetector(PointDetector):
    """A detector of points, without the detections that a check refuses.

    detector: finds the objects;  checks: each judges all of them
    """

    def __init__(self, *, detector: PointDetector, checks: tuple[PointCheck, ...]) -> None:
        self._detector, self._checks = detector, checks

    def detect(self, points: Points) -> Detections:
        detections = self._detector.detect(points)
        kept = np.ones(len(detections), bool)
        for each in self._checks:
            kept &= each.keep(points, detections)
        return detections.select(kept)

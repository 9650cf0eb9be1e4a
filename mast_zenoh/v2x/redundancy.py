"""Redundancy rules: leave out objects that other stations have reported lately (ETSI TR 103 562 v2.1.1).

TS 103 324 v2.1.1 has them as the value of information (annex E). Defaults are those of an implementation of
TR 103 562 for Artery.

An attacker can use these rules: reports near an object silence honest stations that see it. `DynamicsRedundancy` needs
a report that agrees with what the station sees, so that silence costs little; for the others any report will do.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.matching import neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, row_order


@dataclass(frozen=True, slots=True, eq=False)
class HeardObjects:
    """k objects in messages received from other stations, world frame.

    time_ns:  (k,) int64, ns, of the state
    position: (k, 3) m; velocity: (k, 3) m/s
    sender_position: (k, 3) m, where the station was that reported the object
    """

    time_ns: Ints
    position: Floats
    velocity: Floats
    sender_position: Floats

    def __len__(self) -> int:
        return len(self.time_ns)

    @classmethod
    def empty(cls) -> HeardObjects:
        """Nothing heard."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)))

    def select(self, rows: Ints | Bools) -> HeardObjects:
        """Some of the rows."""
        return HeardObjects(self.time_ns[rows], self.position[rows], self.velocity[rows], self.sender_position[rows])


@dataclass(kw_only=True, eq=False)
class RedundancyRule(ABC):
    """Finds objects that need not be sent, because others have reported them.

    A report is about the nearest own object within `gate_m` of where its object would be by now at constant velocity.

    window_s: s, age up to which reports count (W_Redundancy)
    gate_m: m, greatest distance between a report and the own object that it is about
    """

    window_s: float = 1.0
    gate_m: float = 2.0

    def __post_init__(self) -> None:
        check("more than 0, finite", window_s=self.window_s, gate_m=self.gate_m)

    def redundant(self, time_ns: int, own: ObjectStates, origin: Floats, heard: HeardObjects) -> Bools:
        """(n,) which objects to leave out.

        time_ns: ns, now; own: n objects, world frame; origin: (3,) m, position of this station; heard: k reports
        """
        age_ns = time_ns - heard.time_ns
        recent = heard.select((age_ns >= 0) & (age_ns <= round(self.window_s * 1e9)))
        if len(own) == 0 or len(recent) == 0:
            return np.zeros(len(own), bool)
        elapsed = (time_ns - recent.time_ns) / 1e9
        predicted = recent.position + recent.velocity * elapsed[:, None]
        report, row = _nearest_own(predicted, own, self.gate_m)
        return self.left_out(own, row, origin, recent.select(report), predicted[report])

    @abstractmethod
    def left_out(self, own: ObjectStates, row: Ints, origin: Floats, reports: HeardObjects, predicted: Floats) -> Bools:
        """(n,) which objects to leave out.

        row: (p,) the own object that each of p reports is about; predicted: (p, 3) m, where its object would be now
        """


def _nearest_own(predicted: Floats, own: ObjectStates, gate_m: float) -> tuple[Ints, Ints]:
    """Pairs of a report and the nearest own object within a gate: two (p,) arrays of rows; ties by id.

    predicted: (k, 3) m
    """
    report, row, dx, dy = neighbours(predicted, own.position, np.full(len(predicted), gate_m))
    order = row_order(own.id[row], dx * dx + dy * dy, report)
    report, row = report[order], row[order]
    first = np.diff(report, prepend=-1) > 0
    return report[first], row[first]


@dataclass(kw_only=True, eq=False)
class FrequencyRedundancy(RedundancyRule):
    """Leaves out objects that others have reported often (TR 103 562, frequency-based).

    reports: number of reports within the window; with more, the object is left out (N_Redundancy)
    """

    reports: int = 5

    def __post_init__(self) -> None:
        super().__post_init__()
        check("0 or more", reports=self.reports)

    def left_out(self, own: ObjectStates, row: Ints, origin: Floats, reports: HeardObjects, predicted: Floats) -> Bools:
        return np.asarray(np.bincount(row, minlength=len(own)) > self.reports)


@dataclass(kw_only=True, eq=False)
class DynamicsRedundancy(RedundancyRule):
    """Leaves out objects whose newest report is still right (TR 103 562, dynamics-based).

    The newest report is as it was sent, not predicted. Of reports of one time, any that is right will do.

    distance_m: m, how far the object may have moved since (P_Redundancy)
    speed_mps: m/s, by how much its speed may have changed (S_Redundancy)
    """

    distance_m: float = 4.0
    speed_mps: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        check("0 or more, finite", distance_m=self.distance_m, speed_mps=self.speed_mps)

    def left_out(self, own: ObjectStates, row: Ints, origin: Floats, reports: HeardObjects, predicted: Floats) -> Bools:
        newest = np.full(len(own), np.iinfo(np.int64).min)
        np.maximum.at(newest, row, reports.time_ns)
        moved = np.linalg.norm(own.position[row] - reports.position, axis=1)
        speeds = (np.linalg.norm(velocity, axis=1) for velocity in (own.velocity[row], reports.velocity))
        right = (moved <= self.distance_m) & (np.abs(np.subtract(*speeds)) <= self.speed_mps)
        redundant = np.zeros(len(own), bool)
        redundant[row[right & (reports.time_ns == newest[row])]] = True
        return redundant


@dataclass(kw_only=True, eq=False)
class DistanceRedundancy(RedundancyRule):
    """Leaves out objects that a station near this one has reported (TR 103 562, distance-based).

    distance_m: m, up to which the other station is near (R_Redundancy)
    """

    distance_m: float = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check("0 or more, finite", distance_m=self.distance_m)

    def left_out(self, own: ObjectStates, row: Ints, origin: Floats, reports: HeardObjects, predicted: Floats) -> Bools:
        near = np.linalg.norm(reports.sender_position - origin, axis=1) <= self.distance_m
        return np.asarray(np.bincount(row[near], minlength=len(own)) > 0)


@dataclass(kw_only=True, eq=False)
class SelfAnnouncementRedundancy(RedundancyRule):
    """Leaves out objects that say themselves where they are, by CAMs (TR 103 562, self-announcement).

    A report whose object is at the position of its sender is such an announcement.
    """

    def left_out(self, own: ObjectStates, row: Ints, origin: Floats, reports: HeardObjects, predicted: Floats) -> Bools:
        itself = (reports.sender_position == reports.position).all(axis=1)
        return np.asarray(np.bincount(row[itself], minlength=len(own)) > 0)

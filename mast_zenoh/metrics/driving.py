"""Consequences of estimates for driving: corridor objects, times to collision, braking.

Open loop: the corridor is along the path that the vehicle drove in the scene. Pure;
docs/explanation-metrics-and-causes.md.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.arrays.boxes import overlapping
from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import distance_along
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.metrics.assignment import find
from mast_zenoh.metrics.causes import ATTACK_CAUSES, CauseLabels
from mast_zenoh.metrics.estimates import LOCAL, MISSION
from mast_zenoh.metrics.record import Record, Series, TruthTable
from mast_zenoh.metrics.scores import FALSE, MISSED, Scores, Table

#: m/s; a slower vehicle counts as stationary and need not brake.
STANDING_MPS = 0.3


def time_to_collision(gap_m: Floats, speed_mps: Floats, ahead_mps: Floats) -> Floats:
    """Time (n,) s until gaps close at constant speeds; inf if they do not."""
    closing = speed_mps - ahead_mps
    return np.where(closing > 1e-9, gap_m / np.maximum(closing, 1e-9), np.inf)


class BrakingRule(ABC):
    """Base class of braking rules."""

    @abstractmethod
    def brakes(self, gap_m: Floats, speed_mps: Floats, ahead_mps: Floats) -> Bools:
        """(n,) bool, whether to brake for each of n objects.

        gap_m:     (n,) m along the path, from the vehicle's front to the object, 0 or more
        speed_mps: (n,) m/s, of the vehicle along its path, 0 or more
        ahead_mps: (n,) m/s, of the object along the vehicle's path; negative: it approaches
        """


class SafeDistance(BrakingRule):
    """Brake below the minimum safe longitudinal distance.

    The distance is defined by Responsibility-Sensitive Safety.

    Source: Shalev-Shwartz, Shammah and Shashua, On a Formal Model of Safe and Scalable Self-driving Cars (2017),
    Definition 1: the vehicle accelerates for its response time, then brakes with at least its minimum deceleration; the
    object ahead brakes with its maximum deceleration. Approaching objects count as stationary.

    response_s: s, response time;  acceleration: m/s², maximum during the response time
    braking:    m/s², minimum of the vehicle after it;  braking_ahead: m/s², maximum of the object ahead
    """

    def __init__(
        self,
        *,
        response_s: float = 0.5,
        acceleration: float = 2.0,
        braking: float = 4.0,
        braking_ahead: float = 8.0,
    ) -> None:
        check("0 or more, finite", response_s=response_s, acceleration=acceleration)
        check("more than 0, finite", braking=braking, braking_ahead=braking_ahead)
        self.response_s, self.acceleration = response_s, acceleration
        self.braking, self.braking_ahead = braking, braking_ahead

    def distance_m(self, speed_mps: Floats, ahead_mps: Floats) -> Floats:
        """The minimum safe distance (n,) m at speeds (n,) m/s, as of `brakes`."""
        response, final_speed = self.response_s, speed_mps + self.response_s * self.acceleration
        own_m = speed_mps * response + self.acceleration * response**2 / 2.0 + final_speed**2 / (2.0 * self.braking)
        ahead_m = np.maximum(ahead_mps, 0.0) ** 2 / (2.0 * self.braking_ahead)
        return np.asarray(np.maximum(own_m - ahead_m, 0.0))

    def brakes(self, gap_m: Floats, speed_mps: Floats, ahead_mps: Floats) -> Bools:
        return np.asarray((speed_mps > STANDING_MPS) & (gap_m < self.distance_m(speed_mps, ahead_mps)))


class TimeToCollision(BrakingRule):
    """Brake when the time to collision at constant speeds is below a threshold.

    Sources: Hayward, Near-miss determination through use of a scale of danger (Highway Research Record 384, 1972); the
    threshold is from van der Horst, A time-based analysis of road user behaviour in normal and critical encounters
    (TU Delft, 1990), below which an encounter is critical.

    threshold_s: s, below which it brakes
    """

    def __init__(self, *, threshold_s: float = 1.5) -> None:
        check("more than 0, finite", threshold_s=threshold_s)
        self.threshold_s = threshold_s

    def brakes(self, gap_m: Floats, speed_mps: Floats, ahead_mps: Floats) -> Bools:
        moving = speed_mps > STANDING_MPS
        return np.asarray(moving & (time_to_collision(gap_m, speed_mps, ahead_mps) < self.threshold_s))


#: m, spacing of points of the path; and maximum distance of the centre of an object that may reach into the corridor.
_STEP_M, _REACH_M = 1.0, 8.0
#: m, in the bird's-eye view; an object centred within this distance of the vehicle is the vehicle itself.
_SELF_M = 2.0


class VehicleCourse(NamedTuple):
    """A vehicle in f frames.

    position (f, 3) m, velocity (f, 3) m/s, world frame; heading (f,) rad; length, width m
    """

    position: Floats
    velocity: Floats
    heading: Floats
    length: float
    width: float


class RoadUsers(NamedTuple):
    """n objects.

    frame (n,) int64, row of the vehicle's frames; position, velocity and size (n, 3); yaw (n,) rad
    """

    frame: Ints
    position: Floats
    velocity: Floats
    size: Floats
    yaw: Floats

    def select(self, rows: Bools, later: int = 0) -> RoadUsers:
        """The rows selected by a mask, with the numbers of their frames increased."""
        return RoadUsers(self.frame[rows] + later, *(column[rows] for column in self[1:]))


class Ahead(NamedTuple):
    """k objects in the corridor of a vehicle.

    row: (k,) of the objects;  gap_m: (k,) m, along the path from the vehicle's front
    ttc_s: (k,) s, time to collision at constant speeds, inf: never;  brake: (k,) whether the vehicle has to brake
    overlapping: (j,) rows of the objects that overlap the vehicle and are not among these
    speed_mps: (k,) m/s, of the object along the path
    """

    row: Ints
    gap_m: Floats
    ttc_s: Floats
    brake: Bools
    overlapping: Ints
    speed_mps: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Driving:
    """Settings of the driving analysis.

    rule:      braking rule; None: SafeDistance()
    horizon_m: m, length of the corridor ahead
    margin_m:  m, margin of the corridor on either side of the vehicle
    Raises ValueError for an invalid horizon or margin.
    """

    rule: BrakingRule | None = None
    horizon_m: float = 60.0
    margin_m: float = 0.3

    def __post_init__(self) -> None:
        check("more than 0, finite", horizon_m=self.horizon_m)
        check("0 or more, finite", margin_m=self.margin_m)

    def ahead(self, vehicle: VehicleCourse, objects: RoadUsers) -> Ahead:
        """The objects in the corridor, and the objects that overlap the vehicle itself.

        The corridor follows the path that the vehicle drove after each frame, and continues straight beyond its end.
        Overlapping objects are left out: they are the vehicle itself, or a collision that has already happened.
        """
        path, heading, along = _path(vehicle, self.horizon_m)
        driven = distance_along(vehicle.position)
        row, point = _near_path(objects, path, along, driven)
        frame = objects.frame[row]
        c, s = np.cos(heading[point]), np.sin(heading[point])
        offset = objects.position[row, :2] - path[point]
        longitudinal, lateral = c * offset[:, 0] + s * offset[:, 1], c * offset[:, 1] - s * offset[:, 0]
        turn = objects.yaw[row] - heading[point]
        half_length, half_width = objects.size[row, 0] / 2.0, objects.size[row, 1] / 2.0
        half_extent_along = half_length * np.abs(np.cos(turn)) + half_width * np.abs(np.sin(turn))
        half_extent_across = half_length * np.abs(np.sin(turn)) + half_width * np.abs(np.cos(turn))
        centre = along[point] + longitudinal - driven[frame]
        gap = centre - half_extent_along - vehicle.length / 2.0
        overlaps = _overlaps(vehicle, objects, row)
        inside = np.abs(lateral) - half_extent_across <= vehicle.width / 2.0 + self.margin_m
        inside &= (centre > 0.0) & (gap <= self.horizon_m) & ~overlaps
        rows = inside.nonzero()[0]
        overlapping, row, gap = row[overlaps], row[rows], np.maximum(gap[rows], 0.0)
        speed = np.hypot(*vehicle.velocity[objects.frame[row], :2].T)
        ahead_speed = c[rows] * objects.velocity[row, 0] + s[rows] * objects.velocity[row, 1]
        rule = self.rule or SafeDistance()
        ttc, brake = time_to_collision(gap, speed, ahead_speed), rule.brakes(gap, speed, ahead_speed)
        return Ahead(row, gap, ttc, brake, overlapping, ahead_speed)


def _overlaps(vehicle: VehicleCourse, objects: RoadUsers, row: Ints) -> Bools:
    """Whether each of k objects (k,) overlaps the vehicle or is centred on it."""
    frame = objects.frame[row]
    offset = objects.position[row, :2] - vehicle.position[frame, :2]
    own = np.broadcast_to([vehicle.length, vehicle.width], offset.shape)
    overlaps = overlapping(offset, own, vehicle.heading[frame], objects.size[row], objects.yaw[row])
    return np.asarray(overlaps | (np.hypot(offset[:, 0], offset[:, 1]) <= _SELF_M))


def _near_path(objects: RoadUsers, path: Floats, along: Floats, driven: Floats) -> tuple[Ints, Ints]:
    """Rows of the objects near the path, and the nearest path point of each.

    The points are ahead of the vehicle.
    along: (k,) m, arc lengths of the points;  driven: (f,) m, arc length of the vehicle in each frame
    """
    least = along.searchsorted(driven[objects.frame] - _STEP_M)
    point = nearest_points(np.ascontiguousarray(objects.position), path, least, _REACH_M)
    row = (point >= 0).nonzero()[0]
    return row, point[row]


@kernel
def nearest_points(position: Floats, path: Floats, least: Ints, reach_m: float) -> Ints:
    """Nearest point (n,) of a path to each position within `reach_m` of it, the first of several; -1: none.

    position: (n, >= 2) m; path: (k, 2) m; least: (n,) the first point that counts, k: none
    """
    nearest = np.full(len(position), -1)
    for row, (place, first) in enumerate(zip(position[:, :2], least.tolist(), strict=True)):
        offset = place - path[first:]
        squared = offset[:, 0] * offset[:, 0] + offset[:, 1] * offset[:, 1]
        if len(squared) and squared.min() <= reach_m * reach_m:
            nearest[row] = first + squared.argmin()
    return nearest


def _path(vehicle: VehicleCourse, horizon_m: float) -> tuple[Floats, Floats, Floats]:
    """Points (k, 2) m along the path, headings (k,) rad and arc lengths (k,) m.

    At equal steps along the whole path and straight on.
    """
    last = vehicle.heading[-1]
    extension = (horizon_m + vehicle.length) * np.array([np.cos(last), np.sin(last)])
    corners = np.concatenate([vehicle.position[:, :2], vehicle.position[-1:, :2] + extension])
    length = np.concatenate([distance_along(vehicle.position), [0.0]])
    length[-1] = length[-2] + np.hypot(*extension)
    moved = np.diff(length, prepend=-1.0) > 1e-9
    along = np.arange(0.0, length[-1], _STEP_M)
    points = np.column_stack([np.interp(along, length[moved], corners[moved, axis]) for axis in (0, 1)])
    tangent = np.gradient(points, axis=0)
    return points, np.arctan2(tangent[:, 1], tangent[:, 0]), along


TRUTH = "truth"
#: The estimates that a vehicle could use for driving.
ESTIMATES = (LOCAL, MISSION)


class Drive(NamedTuple):
    """The behaviour of one vehicle under one estimate in (f,) frames.

    objects, false, missed: (f,) in its corridor: tracks (or truth objects), false tracks, missed truth objects
    overlapping:  (f,) tracks (or truth objects) that overlap the vehicle itself and are ignored
    gap_m, ttc_s: (f,) least values over all objects; inf without objects
    brake:        (f,) bool
    needless, omitted: (f,) bool, braking without a reason in the truth, or the reverse
    attacked:     (f,) bool, the needless or omitted braking is due to an attack
    """

    objects: Ints
    false: Ints
    missed: Ints
    overlapping: Ints
    gap_m: Floats
    ttc_s: Floats
    brake: Bools
    needless: Bools
    omitted: Bools
    attacked: Bools


def drives(driving: Driving, record: Record, scores: Scores, labels: CauseLabels) -> dict[tuple[str, str], Drive]:
    """The behaviour of each vehicle among the agents, by (agent, estimate).

    "truth" is one of the estimates.
    """
    result: dict[tuple[str, str], Drive] = {}
    for agent, vehicle, real, every_id in vehicles(record.agents, scores.truth, len(scores.frames)):
        by_truth = driving.ahead(vehicle, real)
        ids = every_id[by_truth.row]
        result[agent, TRUTH] = _drive(by_truth, real, len(scores.frames))
        for estimate in ESTIMATES:
            if Series(agent, estimate) not in record.series():
                continue
            table = record.tracks([Series(agent, estimate)], scores.frames)
            tracks = RoadUsers(
                table.boxes.group, table.boxes.position, table.velocity, table.boxes.size, table.boxes.yaw
            )
            ahead = driving.ahead(vehicle, tracks)
            series = scores.every_series[agent, estimate]
            false = _errors(scores, labels, series, FALSE, tracks.frame[ahead.row], table.boxes.id[ahead.row])
            missed = _errors(scores, labels, series, MISSED, real.frame[by_truth.row], ids)
            drive = _drive(ahead, tracks, len(scores.frames))
            result[agent, estimate] = _compare(
                drive, result[agent, TRUTH], (ahead, tracks, *false), (by_truth, real, *missed)
            )
    return result


def vehicles(
    agents: Sequence[str], truth: TruthTable, n_frames: int
) -> Iterator[tuple[str, VehicleCourse, RoadUsers, Ints]]:
    """Yield each vehicle among the agents: its name, itself, all other objects, and their ids (n,).

    Only agents that are objects of the scene in all frames are vehicles.
    """
    for column, agent in enumerate(agents):
        vehicle = _vehicle(truth, column, n_frames)
        if vehicle is not None:
            others = (truth.boxes.id != truth.agent_object[truth.boxes.group, column]).nonzero()[0]
            boxes = truth.boxes.select(others)
            objects = RoadUsers(boxes.group, boxes.position, truth.velocity[others], boxes.size, boxes.yaw)
            yield agent, vehicle, objects, boxes.id


def _vehicle(truth: TruthTable, agent: int, n_frames: int) -> VehicleCourse | None:
    own = (truth.boxes.id == truth.agent_object[truth.boxes.group, agent]) & (truth.boxes.id >= 0)
    rows = own.nonzero()[0]
    if n_frames == 0 or len(rows) != n_frames:
        return None
    boxes = truth.boxes.select(rows)
    length, width = boxes.size[0, :2].tolist()
    return VehicleCourse(boxes.position, truth.velocity[rows], boxes.yaw, length, width)


def _errors(
    scores: Scores, labels: CauseLabels, series: int, outcome: int, frame: Ints, id_: Ints
) -> tuple[Bools, Bools]:
    """Objects (n,) of a series with this outcome, and which of them are due to an attack."""
    judged = scores.judged
    rows = np.flatnonzero((judged.series == series) & (judged.outcome == outcome))
    at = find((scores.frames[frame], id_), (judged.frame[rows], judged.id[rows]))
    wrong = at >= 0
    cause = np.append(labels.cause[rows], -1)[at]
    return wrong, wrong & (cause >= 0) & (cause < len(ATTACK_CAUSES))


def _drive(ahead: Ahead, objects: RoadUsers, n: int) -> Drive:
    frame = objects.frame[ahead.row]
    gap, ttc = np.full(n, np.inf), np.full(n, np.inf)
    np.minimum.at(gap, frame, ahead.gap_m)
    np.minimum.at(ttc, frame, ahead.ttc_s)
    none, never = np.zeros(n, np.int64), np.zeros(n, bool)
    brake = np.bincount(frame[ahead.brake], minlength=n) > 0
    overlapping = np.bincount(objects.frame[ahead.overlapping], minlength=n)
    return Drive(np.bincount(frame, minlength=n), none, none, overlapping, gap, ttc, brake, never, never, never)


def _compare(
    drive: Drive,
    by_truth: Drive,
    false: tuple[Ahead, RoadUsers, Bools, Bools],
    missed: tuple[Ahead, RoadUsers, Bools, Bools],
) -> Drive:
    """The behaviour under an estimate, compared with that under the truth.

    false, missed: objects ahead in the estimate and in the truth, which of them are errors, and which due to attacks
    """
    n = len(drive.brake)

    def frames(part: tuple[Ahead, RoadUsers, Bools, Bools], mask: Bools) -> Ints:
        return np.bincount(part[1].frame[part[0].row][mask], minlength=n)

    needless, omitted = drive.brake & ~by_truth.brake, by_truth.brake & ~drive.brake
    attacked = needless & (frames(false, false[3] & false[0].brake) > 0)
    attacked |= omitted & (frames(missed, missed[3] & missed[0].brake) > 0)
    return drive._replace(
        false=frames(false, false[2]),
        missed=frames(missed, missed[2]),
        needless=needless,
        omitted=omitted,
        attacked=attacked,
    )


def summary(by_estimate: dict[tuple[str, str], Drive], scored: slice) -> dict[str, dict[str, dict[str, Any]]]:
    """Mean numbers of objects and fractions of frames, by agent and estimate.

    Over the scored frames.

    Keys:
    corridor_objects, corridor_false, corridor_missed: per frame, objects in the corridor, false and missed ones
    overlapping_objects: per frame, objects that overlap the vehicle itself; in no other number
    min_ttc_s: least time to collision of the run; None: no collision course
    brake_share: 0 to 1, frames in which to brake
    needless_brake_share, missed_brake_share: 0 to 1, frames in which this estimate brakes and the truth does not, and
        the reverse
    needless_brake_share_attack, missed_brake_share_attack: 0 to 1, of these, frames in which an attack is among the
        causes
    """
    result: dict[str, dict[str, dict[str, Any]]] = {}
    for (agent, estimate), drive in by_estimate.items():
        part = Drive._make(column[scored] for column in drive)
        if not len(part.brake):
            continue
        min_ttc_s = float(part.ttc_s.min())
        values = {
            "corridor_objects": float(part.objects.mean()),
            "overlapping_objects": float(part.overlapping.mean()),
            "min_ttc_s": min_ttc_s if np.isfinite(min_ttc_s) else None,
            "brake_share": float(part.brake.mean()),
        }
        if estimate != TRUTH:
            values |= {
                "corridor_false": float(part.false.mean()),
                "corridor_missed": float(part.missed.mean()),
                "needless_brake_share": float(part.needless.mean()),
                "missed_brake_share": float(part.omitted.mean()),
                "needless_brake_share_attack": float((part.needless & part.attacked).mean()),
                "missed_brake_share_attack": float((part.omitted & part.attacked).mean()),
            }
        result.setdefault(agent, {})[estimate] = values
    return result


def table(by_estimate: dict[tuple[str, str], Drive], frames: Ints) -> Table:
    """The columns of driving.parquet: a row per agent, estimate and frame.

    Columns:
    frame: number of the frame, from 0
    agent, estimate: whose driving, on `truth`, `local` or `mission`
    objects, false, missed: in the vehicle's corridor: tracks (or true objects), false tracks, missed objects
    overlapping: objects that overlap the vehicle itself; counted nowhere else
    gap_m: along the path to the nearest object ahead
    ttc_s: time to collision; missing without a collision course
    brake, needless, omitted: whether to brake; whether that is needless; whether necessary braking is left out
    attacked: whether an attack caused an object that led to the needless or omitted braking
    """
    keys: Sequence[tuple[str, str]] = list(by_estimate)
    count = len(frames)
    columns: Table = {
        "frame": np.tile(frames, len(keys)),
        "agent": np.repeat(np.array([agent for agent, _ in keys], object), count),
        "estimate": np.repeat(np.array([estimate for _, estimate in keys], object), count),
    }
    for name in Drive._fields:
        parts = [getattr(drive, name) for drive in by_estimate.values()]
        columns[name] = np.concatenate(parts) if parts else np.zeros(0)
    for name in ("gap_m", "ttc_s"):
        columns[name] = np.where(np.isfinite(columns[name]), columns[name], np.nan)
    return columns

"""A driver that simulates several proposals, scores them and carries out the best."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import along_and_across, wrap_angle
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, lowest_rows
from mast_zenoh.driving.driver import BEFORE_LINE_M, Driver, Situation, steering
from mast_zenoh.driving.following import IntelligentDriverModel
from mast_zenoh.driving.motion import Command, uncomfortable

#: Target speeds, as shares of the greatest speed, and offsets to the left, m, of proposals: the first of equals wins.
SPEEDS = (1.0, 0.8, 0.6, 0.4, 0.2)
OFFSETS_M = (0.0, 1.0, -1.0)
#: Steps that are simulated, and s of each.
STEPS, STEP_S = 40, 0.1
HORIZON_S = STEPS * STEP_S
#: s, up to which the car and others go on straight in the check of the time to collision; steps between two checks.
TTC_S, TTC_EVERY = (0.3, 0.6, 0.9), 2
#: Weights of progress, time to collision and comfort in the score.
WEIGHTS = (5.0, 5.0, 2.0)
#: m; no progress is worth less than this.
LEAST_PROGRESS_M = 0.1
#: m/s; a slower car is not to blame for a collision.
AT_REST_MPS = 0.05
#: m, between two points of the lane, the greatest length of it that is looked at, and every which point places objects.
GRID_M, MAX_LANE_M, COARSE = 0.25, 400.0, 4
#: Objects that are looked at: the nearest; and m beside the lane, beyond which they do not matter if they stand.
MAX_OBJECTS, NEAR_LANE_M = 200, 8.0
#: m, in the bird's-eye view; an object centred within this distance of the car is the car itself.
SELF_M = 2.0
#: s, over which rates of change are taken for comfort: nuPlan smooths them over 0.8 to 1.5 s.
SMOOTH_S = 1.0


class Lane(NamedTuple):
    """The lane ahead, in steps of GRID_M, on as far as the car may drive: beyond its end, straight on.

    position: (k, 2) m; heading: (k,) rad, without jumps; curvature: (k,) 1/m
    speed: (k,) m/s, from which the car slows down comfortably for all that is ahead
    """

    position: Floats
    heading: Floats
    curvature: Floats
    speed: Floats

    def row(self, along: Floats) -> Ints:
        """Rows of the points nearest to distances (...) m along the lane."""
        return np.asarray(np.minimum(np.maximum(along / GRID_M + 0.5, 0.0), len(self.speed) - 1).astype(np.int64))


class Trajectories(NamedTuple):
    """p proposals as they are simulated, in t steps, the first of them now.

    along, offset: (p, t) m, along the lane and to the left of it; position: (p, t, 2) m, world frame
    heading: (p, t) rad, world frame; speed: (p, t) m/s; acceleration, curvature: (p, t - 1) m/s^2, 1/m, in each step
    """

    along: Floats
    offset: Floats
    position: Floats
    heading: Floats
    speed: Floats
    acceleration: Floats
    curvature: Floats


class Forecast(NamedTuple):
    """n objects at constant velocity in t steps.

    position: (n, t, 2) m; velocity: (n, 2) m/s; half: (n, 2) m, half length and width; yaw: (n,) rad
    along, offset: (n, t) m, of their centres in the lane; reach: (n, t, 2) m, half extents along the lane and across
    ahead: (n, t) m/s, speed along the lane
    """

    position: Floats
    velocity: Floats
    half: Floats
    yaw: Floats
    along: Floats
    offset: Floats
    reach: Floats
    ahead: Floats


class ProposalDriver(Driver):
    """Simulates 15 ways to drive on, scores them, and carries out the best.

    After PDM-Closed (Dauner, Hallgarten, Geiger and Chitta, Parting with Misconceptions about Learning-based Vehicle
    Motion Planning, CoRL 2023), with its constants. A proposal follows the lane and the car ahead by the intelligent
    driver model, at one of five target speeds, in the middle of the lane or 1 m beside it. It is simulated 4 s on,
    against objects at constant velocity, with the kinematic bicycle model. Proposals that hit something by their own
    fault, or leave what the car may drive on, are out; for the others, progress, time to collision and comfort count 5,
    5 and 2. If all are out, the one that hits something last is taken.

    following:    distances and accelerations; None: those of PDM-Closed
    drivable_m:   m, from the middle of the lane to either edge of what it may drive on: the lane, and half a metre
    margin_m:     m, on either side of the car, in which it follows objects
    preview_s:    s, how far ahead it steers (pure pursuit)
    preview_m:    m, how far ahead it steers at least
    emergency_s:  s; it brakes as hard as it can if its best proposal hits something sooner than this
    emergency_mps: m/s, up to which it does; faster, it brakes as its proposals do
    """

    def __init__(
        self,
        *,
        following: IntelligentDriverModel | None = None,
        drivable_m: float = 2.25,
        margin_m: float = 0.3,
        preview_s: float = 1.0,
        preview_m: float = 4.0,
        emergency_s: float = 2.0,
        emergency_mps: float = 5.0,
    ) -> None:
        check("more than 0, finite", drivable_m=drivable_m, preview_s=preview_s, preview_m=preview_m)
        check("0 or more, finite", margin_m=margin_m, emergency_s=emergency_s, emergency_mps=emergency_mps)
        self.following = following or IntelligentDriverModel(acceleration=1.5, braking=3.0, headway_s=1.5, gap_m=1.0)
        self.drivable_m, self.margin_m = drivable_m, margin_m
        self.preview_s, self.preview_m = preview_s, preview_m
        self.emergency_s, self.emergency_mps = emergency_s, emergency_mps
        self.share, self.offset = (grid.ravel() for grid in np.meshgrid(SPEEDS, OFFSETS_M, indexing="ij"))

    def drive(self, situation: Situation) -> Command:
        lane = self._lane(situation)
        forecast = _forecast(situation, lane)
        proposals = self._simulate(situation, lane, forecast)
        collision = _first_collision(situation, proposals, forecast)
        out = np.isfinite(collision) | self._leaves(situation, proposals)
        score = np.where(out, 0.0, _score(situation, proposals, forecast, out))
        best = int(np.lexsort((np.arange(len(out)), -collision, -score))[0])
        limits, acceleration = situation.limits, float(proposals.acceleration[best, 0])
        if collision[best] <= self.emergency_s and situation.speed <= self.emergency_mps:
            acceleration = -limits.braking
        return limits.nearest(acceleration, steering(situation, self._preview(situation.speed), self.offset[best]))

    def _preview(self, speed: float) -> float:
        return max(self.preview_s * speed, self.preview_m)

    def _lane(self, situation: Situation) -> Lane:
        """The lane ahead."""
        route, braking = situation.route, self.following.braking
        end = float(route.along[-1]) + HORIZON_S * (situation.speed + HORIZON_S * situation.limits.acceleration)
        along = np.arange(0.0, min(end, MAX_LANE_M), GRID_M)
        last = route.position[-1] - route.position[-2]
        beyond = np.maximum(along - route.along[-1], 0.0)[:, None] * last / max(float(np.hypot(*last)), 1e-9)
        position = np.column_stack([np.interp(along, route.along, route.position[:, axis]) for axis in (0, 1)]) + beyond
        step = np.diff(route.position, axis=0)
        middle = 0.5 * (route.along[1:] + route.along[:-1])
        heading = np.interp(along, middle, np.unwrap(np.arctan2(step[:, 1], step[:, 0])))
        squared = np.interp(along, route.along, route.speed) ** 2 + 2.0 * braking * along
        allowed = np.minimum.accumulate(squared[::-1])[::-1] - 2.0 * braking * along
        return Lane(position, heading, np.gradient(heading, GRID_M), np.sqrt(np.maximum(allowed, 0.01)))

    def _simulate(self, situation: Situation, lane: Lane, forecast: Forecast) -> Trajectories:
        """Drive all proposals for HORIZON_S: the kinematic bicycle model in the coordinates of the lane."""
        limits, front = situation.limits, situation.size[0] / 2.0
        count = len(self.share)
        start = along_and_across((situation.position[:2] - lane.position[0])[None], lane.heading[:1])[0]
        along, offset = np.full(count, start[0]), np.full(count, start[1])
        turn = np.full(count, float(wrap_angle(situation.heading - lane.heading[0])))
        speed, row = np.full(count, situation.speed), lane.row(along)
        line = start[0] + front + situation.route.stop_m + self.following.gap_m - BEFORE_LINE_M
        wide = situation.size[1] / 2.0 + self.margin_m
        states, actions = [(along, offset, turn, speed, row)], []
        for step in range(STEPS):
            gap, ahead = _leader(forecast, step, along + front, np.stack([offset, self.offset]), wide)
            near = line - along - front < gap
            gap, ahead = np.where(near, line - along - front, gap), np.where(near, 0.0, ahead)
            acceleration = self.following.free(speed, self.share * lane.speed[row])
            acceleration = acceleration + self.following.interaction(speed, gap, ahead)
            acceleration = np.minimum(np.maximum(acceleration, -limits.braking), limits.acceleration)
            preview = np.maximum(self.preview_s * speed, self.preview_m)
            bend = (
                lane.heading[lane.row(along + 0.5 * preview)] - lane.heading[row]
            )  # to the middle of the arc: its chord
            curvature = 2.0 * (self.offset - offset + preview * (bend - turn)) / preview**2
            curvature = np.minimum(np.maximum(curvature, -limits.curvature), limits.curvature)
            new = np.maximum(speed + acceleration * STEP_S, 0.0)
            way = 0.5 * STEP_S * (speed + new)
            middle = turn + 0.5 * curvature * way
            forward = way * np.cos(middle) / np.maximum(1.0 - lane.curvature[row] * offset, 0.1)
            along, offset, speed = along + forward, offset + way * np.sin(middle), new
            row, before = lane.row(along), lane.heading[row]
            turn = turn + curvature * way - (lane.heading[row] - before)
            states.append((along, offset, turn, speed, row))
            actions.append((acceleration, curvature))
        along, offset, turn, speed, row = (np.stack(column, axis=1) for column in zip(*states, strict=True))
        acceleration, curvature = (np.stack(column, axis=1) for column in zip(*actions, strict=True))
        heading = lane.heading[row]
        c, s, forward = np.cos(heading), np.sin(heading), along - row * GRID_M
        position = lane.position[row] + np.stack([c * forward - s * offset, s * forward + c * offset], axis=-1)
        return Trajectories(along, offset, position, heading + turn, speed, acceleration, curvature)

    def _leaves(self, situation: Situation, proposals: Trajectories) -> Bools:
        """(p,) whether a proposal drives beyond what the car may drive on, farther than the car is now."""
        reach = np.abs(proposals.offset) + situation.size[1] / 2.0
        return np.asarray((reach > np.maximum(self.drivable_m, reach[:, :1]) + 1e-6).any(axis=1))


def _forecast(situation: Situation, lane: Lane) -> Forecast:
    """The objects that matter, without the car itself, at constant velocity."""
    objects = _others(situation, lane)
    velocity = objects.velocity[:, :2]
    position = objects.position[:, None, :2] + (STEP_S * np.arange(STEPS + 1.0))[:, None] * velocity[:, None]
    coarse = lane.position[::COARSE]
    nearest = _squared(position, coarse).argmin(axis=-1) * COARSE
    heading = lane.heading[nearest]
    at = position - lane.position[nearest]
    c, s = np.cos(heading), np.sin(heading)
    turn = objects.yaw[:, None] - heading
    half = objects.size[:, :2] / 2.0
    length, width, ct, st = half[:, :1], half[:, 1:], np.abs(np.cos(turn)), np.abs(np.sin(turn))
    return Forecast(
        position,
        velocity,
        half,
        objects.yaw,
        nearest * GRID_M + c * at[..., 0] + s * at[..., 1],
        c * at[..., 1] - s * at[..., 0],
        np.stack([length * ct + width * st, length * st + width * ct], axis=-1),
        c * velocity[:, None, 0] + s * velocity[:, None, 1],
    )


def _squared(points: Floats, others: Floats) -> Floats:
    """(..., k) m^2, squared distances of points (..., 2) m from others (k, 2) m."""
    x, y = points[..., 0, None] - others[:, 0], points[..., 1, None] - others[:, 1]
    return np.asarray(x * x + y * y)


def _others(situation: Situation, lane: Lane) -> ObjectStates:
    """The objects that the car could meet within the horizon, the nearest MAX_OBJECTS, without itself."""
    objects = situation.objects
    away = objects.position[:, :2] - situation.position[:2]
    radius = 0.5 * np.hypot(objects.size[:, 0], objects.size[:, 1])
    reach = HORIZON_S * np.hypot(objects.velocity[:, 0], objects.velocity[:, 1]) + radius + NEAR_LANE_M
    distance = np.sqrt(_squared(objects.position[:, :2], lane.position[::COARSE]).min(axis=1))
    near = np.flatnonzero((distance <= reach) & (np.hypot(away[:, 0], away[:, 1]) > SELF_M))
    heading = np.full(len(near), situation.heading)
    itself = _overlap(away[near], heading, situation.size / 2.0, objects.yaw[near], objects.size[near, :2] / 2.0)
    near = near[~itself]
    if len(near) > MAX_OBJECTS:
        columns = objects.position, objects.velocity, objects.size, objects.yaw[:, None]
        keys = np.concatenate([(distance - radius)[:, None], *columns], axis=1)[near]
        near = near[lowest_rows(list(keys.T), MAX_OBJECTS)]
    return objects.select(near)


def _leader(forecast: Forecast, step: int, front: Floats, offsets: Floats, wide: float) -> tuple[Floats, Floats]:
    """Gap (p,) m to the nearest object ahead of each proposal in a step, and its speed (p,) m/s; inf, 0: none.

    front: (p,) m, of the cars along the lane; offsets: (2, p) m, where they are and want to be; wide: m, half width
    """
    if not len(forecast.yaw):
        return np.full(len(front), np.inf), np.zeros(len(front))
    centre, across = forecast.along[:, step], forecast.offset[:, step]
    along, side = forecast.reach[:, step].T
    right, left = offsets.min(axis=0)[:, None] - wide, offsets.max(axis=0)[:, None] + wide
    inside = (across + side >= right) & (across - side <= left) & (centre > front[:, None] - wide)
    gap = np.where(inside, np.maximum(centre - along - front[:, None], 0.0), np.inf)
    nearest = gap.argmin(axis=1)
    rows = np.arange(len(front))
    found = gap[rows, nearest]
    return found, np.where(np.isfinite(found), forecast.ahead[nearest, step], 0.0)


def _overlap(offset: Floats, heading: Floats, half: Floats, yaw: Floats, other: Floats) -> Bools:
    """(m,) whether rectangles overlap others, by separating axes.

    offset: (m, 2) m, to the centres of the others; heading, yaw: (m,) rad; half, other: (2,) or (m, 2) m, half sizes
    """
    half, (ox, oy) = np.broadcast_to(half, (len(offset), 2)), other.T
    x, y = along_and_across(offset, heading).T
    c, s = np.cos(yaw - heading), np.sin(yaw - heading)
    ac, sc = np.abs(c), np.abs(s)
    apart = np.abs(x) > half[:, 0] + ox * ac + oy * sc
    apart |= np.abs(y) > half[:, 1] + ox * sc + oy * ac
    apart |= np.abs(c * x + s * y) > ox + half[:, 0] * ac + half[:, 1] * sc
    apart |= np.abs(c * y - s * x) > oy + half[:, 0] * sc + half[:, 1] * ac
    return np.asarray(~apart)


def _hits(situation: Situation, car: tuple[Floats, Floats], forecast: Forecast, position: Floats) -> Bools:
    """(p, t) whether cars at positions (p, t, 2) m with headings (p, t) rad hit an object ahead of their rear.

    car: of these;  position: (n, t, 2) m, of the objects
    """
    place, heading = car
    hit = np.zeros(heading.shape, np.bool_)
    half = situation.size / 2.0
    radius = np.hypot(*half) + np.hypot(forecast.half[:, 0], forecast.half[:, 1])
    offset = position[:, None] - place
    near = offset[..., 0] ** 2 + offset[..., 1] ** 2 <= radius[:, None, None] ** 2
    row, proposal, step = np.nonzero(near)
    offset, turned = offset[row, proposal, step], heading[proposal, step]
    before = np.cos(turned) * offset[:, 0] + np.sin(turned) * offset[:, 1] > -half[0]
    met = before & _overlap(offset, turned, half, forecast.yaw[row], forecast.half[row])
    hit[proposal[met], step[met]] = True
    return hit


def _first_collision(situation: Situation, proposals: Trajectories, forecast: Forecast) -> Floats:
    """(p,) s until each proposal hits something while it drives; inf: it does not."""
    hit = _hits(situation, (proposals.position, proposals.heading), forecast, forecast.position)
    hit &= proposals.speed > AT_REST_MPS
    return np.where(hit.any(axis=1), hit.argmax(axis=1) * STEP_S, np.inf)


def _score(situation: Situation, proposals: Trajectories, forecast: Forecast, out: Bools) -> Floats:
    """(p,) from 0 to 1, of proposals that are not `out` (p,)."""
    progress = proposals.along[:, -1] - proposals.along[:, 0]
    most = float(progress[~out].max(initial=0.0))
    gained = np.clip(progress / most, 0.0, 1.0) if most > LEAST_PROGRESS_M else np.ones(len(progress))
    parts = gained, _safe_time(situation, proposals, forecast), _comfortable(proposals)
    return np.asarray(np.array(WEIGHTS) @ np.stack(parts) / sum(WEIGHTS))


def _safe_time(situation: Situation, proposals: Trajectories, forecast: Forecast) -> Bools:
    """(p,) whether a proposal never comes to within the last of TTC_S of a collision at constant velocities."""
    speed = proposals.speed[:, ::TTC_EVERY]
    heading = proposals.heading[:, ::TTC_EVERY]
    ahead = speed[..., None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    unsafe = np.zeros(len(speed), np.bool_)
    for seconds in TTC_S:
        place = proposals.position[:, ::TTC_EVERY] + seconds * ahead
        others = forecast.position[:, ::TTC_EVERY] + seconds * forecast.velocity[:, None]
        hit = _hits(situation, (place, heading), forecast, others) & (speed > AT_REST_MPS)
        unsafe |= hit.any(axis=1)
    return ~unsafe


def _comfortable(proposals: Trajectories) -> Bools:
    """(p,) whether a proposal stays within nuPlan's bounds of comfort; rates of change are those over SMOOTH_S."""
    span = round(SMOOTH_S / STEP_S)

    def rate(values: Floats) -> Floats:
        return np.asarray((values[:, span:] - values[:, :-span]) / SMOOTH_S)

    speed = proposals.speed[:, :-1]
    turn = proposals.curvature * speed
    along, across = rate(proposals.speed), turn * speed
    along_jerk, across_jerk = rate(along), rate(across)
    values = {
        "braking": along,
        "acceleration": along,
        "lateral_acceleration": across,
        "jerk": np.hypot(along_jerk, across_jerk[:, : along_jerk.shape[1]]),
        "longitudinal_jerk": along_jerk,
        "yaw_rate": turn,
        "yaw_acceleration": rate(turn),
    }
    return np.asarray(~np.any([uncomfortable(name, each).any(axis=1) for name, each in values.items()], axis=0))

"""Ground plan of a generated junction: paths, arms, lanes, crossings, pavements.

Traffic drives on the right. In the frame of an arm, x points away from the centre and y to its left, so that lanes
towards the centre have y > 0. Every lane away from the centre ends in a turning loop, out of sight of the junction, and
returns as the lane towards it: no vehicle leaves the scene, so a recording can have any length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import Floats, Ints

#: m, spacing of the samples of a path.
SPACING = 0.25


@dataclass(frozen=True, eq=False)
class SampledCurve:
    """An evenly sampled curve.

    points:    (k, 2) m
    yaw:       (k,) rad, direction of travel, unwrapped
    curvature: (k,) 1/m, positive to the left
    length:    m
    """

    points: Floats
    yaw: Floats
    curvature: Floats
    length: float

    @classmethod
    def through(cls, points: Floats) -> SampledCurve:
        """The path along a dense polyline (m, 2); consecutive duplicate points are merged."""
        steps = np.hypot(*np.diff(points, axis=0).T)
        keep = np.concatenate([[True], steps > 1e-9])
        points = points[keep]
        distance = np.concatenate([[0.0], np.cumsum(steps[steps > 1e-9])])
        length = float(distance[-1])
        at = np.linspace(0.0, length, max(4, int(np.ceil(length / SPACING)) + 1))
        samples = np.stack([np.interp(at, distance, points[:, 0]), np.interp(at, distance, points[:, 1])], axis=1)
        tangent = np.gradient(samples, at, axis=0)
        yaw = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
        return cls(samples, yaw, np.gradient(yaw, at), length)


def straight(start: Floats, end: Floats) -> Floats:
    """(k, 2) m, from `start` (2,) to `end` (2,)."""
    k = max(2, int(np.hypot(*(end - start)) / 0.25) + 1)
    return start + np.linspace(0.0, 1.0, k)[:, None] * (end - start)


def arc(centre: Floats, radius: float, begin: float, sweep: float) -> Floats:
    """Points (k, 2) m on a circle about `centre` (2,).

    begin: rad; sweep: rad, positive to the left
    """
    angle = begin + np.linspace(0.0, sweep, max(8, int(abs(sweep) * radius / 0.1) + 1))
    return centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def bend(start: Floats, heading: float, end: Floats, end_heading: float) -> Floats:
    """Points (k, 2) m of a smooth turn between two poses with least peak curvature.

    A quintic Hermite curve, straight at both ends; the length of the end tangents is chosen from several.
    """
    t = np.linspace(0.0, 1.0, 161)[:, None]
    start_tangent, end_tangent = (
        np.array([np.cos(heading), np.sin(heading)]),
        np.array([np.cos(end_heading), np.sin(end_heading)]),
    )
    chord = float(np.hypot(*(end - start)))
    best: tuple[float, Floats] | None = None
    for strength in np.linspace(0.9, 2.1, 13) * chord:
        curve = (
            start * (1 - 10 * t**3 + 15 * t**4 - 6 * t**5)
            + end * (10 * t**3 - 15 * t**4 + 6 * t**5)
            + strength * start_tangent * (t - 6 * t**3 + 8 * t**4 - 3 * t**5)
            + strength * end_tangent * (-4 * t**3 + 7 * t**4 - 3 * t**5)
        )
        peak_curvature = float(np.abs(SampledCurve.through(curve).curvature).max())
        if best is None or peak_curvature < best[0]:
            best = peak_curvature, curve
    assert best is not None
    return best[1]


def rounded(corners: Floats, radius: float) -> Floats:
    """Points (k, 2) m of a polyline (m, 2) with inner corners rounded off.

    radius: m, distance from a corner within which it is rounded
    """
    parts = [corners[:1]]
    for before, corner, after in zip(corners[:-2], corners[1:-1], corners[2:], strict=True):
        start = corner + (before - corner) * min(0.49, radius / np.hypot(*(before - corner)))
        end = corner + (after - corner) * min(0.49, radius / np.hypot(*(after - corner)))
        t = np.linspace(0.0, 1.0, 60)[:, None]
        parts += [straight(parts[-1][-1], start), (1 - t) ** 2 * start + 2 * t * (1 - t) * corner + t**2 * end]
    parts.append(straight(parts[-1][-1], corners[-1]))
    return np.concatenate(parts)


def oval(middle: Floats, half_width: float) -> Floats:
    """Points (k, 2) m of a closed loop around the line `middle` (m, 2), keeping right.

    The loop is `half_width` m from the line: out on its right, half a turn to the left, back on its left, half a turn.
    The seam is on the way out, where the line is nearly straight, so that the direction is continuous.
    """
    path = SampledCurve.through(middle)
    normal = np.stack([-np.sin(path.yaw), np.cos(path.yaw)], axis=1) * half_width
    right, left = path.points - normal, (path.points + normal)[::-1]
    far = arc(path.points[-1], half_width, path.yaw[-1] - np.pi / 2, np.pi)
    near = arc(path.points[0], half_width, path.yaw[0] + np.pi / 2, np.pi)
    half = len(right) // 4
    return np.concatenate([right[half:], far, left, near, right[: half + 1]])


@dataclass(frozen=True, eq=False)
class PathTable:
    """P paths in flat arrays.

    length: (P,) m;  spacing: (P,) m between the samples of each path;  first: (P,) index of each path's first sample
    points: (K, 2) m;  yaw: (K,) rad;  limit: (K,) m/s, the speed limit due to curvature
    """

    length: Floats
    spacing: Floats
    first: Ints
    points: Floats
    yaw: Floats
    limit: Floats

    @classmethod
    def of(cls, paths: Sequence[SampledCurve], lateral: float, braking: float) -> PathTable:
        """A table of `paths` with speed limits.

        lateral, braking: m/s^2, maximum acceleration across and along the path
        """
        count = np.array([len(path.points) for path in paths])
        limits = []
        for path in paths:
            limit = np.sqrt(lateral / np.maximum(np.abs(path.curvature), 1e-4))
            step = path.length / (len(limit) - 1)
            for k in range(len(limit) - 2, -1, -1):  # slow down in time for the next sample
                limit[k] = min(limit[k], np.sqrt(limit[k + 1] ** 2 + 2 * braking * step))
            limits.append(limit)
        length = np.array([path.length for path in paths])
        return cls(
            length=length,
            spacing=length / (count - 1),
            first=np.cumsum(count) - count,
            points=np.concatenate([path.points for path in paths]),
            yaw=np.concatenate([path.yaw for path in paths]),
            limit=np.concatenate(limits),
        )

    def _sample(self, path: Ints, s: Floats) -> tuple[Ints, Floats]:
        at = np.clip(s, 0.0, self.length[path]) / self.spacing[path]
        index = np.minimum(at.astype(np.int64), np.round(self.length[path] / self.spacing[path]).astype(np.int64) - 1)
        return self.first[path] + index, at - index

    def pose(self, path: Ints, s: Floats) -> tuple[Floats, Floats]:
        """Points (n, 2) m and yaw (n,) rad at `s` (n,) m along `path` (n,)."""
        index, fraction = self._sample(path, s)
        points = self.points[index] + fraction[:, None] * (self.points[index + 1] - self.points[index])
        return points, self.yaw[index] + fraction * (self.yaw[index + 1] - self.yaw[index])

    def limit_at(self, path: Ints, s: Floats) -> Floats:
        """(n,) m/s at `s` (n,) m along `path` (n,)."""
        index, fraction = self._sample(path, s)
        return self.limit[index] + fraction * (self.limit[index + 1] - self.limit[index])


LANE = 3.5  # m, width of a lane
BIKE_LANE = 2.0
KERB = 5.0  # m, from where the kerbs of two arms meet to the crossing
CROSSING = 4.0  # m, width of a pedestrian crossing
REACH = 105.0  # m, where the turning loops begin
LOOP_SHIFT = 30.0  # m, over which lanes spread before the turning loop
PAVEMENT_END = 85.0
PAVEMENT = 6.0  # m, width of a pavement
OPPOSITE_DEG = 20.0  # arms within this angle of being opposite have no corner between them

#: Kinds of road users of a path.
ROAD, BIKE, CROSSER, WALKER = range(4)


@dataclass(frozen=True)
class Arm:
    """One road of the junction.

    angle: rad, direction from the centre; lanes: each way; stop: m, from the centre to the stop line
    """

    angle: float
    lanes: int
    stop: float

    @property
    def half_width(self) -> float:
        """m, from the middle of the road to its kerb."""
        return self.lanes * LANE + BIKE_LANE

    def offset(self, slot: int) -> float:
        """Distance m from the middle of the road to the middle of a lane.

        Slot `lanes` is the bicycle lane.
        """
        return (slot + 0.5) * LANE if slot < self.lanes else self.lanes * LANE + BIKE_LANE / 2

    def world(self, local: Floats) -> Floats:
        """Transform points (k, 2) m from the arm's frame to the world frame."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        rotated: Floats = local @ np.array([[c, s], [-s, c]])
        return rotated


@dataclass(frozen=True, eq=False)
class JunctionLane:
    """One path of the plan.

    user:   ROAD, BIKE, CROSSER or WALKER
    path:   its centre line
    follow: rows of the lanes that continue it
    arm:    an approach's arm; for a connector, the arm that it comes from
    target: the arm that a connector leads to (for pedestrians, the arm of the crossing); -1 for an approach
    turn:   rad, change of direction on a connector, positive to the left
    """

    user: int
    path: SampledCurve
    follow: tuple[int, ...]
    arm: int
    target: int
    turn: float

    @property
    def connector(self) -> bool:
        """Whether the path crosses the junction or a road and needs the right of way."""
        return self.target >= 0


def arms_of(angles: list[float], lanes: list[int]) -> tuple[Arm, ...]:
    """The arms at `angles` rad (ascending) with `lanes` each way.

    Stop lines are set back behind the crossings.
    """
    unplaced = [Arm(angle, count, 0.0) for angle, count in zip(angles, lanes, strict=True)]
    arms = []
    for i, arm in enumerate(unplaced):
        left, right = unplaced[(i + 1) % len(unplaced)], unplaced[i - 1]
        mouth = 4.0
        for other, gap in ((left, left.angle - arm.angle), (right, arm.angle - right.angle)):
            gap %= 2 * np.pi
            if gap < np.pi - np.radians(OPPOSITE_DEG):
                meet = (other.half_width + arm.half_width * np.cos(gap)) / np.sin(gap)
                mouth = max(mouth, float(meet))
        arms.append(Arm(arm.angle, arm.lanes, mouth + KERB + CROSSING + 1.5))
    return tuple(arms)


def plan(arms: tuple[Arm, ...]) -> tuple[JunctionLane, ...]:
    """All lanes of a junction with these arms."""
    lanes: list[JunctionLane] = []
    approach: dict[tuple[int, int], int] = {}
    for a, arm in enumerate(arms):
        for slot in range(arm.lanes + 1):
            approach[a, slot] = len(lanes)
            lanes.append(JunctionLane(BIKE if slot == arm.lanes else ROAD, _approach(arm, slot), (), a, -1, 0.0))
    for (a, slot), row in approach.items():
        for b, exit_slot in _exits(arms, a, slot):
            start = arms[a].world(np.array([[arms[a].stop, arms[a].offset(slot)]]))[0]
            end = arms[b].world(np.array([[arms[b].stop, -arms[b].offset(exit_slot)]]))[0]
            path = SampledCurve.through(bend(start, arms[a].angle + np.pi, end, arms[b].angle))
            lanes.append(JunctionLane(lanes[row].user, path, (approach[b, exit_slot],), a, b, _turn(arms, a, b)))
            lanes[row] = replace(lanes[row], follow=(*lanes[row].follow, len(lanes) - 1))
    for a, arm in enumerate(arms):
        lanes += _crossing(arm, a, len(lanes))
    for a in range(len(arms)):
        lanes.append(JunctionLane(WALKER, SampledCurve.through(_pavement(arms, a)), (len(lanes),), a, -1, 0.0))
    return tuple(lanes)


def _turn(arms: tuple[Arm, ...], a: int, b: int) -> float:
    return float(wrap_angle(np.array(arms[b].angle - arms[a].angle - np.pi)))


def _exits(arms: tuple[Arm, ...], a: int, slot: int) -> list[tuple[int, int]]:
    """Exits (arm, slot) of a lane.

    Straight from every lane, left from the inner one, right from the outer one.
    """
    arm = arms[a]
    turns = {b: _turn(arms, a, b) for b in range(len(arms)) if b != a}
    ahead = [b for b, turn in turns.items() if abs(turn) < np.radians(35)]
    left = [b for b, turn in turns.items() if turn >= np.radians(35)]
    right = [b for b, turn in turns.items() if turn <= -np.radians(35)]
    if slot == arm.lanes:
        return [(b, arms[b].lanes) for b in ahead + right]
    exits = [(b, min(slot, arms[b].lanes - 1)) for b in ahead]
    if slot == 0:
        exits += [(b, 0) for b in left]
    if slot == arm.lanes - 1:
        exits += [(b, arms[b].lanes - 1) for b in right]
    # A middle lane of a road that ends here turns left next to the inner one.
    return exits or [(b, min(slot, arms[b].lanes - 1)) for b in (left or right)[:1]]


def _approach(arm: Arm, slot: int) -> SampledCurve:
    """Out from the exit line, round the turning loop, and back to the stop line."""
    offset, radius = arm.offset(slot), 9.0 + 4.8 * slot
    t = np.linspace(0.0, 1.0, 121)
    shift = offset + (radius - offset) * (10 * t**3 - 15 * t**4 + 6 * t**5)
    spread = np.stack([REACH + LOOP_SHIFT * t, -shift], axis=1)
    out = straight(np.array([arm.stop, -offset]), spread[0])
    half = np.concatenate([out, spread])
    loop = arc(np.array([REACH + LOOP_SHIFT, 0.0]), radius, -np.pi / 2, np.pi)
    return SampledCurve.through(arm.world(np.concatenate([half, loop, half[::-1] * [1.0, -1.0]])))


def _crossing(arm: Arm, a: int, first: int) -> list[JunctionLane]:
    """Two paths across the road, joined by a landing on each pavement.

    Pedestrians turn round on the landings.
    """
    x, half, track = arm.stop - 1.5 - CROSSING / 2, arm.half_width + 0.2, 0.9
    over = straight(np.array([x + track, -half]), np.array([x + track, half]))
    out, back = np.array([x + track, half + 0.5]), np.array([x - track, half])
    landing = np.concatenate([straight(over[-1], out), arc(np.array([x, half + 0.5]), track, 0.0, np.pi), back[None]])
    paths = []
    for mirror in (1.0, -1.0):  # the return path is the outbound path, rotated about the middle of the road
        middle = np.array([x, 0.0])
        paths += [(over - middle) * mirror + middle, (landing - middle) * mirror + middle]
    lanes = []
    for k, local in enumerate(paths):
        path = SampledCurve.through(arm.world(local))
        lanes.append(JunctionLane(CROSSER, path, (first + (k + 1) % 4,), a, -1 if k % 2 else a, 0.0))
    return lanes


def corners(arms: tuple[Arm, ...], a: int, setback: float) -> Floats:
    """Corner (1 or 2, 2) m between the left side of arm `a` and the next arm.

    It is `setback` m behind the kerbs: one point if the sides meet, two if the arms are opposite each other.
    """
    arm, next_arm = arms[a], arms[(a + 1) % len(arms)]
    gap = (next_arm.angle - arm.angle) % (2 * np.pi)
    y, z = arm.half_width + setback, next_arm.half_width + setback
    if abs(gap - np.pi) > np.radians(OPPOSITE_DEG):
        return arm.world(np.array([[(z + y * np.cos(gap)) / np.sin(gap), y]]))
    ends = arm.world(np.array([[arm.stop + 3.0, y]])), next_arm.world(np.array([[next_arm.stop + 3.0, -z]]))
    return np.concatenate(ends)


def _pavement(arms: tuple[Arm, ...], a: int) -> Floats:
    """The loop of pedestrians walking round the corner between arm `a` and the next."""
    arm, next_arm = arms[a], arms[(a + 1) % len(arms)]
    setback = 3.5
    start = arm.world(np.array([[PAVEMENT_END, arm.half_width + setback]]))
    end = next_arm.world(np.array([[PAVEMENT_END, -next_arm.half_width - setback]]))
    return oval(rounded(np.concatenate([start, corners(arms, a, setback), end]), 5.0), 0.9)

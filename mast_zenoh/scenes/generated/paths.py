"""Planar curves that road users move along, with batched look-up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints

#: m, spacing of the samples of a path.
SPACING = 0.25


@dataclass(frozen=True, eq=False)
class Path:
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
    def through(cls, points: Floats) -> Path:
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
        peak_curvature = float(np.abs(Path.through(curve).curvature).max())
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
    path = Path.through(middle)
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
    def of(cls, paths: Sequence[Path], lateral: float, braking: float) -> PathTable:
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

"""A lidar's scan: the nearest surface on each beam, of shapes, walls and the ground, while all of them move.

The lidar and the objects move and turn evenly during a turn, so each azimuth has a pose of its own. A beam is tested
against the parts of an object only in the window of azimuths and channels that the object can meet.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import along_and_across, box_corners, rotation_from_yaw, wrap_angle
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.sensing.beams import Beams
from mast_zenoh.sensing.raycast import Walls, channel_window, distance_to
from mast_zenoh.sensing.shapes import Parts

#: What a beam met that is no object, in `Scan.source`.
GROUND, WALL, NOTHING = -1, -2, -3


@dataclass(frozen=True, eq=False)
class Moving:
    """Poses at the time of a scan, and how they change: of n objects, or of a lidar (n = 1).

    position: (n, 3) m, velocity: (n, 3) m/s, yaw: (n,) rad, turn: (n,) rad/s: world frame
    """

    position: Floats
    velocity: Floats
    yaw: Floats
    turn: Floats


class Scan(NamedTuple):
    """What the beams met, (m, c) each: m azimuths, c channels.

    range_m: float64, m, along the beam; inf: nothing in range
    source:  int32, row of the object; GROUND, WALL or NOTHING
    cosine:  float64, of the angle between the beam and the surface's normal, 0 to 1
    """

    range_m: Floats
    source: NDArray[np.int32]
    cosine: Floats


def cast(
    beams: Beams,
    lidar: Moving,
    mount: Floats,
    objects: Moving,
    parts: Parts,
    ground_m: float = 0.0,
    walls: Walls | None = None,
    own: int = -1,
) -> Scan:
    """The scan of a lidar.

    lidar:    its pose and motion;  mount: (3, 3) active, the rest of its rotation: lidar to its yaw
    objects:  poses and motions of their boxes' middles;  parts: their shapes
    ground_m: m, z of the ground, world frame, where the lidar is
    own:      row of the object that carries the lidar, which its beams do not meet; -1: none
    """
    _keep_freed_memory()
    still = walls if walls is not None else Walls.of_buildings((), np.zeros(0))
    return Scan(
        *nearest_surfaces(
            *firings(beams),
            ScanPose.of(lidar, mount, ground_m),
            objects,
            _heading(objects.yaw),
            parts,
            _object_windows(beams, lidar, mount, objects, parts, own),
            still,
            _wall_windows(beams, lidar, mount, still, ground_m),
            beams.max_range_m,
        )
    )


@cache
def _keep_freed_memory() -> None:
    """Make glibc keep freed memory for the next scans: page faults take longer than scans do.

    Freeing a large block raises the size from which glibc maps and unmaps each block (mallopt(3), M_MMAP_THRESHOLD).
    """
    np.empty(1 << 24, np.uint8)


class ScanPose(NamedTuple):
    """A lidar at the time of its scan.

    position (3,) m, velocity (3,) m/s, heading (2,) cosine and sine of its yaw, turn rad/s, mount (3, 3), ground_m m
    """

    position: Floats
    velocity: Floats
    heading: Floats
    turn: float
    mount: Floats
    ground_m: float

    @classmethod
    def of(cls, lidar: Moving, mount: Floats, ground_m: float = 0.0) -> ScanPose:
        """That of a lidar; see `cast`."""
        return cls(lidar.position[0], lidar.velocity[0], _heading(lidar.yaw)[0], float(lidar.turn[0]), mount, ground_m)


def firings(beams: Beams) -> tuple[Floats, Floats]:
    """The `columns` and `channels` of `nearest_surfaces`."""
    flat = np.cos(beams.elevation)
    return (
        np.stack([beams.time_s, np.cos(beams.azimuth), np.sin(beams.azimuth)]),
        np.stack([flat * np.cos(beams.offset), flat * np.sin(beams.offset), np.sin(beams.elevation)]),
    )


def firing_axes(columns: Floats, pose: ScanPose) -> tuple[Floats, Floats, Floats, Floats]:
    """Where the lidar is at each azimuth (m, 3) m, and unit vectors (m, 3) along it, to its left, up: world frame."""
    time, cosine, sine = columns
    rotation = _rotations(_turned(pose.heading, pose.turn * time), pose.mount)
    return (
        pose.position + pose.velocity * time[:, None],
        cosine[:, None] * rotation[:, :, 0] + sine[:, None] * rotation[:, :, 1],
        cosine[:, None] * rotation[:, :, 1] - sine[:, None] * rotation[:, :, 0],
        rotation[:, :, 2],
    )


@kernel
def nearest_surfaces(
    columns: Floats,
    channels: Floats,
    pose: ScanPose,
    objects: Moving,
    heading: Floats,
    parts: Parts,
    windows: Ints,
    walls: Walls,
    wall_windows: Ints,
    max_range_m: float,
) -> tuple[Floats, NDArray[np.int32], Floats]:
    """The arrays of a `Scan`.

    columns:  (3, m) time s, cosine and sine of each azimuth
    channels: (3, c) components of each channel's direction: along the azimuth, to the left of it, up
    heading:  (n, 2) cosine and sine of the objects' yaw
    windows, wall_windows: (k, 5) row of an object or wall, azimuths from and to, channels from and to: may be met
    """
    time = columns[0]
    origin, ahead, left, up = firing_axes(columns, pose)
    fall = ahead[:, 2:] * channels[0] + left[:, 2:] * channels[1] + up[:, 2:] * channels[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        range_m = (pose.ground_m - origin[:, 2:]) / fall
    down = (fall < 0.0) & (range_m >= 0.0) & (range_m <= max_range_m)
    source = np.where(down, GROUND, NOTHING).astype(np.int32)
    scan = Scan(np.where(down, range_m, np.inf), source, np.where(down, -fall, 0.0))
    for row, start, stop, low, high in windows:
        span = slice(start, stop)
        at = origin[span] - (objects.position[row] + objects.velocity[row] * time[span, None])
        turned = _turned(heading[row], objects.turn[row] * time[span])
        local = _into(turned, at)
        axes = [_into(turned, each[span]) for each in (ahead, left, up)]
        beam = sum(axis[:, None] * part[low:high, None] for axis, part in zip(axes, channels, strict=True))
        for part in range(parts.first[row], parts.first[row + 1]):
            met = _into_part(local[:, None], beam, parts.low[part], parts.high[part])
            _nearer(scan, (span, slice(low, high)), met, row, max_range_m)
    for row, start, stop, low, high in wall_windows:
        span = slice(start, stop)
        axes = [each[span] for each in (ahead, left, up)]
        beam = sum(axis[:, None] * part[low:high, None] for axis, part in zip(axes, channels, strict=True))
        met = _to_wall(origin[span, None], beam, walls.start[row], walls.end[row], walls.top[row])
        _nearer(scan, (span, slice(low, high)), met, WALL, max_range_m)
    return scan.range_m, scan.source, scan.cosine


def _nearer(scan: Scan, where: tuple[slice, slice], met: tuple[Floats, Floats], source: int, limit_m: float) -> None:
    """Write what is nearer than all before it into a window of the scan. met: distance, m, and cosine"""
    nearer = (met[0] < scan.range_m[where]) & (met[0] <= limit_m)
    np.copyto(scan.range_m[where], met[0], where=nearer)
    np.copyto(scan.source[where], source, where=nearer)
    np.copyto(scan.cosine[where], met[1], where=nearer)


def _heading(yaw: Floats) -> Floats:
    return np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)


def _turned(heading: Floats, angle: Floats) -> tuple[Floats, Floats]:
    """Cosine and sine of a heading (2,) after turning by small angles (m,) rad: to 1e-10 below 0.3 rad."""
    square = angle * angle
    cosine = 1.0 - square * (0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0 - square * (1.0 / 40320.0))))
    sine = angle * (1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0))))
    return heading[0] * cosine - heading[1] * sine, heading[1] * cosine + heading[0] * sine


def _rotations(turned: tuple[Floats, Floats], mount: Floats) -> Floats:
    """(m, 3, 3) active, lidar to world."""
    cosine, sine = (each[:, None] for each in turned)
    rows = (
        cosine * mount[0] - sine * mount[1],
        sine * mount[0] + cosine * mount[1],
        np.broadcast_to(mount[2], (len(cosine), 3)),
    )
    return np.stack(rows, axis=1)


def _into(turned: tuple[Floats, Floats], vectors: Floats) -> Floats:
    """Vectors (m, 3) of the world, in turned axes."""
    cosine, sine = turned
    x, y, z = vectors.T
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)


def _into_part(origin: Floats, beam: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """m along beams (…, 3) from origins into a part, inf: not met; and the cosine to the face on which they enter."""
    height = high[0] - low[0]
    enter, slope, missed = np.full(beam.shape[:-1], -1.0), np.zeros(beam.shape[:-1]), np.zeros(beam.shape[:-1], bool)
    planes = [(2, 0.0, low[0], -1.0), (2, 0.0, high[0], 1.0)]
    for column, (axis, side) in enumerate(((0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0)), 1):
        lean = (high[column] - low[column]) / height
        planes.append((axis, lean, low[column] - lean * low[0], side))
    faces = []
    for axis, lean, at, side in planes:
        before = side * (origin[..., axis] - lean * origin[..., 2] - at)
        along = side * (beam[..., axis] - lean * beam[..., 2])
        outer, away = before > 0.0, along > -1e-12
        missed |= outer & away
        distance = -before / np.where(away, 1.0, along)
        later = outer & ~away & (distance > enter)
        slope = np.where(later, -along / np.sqrt(1.0 + lean * lean), slope)
        enter = np.where(later, distance, enter)
        faces.append((outer, before, along))
    for outer, before, along in faces:
        missed |= ~outer & (before + enter * along > 0.0)
    return np.where(~missed & (enter >= 0.0), enter, np.inf), slope


def _to_wall(origin: Floats, beam: Floats, start: Floats, end: Floats, top: float) -> tuple[Floats, Floats]:
    """m along beams (…, 3) to a wall, inf: not met; and the cosine to its normal."""
    span, to_start = end - start, start - origin[..., :2]
    across = beam[..., 0] * span[1] - beam[..., 1] * span[0]
    across = np.where(np.abs(across) < 1e-12, 1e-12, across)
    distance = (to_start[..., 0] * span[1] - to_start[..., 1] * span[0]) / across
    share = (to_start[..., 0] * beam[..., 1] - to_start[..., 1] * beam[..., 0]) / across
    met = (distance >= 0.0) & (share >= 0.0) & (share <= 1.0) & (origin[..., 2] + distance * beam[..., 2] <= top)
    return np.where(met, distance, np.inf), np.abs(across) / np.sqrt(span[0] * span[0] + span[1] * span[1])


#: m and rad, far more than rounding moves a beam.
_MARGIN_M, _MARGIN_RAD = 1e-6, 1e-6


def _object_windows(beams: Beams, lidar: Moving, mount: Floats, objects: Moving, parts: Parts, own: int) -> Ints:
    """The windows of objects, whose boxes are enlarged by all that they may move relative to the lidar."""
    half, low, high = _extent(parts)
    rows = np.flatnonzero(np.arange(len(half)) != own)
    half, low, high = half[rows], low[rows], high[rows]
    moved = np.linalg.norm(objects.velocity[rows] - lidar.velocity[0], axis=1) * beams.longest_s
    moved += np.abs(objects.turn[rows]) * beams.longest_s * np.linalg.norm(half, axis=1) + _MARGIN_M
    offset = objects.position[rows] - lidar.position[0]
    half, low, high = half + moved[:, None], low - moved, high + moved
    sides = np.abs(along_and_across(offset, objects.yaw[rows]))
    gap = np.column_stack([sides - half, np.maximum(low + offset[:, 2], -high - offset[:, 2])])
    nearest = np.linalg.norm(np.maximum(gap, 0.0), axis=1)
    middle = offset + np.column_stack([np.zeros_like(half), (low + high) / 2])
    corners = box_corners(middle, np.column_stack([2 * half, high - low]), objects.yaw[rows])
    return _windows(beams, lidar, mount, rows, corners, nearest)


def _wall_windows(beams: Beams, lidar: Moving, mount: Floats, walls: Walls, ground_m: float) -> Ints:
    """The windows of walls, which are met above the ground only."""
    if not len(walls.top):
        return np.zeros((0, 5), np.int64)
    moved = float(np.linalg.norm(lidar.velocity[0])) * beams.longest_s + _MARGIN_M
    start, end = walls.start - lidar.position[0, :2], walls.end - lidar.position[0, :2]
    span = end - start
    length = np.maximum(np.linalg.norm(span, axis=1), 1e-9)[:, None]
    nearest = np.maximum(distance_to(start, end) - moved, 0.0)
    along = span / length * moved
    left = np.stack([-along[:, 1], along[:, 0]], axis=1)
    around = [start - along - left, start - along + left, end + along - left, end + along + left]
    plan = np.repeat(np.stack(around, axis=1), 2, axis=1)
    low = ground_m - lidar.position[0, 2] - moved
    z = np.tile(np.stack([np.full(len(length), low), walls.top - lidar.position[0, 2] + moved], axis=1), 4)
    return _windows(beams, lidar, mount, np.arange(len(length)), np.dstack([plan, z]), nearest)


def _extent(parts: Parts) -> tuple[Floats, Floats, Floats]:
    """(n, 2) m half of the length and width, (n,) m lowest and highest z, of what surrounds all parts of an object."""
    first = parts.first[:-1]
    if not len(first):
        return np.zeros((0, 2)), np.zeros(0), np.zeros(0)
    both = np.stack([parts.low, parts.high])
    reach = np.abs(both[:, :, 1:]).max(axis=0)
    sides = np.stack([reach[:, :2].max(axis=1), reach[:, 2:].max(axis=1)], axis=1)
    low, high = both[:, :, 0].min(axis=0), both[:, :, 0].max(axis=0)
    return np.maximum.reduceat(sides, first), np.minimum.reduceat(low, first), np.maximum.reduceat(high, first)


def _windows(beams: Beams, lidar: Moving, mount: Floats, rows: Ints, corners: Floats, nearest: Floats) -> Ints:
    """(k, 5) row, azimuths from and to, channels from and to, of what is within `corners`; two across the last azimuth.

    corners: (n, 8, 3) m from the lidar, in the axes of the world;  nearest: (n,) m
    """
    kept = np.flatnonzero(nearest <= beams.max_range_m)
    rows, nearest = rows[kept], nearest[kept]
    rotation = rotation_from_yaw(float(lidar.yaw[0])) @ mount
    corners = corners[kept] @ rotation
    turned = abs(float(lidar.turn[0])) * beams.longest_s
    tilted = float(np.linalg.norm(rotation[2, :2]))  # then a turn changes elevations, too
    margin = 2.0 * turned + float(np.abs(beams.offset).max(initial=0.0)) + _MARGIN_RAD
    first, count = _azimuths(beams, corners, margin)
    low, high = channel_window(beams.elevation, corners, nearest, turned * tilted + _MARGIN_RAD)
    first = first % beams.turn
    before = np.column_stack([rows, first, np.minimum(first + count, beams.turn), low, high])
    after = np.column_stack([rows, np.zeros_like(first), np.maximum(first + count - beams.turn, 0), low, high])
    windows = np.concatenate([before, after])
    windows[:, 2] = np.minimum(windows[:, 2], len(beams.azimuth))
    some = (windows[:, 1] < windows[:, 2]) & (windows[:, 3] < windows[:, 4])
    return np.ascontiguousarray(windows[some].astype(np.int64))


def _azimuths(beams: Beams, corners: Floats, margin: float) -> tuple[Ints, Ints]:
    """(n,) the first azimuth, and how many from there on."""
    centre = corners.mean(axis=1)
    bearing = np.arctan2(centre[:, 1], centre[:, 0])
    offset = wrap_angle(np.arctan2(corners[..., 1], corners[..., 0]) - bearing[:, None])
    low, high = offset.min(axis=1) - margin, offset.max(axis=1) + margin
    around = high - low >= np.pi  # the axis of the lidar may go through it
    first = np.ceil((bearing + low - beams.azimuth[0]) / beams.step).astype(np.int64)
    count = np.floor((bearing + high - beams.azimuth[0]) / beams.step).astype(np.int64) - first + 1
    return np.where(around, 0, first), np.where(around, beams.turn, np.clip(count, 0, beams.turn))

"""The beams behind the points of a scan: what each firing of a lidar met, worked out from the points themselves.

Attacks on points change what a beam returns, so they need the beams, also those that met nothing. A spoofer that
listens to the lidar's pulses knows them (Cao 2019, section 5.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import along_and_across, angles_of, unit_vectors, wrap_angle
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.sensing.beams import Beams
from mast_zenoh.sensing.points import Points, Singles
from mast_zenoh.sensing.raycast import Walls
from mast_zenoh.sensing.scan import Moving, ScanPose, firings, nearest_surfaces
from mast_zenoh.sensing.shapes import Parts

#: m, far below any ground that a beam reaches: a phantom is cast without the ground.
NO_GROUND_M = -1e9


class NoBeams(Exception):
    """No beam of a scan is where one is expected, or its points have no firing times."""


@dataclass(frozen=True, eq=False)
class LidarMotion:
    """Pose of a lidar at the time of a scan, and how it moves during it.

    rotation: (3, 3) active, lidar to world; velocity: (3,) m/s, world frame; turn: rad/s, about the vertical
    """

    rotation: Floats
    velocity: Floats
    turn: float

    def as_fired(self, position: Singles, time_s: Singles) -> Floats:
        """Positions (n, 3) m of deskewed points, in the frame that the lidar had when it fired."""
        time = time_s.astype(np.float64)[:, None]
        return _turned(position @ self.rotation.T - self.velocity * time, -self.turn * time) @ self.rotation

    def deskewed(self, position: Floats, time_s: Singles) -> Singles:
        """The inverse of `as_fired`."""
        time = time_s.astype(np.float64)[:, None]
        world = _turned(position @ self.rotation.T, self.turn * time) + self.velocity * time
        return np.asarray(world @ self.rotation, np.float32)


def _turned(vectors: Floats, angle: Floats) -> Floats:
    """Vectors (n, 3) turned about z by (n, 1) rad."""
    return np.column_stack([along_and_across(vectors, -angle[:, 0]), vectors[:, 2]])


@dataclass(frozen=True, eq=False)
class ChannelAngles:
    """Directions of a lidar's beams: a channel looks to `rate * time + offset`, counter-clockwise from x.

    rate: rad/s; channel: (c,) uint8, those seen, ascending; offset, elevation: (c,) rad, of them
    """

    rate: float
    channel: NDArray[np.uint8]
    offset: Floats
    elevation: Floats

    @classmethod
    def of(cls, fired: Floats, points: Points) -> ChannelAngles:
        """From a scan that is not empty; raises NoBeams without firing times. fired: (n, 3) m, as of `as_fired`"""
        time = points.time_s.astype(np.float64)
        one = points.channel == np.bincount(points.channel).argmax()
        if time[one].min() == time[one].max():
            raise NoBeams("untimed")
        azimuth, elevation = angles_of(fired)
        rate = float(np.polyfit(time[one], np.unwrap(azimuth[one]), 1)[0])
        channel, first = np.unique(points.channel, return_inverse=True)
        off = wrap_angle(azimuth - rate * time)
        return cls(rate, channel, *(_medians(first, each) for each in (off, elevation)))


def _medians(group: Ints, values: Floats) -> Floats:
    """(g,) medians of values (n,) by their groups (n,), 0 to g - 1, none of which is empty."""
    ordered = values[np.lexsort((values, group))]
    count = np.bincount(group)
    return np.asarray(ordered[np.cumsum(count) - count + count // 2])


@dataclass(frozen=True, eq=False)
class Sector:
    """The beams of f firings of c channels, in part of a scan.

    points:   of the whole scan;  motion: of its lidar
    time_s:   (f,) float32, ascending;  channels: the c of them;  azimuth: (f,) rad, of a channel without offset
    row:      (f, c) rows of the points, -1: nothing returned
    range_m:  (f, c) m, along the beam; inf: nothing returned
    """

    points: Points
    motion: LidarMotion
    time_s: Singles
    channels: ChannelAngles
    azimuth: Floats
    row: Ints
    range_m: Floats

    @classmethod
    def near(cls, points: Points, motion: LidarMotion, seen: ChannelAngles, azimuth: float, half_rad: float) -> Sector:
        """The firings within `half_rad` of an azimuth, both rad; raises NoBeams if there is none."""
        fired = motion.as_fired(points.position, points.time_s)
        looks = seen.rate * points.time_s.astype(np.float64)
        margin = half_rad + np.abs(wrap_angle(seen.offset)).max(initial=0.0)
        rows = np.flatnonzero(np.abs(wrap_angle(looks - azimuth)) <= margin)
        if not len(rows):
            raise NoBeams
        time, firing = np.unique(points.time_s[rows], return_inverse=True)
        known, shape = np.isin(points.channel[rows], seen.channel), (len(time), len(seen.channel))
        beam = firing[known], np.searchsorted(seen.channel, points.channel[rows[known]])
        row, range_m = np.full(shape, -1), np.full(shape, np.inf)
        row[beam], range_m[beam] = rows[known], np.linalg.norm(fired[rows[known]], axis=1)
        return cls(points, motion, time, seen, seen.rate * time.astype(np.float64), row, range_m)

    def angles(self) -> tuple[Floats, Floats]:
        """(f, c) rad azimuth and (c,) rad elevation of the beams, in the frame of the lidar when it fired."""
        return wrap_angle(self.azimuth[:, None] + self.channels.offset), self.channels.elevation

    def directions(self) -> Floats:
        """(f, c, 3) unit vectors along the beams, in the frame of the lidar when it fired."""
        return unit_vectors(*self.angles())

    def beams_at(self, position: Floats) -> tuple[Ints, Ints, Bools]:
        """(n,) firing and channel nearest to the direction of positions (n, 3) m; (n,) whether a beam looks there."""
        azimuth, elevation = angles_of(position)
        order = np.argsort(self.channels.elevation)
        step = np.diff(self.channels.elevation[order])
        apart = float(np.median(step)) if len(step) else 0.02
        channel = order[nearest(self.channels.elevation[order], elevation)]
        middle = self.azimuth[len(self.azimuth) // 2]
        off = wrap_angle(azimuth - self.channels.offset[channel] - middle) + middle
        firing = nearest(self.azimuth, off)
        aside = np.abs(off - self.azimuth[firing]), np.abs(elevation - self.channels.elevation[channel])
        return firing, channel, (aside[0] <= 0.01) & (aside[1] <= apart)

    def to_shape(self, middle: Floats, yaw: float, parts: Parts, longest_m: float = 300.0) -> Floats:
        """(f, c) m along each beam to one shape that stands still in the axes of the world; inf: not met.

        middle: (3,) m, of its box, from the lidar;  yaw: rad
        """
        zero, (f, c) = np.zeros(3), self.row.shape
        beams = self.channels.elevation, self.channels.offset, np.zeros(f), 0.0, longest_m
        range_m, _, _ = nearest_surfaces(
            *firings(Beams(self.azimuth, *beams)),
            ScanPose(zero, zero, np.array([1.0, 0.0]), 0.0, np.ascontiguousarray(self.motion.rotation), NO_GROUND_M),
            Moving(middle[None], zero[None], np.array([yaw]), np.zeros(1)),
            np.array([[np.cos(yaw), np.sin(yaw)]]),
            parts,
            np.array([[0, 0, f, 0, c]], np.int64),
            Walls.of_buildings((), np.zeros(0)),
            np.zeros((0, 5), np.int64),
            longest_m,
        )
        return range_m

    def changed(self, which: Bools, range_m: Floats, intensity: float = 1.0) -> Points:
        """The scan after some of these beams, (f, c), returned from other distances (f, c) m; inf: not at all.

        If that changes none of them, the same object.
        """
        firing, channel = np.nonzero(which & np.isfinite(range_m))
        beam, time = self.directions()[firing, channel], self.time_s[firing]
        new = Points(
            self.motion.deskewed(beam * range_m[firing, channel, None], time),
            np.full(len(time), intensity, np.float32),
            time,
            self.channels.channel[channel],
        )
        gone = np.zeros(len(self.points), bool)
        gone[self.row[which & (self.row >= 0)]] = True
        if not len(time) and not gone.any():
            return self.points
        return ordered(Points.joined([self.points.select(~gone), new]))


def ordered(points: Points) -> Points:
    """The same points by firing, then by channel."""
    channel = points.channel.astype(np.float64) * 1e-9  # s, less than between any two firings
    return points.select(np.argsort(points.time_s.astype(np.float64) + channel, kind="stable"))


def nearest(ascending: Floats, values: Floats) -> Ints:
    """(…) rows of the elements of (k,), ascending, that are nearest to values (…)."""
    after = np.clip(np.searchsorted(ascending, values), 1, max(len(ascending) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(ascending) - 1)
    return np.where(values - ascending[before] < ascending[after] - values, before, after)


class BeamMemory:
    """What a listener learns of one lidar from scan to scan: its motion and its beams."""

    _motion: LidarMotion

    def __init__(self) -> None:
        self._before: tuple[float, Floats, Floats] | None = None
        self._poses = 0
        self._channels: ChannelAngles | None = None

    def move(self, time_s: float, position: Floats, rotation: Floats) -> None:
        """Take note of the pose of the lidar at a scan: (3,) m and (3, 3) active, world frame."""
        velocity, turn = np.zeros(3), 0.0
        if self._before is not None and 0.0 < time_s - self._before[0] < 1.0:
            elapsed, since = time_s - self._before[0], rotation @ self._before[2].T
            velocity = (position - self._before[1]) / elapsed
            turn = float(np.arctan2(since[1, 0] - since[0, 1], since[0, 0] + since[1, 1])) / elapsed
        self._before, self._motion = (time_s, position, rotation), LidarMotion(rotation, velocity, turn)
        self._poses += 1

    def near(self, points: Points, azimuth: float, half_rad: float) -> Sector:
        """The firings of the scan at the last pose within `half_rad` of an azimuth, both rad; may raise NoBeams."""
        if self._channels is None or self._poses <= 2:  # the motion is known from the second pose on
            self._channels = ChannelAngles.of(self._motion.as_fired(points.position, points.time_s), points)
        return Sector.near(points, self._motion, self._channels, azimuth, half_rad)


def chords(beam: Floats, position: Floats, size: Floats, yaw: Floats) -> tuple[Floats, Floats]:
    """(n, k) m along beams (n, 3), from the origin, at which they enter and leave upright boxes (k, 3), (k, 3), (k,).

    A beam that misses a box leaves it before it enters.
    """
    c, s = np.cos(yaw), np.sin(yaw)
    middle = [*along_and_across(position, yaw).T, position[:, 2]]
    x, y, z = (each[:, None] for each in beam.T.astype(np.float64))
    enter, leave = np.full((len(beam), len(yaw)), -np.inf), np.full((len(beam), len(yaw)), np.inf)
    for axis, along in enumerate((c * x + s * y, c * y - s * x, np.broadcast_to(z, enter.shape))):
        slope = np.where(np.abs(along) < 1e-12, 1e-12, along)
        near, far = (middle[axis] - size[:, axis] / 2) / slope, (middle[axis] + size[:, axis] / 2) / slope
        enter, leave = np.maximum(enter, np.minimum(near, far)), np.minimum(leave, np.maximum(near, far))
    return enter, leave

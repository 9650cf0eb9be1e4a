"""Lidar returns by ray casting against boxes and walls, free space, and which sensors would see an object.

Each beam returns from the nearest box unless a wall is in between. The test is exact for upright boxes and vertical
walls. It is fast because a box is only tested against the beams in its angular window, and walls only against the beams
that hit a box.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import box_corners, to_local, unit_vectors, wrap_angle
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.kernels import kernel
from mast_zenoh.sensing.sensors import LidarSensor


@dataclass(frozen=True, eq=False)
class Walls:
    """w vertical walls, opaque from far below the ground up to `top`.

    start, end: (w, 2) m, world frame
    top:        (w,) m, z of the upper edge in the world frame
    """

    start: Floats
    end: Floats
    top: Floats

    def joined(self, other: Walls) -> Walls:
        """These walls and others."""
        ends = (np.concatenate([getattr(self, name), getattr(other, name)]) for name in ("start", "end", "top"))
        return Walls(*ends)

    @classmethod
    def of_buildings(cls, outlines: tuple[Floats, ...], height: Floats) -> Walls:
        """The walls of closed outlines, each (k, 2), and the z of their tops (B,)."""
        if not outlines:
            return cls(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
        return cls(
            np.concatenate(outlines),
            np.concatenate([np.roll(outline, -1, axis=0) for outline in outlines]),
            np.repeat(np.asarray(height, np.float64), [len(outline) for outline in outlines]),
        )


@kernel
def lidar_points(
    lidar: LidarSensor,
    sensor_position: Floats,
    sensor_rotation: Floats,
    position: Floats,
    size: Floats,
    yaw: Floats,
    walls: Walls | None = None,
    own: int = -1,
    beams: tuple[Ints, Ints] | None = None,
) -> NDArray[np.int32]:
    """(n,) lidar returns of each of n upright boxes.

    sensor_position (3,) m and sensor_rotation (3, 3) active: the lidar's pose in the world (`sensing.sensor_pose`).
    position (n, 3) m centre, size (n, 3) m l w h, yaw (n,) rad: the boxes in the world.
    own: row of the box that carries the lidar; it occludes nothing and has no returns. -1: none.
    beams: rows (k,) of `LidarSensor.azimuths` and (k,) of `LidarSensor.elevations`: cast only these; None: all
    """
    points = np.zeros(len(position), np.int32)
    boxes = position, size, yaw
    box, _, distance, direction = _nearest_hits(lidar, sensor_position, sensor_rotation, *boxes, own, beams)
    visible = np.ones(len(box), bool)
    if walls is not None and len(walls.top) and len(box):
        ends = sensor_position + (direction * distance[:, None]) @ sensor_rotation.T
        visible = ~_behind_walls(sensor_position, ends, box, walls)
    points[:] = np.bincount(box[visible], minlength=len(position))
    return points


def first_hits(
    lidar: LidarSensor,
    sensor_position: Floats,
    sensor_rotation: Floats,
    position: Floats,
    size: Floats,
    yaw: Floats,
    own: int = -1,
) -> tuple[Ints, Floats]:
    """Beams that hit a box, and the distance m of the first box.

    The beams are numbered by azimuth, then channel, both ascending. The parameters are those of `lidar_points`.
    """
    _, beam, distance, _ = _nearest_hits(lidar, sensor_position, sensor_rotation, position, size, yaw, own)
    return beam, distance


def _nearest_hits(
    lidar: LidarSensor,
    sensor_position: Floats,
    sensor_rotation: Floats,
    position: Floats,
    size: Floats,
    yaw: Floats,
    own: int,
    beams: tuple[Ints, Ints] | None = None,
) -> tuple[Ints, Ints, Floats, Floats]:
    """The first box on each beam: box, beam, distance m, direction (sensor frame)."""
    # Directions and the sensor's origin in each box's frame: box <- world <- sensor.
    c, s, zero, one = np.cos(yaw), np.sin(yaw), np.zeros(len(yaw)), np.ones(len(yaw))
    to_box = np.stack([np.stack([c, s, zero], 1), np.stack([-s, c, zero], 1), np.stack([zero, zero, one], 1)], 1)
    origin = np.einsum("nij,nj->ni", to_box, sensor_position - position)
    half = size / 2
    nearest = np.linalg.norm(np.maximum(np.abs(origin) - half, 0.0), axis=1)
    near = nearest <= lidar.max_range_m
    if own >= 0:
        near[own] = False
    rows = np.flatnonzero(near)
    if not len(rows):
        return rows, rows, np.zeros(0), np.zeros((0, 3))
    corners = to_local(
        box_corners(position[rows], size[rows], yaw[rows]).reshape(-1, 3), sensor_position, sensor_rotation
    )
    box, azimuth, channels = _columns(lidar, corners.reshape(-1, 8, 3), nearest[rows])
    if beams is not None:
        column, beam = np.nonzero(azimuth[:, None] == beams[0])
        channel = beams[1][beam]
        inside = (channels[column, 0] <= channel) & (channel < channels[column, 1])
        column, channel = column[inside], channel[inside]
        box, azimuth, channels = box[column], azimuth[column], np.stack([channel, channel + 1], axis=1)
    hits = _hits(lidar, to_box[rows] @ sensor_rotation, origin[rows], half[rows], box, azimuth, channels)
    box, beam, distance, direction = _nearest(*hits)
    return rows[box], beam, distance, direction


def _columns(lidar: LidarSensor, corners: Floats, nearest: Floats) -> tuple[Ints, Ints, Ints]:
    """Candidate (box, azimuth) pairs and the range of channels (2,) of each.

    The bounds are conservative. corners: (n, 8, 3) in the sensor frame; nearest: (n,) distance of each box
    """
    azimuths, elevations = lidar.azimuths, lidar.elevations
    centre = corners.mean(axis=1)
    bearing = np.arctan2(centre[:, 1], centre[:, 0])
    offset = wrap_angle(np.arctan2(corners[..., 1], corners[..., 0]) - bearing[:, None])
    low, high = offset.min(axis=1), offset.max(axis=1)
    around = high - low >= np.pi  # the sensor's axis goes through the box: any azimuth may hit it
    low, high = np.where(around, -np.pi, low), np.where(around, np.pi, high)

    first, last = channel_window(elevations, corners, nearest, 1e-9)

    # Beam k is at azimuths[0] + k * step, with k modulo a full turn; beams outside the sector are dropped.
    step = np.radians(lidar.azimuth_step_deg)
    turn = max(round(2 * np.pi / step), len(azimuths))
    first_beam = np.ceil((bearing + low - azimuths[0]) / step - 1e-9).astype(np.int64)
    count = np.floor((bearing + high - azimuths[0]) / step + 1e-9).astype(np.int64) - first_beam + 1
    count = np.where(last > first, np.clip(count, 0, turn), 0)
    box = np.repeat(np.arange(len(corners)), count)
    azimuth = (np.arange(len(box)) - np.repeat(np.cumsum(count) - count, count) + first_beam[box]) % turn
    inside = azimuth < len(azimuths)
    box, azimuth = box[inside], azimuth[inside]
    return box, azimuth, np.stack([first, last], axis=1)[box]


def channel_window(elevations: Floats, corners: Floats, nearest: Floats, margin: float) -> tuple[Ints, Ints]:
    """(n,) channels from, and (n,) to, that what is within `corners` can meet: sin(elevation) is z over a distance.

    elevations: (c,) rad, ascending;  corners: (n, 8, 3) in the sensor frame;  nearest: (n,) m;  margin: rad
    """
    farthest, near = np.linalg.norm(corners, axis=2).max(axis=1), np.maximum(nearest, 1e-6)
    low, high = corners[..., 2].min(axis=1), corners[..., 2].max(axis=1)
    sin_low = np.clip(low / np.where(low < 0, near, farthest), -1, 1)
    sin_high = np.clip(high / np.where(high > 0, near, farthest), -1, 1)
    first = np.searchsorted(elevations, np.arcsin(sin_low) - margin)
    return first, np.searchsorted(elevations, np.arcsin(sin_high) + margin, side="right")


def _hits(
    lidar: LidarSensor, rotation: Floats, origin: Floats, half: Floats, box: Ints, azimuth: Ints, channels: Ints
) -> tuple[Ints, Ints, Floats, Floats]:
    """Slab test of every beam in the columns.

    Returns box, beam, distance and direction (sensor frame) of the beams that hit.
    """
    azimuths, elevations = lidar.azimuths, lidar.elevations
    horizontal = np.stack([np.cos(azimuths), np.sin(azimuths)])[:, azimuth]
    count = channels[:, 1] - channels[:, 0]
    column = np.repeat(np.arange(len(box)), count)
    channel = np.arange(len(column)) - np.repeat(np.cumsum(count) - count - channels[:, 0], count)
    flat, rise = np.cos(elevations)[channel], np.sin(elevations)[channel]
    enter = np.zeros(len(column))
    leave = np.full(len(column), lidar.max_range_m)
    for axis in range(3):
        along = rotation[box, axis, 0] * horizontal[0] + rotation[box, axis, 1] * horizontal[1]
        direction = flat * along[column] + rise * rotation[box, axis, 2][column]
        # Avoids division by zero for a beam parallel to a face.
        direction = np.where(np.abs(direction) < 1e-12, 1e-12, direction)
        centre = (-origin[box, axis])[column] / direction
        half_span = half[box, axis][column] / np.abs(direction)
        np.maximum(enter, centre - half_span, out=enter)
        np.minimum(leave, centre + half_span, out=leave)
    hit = np.flatnonzero(enter <= leave)
    column, channel = column[hit], channel[hit]
    directions = np.stack(
        [flat[hit] * horizontal[0][column], flat[hit] * horizontal[1][column], rise[hit]],
        axis=1,
    )
    return box[column], azimuth[column] * lidar.channels + channel, enter[hit], directions


def _nearest(box: Ints, beam: Ints, distance: Floats, direction: Floats) -> tuple[Ints, Ints, Floats, Floats]:
    """The nearest hit of each beam: box, beam, distance, direction."""
    order = np.lexsort((distance, beam))
    first = order[np.flatnonzero(np.diff(beam[order], prepend=-1))]
    return box[first], beam[first], distance[first], direction[first]


def _behind_walls(origin: Floats, ends: Floats, box: Ints, walls: Walls) -> NDArray[np.bool_]:
    """Whether a wall blocks the line from `origin` to each hit in `ends` (n, 3).

    box: (n,) box of each hit
    """
    blocked = np.zeros(len(ends), bool)
    order = np.argsort(box, kind="stable")
    sight = ends[order, :2] - origin[:2]
    start, stop = walls.start - origin[:2], walls.end - origin[:2]
    # Only a wall that meets the bounding box and the sector of all sight lines to a box can occlude it.
    box_start = np.flatnonzero(np.diff(box[order], prepend=-1))
    count = np.diff(box_start, append=len(order))
    low = np.minimum(np.minimum.reduceat(sight, box_start), 0.0)
    high = np.maximum(np.maximum.reduceat(sight, box_start), 0.0)
    wall_low, wall_high = np.minimum(start, stop), np.maximum(start, stop)
    candidates = np.logical_and.reduce((wall_low[None] <= high[:, None]) & (wall_high[None] >= low[:, None]), axis=2)
    middle = np.add.reduceat(sight, box_start)
    side = np.repeat(middle, count, axis=0)
    turn = np.arctan2(_cross(side, sight), np.einsum("ij,ij->i", side, sight))
    min_turn, max_turn = np.minimum.reduceat(turn, box_start), np.maximum.reduceat(turn, box_start)
    all_around = (max_turn - min_turn >= np.pi)[:, None]
    for extreme, sign in ((min_turn, 1.0), (max_turn, -1.0)):
        c, s = np.cos(extreme), np.sin(extreme)
        edge = np.stack([c * middle[:, 0] - s * middle[:, 1], s * middle[:, 0] + c * middle[:, 1]], axis=1)
        in_sector = np.maximum(sign * _cross(edge[:, None], start), sign * _cross(edge[:, None], stop)) >= -1e-9
        candidates &= in_sector | all_around
    hit, wall = np.nonzero(np.repeat(candidates, count, axis=0))
    span = (stop - start)[wall]
    line = sight[hit]
    cross = _cross(line, span)
    cross = np.where(np.abs(cross) < 1e-12, np.nan, cross)  # parallel: never crosses
    along_sight = _cross(start[wall], span) / cross
    along_wall = _cross(start[wall], line) / cross
    height = origin[2] + along_sight * (ends[order[hit], 2] - origin[2])
    crosses = (
        (along_sight > 0) & (along_sight < 1) & (along_wall >= 0) & (along_wall <= 1) & (height <= walls.top[wall])
    )
    blocked[order[hit[crosses]]] = True
    return blocked


def _cross(one: Floats, other: Floats) -> Floats:
    """The z component of the cross product of vectors in the plane."""
    product: Floats = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
    return product


#: deg, approximate width and height of a cell.
CELL_DEG = (2.0, 2.0)
#: Least number of cells from the lowest to the highest channel.
MIN_BANDS = 16
#: Rays through a cell, across and up.
RAYS = (4, 2)


@dataclass(frozen=True, slots=True, eq=False)
class SweepRays:
    """The rays that sample the free space of a lidar.

    lidar: with the rays as its beams; bands, sectors: numbers of cells up and across
    """

    lidar: LidarSensor
    bands: int
    sectors: int

    @classmethod
    def of(cls, lidar: LidarSensor) -> SweepRays:
        """The rays of a lidar."""
        width = lidar.azimuth_max_deg - lidar.azimuth_min_deg
        height = lidar.elevation_max_deg - lidar.elevation_min_deg
        sectors, bands = max(1, round(width / CELL_DEG[0])), max(MIN_BANDS, round(height / CELL_DEG[1]))
        height /= bands * RAYS[1]
        return cls(
            replace(
                lidar,
                azimuth_step_deg=width / (sectors * RAYS[0]),
                elevation_min_deg=lidar.elevation_min_deg + height / 2,
                elevation_max_deg=lidar.elevation_max_deg - height / 2,
                channels=bands * RAYS[1],
            ),
            bands,
            sectors,
        )

    def directions(self) -> Floats:
        """(rays, 3) unit vectors in the sensor frame, by azimuth, then channel."""
        return unit_vectors(self.lidar.azimuths[:, None], self.lidar.elevations).reshape(-1, 3)

    def background(self, position: Floats, rotation: Floats, walls: Walls) -> Floats:
        """(rays,) m to the nearest wall or the end of the range.

        position: (3,) m, rotation: (3, 3) active: the sensor's pose in the world
        """
        directions = self.directions() @ rotation.T
        depth = np.full(len(directions), self.lidar.max_range_m)
        bearing = np.arctan2(directions[:, 1], directions[:, 0])
        order = np.argsort(bearing)
        start, end = walls.start - position[:2], walls.end - position[:2]
        for row in np.flatnonzero(distance_to(start, end) <= self.lidar.max_range_m):
            rays = order[_within(bearing[order], start[row], end[row])]
            distance = _distance_along(directions[rays], start[row], end[row], walls.top[row] - position[2])
            depth[rays] = np.minimum(depth[rays], distance)
        return depth

    def sweep(
        self,
        background: Floats,
        position: Floats,
        rotation: Floats,
        boxes: tuple[Floats, Floats, Floats],
        own: int = -1,
    ) -> Floats:
        """(bands, sectors) m that each cell is free.

        background: (rays,) m, see `background`; position, rotation: of the sensor in the world
        boxes: position (n, 3) m, size (n, 3) m and yaw (n,) rad of the road users, world frame
        own: row of the box that carries the sensor; -1: none
        """
        depth = background.copy()
        beam, distance = first_hits(self.lidar, position, rotation, *boxes, own)
        depth[beam] = np.minimum(depth[beam], distance)
        cells = depth.reshape(self.sectors, RAYS[0], self.bands, RAYS[1]).min(axis=(1, 3))
        return np.ascontiguousarray(cells.T)


def distance_to(start: Floats, end: Floats) -> Floats:
    """(w,) m from the origin to segments (w, 2)."""
    span = end - start
    length = np.maximum(np.einsum("ij,ij->i", span, span), 1e-12)
    along = np.clip(-np.einsum("ij,ij->i", start, span) / length, 0.0, 1.0)
    nearest: Floats = np.linalg.norm(start + along[:, None] * span, axis=1)
    return nearest


def _within(bearing: Floats, start: Floats, end: Floats) -> Ints:
    """Rows of `bearing` (m,) rad, ascending, between the bearings of two points (2,)."""
    first, last = np.arctan2(start[1], start[0]), np.arctan2(end[1], end[0])
    low, high = min(first, last), max(first, last)
    left, right = np.searchsorted(bearing, (low, high))
    if high - low <= np.pi:
        return np.arange(left, right)
    return np.concatenate([np.arange(left), np.arange(right, len(bearing))])  # across the negative x axis


def _distance_along(directions: Floats, start: Floats, end: Floats, top: float) -> Floats:
    """(m,) m along unit vectors (m, 3) to a wall from `start` to `end` (2,), relative to the sensor; infinite: misses.

    top: m, height of its upper edge above the sensor
    """
    span = end - start
    cross = directions[:, 0] * span[1] - directions[:, 1] * span[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (start[0] * span[1] - start[1] * span[0]) / cross
        met = (along > 0.0) & (along * directions[:, 2] <= top)
    return np.where(met, along, np.inf)


class PlacedSensor(NamedTuple):
    """A lidar at one time.

    position: (3,) m, rotation: (3, 3) active: of the lidar in the world (`sensing.sensor_pose`)
    own: id of the object that carries it, which occludes nothing; -1: none
    """

    lidar: LidarSensor
    position: Floats
    rotation: Floats
    own: int = -1


def observable(
    position: Floats,
    size: Floats,
    yaw: Floats,
    sensors: Sequence[PlacedSensor],
    walls: Walls | None,
    occluders: ObjectStates,
) -> NDArray[np.int32]:
    """(n, a) lidar returns that each of a sensors would have from each of n objects, if it were real.

    position: (n, 3) m, centre, size: (n, 3) m, yaw: (n,) rad, of the objects, world frame; they do not hide each other
    walls: None: none;  occluders: the real objects of that time

    An observer that has none where it should have some knows that the object is not there.
    """
    returns = np.zeros((len(position), len(sensors)), np.int32)
    for column, sensor in enumerate(sensors):
        others = occluders.select(occluders.id != sensor.own) if sensor.own >= 0 else occluders
        for row in range(len(position)):
            before = _in_the_way(sensor.position, position[row], size[row], others)
            boxes = (
                np.concatenate([position[None, row], others.position[before]]),
                np.concatenate([size[None, row], others.size[before]]),
                np.concatenate([yaw[None, row], others.yaw[before]]),
            )
            returns[row, column] = lidar_points(sensor.lidar, sensor.position, sensor.rotation, *boxes, walls)[0]
    return returns


@kernel
def has_returns(
    position: Floats,
    size: Floats,
    yaw: Floats,
    sensor: PlacedSensor,
    walls: Walls | None,
    occluders: ObjectStates,
    least: int,
) -> Bools:
    """(n,) whether a sensor would have `least` or more lidar returns from each of n objects, if it were real.

    The other parameters are those of `observable`. Compiled, it is faster, as it stops at the last return that matters.
    """
    return observable(position, size, yaw, [sensor], walls, occluders)[:, 0] >= least


def _in_the_way(origin: Floats, position: Floats, size: Floats, others: ObjectStates) -> Ints:
    """Rows of `others` that may hide an object from a sensor at `origin`."""
    offset = others.position[:, :2] - origin[:2]
    distance, target = np.hypot(*offset.T), position[:2] - origin[:2]
    far, radius = float(np.hypot(*target)), float(np.hypot(*size[:2])) / 2
    radii = np.hypot(*others.size[:, :2].T) / 2
    apart = np.abs(wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - np.arctan2(target[1], target[0])))
    width = _half_angle(radii, distance) + _half_angle(np.array(radius), np.array(far))
    return np.flatnonzero((apart <= width) & (distance - radii <= far + radius))


def _half_angle(radius: Floats, distance: Floats) -> Floats:
    """rad, half the angle under which circles are seen; pi from inside."""
    ratio = np.divide(radius, distance, out=np.full(np.shape(distance), 2.0), where=distance > 0.0)
    return np.where(ratio < 1.0, np.arcsin(np.minimum(ratio, 1.0)), np.pi)

"""Lidar returns by ray casting against boxes and walls.

Each beam returns from the nearest box unless a wall is in between.

The test is exact for upright boxes and vertical walls. It is fast because a box is only tested against the beams in
its angular window, and walls only against the beams that hit a box.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import box_corners, to_local, wrap_angle
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.sensing.lidar import LidarSensor


@dataclass(frozen=True, eq=False)
class Walls:
    """w vertical walls, opaque from far below the ground up to `top`.

    start, end: (w, 2) m, world frame
    top:        (w,) m, z of the upper edge in the world frame
    """

    start: Floats
    end: Floats
    top: Floats

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


def lidar_points(
    lidar: LidarSensor,
    sensor_position: Floats,
    sensor_rotation: Floats,
    position: Floats,
    size: Floats,
    yaw: Floats,
    walls: Walls | None = None,
    own: int = -1,
) -> NDArray[np.int32]:
    """(n,) lidar returns of each of n upright boxes.

    sensor_position (3,) m and sensor_rotation (3, 3) active: the lidar's pose in the world (`sensing.sensor_pose`).
    position (n, 3) m centre, size (n, 3) m l w h, yaw (n,) rad: the boxes in the world.
    own: row of the box that carries the lidar; it occludes nothing and has no returns. -1: none.
    """
    points = np.zeros(len(position), np.int32)
    box, _, distance, direction = _nearest_hits(lidar, sensor_position, sensor_rotation, position, size, yaw, own)
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

    # Elevation from height and distance: sin(elevation) = z / d, with d between nearest and farthest.
    farthest = np.linalg.norm(corners, axis=2).max(axis=1)
    z_low, z_high = corners[..., 2].min(axis=1), corners[..., 2].max(axis=1)
    near = np.maximum(nearest, 1e-6)
    sin_low = np.clip(z_low / np.where(z_low < 0, near, farthest), -1, 1)
    sin_high = np.clip(z_high / np.where(z_high > 0, near, farthest), -1, 1)
    first = np.searchsorted(elevations, np.arcsin(sin_low) - 1e-9)
    last = np.searchsorted(elevations, np.arcsin(sin_high) + 1e-9, side="right")

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

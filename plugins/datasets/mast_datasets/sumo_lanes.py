"""The way of a driven car through SUMO's lanes: where it leads, how fast, and where the car has to stop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from mast_datasets.sumo_simulation import Foe
from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import Floats

#: m, how far ahead of a car its route is told.
HORIZON_M = 80
#: m/s^2, at most, along and across a lane: as in generated junctions.
_COMFORT = 1.5
#: m/s^2: a car that would have to brake harder for a yellow light goes on.
_FIRM_BRAKING = 3.0
#: m, on either side of a place, over which the curvature of a lane is measured.
_CURVATURE_M = 3.0
_SAME_M = 0.01  # points nearer to each other are the same
#: States of links, as SUMO writes them, at which a car stops, and stops if it can; and those where it stands once.
_RED, _YELLOW, _STAND_ONCE = "ru", "yY", "sw"


class SumoLane(NamedTuple):
    """A lane of a network.

    shape: (k, 2) m, k >= 2;  limit: m/s;
    links: (next lane, first lane of the junction between or "", direction) of each
    """

    shape: Floats
    limit: float
    links: Sequence[tuple[str, str, str]]


class StopLine(NamedTuple):
    """The end of a lane of a way.

    at: m along the way;  lane: that ends;  link: row of the way's link among those of the lane
    via: first lane of the junction behind it, "": none
    """

    at: float
    lane: str
    link: int
    via: str


class Way(NamedTuple):
    """The lanes that a car follows, one after the other, without changing to a lane beside it.

    lanes: their names;  limit: (l,) m/s, of each
    start: (l + 1,) m, where each begins along the way, and where the last one ends
    position: (k, 2) m, every metre;  speed: (k,) m/s, the greatest: the limit, and what bends allow
    lines: where a car may have to stop, ascending;  is_dead_end: whether no lane leads on
    """

    lanes: Sequence[str]
    limit: Floats
    start: Floats
    position: Floats
    speed: Floats
    lines: Sequence[StopLine]
    is_dead_end: bool

    @property
    def length(self) -> float:
        """m, of the way."""
        return float(self.start[-1])

    def along(self, position: Floats, near: float) -> float:
        """m along the way to its point that is nearest to a position (2,) m, not farther than 15 m from `near` m."""
        first = max(0, int(near) - 15)
        part = self.position[first : int(near) + 16]
        if not len(part):
            return self.length
        row = int(np.argmin(np.hypot(*(part - position).T)))
        k = min(first + row, len(self.position) - 2)
        step = self.position[k + 1] - self.position[k]
        return max(0.0, k + float((position - self.position[k]) @ step) / max(float(step @ step), 1e-9))

    def duration_s(self, front: float, factor: float, fastest: float) -> float:
        """s, at least, from a place m along the way to its end. factor: of limits;  fastest: m/s"""
        rest = np.diff(np.maximum(self.start, front))
        return float((rest / np.maximum(np.minimum(self.limit * factor, fastest), 0.1)).sum())

    def row_at(self, along: float) -> int:
        """The row of the lane at a place m along the way."""
        return int(np.clip(np.searchsorted(self.start, along, side="right") - 1, 0, len(self.lanes) - 1))

    def lane_at(self, along: float) -> tuple[str, int]:
        """The edge, and the row of its lane, at a place m along the way."""
        edge, _, lane = self.lanes[self.row_at(along)].rpartition("_")
        return edge, int(lane)

    @property
    def edges(self) -> list[str]:
        """The edges of its lanes, without those of junctions."""
        return [lane.rpartition("_")[0] for lane in self.lanes if not lane.startswith(":")]

    def lines_ahead(self, front: float) -> list[StopLine]:
        """The lines within the horizon of a car whose front is at a place m along the way."""
        return [line for line in self.lines if -_SAME_M <= line.at - front <= HORIZON_M]

    def ahead(self, along: float) -> tuple[Floats, Floats]:
        """Points (k, 2) m, 1 m apart, from a place m along the way on, and the greatest speed (k,) m/s at each."""
        last = len(self.position) - 1
        places = along + np.arange(HORIZON_M + 1)
        places = np.minimum(places[: max(2, int(last - along) + 1)], last)
        rows = np.minimum(places.astype(int), last - 1)
        share = (places - rows)[:, None]
        points = self.position[rows] * (1.0 - share) + self.position[rows + 1] * share
        if len(points) == 2:  # at the end of the way: straight on
            step = self.position[-1] - self.position[-2]
            points[1] = points[0] + step / max(float(np.hypot(*step)), 1e-9)
        return points, self.speed[rows]


def way_from(lane: str, edges: Sequence[str], length_m: float, lane_of: Callable[[str], SumoLane]) -> Way:
    """The way that begins with a lane, and leads along edges as far as its lanes do; at a fork elsewhere straight on.

    edges: of the car's route, after that of the lane;  length_m: m, at which it may end;  lane_of: by its name
    """
    names, lines, shapes, limits = [lane], [], [lane_of(lane).shape], [lane_of(lane).limit]
    ends = [_length(shapes[0])]
    wanted = list(edges)
    while ends[-1] < length_m:
        links = lane_of(names[-1]).links
        if not links:
            break
        inside = names[-1].startswith(":")
        row = 0 if inside else _choose(links, wanted)
        target, via, _ = links[row]
        if not inside:
            lines.append(StopLine(ends[-1], names[-1], row, via))
        names.append(via or target)
        if names[-1] == target and wanted and target.rpartition("_")[0] == wanted[0]:
            wanted.pop(0)
        elif names[-1] == target:
            wanted = []  # its lanes lead elsewhere than its route
        shapes.append(lane_of(names[-1]).shape)
        limits.append(lane_of(names[-1]).limit)
        ends.append(ends[-1] + _length(shapes[-1]))
    start = np.array([0.0, *ends])
    corners = np.concatenate(shapes)
    distinct = np.concatenate([[True], np.hypot(*np.diff(corners, axis=0).T) > _SAME_M])
    corners = corners[distinct]
    if len(corners) < 2:
        corners = np.stack([corners[0], corners[0] + [1.0, 0.0]])
    distance = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    places = np.append(np.arange(0.0, distance[-1], 1.0), distance[-1] + 1.0)
    position = np.stack([np.interp(places, distance, corners[:, axis]) for axis in (0, 1)], axis=1)
    if len(position) > 2:  # the last one is a metre after the one before, also beyond the end
        position[-1] = position[-2] + (position[-2] - position[-3])
    part = np.clip(np.searchsorted(start, places, side="right") - 1, 0, len(limits) - 1)
    limit, is_dead_end = np.array(limits), not lane_of(names[-1]).links
    return Way(names, limit, start, position, _speeds(position, limit[part]), lines, is_dead_end)


def _length(shape: Floats) -> float:
    return float(np.hypot(*np.diff(shape, axis=0).T).sum())


def _choose(links: Sequence[tuple[str, str, str]], wanted: Sequence[str]) -> int:
    """The link that leads to the next edge of a route; without one the straightest."""
    order, towards = "sRrLlt", [target.rpartition("_")[0] for target, _, _ in links]
    if wanted and wanted[0] in towards:
        return towards.index(wanted[0])
    return min(range(len(links)), key=lambda row: (order.find(links[row][2]) % (len(order) + 1), row))


def _speeds(position: Floats, limit: Floats) -> Floats:
    """(k,) m/s, greatest speeds at points (k, 2) 1 m apart: the limit, and what is comfortable in and before bends."""
    step = np.diff(position, axis=0)
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    reach = int(_CURVATURE_M)
    padded = np.pad(heading, (reach, reach), mode="edge")
    turned = wrap_angle(padded[2 * reach :] - padded[: -2 * reach])
    curvature = np.abs(np.append(turned, 0.0)) / (2.0 * _CURVATURE_M)
    speed = np.minimum(limit, np.sqrt(_COMFORT / np.maximum(curvature, 1e-4)))
    for k in range(len(speed) - 2, -1, -1):  # slow down in time for the next point
        speed[k] = min(speed[k], np.sqrt(speed[k + 1] ** 2 + 2.0 * _COMFORT))
    return np.asarray(np.maximum(speed, 0.5))


#: s, between two vehicles at the same place of a junction.
_MARGIN_S = 1.5
#: s, after which a car that waits goes before others that stand.
_PATIENCE_S = 8.0
_STANDING_MPS = 0.3
_STOPPED_M = 4.0  # before the line, where a car counts as waiting at it
_START = 2.0  # m/s^2, from a standstill


class Priority:
    """Where one car has to stop, from lights, signs and others: what it remembers is how long it has waited.

    period_s: s, between two frames
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._waited_s = 0.0
        self._stood_at: str | None = None  # the lane at whose end it has stood

    def stop(
        self,
        lines: Sequence[tuple[StopLine, float, str]],
        speed: float,
        length: float,
        foes: Sequence[tuple[Foe, float]],
    ) -> float:
        """m from the car's front to where it has to stop; inf: nowhere.

        lines: ahead, with the distance m of each and the state of its link;  speed: m/s, and length: m, of the car
        foes:  at the next junctions, with their speeds m/s
        """
        waiting = bool(lines) and lines[0][1] < _STOPPED_M and speed < _STANDING_MPS
        self._waited_s = self._waited_s + self._period_s if waiting else 0.0
        if waiting:
            self._stood_at = lines[0][0].lane
        for line, distance, state in lines:
            needed = speed**2 / (2.0 * _FIRM_BRAKING)
            must = state in _RED or (state in _YELLOW and needed < distance)
            must = must or (state in _STAND_ONCE and self._stood_at != line.lane)
            if must or any(
                self._gives_way(foe, foe_speed, speed, length)
                for foe, foe_speed in foes
                if (foe.yields or foe.is_inside) and foe.lane == line.via
            ):
                return max(distance, 0.0)
        return np.inf

    def _gives_way(self, foe: Foe, foe_speed: float, speed: float, length: float) -> bool:
        """Whether the car and another would be at the same place at the same time, more or less."""
        if foe_speed < _STANDING_MPS and self._waited_s > _PATIENCE_S:
            return False
        begins = _earliest(foe.distance, speed)
        ends = max(foe.exit + length, 0.0) / max(speed, 2.0)
        foe_begins = _earliest(foe.foe_distance, foe_speed)
        foe_ends = max(foe.foe_exit, 0.0) / max(foe_speed, 1.0)
        return foe_begins < ends + _MARGIN_S and foe_ends > begins - _MARGIN_S


def _earliest(distance: float, speed: float) -> float:
    """s until a vehicle gets somewhere that accelerates from now on."""
    distance = max(distance, 0.0)
    return float((np.sqrt(speed**2 + 2.0 * _START * distance) - speed) / _START)

"""Conflicts between paths of a junction, and conflict-free traffic lights.

A *mover* on a path sweeps an area, here a chain of discs. Two connectors (paths across the junction) conflict if their
swept areas meet. Lights are derived from the conflicts: groups of connectors without conflicts share a phase, and
every group has at least one phase.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.scenes.generated.junction import BIKE, CROSSER, ROAD, JunctionLane, SampledCurve

#: Length and width m of the largest mover of each kind: short road vehicles, long ones, bicycles, pedestrians.
SHORT, LONG = 0, 1
_FOOTPRINT = {
    (ROAD, SHORT): (5.2, 2.0),
    (ROAD, LONG): (12.0, 2.55),
    (BIKE, SHORT): (1.9, 0.7),
    (CROSSER, SHORT): (0.7, 0.7),
}
_CLEARANCE = 0.2  # m
#: s, by which a mover that started late may still be on its connector when the light has turned red.
LATE_S = 3.0
#: m/s, speed of the slowest mover of each kind; and s, the least time for it to start.
_SLOWEST = {ROAD: 8.0, BIKE: 4.0, CROSSER: 1.1}
_START_S = 4.0
_TAIL = 15.0  # m, ends of adjacent lanes that a turning vehicle's sweep must not reach


def _sweep(
    path: SampledCurve, footprint: tuple[float, float], begin: float = 0.0, end: float = np.inf
) -> tuple[Floats, float]:
    """Discs that cover the area swept by a box along a path.

    Centres (k, 2) m and radius m; footprint: length and width of the box, m.
    """
    length, width = footprint
    count = max(1, round(length / 1.6))
    distance = np.linspace(0.0, path.length, len(path.points))
    sampled = slice(None, None, 4)  # every metre
    inside = (distance[sampled] >= begin) & (distance[sampled] <= end)
    along = ((np.arange(count) + 0.5) / count - 0.5) * length
    forward = np.stack([np.cos(path.yaw[sampled]), np.sin(path.yaw[sampled])], axis=1)[inside]
    discs = path.points[sampled][inside][:, None, :] + forward[:, None, :] * along[None, :, None]
    return discs.reshape(-1, 2), float(np.hypot(length / count / 2, width / 2))


def _meet(one: tuple[Floats, float], other: tuple[Floats, float]) -> bool:
    return bool(_distances(one[0], other[0]).min(initial=np.inf) < one[1] + other[1] + _CLEARANCE)


def _distances(a: Floats, b: Floats) -> Floats:
    """(n, m) m, distances between positions (n, 2) and (m, 2)."""
    from scipy.spatial.distance import cdist  # slow to import, and most runs use a cached scene

    return cdist(a, b)


def _footprints(lane: JunctionLane) -> list[int]:
    return [SHORT, LONG] if lane.user == ROAD else [SHORT]


def origins(lanes: Sequence[JunctionLane]) -> Ints:
    """(P,) the lane in which each connector begins; -1 for other lanes."""
    result = np.full(len(lanes), -1)
    for row, lane in enumerate(lanes):
        if not lane.connector:
            for target in lane.follow:
                if lanes[target].connector:
                    result[target] = row
    return result


def conflicts(lanes: Sequence[JunctionLane]) -> Bools:
    """Conflicts (2 P, 2 P) between connectors.

    Row 2 p + c is mover class c on path p.
    Connectors that begin in the same lane do not conflict: their movers follow each other at a distance.
    """
    result = np.zeros((2 * len(lanes), 2 * len(lanes)), bool)
    swept = [
        (2 * row + size, row, _sweep(lane.path, _FOOTPRINT[lane.user, size]))
        for row, lane in enumerate(lanes)
        if lane.connector
        for size in _footprints(lane)
    ]
    origin = origins(lanes)
    for k, (i, row, one) in enumerate(swept):
        for j, other_row, other in swept[k + 1 :]:
            if row != other_row and origin[row] != origin[other_row] and _meet(one, other):
                result[i, j] = result[j, i] = True
    return result


def passable(lanes: Sequence[JunctionLane]) -> Bools:
    """Whether a mover class can use a path (P, 2).

    A mover must not reach into adjacent lanes or a dead end.
    A long vehicle swings out in a tight turn and could hit vehicles waiting beside it. A lane without a passable
    continuation for long vehicles is not passable for them either.
    """
    result = np.ones((len(lanes), 2), bool)
    waiting = {
        row: [
            _sweep(lane.path, _FOOTPRINT[lane.user, SHORT], end=_TAIL),
            _sweep(lane.path, _FOOTPRINT[lane.user, SHORT], begin=lane.path.length - _TAIL),
        ]
        for row, lane in enumerate(lanes)
        if not lane.connector and lane.user in (ROAD, BIKE)
    }
    origin = origins(lanes)
    for row, lane in enumerate(lanes):
        result[row, LONG] = lane.user == ROAD
        if lane.connector and lane.user == ROAD:
            for size in _footprints(lane):
                sweep = _sweep(lane.path, _FOOTPRINT[ROAD, size])
                beside = [k for k in waiting if k != origin[row] and k not in lane.follow]
                result[row, size] = not any(_meet(sweep, tail) for k in beside for tail in waiting[k])
    for _ in lanes:
        for row, lane in enumerate(lanes):
            result[row] &= result[list(lane.follow)].any(axis=0)
    return result


def shared(lanes: Sequence[JunctionLane]) -> Floats:
    """(P, P) m, the distance along path q up to which a mover there obstructs path p.

    Infinite for p = q; for two connectors out of the same lane, where they diverge; -inf for all others.
    """
    result = np.full((len(lanes), len(lanes)), -np.inf)
    np.fill_diagonal(result, np.inf)
    for lane in lanes:
        for p in lane.follow:
            for q in lane.follow:
                if p != q:
                    one, other = lanes[p].path, lanes[q].path
                    apart = _distances(other.points, one.points).min(axis=1) > 3.2
                    result[p, q] = other.length * float(np.argmax(apart)) / len(apart) if apart.any() else other.length
    return result


@dataclass(frozen=True, eq=False)
class Lights:
    """Fixed-time traffic lights.

    green:    (phases, P) whether a connector has green in a phase
    begin:    (phases,) s, when each begins in the cycle
    length:   (phases,) s, of green; then everything is red until the next phase
    cycle:    s
    """

    green: Bools
    begin: Floats
    length: Floats
    cycle: float

    def now(self, time: float) -> tuple[Bools, float]:
        """Whether each connector (P,) has green at `time` s, and the remaining green s."""
        cycle_time = time % self.cycle
        phase = int(np.searchsorted(self.begin, cycle_time, side="right")) - 1
        remaining = float(self.begin[phase] + self.length[phase] - cycle_time)
        return (self.green[phase], remaining) if remaining > 0 else (np.zeros_like(self.green[phase]), 0.0)


def lights(lanes: Sequence[JunctionLane], conflict: Bools, green_s: float, red_s: float) -> Lights:
    """Lights for a junction.

    Phases of `green_s` s or more, each followed by `red_s` s of red for all.
    """
    groups: dict[tuple[int, int, int], list[int]] = {}
    for row, lane in enumerate(lanes):
        if lane.connector:
            groups.setdefault((lane.user, lane.arm, lane.target), []).append(row)

    def priority(group: tuple[int, int, int]) -> tuple[int, float, tuple[int, int, int]]:
        # Straight on first, then left, then right; motor vehicles before bicycles before pedestrians.
        turn = lanes[groups[group][0]].turn
        return (0 if abs(turn) < 0.6 else 1 if turn > 0 else 2, float(group[0]), group)

    def compatible(group: tuple[int, int, int], phase: list[int]) -> bool:
        rows = np.array([2 * row + SHORT for row in groups[group]])
        return not conflict[np.ix_(rows, 2 * np.array(phase, np.int64) + SHORT)].any()

    order = sorted(groups, key=priority)
    waiting = list(order)
    phases: list[list[int]] = []
    while waiting:
        phase: list[int] = []
        for group in waiting + [group for group in order if group not in waiting]:
            if compatible(group, phase):
                phase += groups[group]
        waiting = [group for group in waiting if groups[group][0] not in phase]
        phases.append(phase)
    green = np.zeros((len(phases), len(lanes)), bool)
    for index, phase in enumerate(phases):
        green[index, phase] = True
    # Long enough for the slowest mover to start and cross.
    length = [
        max(green_s, *(lanes[row].path.length / _SLOWEST[lanes[row].user] - LATE_S + _START_S for row in phase))
        for phase in phases
    ]
    end = np.cumsum(np.array(length) + red_s)
    return Lights(green, end - length - red_s, np.array(length), float(end[-1]))

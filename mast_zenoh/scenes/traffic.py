"""Traffic on a plan: everything that moves keeps to its lane, keeps its distance, slows for curves, stops at red.

Car following is the intelligent driver model (Treiber, Hennecke, Helbing: Congested traffic states in empirical
observations and microscopic simulations, Physical Review E 62, 2000), for bicycles and pedestrians too. A way over the
junction is entered only on green and only when nobody is on a way that conflicts with it, so that boxes never touch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.scenes.junction import ROAD, Lane
from mast_zenoh.scenes.paths import PathTable
from mast_zenoh.scenes.signals import LATE_S, LONG, SHORT, Lights, conflicts, lights, origins, passable, shared
from mast_zenoh.streams import stream

_STOP_AHEAD = 0.8  # m, where the front stops, before the stop line
_FIRM_BRAKING = 2.2  # m/s^2, who would have to brake harder passes
_HARDEST_BRAKING = 7.0
_COMFORT = 1.5  # m/s^2, along and across the path


@dataclass(frozen=True, eq=False)
class Movers:
    """n road users and how they drive; arrays of (n,).

    size: (n, 3) m;  user: ROAD, BIKE, CROSSER or WALKER;  speed: m/s wished for;  acceleration, braking: m/s^2, usual;
    headway: s;  gap: m, at a standstill;  path, start: where they begin
    """

    size: Floats
    user: Ints
    speed: Floats
    acceleration: Floats
    braking: Floats
    headway: Floats
    gap: Floats
    path: Ints
    start: Floats

    @property
    def size_class(self) -> Ints:
        """(n,) SHORT or LONG."""
        return np.where((self.user == ROAD) & (self.size[:, 0] > 5.2), LONG, SHORT)


@dataclass(frozen=True, eq=False)
class Network:
    """A plan with everything that traffic asks of it."""

    lanes: tuple[Lane, ...]
    table: PathTable
    conflict: Bools
    passable: Bools
    shared: Floats
    lights: Lights
    origin: Ints

    @classmethod
    def of(cls, lanes: tuple[Lane, ...], green_s: float, red_s: float) -> Network:
        """The network of a plan, with lights of `green_s` s green and `red_s` s red between phases."""
        conflict = conflicts(lanes)
        return cls(
            lanes,
            PathTable.of([lane.path for lane in lanes], _COMFORT, _COMFORT),
            conflict,
            passable(lanes),
            shared(lanes),
            lights(lanes, conflict, green_s, red_s),
            origins(lanes),
        )


@dataclass(frozen=True, eq=False)
class Motion:
    """Where n movers were in F frames: position (F, n, 2) m, yaw (F, n) rad, speed (F, n) m/s, path (F, n) row."""

    position: Floats
    yaw: Floats
    speed: Floats
    path: Ints

    def frames(self, index: slice) -> Motion:
        """Some of the frames."""
        return Motion(self.position[index], self.yaw[index], self.speed[index], self.path[index])


class Traffic:
    """A running simulation; `step` moves everything on."""

    def __init__(self, network: Network, movers: Movers, seed: int, name: str) -> None:
        """Movers at their start, standing. Each chooses its turns by a stream of its own, `stream(seed, name, i)`."""
        self.network, self.movers = network, movers
        self.time = 0.0
        n = len(movers.user)
        self._choice = [stream(seed, name, "route", i) for i in range(n)]
        self._size_class = movers.size_class
        #: Where each is, and the next two paths it will take: (n, 3).
        self.route = np.zeros((n, 3), np.int64)
        self.route[:, 0] = movers.path
        for i in range(n):
            for k in (1, 2):
                self.route[i, k] = self._onward(i, int(self.route[i, k - 1]))
        self.s = movers.start.copy()
        self.v = np.zeros(n)
        #: The connector whose right of way each holds, -1: none.
        self.granted = np.full(n, -1)
        #: Since when each asks for it in vain, s; inf: does not. Who has asked goes on asking, also when it has slowed
        #: down so far that there would be time yet.
        self.refused = np.full(n, np.inf)
        self._signalled = np.array(
            [bool(lane.follow) and network.lanes[lane.follow[0]].connector for lane in network.lanes]
        )

    def _onward(self, i: int, path: int) -> int:
        """A next path for mover i: straight on more often than not."""
        follow = self.network.lanes[path].follow
        size = self._size_class[i]
        ways = [row for row in follow if self.network.passable[row, size]] or list(follow)
        if len(ways) == 1:
            return ways[0]
        weight = np.array([3.0 if abs(self.network.lanes[row].turn) < 0.6 else 1.5 for row in ways])
        return ways[int(self._choice[i].choice(len(ways), p=weight / weight.sum()))]

    def motion(self) -> tuple[Floats, Floats, Floats, Ints]:
        """Position (n, 2) m, yaw (n,) rad, speed (n,) m/s and path (n,) of all, now."""
        points, yaw = self.network.table.pose(self.route[:, 0], self.s)
        return points, yaw, self.v.copy(), self.route[:, 0].copy()

    def run(self, frames: int, steps: int, dt: float) -> Motion:
        """The next `frames` frames, the present one first, `steps` steps of `dt` s apart."""
        log = []
        for _ in range(frames):
            log.append(self.motion())
            for _ in range(steps):
                self.step(dt)
        return Motion(*(np.stack(column) for column in zip(*log, strict=True)))

    def step(self, dt: float) -> None:
        """Move everything on by `dt` s."""
        m, table = self.movers, self.network.table
        end = table.length[self.route[:, 0]]
        gap, leader_speed = self._leader()
        to_line = end - self.s - m.size[:, 0] / 2
        held = self._right_of_way(to_line)
        acceleration = np.minimum(
            self._follow(gap, leader_speed),
            np.where(held, self._follow(to_line + m.gap - _STOP_AHEAD, np.zeros(len(gap))), np.inf),
        )
        ahead = table.limit_at(self.route[:, 1], np.zeros(len(gap)))
        wished = np.minimum(m.speed, table.limit_at(self.route[:, 0], self.s))
        wished = np.minimum(wished, np.sqrt(ahead**2 + 2 * _COMFORT * np.maximum(end - self.s, 0.0)))
        free = np.maximum(m.acceleration * (1.0 - (self.v / wished) ** 4), -m.braking)
        # The intelligent driver's acceleration is the free one plus the (negative) interaction.
        acceleration = np.clip(free + np.minimum(acceleration, 0.0), -_HARDEST_BRAKING, m.acceleration)
        faster = np.maximum(self.v + acceleration * dt, 0.0)
        self.s += (self.v + faster) / 2 * dt
        self.v = faster
        self.time += dt
        self._advance(end)

    def _leader(self) -> tuple[Floats, Floats]:
        """Free distance (n,) m to whoever is next on the way of each, and that one's speed (n,) m/s."""
        length = self.movers.size[:, 0]
        rear = self.s - length / 2
        best = np.full(len(self.s), np.inf)
        speed = np.zeros(len(self.s))
        offset = -self.s
        for k in range(3):
            there = rear[None, :] < self.network.shared[self.route[:, k]][:, self.route[:, 0]]
            distance = offset[:, None] + self.s[None, :]
            distance = np.where(there & (distance > 1e-9), distance - (length[:, None] + length[None, :]) / 2, np.inf)
            leader = distance.argmin(axis=1)
            nearest = distance[np.arange(len(leader)), leader]
            speed = np.where(nearest < best, self.v[leader], speed)
            best = np.minimum(best, nearest)
            offset = offset + self.network.table.length[self.route[:, k]]
        return best, speed

    def _follow(self, gap: Floats, leader_speed: Floats) -> Floats:
        """The interaction term of the intelligent driver model, (n,) m/s^2, negative."""
        m = self.movers
        closing = self.v * (self.v - leader_speed) / (2 * np.sqrt(m.acceleration * m.braking))
        wanted = m.gap + np.maximum(self.v * m.headway + closing, 0.0)
        interaction: Floats = -m.acceleration * (wanted / np.maximum(gap, 0.05)) ** 2
        return interaction

    def _right_of_way(self, to_line: Floats) -> Bools:
        """(n,) who has to stop at the line. Those about to pass it get the right of way here, or do not."""
        green, left = self.network.lights.now(self.time)
        way = self.route[:, 1]
        waiting = self._signalled[self.route[:, 0]] & (self.granted != way)
        # Nobody starts over what cannot be left before the light turns, give or take a little.
        need = self.network.table.length[way] / self.movers.speed - LATE_S
        held: Bools = waiting & ~(green[way] & (left >= need))
        decide = to_line < self.v**2 / (2 * _FIRM_BRAKING) + 1.5
        asking = np.flatnonzero(waiting & ~held & (decide | (self.refused < np.inf)))
        self.refused[~waiting | held] = np.inf
        holders = np.flatnonzero(self.granted >= 0)
        taken = list(2 * self.granted[holders] + self._size_class[holders])
        # Who has waited longest first, and nobody overtakes: else turning traffic would starve whoever is slower.
        for i in asking[np.lexsort((to_line[asking], self.refused[asking]))]:
            mine = 2 * way[i] + self._size_class[i]
            if self.network.conflict[mine, taken].any() or not self._room_beyond(int(i)):
                held[i] = True
                self.refused[i] = min(self.refused[i], self.time)
            else:
                self.granted[i] = way[i]
                self.refused[i] = np.inf
            taken.append(mine)
        return held

    def _room_beyond(self, i: int) -> bool:
        """Whether mover i would find room behind its way, counting those who are already on the way there."""
        m, beyond = self.movers, self.route[i, 2]
        there = np.flatnonzero(self.route[:, 0] == beyond)
        if not len(there):
            return True
        last = there[self.s[there].argmin()]
        coming = np.flatnonzero((self.granted >= 0) & (self.route[:, 1] == beyond) & (self.route[:, 0] == self.granted))
        # Where the last one would stop if it braked now.
        free = self.s[last] - m.size[last, 0] / 2 + self.v[last] ** 2 / (2 * _FIRM_BRAKING)
        return bool(free > m.size[i, 0] + 2 * m.gap[i] + float((m.size[coming, 0] + m.gap[coming]).sum()))

    def _advance(self, end: Floats) -> None:
        """Go on to the next path, and give back the right of way when the rear has left the way it was for."""
        for i in np.flatnonzero(self.s >= end):
            self.s[i] -= end[i]
            self.route[i] = (*self.route[i, 1:], self._onward(int(i), int(self.route[i, 2])))
        gone = (self.granted >= 0) & (self.network.origin[self.route[:, 0]] < 0)
        gone &= (self.route[:, 1] != self.granted) & (self.s - self.movers.size[:, 0] / 2 > 0)
        self.granted[gone] = -1

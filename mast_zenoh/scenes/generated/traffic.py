"""Traffic simulation: movers keep their lane and distance, and stop at red lights.

Car following is the intelligent driver model (Treiber, Hennecke, Helbing: Congested traffic states in empirical
observations and microscopic simulations, Physical Review E 62, 2000), for bicycles and pedestrians too. A mover
enters a connector only on green and only while no conflicting connector is occupied, so that boxes never touch.

Drivers that differ: how fast, how close behind each other and how late each drives is drawn per vehicle.

Time headways are log-normal, as measured ones are; the parameters are chosen so that the time gaps of moving followers
are about those of the clips of NGSIM: 20 % are below 1 s (15 % in the clips), and 5 % below 0.67 s, as in the clips.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenes.generated.junction import BIKE, CROSSER, ROAD, WALKER, JunctionLane, PathTable
from mast_zenoh.scenes.generated.signals import (
    LATE_S,
    LONG,
    SHORT,
    Lights,
    conflicts,
    lights,
    origins,
    passable,
    shared,
)
from mast_zenoh.streams import stream

# kind: user, class, (l, w, h) m smallest and largest, desired speed m/s, acceleration, braking m/s^2, headway s, gap m
_KINDS = {
    "car": (ROAD, "car", (4.0, 1.7, 1.4), (5.0, 1.95, 1.8), (10.5, 14.0), 1.6, 2.0, 1.2, 2.0),
    "truck": (ROAD, "truck", (7.0, 2.35, 2.8), (9.0, 2.5, 3.6), (9.5, 12.5), 1.0, 1.8, 1.5, 2.5),
    "bus": (ROAD, "bus", (11.0, 2.5, 3.0), (12.0, 2.5, 3.3), (9.5, 12.0), 1.0, 1.6, 1.5, 2.5),
    "bicycle": (BIKE, "bicycle", (1.7, 0.55, 1.6), (1.9, 0.7, 1.85), (4.0, 6.0), 0.9, 1.8, 1.0, 1.2),
    "crosser": (CROSSER, "pedestrian", (0.5, 0.5, 1.5), (0.7, 0.7, 1.9), (1.1, 1.6), 1.0, 1.5, 0.4, 0.5),
    "walker": (WALKER, "pedestrian", (0.5, 0.5, 1.5), (0.7, 0.7, 1.9), (0.9, 1.6), 1.0, 1.5, 0.4, 0.5),
}


def road_users(network: LaneNetwork, count: dict[str, int], random: np.random.Generator) -> tuple[Movers, list[str]]:
    """Road users spread over the lanes, and the class name of each.

    count: number of "vehicle", "bicycle" and "pedestrian". Raises ConfigurationError if there is not enough room.
    """
    vehicle = random.choice(["car", "truck", "bus"], size=count["vehicle"], p=[0.84, 0.1, 0.06])
    vehicle[0] = "car"  # the ego needs a car
    pedestrian = random.choice(["crosser", "walker"], size=count["pedestrian"], p=[0.5, 0.5])
    names = [*vehicle, *["bicycle"] * count["bicycle"], *pedestrian]
    places = {user: _places(network, user, random) for user in (ROAD, BIKE, CROSSER, WALKER)}
    room = {user: len(free) for user, free in places.items()}
    long_places = [place for place in places[ROAD] if network.passable[place[0], 1]]
    rows: list[tuple[int, float]] = []
    for i, name in enumerate(names):
        user = _KINDS[name][0]
        free = long_places if name in ("truck", "bus") else places[user]
        if not free and user == CROSSER:  # no room at the crossings: a walker on the pavement instead
            names[i], user, free = "walker", WALKER, places[WALKER]
        elif not free and name in ("truck", "bus"):  # no lane passable for long vehicles: a car instead
            names[i], free = "car", places[ROAD]
        if not free:
            users = (CROSSER, WALKER) if user == WALKER else (user,)
            wanted, most = sum(_KINDS[name][0] in users for name in names), sum(room[user] for user in users)
            what = {ROAD: "motor vehicles, the ego and n_mobile among them", BIKE: "bicycles"}.get(user, "pedestrians")
            raise ConfigurationError(f"Intersection: no room for {wanted}, expected at most {most} {what}")
        place = free[-1]
        for free_places in (places[user], long_places):
            if place in free_places:
                free_places.remove(place)
        rows.append(place)
    kinds = [_KINDS[name] for name in names]
    fraction = random.random((len(names), 4))
    low, high = np.array([kind[2] for kind in kinds]), np.array([kind[3] for kind in kinds])
    slow, fast = np.array([kind[4] for kind in kinds]).T
    acceleration, braking, headway, gap = np.array([kind[5:] for kind in kinds], np.float64).T
    movers = Movers(
        size=np.round(low + (high - low) * fraction[:, :3], 2),
        user=np.array([kind[0] for kind in kinds]),
        speed=slow + (fast - slow) * fraction[:, 3],
        acceleration=acceleration,
        braking=braking,
        headway=headway,
        gap=gap,
        path=np.array([path for path, _ in rows]),
        start=np.array([s for _, s in rows]),
        reaction=np.zeros(len(names)),
        guide=np.arange(len(names)),
    )
    return movers, [kind[1] for kind in kinds]


def _places(network: LaneNetwork, user: int, random: np.random.Generator) -> list[tuple[int, float]]:
    """Start positions (path, m along it) of a kind of movers, shuffled.

    They do not overlap.
    """
    spacing = {ROAD: 18.0, BIKE: 8.0, CROSSER: 2.2, WALKER: 4.0}[user]
    places = []
    landings = 0
    for row, lane in enumerate(network.lanes):
        if lane.user == user and not lane.connector and (user == WALKER or network.passable[row].any()):
            begin = 0.5 * spacing if user == ROAD else 0.6
            room = lane.path.length - (spacing if user in (ROAD, WALKER) else 1.0)
            if user == CROSSER:
                # A crossing with two full landings would block: on every second landing, one place stays free.
                room -= spacing * (landings % 2)
                landings += 1
            places += [(row, float(s)) for s in np.arange(begin, room, spacing)]
    return [places[k] for k in random.permutation(len(places))]


_STOP_AHEAD = 0.8  # m, distance between front and stop line when stopped
_FIRM_BRAKING = 2.2  # m/s^2, a mover that would have to brake harder does not stop
_HARDEST_BRAKING = 7.0
_LINE_HEADWAY_S = 1.2  # least, of drivers that differ, when they stop at a line
_EXPECTED_BRAKING = 2.5  # m/s^2, of the mover ahead: harder braking is a surprise
_COMFORT = 1.5  # m/s^2, along and across the path


@dataclass(frozen=True, eq=False)
class Movers:
    """n road users and how they drive; arrays of (n,).

    size: (n, 3) m;  user: ROAD, BIKE, CROSSER or WALKER;  speed: m/s, desired;  acceleration, braking: m/s^2, usual;
    headway: s;  gap: m, at a standstill;  path, start: initial path, and initial distance along it, m
    exact_headway: whether a follower keeps just its headway (IDM+: Schakel, van Arem, Netten: Effects of cooperative
              adaptive cruise control on traffic flow stability, ITSC 2010)
    reaction: s, after which it notices a change of speed of the mover ahead
    guide: the mover whose turns it takes; itself, if it is not in a platoon
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
    reaction: Floats
    guide: Ints
    exact_headway: bool = False

    @property
    def size_class(self) -> Ints:
        """(n,) SHORT or LONG."""
        return np.where((self.user == ROAD) & (self.size[:, 0] > 5.2), LONG, SHORT)


@dataclass(frozen=True, eq=False)
class LaneNetwork:
    """A plan with the tables that the simulation needs."""

    lanes: tuple[JunctionLane, ...]
    table: PathTable
    conflict: Bools
    passable: Bools
    shared: Floats
    lights: Lights
    origin: Ints

    @classmethod
    def of(cls, lanes: tuple[JunctionLane, ...], green_s: float, red_s: float) -> LaneNetwork:
        """The network of a plan.

        green_s, red_s: s, green phases of the lights, and red between them
        """
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
    """The motion of n movers in F frames.

    position (F, n, 2) m, yaw (F, n) rad, speed (F, n) m/s, path (F, n) row
    """

    position: Floats
    yaw: Floats
    speed: Floats
    path: Ints

    def frames(self, index: slice) -> Motion:
        """The selected frames."""
        return Motion(self.position[index], self.yaw[index], self.speed[index], self.path[index])

    def with_standing(self, position: Floats, yaw: Floats) -> Motion:
        """The motion of the movers, and then that of p objects that stand. position (p, 2) m, yaw (p,) rad"""
        frames, p = len(self.yaw), len(yaw)
        return Motion(
            np.concatenate([self.position, np.broadcast_to(position, (frames, p, 2))], axis=1),
            np.concatenate([self.yaw, np.broadcast_to(yaw, (frames, p))], axis=1),
            np.concatenate([self.speed, np.zeros((frames, p))], axis=1),
            np.concatenate([self.path, np.full((frames, p), -1)], axis=1),
        )


class Traffic:
    """A running simulation; `step` advances it."""

    def __init__(self, network: LaneNetwork, movers: Movers, seed: int, name: str) -> None:
        """Place the movers at their starting points, at rest.

        Mover i chooses its turns with its own random stream, or one that equals that of its guide.
        """
        self.network, self.movers = network, movers
        self.time = 0.0
        n = len(movers.user)
        self._choice = [stream(seed, name, "route", int(i)) for i in movers.guide]
        self._size_class = movers.size_class
        #: (n, 3), the current path of each mover and the next two.
        self.route = np.zeros((n, 3), np.int64)
        self.route[:, 0] = movers.path
        for i in range(n):
            for k in (1, 2):
                self.route[i, k] = self._next_path(i, int(self.route[i, k - 1]))
        self.s = movers.start.copy()
        self.v = np.zeros(n)
        self._travelled = np.zeros(n)  # m, since the beginning
        #: Time s, speed (n,) m/s and way travelled (n,) m of the last steps, as far back as the latest reaction.
        self._past: list[tuple[float, Floats, Floats]] = []
        #: (n,) connector on which a mover has the right of way; -1: none.
        self.granted = np.full(n, -1)
        #: (n,) s, time of the first refused request for the right of way; inf: no request. A mover keeps requesting,
        #: even if it has slowed down so much that it need not decide yet.
        self.refused = np.full(n, np.inf)
        #: (n,) whether each mover must stop at the line, by the last decision.
        self.must_stop = np.zeros(n, bool)
        self._signalled = np.array(
            [bool(lane.follow) and network.lanes[lane.follow[0]].connector for lane in network.lanes]
        )

    def _next_path(self, i: int, path: int) -> int:
        """Choose the next path of mover i, preferring straight on."""
        follow = self.network.lanes[path].follow
        size_class = self._size_class[i]
        successors = [row for row in follow if self.network.passable[row, size_class]] or list(follow)
        if len(successors) == 1:
            return successors[0]
        weight = np.array([3.0 if abs(self.network.lanes[row].turn) < 0.6 else 1.5 for row in successors])
        return successors[int(self._choice[i].choice(len(successors), p=weight / weight.sum()))]

    def motion(self) -> tuple[Floats, Floats, Floats, Ints]:
        """Position (n, 2) m, yaw (n,) rad, speed (n,) m/s and path (n,) of all movers now."""
        points, yaw = self.network.table.pose(self.route[:, 0], self.s)
        return points, yaw, self.v.copy(), self.route[:, 0].copy()

    def run(self, frames: int, steps: int, dt: float) -> Motion:
        """Simulate `frames` frames, beginning with the current one.

        Frames are `steps` steps of `dt` s apart.
        """
        log = []
        for _ in range(frames):
            log.append(self.motion())
            for _ in range(steps):
                self.step(dt)
        return Motion(*(np.stack(column) for column in zip(*log, strict=True)))

    def step(self, dt: float) -> None:
        """Advance the simulation by `dt` s."""
        self.move(self.decide(), dt)

    def decide(self) -> Floats:
        """Acceleration (n,) m/s^2 that each mover chooses now; grants rights of way, so once before each `move`."""
        movers, table = self.movers, self.network.table
        end = table.length[self.route[:, 0]]
        gap, leader_speed = self._noticed(*self._leader())
        to_line = end - self.s - movers.size[:, 0] / 2
        self.must_stop = self._right_of_way(to_line)
        # A close follower brakes for a line as early as others.
        for_line = np.maximum(movers.headway, _LINE_HEADWAY_S) if movers.exact_headway else movers.headway
        stopping = self._follow(to_line + movers.gap - _STOP_AHEAD, np.zeros(len(gap)), for_line)
        acceleration = np.minimum(
            self._follow(gap, leader_speed, movers.headway), np.where(self.must_stop, stopping, np.inf)
        )
        ahead = table.limit_at(self.route[:, 1], np.zeros(len(gap)))
        desired_speed = np.minimum(movers.speed, table.limit_at(self.route[:, 0], self.s))
        desired_speed = np.minimum(desired_speed, np.sqrt(ahead**2 + 2 * _COMFORT * np.maximum(end - self.s, 0.0)))
        free = np.maximum(movers.acceleration * (1.0 - (self.v / desired_speed) ** 4), -movers.braking)
        # The intelligent driver's acceleration is the free one plus the (negative) interaction. So it keeps more than
        # its headway, the more the closer it is to its desired speed; with IDM+, it keeps just its headway.
        interaction = np.minimum(acceleration, 0.0)
        wanted = np.minimum(free, movers.acceleration + interaction) if movers.exact_headway else free + interaction
        return np.asarray(np.clip(wanted, -_HARDEST_BRAKING, movers.acceleration))

    def move(self, acceleration: Floats, dt: float) -> None:
        """Move all movers for `dt` s. acceleration: (n,) m/s^2"""
        end = self.network.table.length[self.route[:, 0]]
        new_speed = np.maximum(self.v + acceleration * dt, 0.0)
        progress = self._progress((self.v + new_speed) / 2 * dt)
        self.s += progress
        self._travelled = self._travelled + progress
        self.v = new_speed
        self.time += dt
        self._advance(end)

    def _progress(self, distance: Floats) -> Floats:
        """Progress (n,) m along the paths of movers that drive a distance (n,) m."""
        return distance

    def _noticed(self, gap: Floats, leader: Ints) -> tuple[Floats, Floats]:
        """Free distance (n,) m to the mover ahead of each and its speed (n,) m/s, as the driver believes.

        A driver expects the mover ahead to brake as is usual for lights and queues, and follows at once; harder braking
        is a surprise, noticed after the reaction time. Until then it believes in the usual one.
        gap: m, true; leader: (n,) row of the mover ahead
        """
        if not self.movers.reaction.any():
            return gap, self.v[leader]
        self._past.append((self.time, self.v, self._travelled))
        times = np.array([time for time, _, _ in self._past])
        seen = np.maximum(np.searchsorted(times, self.time - self.movers.reaction + 1e-9, side="right") - 1, 0)
        before = np.stack([speed for _, speed, _ in self._past])[seen, leader]
        travelled = self._travelled[leader] - np.stack([way for _, _, way in self._past])[seen, leader]
        del self._past[: int(seen.min())]
        expected = np.maximum(before - _EXPECTED_BRAKING * (self.time - times[seen]), 0.0)
        way = (before**2 - expected**2) / (2 * _EXPECTED_BRAKING)
        return gap + np.maximum(way - travelled, 0.0), np.maximum(self.v[leader], expected)

    def _leader(self) -> tuple[Floats, Ints]:
        """Free distance (n,) m to the mover ahead of each, inf: there is none, and the row (n,) of that mover."""
        length = self.movers.size[:, 0]
        rear = self.s - length / 2
        best = np.full(len(self.s), np.inf)
        row = np.zeros(len(self.s), np.int64)
        offset = -self.s
        for k in range(3):
            obstructs = rear[None, :] < self.network.shared[self.route[:, k]][:, self.route[:, 0]]
            distance = offset[:, None] + self.s[None, :]
            distance = np.where(
                obstructs & (distance > 1e-9), distance - (length[:, None] + length[None, :]) / 2, np.inf
            )
            leader = distance.argmin(axis=1)
            nearest = distance[np.arange(len(leader)), leader]
            row = np.where(nearest < best, leader, row)
            best = np.minimum(best, nearest)
            offset = offset + self.network.table.length[self.route[:, k]]
        return best, row

    def _follow(self, gap: Floats, leader_speed: Floats, headway: Floats) -> Floats:
        """The interaction term of the intelligent driver model, (n,) m/s^2, negative."""
        movers = self.movers
        closing = self.v * (self.v - leader_speed) / (2 * np.sqrt(movers.acceleration * movers.braking))
        desired_gap = movers.gap + np.maximum(self.v * headway + closing, 0.0)
        interaction: Floats = -movers.acceleration * (desired_gap / np.maximum(gap, 0.05)) ** 2
        return interaction

    def _right_of_way(self, to_line: Floats) -> Bools:
        """Whether each mover (n,) must stop at the line.

        Grants the right of way to movers that are about to pass the line.
        """
        green, remaining = self.network.lights.now(self.time)
        connector = self.route[:, 1]
        waiting = self._signalled[self.route[:, 0]] & (self.granted != connector)
        # A mover does not enter a connector that it cannot clear before red, within LATE_S.
        crossing_time = self.network.table.length[connector] / self.movers.speed - LATE_S
        must_stop: Bools = waiting & ~(green[connector] & (remaining >= crossing_time))
        near_line = to_line < self.v**2 / (2 * _FIRM_BRAKING) + 1.5
        requesting = np.flatnonzero(waiting & ~must_stop & (near_line | (self.refused < np.inf)))
        self.refused[~waiting | must_stop] = np.inf
        holders = np.flatnonzero(self.granted >= 0)
        occupied = list(2 * self.granted[holders] + self._size_class[holders])
        # Longest waiting first, without overtaking: otherwise slower movers would starve.
        for i in requesting[np.lexsort((to_line[requesting], self.refused[requesting]))]:
            entry = 2 * connector[i] + self._size_class[i]
            if self.network.conflict[entry, occupied].any() or not self._room_beyond(int(i)):
                must_stop[i] = True
                self.refused[i] = min(self.refused[i], self.time)
            else:
                self.granted[i] = connector[i]
                self.refused[i] = np.inf
            occupied.append(entry)
        return must_stop

    def _room_beyond(self, i: int) -> bool:
        """Whether there is room for mover i beyond its connector.

        Movers that are already heading there count.
        """
        movers, exit_path = self.movers, self.route[i, 2]
        on_exit = np.flatnonzero(self.route[:, 0] == exit_path)
        if not len(on_exit):
            return True
        last_mover = on_exit[self.s[on_exit].argmin()]
        approaching = np.flatnonzero(
            (self.granted >= 0) & (self.route[:, 1] == exit_path) & (self.route[:, 0] == self.granted)
        )
        # Where the last mover would stop if it braked now.
        free = self.s[last_mover] - movers.size[last_mover, 0] / 2 + self.v[last_mover] ** 2 / (2 * _FIRM_BRAKING)
        return bool(
            free
            > movers.size[i, 0]
            + 2 * movers.gap[i]
            + float((movers.size[approaching, 0] + movers.gap[approaching]).sum())
        )

    def _advance(self, end: Floats) -> None:
        """Move on to the next path, and release the right of way of cleared connectors.

        A connector is cleared when the rear of its mover has left it.
        """
        for i in np.flatnonzero(self.s >= end):
            self.s[i] -= end[i]
            self.route[i] = (*self.route[i, 1:], self._next_path(int(i), int(self.route[i, 2])))
        cleared = (self.granted >= 0) & (self.network.origin[self.route[:, 0]] < 0)
        cleared &= (self.route[:, 1] != self.granted) & (self.s - self.movers.size[:, 0] / 2 > 0)
        self.granted[cleared] = -1


#: s, median of the time headway of a driver, its spread (of the logarithm), and its least and greatest value.
_HEADWAY = (0.46, 0.66, (0.18, 2.5))
#: s, the same of the reaction time.
_REACTION = (0.6, 0.35, (0.3, 1.2))
#: The same of factors on the usual desired speed and acceleration of a kind of vehicle.
_SPEED = (1.0, 0.1, (0.8, 1.15))
_ACCELERATION = (1.1, 0.2, (0.7, 1.6))
#: m/s, the slowest desired speed: green phases are made for it.
_SLOWEST = 8.0
#: How many cars a platoon has, and s, the headway in it.
_PLATOON, _PLATOON_HEADWAY_S = (3, 5), 0.5
_PLATOON_SPEED = 0.8  # of its first car; the others would be faster
_PLATOON_CHANCE = 0.5  # in each scene


def with_differing_drivers(movers: Movers, random: np.random.Generator) -> Movers:
    """The movers with vehicles whose drivers differ, in some scenes with a platoon among them."""
    road = movers.user == ROAD

    def factors(median: float, spread: float, limits: tuple[float, float]) -> Floats:
        return np.asarray(np.clip(median * np.exp(spread * random.standard_normal(len(road))), *limits))

    headway = factors(*_HEADWAY)
    reaction = factors(*_REACTION)
    speed = np.maximum(movers.speed * factors(*_SPEED), _SLOWEST)
    acceleration = movers.acceleration * factors(*_ACCELERATION)
    platoon = _platoon(movers, random) if random.random() < _PLATOON_CHANCE else np.zeros(0, np.int64)
    guide = movers.guide.copy()
    if len(platoon):
        guide[platoon] = platoon[0]
        speed[platoon[0]] = max(_PLATOON_SPEED * movers.speed[platoon[0]], _SLOWEST)
        headway[platoon[1:]] = _PLATOON_HEADWAY_S
    return replace(
        movers,
        headway=np.where(road, headway, movers.headway),
        reaction=np.where(road, reaction, movers.reaction),
        speed=np.where(road, speed, movers.speed),
        acceleration=np.where(road, acceleration, movers.acceleration),
        guide=guide,
        exact_headway=True,
    )


def _platoon(movers: Movers, random: np.random.Generator) -> Ints:
    """(k,) cars that start one behind the other in a lane, the first one first; empty if no lane has as many."""
    length = int(random.integers(_PLATOON[0], _PLATOON[1] + 1))
    runs = []
    for lane in np.unique(movers.path[movers.user == ROAD]):
        rows = np.flatnonzero((movers.user == ROAD) & (movers.path == lane))
        rows = rows[np.argsort(-movers.start[rows])]
        short = movers.size_class[rows] == SHORT
        runs += [rows[k : k + length] for k in range(len(rows) - length + 1) if short[k : k + length].all()]
    return runs[int(random.integers(len(runs)))] if runs else np.zeros(0, np.int64)

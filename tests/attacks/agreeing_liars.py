"""Liars that agree without talking to each other, and liars about what real objects look like and how they move.

Threat model as in `informed_liars`. Two liars of these kinds claim the same, because both compute it from what every
agent knows: the sensors, the routes, the buildings and the time. They are inputs of tests, not attacks for users.
"""

from abc import abstractmethod

import numpy as np
from informed_liars import ALL, CHANGED, LiesAtOnce, cars_at, nearest_m

from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Floats, ObjectStates, concatenate
from mast_zenoh.attacks.adaptive import AdaptiveAttack, Lies, Moment
from mast_zenoh.attacks.imitation import typical
from mast_zenoh.attacks.surroundings import boxes_of

#: m, length, width and height of a pedestrian.
PEDESTRIAN: Floats = np.array([0.6, 0.6, 1.7])
#: Classes of vehicles.
VEHICLES = [CLASS_INDEX[name] for name in ("car", "truck", "bus")]


class UnlimitedLiar(AdaptiveAttack):
    """Base of liars that lie about whatever they like at once."""

    def __init__(self, *, start_s: float = 4.0) -> None:
        super().__init__(start_s=start_s)
        self.budget = LiesAtOnce(ALL)


class BesideReal(UnlimitedLiar):
    """Invents a pedestrian half a metre before each vehicle, towards the ego: rays that end at the vehicle pass close
    by it, within what errors of honest agents allow."""

    gap_m = 0.5

    def lie(self, moment: Moment) -> Lies:
        ego = self._surroundings.ego_sensor
        centre = moment.position if ego is None else ego.route.position_at(moment.time_s)
        known = concatenate([moment.seen, self.known_objects(moment)])
        vehicles = known.select(np.isin(known.class_id, VEHICLES))
        to_ego = centre[:2] - vehicles.position[:, :2]
        distance = np.linalg.norm(to_ego, axis=1)
        vehicles, to_ego = vehicles.select(distance > 6.0), to_ego[distance > 6.0]
        kept: list[int] = []  # one of each vehicle
        for row in range(len(vehicles)):
            if nearest_m(vehicles.select(slice(row, row + 1)), vehicles.select(np.array(kept, np.int64)))[0] > 2.5:
                kept.append(row)
        vehicles, to_ego = vehicles.select(np.array(kept, np.int64)), to_ego[kept]
        k = len(vehicles)
        to_ego /= np.maximum(np.linalg.norm(to_ego, axis=1), 1e-6)[:, None]
        cos, sin = np.cos(vehicles.yaw), np.sin(vehicles.yaw)
        along = np.abs(to_ego[:, 0] * cos + to_ego[:, 1] * sin)
        across = np.abs(to_ego[:, 1] * cos - to_ego[:, 0] * sin)
        with np.errstate(divide="ignore"):
            face = np.minimum(0.5 * vehicles.size[:, 0] / along, 0.5 * vehicles.size[:, 1] / across)
        position = np.zeros((k, 3))
        position[:, :2] = vehicles.position[:, :2] + to_ego * (face + self.gap_m + 0.5 * PEDESTRIAN[0])[:, None]
        position[:, 2] = vehicles.position[:, 2] - 0.5 * vehicles.size[:, 2] + 0.5 * PEDESTRIAN[2]
        pedestrians = np.full(k, CLASS_INDEX["pedestrian"], np.uint8)
        ghosts = ObjectStates.of(
            position,
            velocity=vehicles.velocity,
            size=np.tile(PEDESTRIAN, (k, 1)),
            yaw=vehicles.yaw,
            class_id=pedestrians,
        )
        return Lies(inserted=typical(ghosts.with_(id=np.arange(k)), moment.seen))


class AtBumper(UnlimitedLiar):
    """Invents a pedestrian half a metre before the ego, wherever that drives, by the own track of it."""

    gap_m, length_m, lost_m = 0.5, 4.5, 8.0

    def __init__(self, *, start_s: float = 4.0) -> None:
        super().__init__(start_s=start_s)
        self._place: Floats | None = None  # (2,) m, where the ego should be next

    def lie(self, moment: Moment) -> Lies:
        ego, cars = self._surroundings.ego_sensor, moment.seen.select(np.isin(moment.seen.class_id, VEHICLES))
        if ego is None or not len(cars):
            return Lies()
        place = ego.route.position_at(moment.time_s)[:2] if self._place is None else self._place
        away = np.linalg.norm(cars.position[:, :2] - place, axis=1)
        if away.min() > self.lost_m:
            return Lies()
        car = cars.select(away.argmin()[None])
        self._place = (car.position + moment.elapsed_s * car.velocity)[0, :2]
        ahead = np.stack([np.cos(car.yaw), np.sin(car.yaw), np.zeros(1)], axis=1)
        position = car.position + ahead * (0.5 * (self.length_m + PEDESTRIAN[0]) + self.gap_m)
        position[:, 2] += 0.5 * (PEDESTRIAN[2] - car.size[:, 2])
        pedestrian = np.full(1, CLASS_INDEX["pedestrian"], np.uint8)
        ghost = ObjectStates.of(
            position, velocity=car.velocity, size=PEDESTRIAN[None], yaw=car.yaw, class_id=pedestrian
        )
        return Lies(inserted=typical(ghost.with_(id=np.zeros(1, np.int64)), moment.seen))


class Scapegoats(UnlimitedLiar):
    """Invents standing cars on a grid that all liars share, where at most `scapegoats` honest agents look.

    Those deny them, and as many liars claim them: nobody can tell which of the two lie.
    """

    cars, scapegoats, step_m = 12, 2, 6.0

    def lie(self, moment: Moment) -> Lies:
        ego = self._surroundings.ego_sensor
        centre = moment.position if ego is None else ego.route.position_at(10.0 * (moment.time_s // 10.0))
        axis = np.arange(-48.0, 48.1, self.step_m)
        xy = np.round(centre[:2] / self.step_m) * self.step_m + np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
        cars = cars_at(xy, np.zeros(len(xy)), moment)
        boxes = boxes_of(cars)
        looks = np.array(
            [moment.coverage.visible(view, boxes) for view in self._surroundings.other_views(moment.time_s)]
        )
        lookers = looks.sum(axis=0)
        taken = concatenate([moment.seen, self.known_objects(moment)])
        free = (lookers >= 1) & (lookers <= self.scapegoats) & (nearest_m(cars, taken) > 4.5)
        free &= ~self._surroundings.inside_buildings(xy)
        rows = np.flatnonzero(free)
        rows = rows[np.argsort(np.linalg.norm(xy[rows] - centre[:2], axis=1), kind="stable")][: self.cars]
        return Lies(inserted=typical(cars.select(rows).with_(id=rows.astype(np.int64)), moment.seen))


class AlteredObjects(UnlimitedLiar):
    """Base of liars that alter what they see."""

    def lie(self, moment: Moment) -> Lies:
        rows = np.flatnonzero(moment.established & self._wanted(moment))
        claims = self._altered(moment.seen.select(rows), moment.time_s - self._start_ns * 1e-9, moment)
        return Lies(changed=rows, claims=claims, changed_number=CHANGED + rows)

    def _wanted(self, moment: Moment) -> Bools:
        """(n,) which of the objects are altered."""
        return np.ones(len(moment.seen), np.bool_)

    @abstractmethod
    def _altered(self, objects: ObjectStates, elapsed_s: float, moment: Moment) -> ObjectStates:
        """What is claimed of objects `elapsed_s` s after the start."""


class Turned(AlteredObjects):
    """Reports all vehicles where they are, turned by 90 degrees, and standing."""

    def _wanted(self, moment: Moment) -> Bools:
        return np.isin(moment.seen.class_id, VEHICLES)

    def _altered(self, objects: ObjectStates, elapsed_s: float, moment: Moment) -> ObjectStates:
        return objects.with_(yaw=objects.yaw + 0.5 * np.pi, velocity=np.zeros_like(objects.velocity))


class Growing(AlteredObjects):
    """Reports vehicles longer and wider by a tenth more in each second, up to half as much again."""

    def _wanted(self, moment: Moment) -> Bools:
        return np.isin(moment.seen.class_id, VEHICLES)

    def _altered(self, objects: ObjectStates, elapsed_s: float, moment: Moment) -> ObjectStates:
        factor = np.array([1.0 + min(0.1 * elapsed_s, 0.5)] * 2 + [1.0])
        return objects.with_(size=objects.size * factor)


class HeadingDrift(AlteredObjects):
    """Turns headings and velocities of moving vehicles by 3 degrees more in each second, up to 60."""

    def _wanted(self, moment: Moment) -> Bools:
        return np.isin(moment.seen.class_id, VEHICLES) & (np.linalg.norm(moment.seen.velocity[:, :2], axis=1) > 1.0)

    def _altered(self, objects: ObjectStates, elapsed_s: float, moment: Moment) -> ObjectStates:
        angle = np.radians(min(3.0 * elapsed_s, 60.0))
        cos, sin = np.cos(angle), np.sin(angle)
        vx, vy, vz = objects.velocity.T
        velocity = np.column_stack([cos * vx - sin * vy, sin * vx + cos * vy, vz])
        return objects.with_(yaw=objects.yaw + angle, velocity=velocity)


class OnOff(AlteredObjects):
    """Displaces all that it sees by 2 m for two seconds, and is honest for two."""

    shift_m, on_s, off_s = np.array([2.0, 0.0, 0.0]), 2.0, 2.0

    def _altered(self, objects: ObjectStates, elapsed_s: float, moment: Moment) -> ObjectStates:
        on = elapsed_s % (self.on_s + self.off_s) < self.on_s
        return objects.with_(position=objects.position + self.shift_m * on)


class OnOffHalf(OnOff):
    """As `OnOff`, of every other object: no fault of the whole agent explains it."""

    def _wanted(self, moment: Moment) -> Bools:
        return moment.seen.id % 2 == 0


class FrameTwo(AlteredObjects):
    """Displaces what two honest agents see, so that both differ from the liars, and denies nothing else.

    The two agents are the first by name that do not lie.
    """

    shift_m = np.array([1.2, 0.0, 0.0])

    def _wanted(self, moment: Moment) -> Bools:
        known, seen = self._surroundings, moment.seen
        framed = sorted(name for name in known.sensors if name not in known.victims)[:2]
        if not framed or not len(seen):
            return np.zeros(len(seen), np.bool_)
        sight = np.array([moment.coverage.in_sight(known.sensors[name], seen, seen) for name in framed])
        return np.asarray(sight.any(axis=0))

    def _altered(self, objects: ObjectStates, elapsed_s: float, moment: Moment) -> ObjectStates:
        return objects.with_(position=objects.position + self.shift_m)


class AgainstEgo(FrameTwo):
    """As `FrameTwo`, with the ego as the only victim: what it sees is reported elsewhere."""

    def _wanted(self, moment: Moment) -> Bools:
        ego = self._surroundings.ego_sensor
        if ego is None or not len(moment.seen):
            return np.zeros(len(moment.seen), np.bool_)
        return np.asarray(moment.coverage.in_sight(ego, moment.seen, moment.seen))

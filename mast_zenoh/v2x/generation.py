"""When a station sends a message, and what is in it: collective perception (CPM) and cooperative awareness (CAM).

Collective perception after ETSI TS 103 324 v2.1.1, clause 6.1. A station has its own instance of the rules; all its
objects are handled at once, in a table of what it remembers of each object that it perceives.

Cooperative awareness after ETSI TS 103 900 v2.1.1: what a vehicle knows of itself, and when it says so.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Floats, Ints, ObjectStates
from mast_zenoh.v2x.perceived_objects import MAX_QUALITY, quality_of_score
from mast_zenoh.v2x.redundancy import HeardObjects, RedundancyRule


class ObjectTable:
    """Rows of named columns by id of an object, without a Python object for each.

    columns: (name, dtype) or (name, dtype, shape) of each column besides `id` and `perceived_ns`, the time at which the
        object was last perceived
    most: number of objects that are remembered at most
    """

    def __init__(self, *columns: tuple[str, DTypeLike] | tuple[str, DTypeLike, int], most: int) -> None:
        self.dtype = np.dtype([("id", np.int64), ("perceived_ns", np.int64), *columns])
        self._most = most
        self._rows: NDArray[Any] = np.zeros(0, self.dtype)

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def ids(self) -> Ints:
        """Ids of all objects, ascending."""
        return np.asarray(self._rows["id"])

    def read(self, ids: Ints) -> tuple[NDArray[Any], Bools]:
        """Rows (n,) of objects, zero for unknown ones, and which are known (n,)."""
        place, known = self._find(ids)
        rows = np.zeros(len(ids), self.dtype)
        rows[known] = self._rows[place[known]]
        return rows, known

    def write(self, rows: NDArray[Any]) -> None:
        """Replace or add rows (n,), no id twice.

        Beyond the limit, the objects that were last perceived stay, of equal ones those with low ids.
        """
        place, known = self._find(rows["id"])
        self._rows[place[known]] = rows[known]
        if known.all():
            return
        table = np.concatenate([self._rows, rows[~known]])
        table = table[table["id"].argsort()]
        if len(table) > self._most:
            table = table[np.sort(np.lexsort((table["id"], -table["perceived_ns"]))[: self._most])]
        self._rows = table

    def note_perceived(self, ids: Ints, time_ns: int) -> None:
        """Note that objects (n,) are perceived; unknown ones stay unknown."""
        place, known = self._find(ids)
        self._rows["perceived_ns"][place[known]] = time_ns

    def forget(self, before_ns: int) -> None:
        """Forget objects last perceived before a time."""
        perceived = self._rows["perceived_ns"]
        if len(perceived) and perceived.min() < before_ns:
            self._rows = self._rows[perceived >= before_ns]

    def _find(self, ids: Ints) -> tuple[Ints, Bools]:
        """Places (n,) of objects, and which are known (n,)."""
        if len(self._rows) == 0:
            return np.zeros(len(ids), np.int64), np.zeros(len(ids), bool)
        place = np.minimum(np.searchsorted(self._rows["id"], ids), len(self._rows) - 1)
        return place, np.asarray(self._rows["id"][place] == ids)


@dataclass(frozen=True, slots=True, eq=False)
class Perception:
    """What a station perceives and has heard at one time.

    time_ns: ns, now
    objects: its own n objects, world frame; no id twice
    quality: (n,) int64, objectPerceptionQuality, 0 to 15
    position: (3,) m, of the station, world frame
    heard:   objects in messages from others
    """

    time_ns: int
    objects: ObjectStates
    quality: Ints
    position: Floats
    heard: HeardObjects

    @classmethod
    def of(
        cls,
        time_ns: int,
        objects: ObjectStates,
        *,
        quality: Ints | None = None,
        position: Floats | None = None,
        heard: HeardObjects | None = None,
    ) -> Perception:
        """A perception; by default with the quality of the scores, from the origin, and with nothing heard."""
        return cls(
            time_ns,
            objects,
            quality_of_score(objects.score) if quality is None else quality,
            np.zeros(3) if position is None else position,
            HeardObjects.empty() if heard is None else heard,
        )

    def select(self, rows: Ints) -> Perception:
        """The same with some of the objects."""
        return Perception(self.time_ns, self.objects.select(rows), self.quality[rows], self.position, self.heard)

    def redundant(self, rules: Iterable[RedundancyRule]) -> Bools:
        """(n,) which objects one of some rules leaves out; raises ValueError for a rule that returns something else."""
        redundant = np.zeros(len(self.objects), bool)
        for rule in rules:
            found = rule.redundant(self.time_ns, self.objects, self.position, self.heard)
            if not isinstance(found, np.ndarray) or found.shape != redundant.shape or found.dtype != bool:
                kind = f"{found.dtype} {found.shape}" if isinstance(found, np.ndarray) else type(found).__name__
                raise ValueError(
                    f"{type(rule).__name__}: found {kind} as which objects to leave out, expected an array "
                    f"bool {redundant.shape}: one value for each own object"
                )
            redundant |= found
        return redundant


@dataclass(frozen=True, slots=True, eq=False)
class Generation:
    """Whether a station generates a message now, and what is in it.

    generated: whether there is a message; it may be without objects
    rows:      (k,) int64, rows of the objects in it, those first that should survive segmentation
    sensors:   whether it has a sensor information container
    """

    generated: bool
    rows: Ints
    sensors: bool

    @classmethod
    def nothing(cls) -> Generation:
        """No message."""
        return cls(False, np.zeros(0, np.int64), False)


class GenerationRules(ABC):
    """Decides at each frame whether a station generates a message, and which objects are in it."""

    @property
    def uses_heard(self) -> bool:
        """Whether it looks at what others have reported; otherwise nobody needs to collect that."""
        return True

    @abstractmethod
    def generate(self, perception: Perception) -> Generation:
        """What to send now."""


class EveryFrame(GenerationRules):
    """Sends all objects in every frame, whatever the channel allows."""

    @property
    def uses_heard(self) -> bool:
        return False

    def generate(self, perception: Perception) -> Generation:
        return Generation(True, np.arange(len(perception.objects), dtype=np.int64), True)


@dataclass(kw_only=True, eq=False)
class CpmGeneration(GenerationRules):
    """Generation rules of Collective Perception Messages (TS 103 324 v2.1.1, clause 6.1).

    An object is due if it was never sent, or has changed since it was last sent, or was not sent for `most_s`. Road
    users of type A are due together: as soon as one of them was never sent, or not for `type_a_s`. Objects are sent in
    the order of their utility, new ones first. A message is sent if an object or the sensor information container is
    due.

    least_s, most_s: s, limits of the time between two messages (T_GenCpmMin, T_GenCpmMax; clause 6.1.3)
    sensors_s: s, between two sensor information containers (T_AddSensorInformation; clause 6.1.2.2)
    moved_m: m, by which an object must have moved to be due (clause 6.1.2.3, as the next three)
    speed_mps: m/s, by which its speed must have changed
    direction_deg: °, by which the direction of its velocity must have changed
    direction_sigmas: standard deviations of a velocity above which an object moves, so that its velocity has a
        direction. A slower object keeps the one that was last sent, or noise would turn parked cars. The standard
        compares directions of estimated ground velocities (clause 6.1.2.3), and has no such limit
    type_a: classes of type A; the standard's are pedestrians, light vehicles such as bicycles, and animals
    type_a_s: s, after which all objects of type A are due (T_GenCpmMax / 2)
    quality: objects are sent if their quality is above (ObjectPerceptionQualityThreshold)
    send_all: whether all objects of sufficient quality are due in every message (ObjectInclusionConfig 0)
    priority_moved_m, priority_speed_mps, priority_direction_deg, priority_silence_s: range over which each change
        raises the utility of an object from 0 to 1
    most_objects: number of objects in a message; the others stay due
    redundancy: rules that leave out what others have reported
    retention_s: s, after which an object that is no longer perceived is forgotten (UnusedObjectIdRetentionPeriod)
    remembered: number of objects that are remembered at most
    tolerance_s: s, by which a frame may be early and still count as due; times of frames are rounded
    """

    least_s: float = 0.1
    most_s: float = 1.0
    sensors_s: float = 1.0
    moved_m: float = 4.0
    speed_mps: float = 0.5
    direction_deg: float = 4.0
    direction_sigmas: float = 2.0
    type_a: tuple[str, ...] = ("bicycle", "pedestrian")
    type_a_s: float = 0.5
    quality: int = 3
    send_all: bool = False
    priority_moved_m: tuple[float, float] = (0.0, 8.0)
    priority_speed_mps: tuple[float, float] = (0.0, 1.0)
    priority_direction_deg: tuple[float, float] = (0.0, 8.0)
    priority_silence_s: tuple[float, float] = (0.1, 1.0)
    most_objects: int = 255
    redundancy: tuple[RedundancyRule, ...] = ()
    retention_s: float = 60.0
    remembered: int = 4096
    tolerance_s: float = 0.001

    def __post_init__(self) -> None:
        check("more than 0 and at most 60 s", least_s=self.least_s, most_s=self.most_s)
        check("more than 0, finite", sensors_s=self.sensors_s)
        check("more than 0, finite", type_a_s=self.type_a_s, retention_s=self.retention_s)
        check("0 or more, finite", moved_m=self.moved_m, speed_mps=self.speed_mps, direction_deg=self.direction_deg)
        check("0 or more, finite", direction_sigmas=self.direction_sigmas, tolerance_s=self.tolerance_s)
        check("1 or more", most_objects=self.most_objects, remembered=self.remembered)
        if self.least_s > self.most_s:
            raise ValueError(f"least_s: found {self.least_s}, expected at most `most_s`, which is {self.most_s}")
        for name in ("priority_moved_m", "priority_speed_mps", "priority_direction_deg", "priority_silence_s"):
            low, high = getattr(self, name)
            if not low < high:
                raise ValueError(f"{name}: found {(low, high)}, expected a lower and a higher value")
        for name in self.type_a:
            if name not in CLASS_INDEX:
                raise ValueError(f"type_a: found {name!r}, expected some of {', '.join(CLASS_INDEX)}")
        self._type_a = np.array([CLASS_INDEX[name] for name in self.type_a], np.uint8)
        self._sent = SentObjects(self.remembered, self.direction_sigmas)
        self._message_ns: int | None = None
        self._sensors_ns: int | None = None

    @property
    def uses_heard(self) -> bool:
        return bool(self.redundancy)

    def generate(self, perception: Perception) -> Generation:
        now = perception.time_ns
        self._sent.forget(now - round(self.retention_s * 1e9))
        self._sent.note_perceived(perception.objects.id, now)
        if not _passed(now, self._message_ns, self.least_s - self.tolerance_s):
            return Generation.nothing()
        good = (perception.quality > self.quality).nonzero()[0]
        by_id = good[perception.objects.id[good].argsort()]  # so that the order of rows does not matter
        rows = by_id[self._select(perception.select(by_id))]
        sensors = _passed(now, self._sensors_ns, self.sensors_s - self.tolerance_s)
        if len(rows) == 0 and not sensors:
            return Generation.nothing()
        self._message_ns = now
        self._sensors_ns = now if sensors else self._sensors_ns
        self._sent.note_sent(perception.objects.select(rows), now)
        return Generation(True, rows, sensors)

    def _select(self, perception: Perception) -> Ints:
        """(k,) rows of objects to send, the most useful first."""
        objects = perception.objects
        change = self._sent.changes(objects, perception.time_ns)
        due = change.new | (change.moved_m > self.moved_m) | (change.speed_mps > self.speed_mps)
        due |= (change.direction_deg > self.direction_deg) | (change.silence_s >= self.most_s - self.tolerance_s)
        type_a = np.isin(objects.class_id, self._type_a)
        waiting = change.new | (change.silence_s >= self.type_a_s - self.tolerance_s)
        due[type_a] = bool((type_a & waiting).any())
        due |= self.send_all
        due &= ~perception.redundant(self.redundancy)
        rows = due.nonzero()[0]
        first = np.lexsort((objects.id[rows], -self._utility(perception.quality, change)[rows], ~change.new[rows]))
        return rows[first[: self.most_objects]]

    def _utility(self, quality: Ints, change: ChangesSinceSent) -> Floats:
        """(n,) how useful objects are, 0 to 5."""
        return (
            quality / MAX_QUALITY
            + _ramp(change.moved_m, self.priority_moved_m)
            + _ramp(change.speed_mps, self.priority_speed_mps)
            + _ramp(change.direction_deg, self.priority_direction_deg)
            + _ramp(change.silence_s, self.priority_silence_s)
        )


def _passed(now_ns: int, last_ns: int | None, period_s: float) -> bool:
    """Whether a period has passed."""
    return last_ns is None or now_ns - last_ns >= round(period_s * 1e9)


def _ramp(value: Floats, limits: Sequence[float]) -> Floats:
    """0 up to the lower limit, 1 from the higher one on."""
    low, high = limits
    return np.clip((value - low) / (high - low), 0.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class ChangesSinceSent:
    """How n objects differ from what was last sent of them; all 0 for new ones.

    new: (n,) whether they were never sent
    moved_m, speed_mps, direction_deg, silence_s: (n,) distance, differences, and time since then
    """

    new: Bools
    moved_m: Floats
    speed_mps: Floats
    direction_deg: Floats
    silence_s: Floats


class SentObjects(ObjectTable):
    """The objects that a station has sent, as it sent them, each with its last known direction.

    most: number of objects that are remembered at most
    direction_sigmas: standard deviations of a velocity above which it has a direction
    """

    def __init__(self, most: int, direction_sigmas: float) -> None:
        columns = (("sent_ns", np.int64), ("position", np.float64, 3), ("speed", np.float64), ("direction", np.float64))
        super().__init__(*columns, most=most)
        self._direction_sigmas = direction_sigmas

    def changes(self, objects: ObjectStates, time_ns: int) -> ChangesSinceSent:
        """How objects differ from what was last sent; the direction of one that does not move, not at all."""
        last, known = self.read(objects.id)
        turned = np.nan_to_num(wrap_angle(_direction(objects, self._direction_sigmas) - last["direction"]))
        return ChangesSinceSent(
            ~known,
            np.where(known, np.linalg.norm(objects.position - last["position"], axis=1), 0.0),
            np.where(known, np.abs(_speed(objects) - last["speed"]), 0.0),
            np.where(known, np.abs(np.degrees(turned)), 0.0),
            np.where(known, (time_ns - last["sent_ns"]) / 1e9, 0.0),
        )

    def note_sent(self, objects: ObjectStates, time_ns: int) -> None:
        """Note that objects are sent."""
        last, known = self.read(objects.id)
        direction = _direction(objects, self._direction_sigmas)
        sent = np.zeros(len(objects), self.dtype)
        sent["id"], sent["position"], sent["speed"] = objects.id, objects.position, _speed(objects)
        sent["direction"] = np.where(np.isnan(direction) & known, last["direction"], direction)
        sent["sent_ns"] = sent["perceived_ns"] = time_ns
        self.write(sent)


def _speed(objects: ObjectStates) -> Floats:
    """Speeds (n,) m/s."""
    return np.asarray(np.linalg.norm(objects.velocity, axis=1))


def _direction(objects: ObjectStates, sigmas: float) -> Floats:
    """Directions (n,) rad of velocities, seen from above; NaN below so many standard deviations, one for both axes."""
    x, y = objects.velocity[:, :2].T
    variance = (objects.covariance[:, 6, 6] + objects.covariance[:, 7, 7]) / 2.0
    return np.where(x**2 + y**2 > sigmas**2 * variance, np.arctan2(y, x), np.nan)


# -- cooperative awareness ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """What a vehicle knows of itself besides its pose.

    size: m, length, width, height;  kind: name of its class
    position_std_m, height_std_m, velocity_std_mps: standard deviations of its own positioning, of each component
    """

    size: tuple[float, float, float] = (4.5, 1.8, 1.5)
    kind: str = "car"
    position_std_m: float = 0.25
    height_std_m: float = 1.0
    velocity_std_mps: float = 0.1

    def __post_init__(self) -> None:
        check("more than 0, finite", **{f"size[{i}]": side for i, side in enumerate(self.size)})
        check("more than 0, finite", position_std_m=self.position_std_m, height_std_m=self.height_std_m)
        check("more than 0, finite", velocity_std_mps=self.velocity_std_mps)
        if self.kind not in CLASS_INDEX:
            raise ValueError(f"kind: found {self.kind!r}, expected one of {', '.join(CLASS_INDEX)}")

    def state(self, place: Floats, velocity: Floats, yaw: float) -> ObjectStates:
        """Its own state, one row, id 0, world frame.

        place: (3,) m, on the ground below its centre; velocity: (3,) m/s; yaw: rad
        """
        centre = place + np.array([0.0, 0.0, 0.5 * self.size[2]])
        std = [*(2 * [self.position_std_m]), self.height_std_m, *(3 * [0.1]), *(3 * [self.velocity_std_mps])]
        return ObjectStates.of(
            centre[None],
            velocity=velocity[None],
            size=np.array([self.size], np.float64),
            yaw=np.array([yaw]),
            covariance=np.diag(np.square(std))[None],
            class_id=np.array([CLASS_INDEX[self.kind]], np.uint8),
        )


class CamDecision(NamedTuple):
    """Whether a CAM is generated now, and whether it has the low-frequency container."""

    generated: bool
    low_frequency: bool


class _Sent(NamedTuple):
    """What the last CAM said: time, ns; position (3,) m; speed, m/s; heading, rad."""

    time_ns: int
    position: Floats
    speed: float
    yaw: float


@dataclass(kw_only=True, eq=False)
class CamGeneration:
    """Decides at each frame whether a station generates a CAM (TS 103 900 v2.1.1, clause 6.1.3).

    A CAM is sent at once if the station has moved or turned or changed its speed since the last one. Further ones
    follow at the interval after which that happened, `repeats` times, then every `most_s`.

    least_s, most_s: s, limits of the time between two CAMs (T_GenCamMin, T_GenCamMax)
    heading_deg, moved_m, speed_mps: changes of °, m and m/s that call for a CAM
    repeats: number of CAMs at the interval of the last change (N_GenCam)
    low_frequency_s: s, between two low-frequency containers
    tolerance_s: s, by which a frame may be early and still count as due; times of frames are rounded
    """

    least_s: float = 0.1
    most_s: float = 1.0
    heading_deg: float = 4.0
    moved_m: float = 4.0
    speed_mps: float = 0.5
    repeats: int = 3
    low_frequency_s: float = 0.5
    tolerance_s: float = 0.001

    def __post_init__(self) -> None:
        check("more than 0 and at most 60 s", least_s=self.least_s, most_s=self.most_s)
        check("more than 0, finite", low_frequency_s=self.low_frequency_s)
        check("0 or more, finite", heading_deg=self.heading_deg, moved_m=self.moved_m, speed_mps=self.speed_mps)
        check("0 or more, finite", tolerance_s=self.tolerance_s)
        check("1 or more", repeats=self.repeats)
        if self.least_s > self.most_s:
            raise ValueError(f"least_s: found {self.least_s}, expected at most `most_s`, which is {self.most_s}")
        self._sent: _Sent | None = None
        self._low_frequency_ns: int | None = None
        self._period_s = self.most_s
        self._repeated = 0

    def generate(self, time_ns: int, position: Floats, velocity: Floats, yaw: float) -> CamDecision:
        """Whether to send a CAM now.

        position: (3,) m; velocity: (3,) m/s; yaw: rad, of the station, world frame
        """
        now = _Sent(time_ns, position, float(np.linalg.norm(velocity)), yaw)
        if not self._is_due(now):
            return CamDecision(False, False)
        self._sent = now
        low_frequency = _passed(time_ns, self._low_frequency_ns, self.low_frequency_s - self.tolerance_s)
        if low_frequency:
            self._low_frequency_ns = time_ns
        return CamDecision(True, low_frequency)

    def _is_due(self, now: _Sent) -> bool:
        """Whether to send a CAM; updates the period."""
        if self._sent is None:
            return True
        last_ns = self._sent.time_ns
        if not _passed(now.time_ns, last_ns, self.least_s - self.tolerance_s):
            return False
        if self._changed(self._sent, now):
            self._period_s = min((now.time_ns - last_ns) / 1e9, self.most_s)
            self._repeated = 0
            return True
        if not _passed(now.time_ns, last_ns, self._period_s - self.tolerance_s):
            return False
        self._repeated += 1
        if self._repeated >= self.repeats:
            self._period_s = self.most_s
        return True

    def _changed(self, last: _Sent, now: _Sent) -> bool:
        turned = abs(float(wrap_angle(np.array(now.yaw - last.yaw))))
        return (
            turned > np.radians(self.heading_deg)
            or float(np.linalg.norm(now.position - last.position)) > self.moved_m
            or abs(now.speed - last.speed) > self.speed_mps
        )

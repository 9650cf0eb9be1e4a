"""Attacks: the base class, tampering with one message, and attacks that follow targets.

One compromised agent: its poses and messages, and the columns that are forwarded instead of the original.

An attack on the commands that drivers give their cars.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import rotation_from_quaternion, states_to_local, within_range
from mast_zenoh.arrays.states import Detections, Floats, Ints, ObjectStates, canonical_order, concatenate
from mast_zenoh.attacks.campaign import NANOSECONDS, Campaign, Propagation, TrajectoryPropagation
from mast_zenoh.attacks.following import Follower
from mast_zenoh.attacks.imitation import ForgedIds, Imitation, VictimLike
from mast_zenoh.attacks.knowledge import Attacker
from mast_zenoh.attacks.selection import Selection, UncoordinatedSelection
from mast_zenoh.attacks.surroundings import UNKNOWN, Coverage, Surroundings, unlimited
from mast_zenoh.attacks.targets import Changes, Tampering, Targets, ViewForger
from mast_zenoh.integrity.views import SweptView, check_view
from mast_zenoh.messages.schemas import Body
from mast_zenoh.sensing import sensor_pose, to_sensor, to_world
from mast_zenoh.sensing.points import Points
from mast_zenoh.tracking.view import SensorView
from mast_zenoh.wiring.model import agent_of
from mast_zenoh.wiring.received import Received


class Attack(Attacker):
    """Base class of attacks: tampers with the messages of a victim."""

    def look(self, view: SensorView, *, fused: bool) -> None:
        """Set the victim's field of view for the next step.

        fused: whether the objects are those of several agents
        """

    @abstractmethod
    def step(
        self,
        frame: int,
        time_ns: int,
        objects: ObjectStates,
        agent_position: Floats,
        directive: Targets | None = None,
    ) -> Tampering:
        """Tamper with the objects of one message.

        frame:          index of the message's frame
        time_ns:        ns, its time since the start of the scene
        objects:        the victim's objects, world frame: tracks, or detections (velocity zero, ids below 0)
        agent_position: (3,) m, the victim, world frame
        directive:      the coordinator's newest targets from an earlier frame, if any

        The result does not depend on the order of the objects.
        """

    def forge_view(self, frame: int, time_ns: int, swept: SweptView) -> SweptView:
        """The view that the victim is to claim, by default the true one.

        Called after `step` for the same frame. swept: the true view
        """
        return swept

    def forge_pose(self, frame: int, time_ns: int, position: Floats) -> Floats:
        """The position (3,) m that the victim is to believe, by default the true one (3,) m.

        Called before `step` for the same frame, or after it.
        """
        return position

    def forge_command(self, time_ns: int, acceleration: float, curvature: float) -> tuple[float, float]:
        """The acceleration, m/s^2, and the curvature, 1/m, that the victim's car is told; by default its driver's.

        time_ns: ns, of the command
        """
        return acceleration, curvature

    def forge_trust(self, time_ns: int, teller: str, agents: tuple[str, ...], trust: Floats) -> Floats:
        """The trust (a,) in agents that the victim is to tell others, 0 to 1; by default its own (a,).

        time_ns: ns, of the message; teller: the victim; agents: names of those a agents
        """
        return trust

    def forge_points(self, frame: int, time_ns: int, points: Points, lidar: tuple[Floats, Floats]) -> Points:
        """The points of a scan that the victim's detector is to get; by default the real ones, the same object.

        frame, time_ns: of the scan, each once and in order; points: in the frame of the lidar
        lidar: its position (3,) m and active rotation (3, 3), world frame
        """
        return points

    def forge(self, message: str, frame: int, time_ns: int, body: Body) -> Body:
        """The columns of a message of any other type that others are to receive; by default its own, as they are.

        message: its type; frame, time_ns: that it is about; body: its columns, which cannot be written to
        """
        return body


class ObjectsUnchanged:
    """For attacks on something else: leaves the objects of each message as they are."""

    def step(
        self,
        frame: int,
        time_ns: int,
        objects: ObjectStates,
        agent_position: Floats,
        directive: Targets | None = None,
    ) -> Tampering:
        return Tampering.nothing(len(objects))


class PassThrough(ObjectsUnchanged, Attack):
    """Relays every message unchanged."""


def alter(
    objects: ObjectStates,
    *,
    insert: ObjectStates | None = None,
    hide: Sequence[int] = (),
    move: Sequence[int] = (),
    offset: Floats | None = None,
    change: Sequence[int] = (),
    claims: ObjectStates | None = None,
) -> Tampering:
    """Tamper with explicit rows: insert, hide, move by `offset` (k, 3) m, or change into `claims`.

    claims: the state, of any size, heading, velocity or class, that replaces each row of `change`
    The changes are reported with the target numbers 0, 1, …: inserted, then hidden, then moved, then changed.
    Raises ValueError for a row that is named twice, and for another number of claims than of rows to change.
    """
    hidden, moved, changed = (np.asarray(rows, np.int64) for rows in (hide, move, change))
    claims = objects.select(changed) if claims is None else claims
    if len(claims) != len(changed):
        raise ValueError(f"claims: found {len(claims)} states, expected {len(changed)}, one for each row of `change`")
    named = np.concatenate([hidden, moved, changed])
    if len(np.unique(named)) < len(named):
        raise ValueError(f"hide, move, change: found the rows {named.tolist()}, expected each row once")
    shifted = objects.select(moved)
    if offset is not None:
        shifted = shifted.with_(position=shifted.position + offset)
    rows = np.concatenate([moved, changed])
    before = objects.select(rows)
    claims = concatenate([shifted, claims]).with_(id=before.id)
    targets = Targets(
        ObjectStates.empty() if insert is None else insert,
        objects.select(hidden),
        before,
        claims.position - before.position,
    ).numbered(0)
    numbers = [targets.add.id, targets.remove.id, targets.move.id]
    order = np.arange(len(objects))
    return Tampering.of(objects, order, targets.add, hidden, rows, before, claims, numbers, targets)


def carry_out(
    targets: Targets, inserted: ObjectStates, objects: ObjectStates, order: Ints, remove_row: Ints, move_row: Ints
) -> Tampering:
    """Insert false objects, and hide and displace matched objects of a victim.

    All positions are in the world frame.
    targets:    the current targets
    inserted:   false objects as they will appear; their ids are the target numbers
    objects:    the victim's n objects, in canonical order
    order:      (n,) the row of each object in the message
    remove_row, move_row: by target, the matched row of `objects`, -1 for none; no row twice
    """
    hides, moves = remove_row >= 0, move_row >= 0
    hidden, displaced = remove_row[hides], move_row[moves]
    before = moved = objects.select(displaced)
    if len(displaced):
        moved = before.with_(position=before.position + targets.move_offset[moves])
    numbers = [inserted.id, targets.remove.id[hides], targets.move.id[moves]]
    return Tampering.of(objects, order, inserted, hidden, displaced, before, moved, numbers, targets)


#: m; an object within this distance of a coordinator's target (a mean of several agents' tracks) may be that target.
ATTACH_M = 2.5
#: m; likewise for a target that the adversary has selected itself.
OWN_TARGET_M = 0.1
#: Number of messages in which an object must have been seen before it can be a target.
ESTABLISHED = 3
#: s, time before the attack from which objects are tracked, so that their velocities are known.
LEAD_S = 1.0


class ObservingAttack(Attack):
    """Base of attacks that follow the victim's objects, and whose claimed views agree with their lies.

    start_s: s of scene time at which the attack begins; gate_m: m, the widest gate in which an object is followed
    id_gap:  difference between the victim's highest track id and the first id of a false object
    """

    def __init__(self, start_s: float, gate_m: float, id_gap: int) -> None:
        check("0 or more, finite", start_s=start_s)
        self._start_ns = round(start_s * NANOSECONDS)
        self._ids = ForgedIds(id_gap)
        self._follower = Follower(gate_m)
        self._forger = ViewForger()
        self._surroundings = UNKNOWN
        self._view: SensorView | None = None
        self._fused = False

    def inform(self, surroundings: Surroundings) -> None:
        self._surroundings = surroundings

    def look(self, view: SensorView, *, fused: bool) -> None:
        self._view, self._fused = view, fused

    def forge_view(self, frame: int, time_ns: int, swept: SweptView) -> SweptView:
        return self._forger.forge(frame, swept)

    def _coverage(self, time_ns: int, agent_position: Floats) -> Coverage:
        """What the victim covers at a time."""
        view = unlimited(agent_position) if self._view is None else self._view
        return Coverage(self._surroundings, (view,), time_ns / NANOSECONDS, self._fused)


@dataclass(kw_only=True, eq=False)
class TargetedAttack(ObservingAttack):
    """Base of attacks that follow targets and imitate the victim's objects.

    start_s:          s of scene time at which the attack begins
    max_range_m:      m, false objects farther from the victim are withheld
    assign_radius_m:  m, maximum distance of an object from the predicted position of its target, even after a long
                      time without a measurement
    imitation:        the appearance of false objects; None: VictimLike()
    id_gap:           difference between the victim's highest track id and the first id of a false object
    """

    #: m, see `Follower.follow`.
    attach_m: ClassVar[float]

    start_s: float = 4.0
    max_range_m: float = 70.0
    assign_radius_m: float = 6.0
    imitation: Imitation | None = None
    id_gap: int = 1000

    def __post_init__(self) -> None:
        super().__init__(self.start_s, self.assign_radius_m, self.id_gap)
        self._imitation = self.imitation or VictimLike()

    def bind(self, seed: int, name: str) -> None:
        self._imitation.bind(seed, self._surroundings.scene, name)

    def step(
        self,
        frame: int,
        time_ns: int,
        objects: ObjectStates,
        agent_position: Floats,
        directive: Targets | None = None,
    ) -> Tampering:
        order = canonical_order(objects)
        seen = objects.select(order)
        self._ids.observe(objects.id)
        self._imitation.observe(seen, time_ns, agent_position)
        if time_ns >= self._start_ns - LEAD_S * NANOSECONDS:
            self._follower.observe(seen, time_ns)
        coverage = self._coverage(time_ns, agent_position)
        targets = self._targets_at(frame, time_ns, seen, coverage, directive)
        if targets is None:
            return Tampering.nothing(len(objects))
        targets, remove_row, move_row = self._follower.follow(targets, self.attach_m)
        in_range, near = targets.add, within_range(targets.add.position, agent_position, self.max_range_m)
        if not near.all():
            in_range = in_range.select(near)
        false_objects = self._imitation.show(frame, in_range, seen, coverage, coverage.victims[0])
        tampering = carry_out(targets, false_objects, seen, order, remove_row, move_row)
        self._store_targets(tampering.targets, time_ns)
        self._forger.remember(frame, objects, tampering)
        return replace(tampering, added=false_objects.with_(id=self._ids.of(false_objects.id)))

    @abstractmethod
    def _targets_at(
        self, frame: int, time_ns: int, seen: ObjectStates, coverage: Coverage, directive: Targets | None
    ) -> Targets | None:
        """The targets at the time of a message; None before the attack begins."""

    @abstractmethod
    def _store_targets(self, targets: Targets, time_ns: int) -> None:
        """Store the current targets."""


@dataclass(kw_only=True, eq=False)
class UncoordinatedAttack(TargetedAttack):
    """Deceives trackers (on detections) or the broker (on tracks) independently.

    selection:        which objects to add, hide and move; None: UncoordinatedSelection()
    propagation:      motion of false objects; None: TrajectoryPropagation()
    reselect_every_s: s, interval between selections of new targets; None: select once
    The other parameters come from TargetedAttack: start_s, max_range_m, assign_radius_m, imitation, id_gap.
    """

    attach_m = OWN_TARGET_M

    selection: Selection | None = None
    propagation: Propagation | None = None
    reselect_every_s: float | None = 20.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._selection = self.selection or UncoordinatedSelection()
        motion = self.propagation or TrajectoryPropagation()
        self._campaign = Campaign(self._selection, motion, self.reselect_every_s, self.start_s)

    def bind(self, seed: int, name: str) -> None:
        super().bind(seed, name)
        self._campaign.bind(seed, self._surroundings.scene, name)

    def counts(self) -> dict[str, int]:
        return self._campaign.counts

    def _targets_at(
        self, frame: int, time_ns: int, seen: ObjectStates, coverage: Coverage, directive: Targets | None
    ) -> Targets | None:
        def scene() -> tuple[ObjectStates, Coverage]:
            return self._selection.view(seen).select(self._follower.established(ESTABLISHED)), coverage

        return self._campaign.begin(frame, time_ns, scene)

    def _store_targets(self, targets: Targets, time_ns: int) -> None:
        self._campaign.store(targets, time_ns)


@dataclass(kw_only=True, eq=False)
class CoordinatedAttack(TargetedAttack):
    """Follows the newest directive of a coordinator.

    A directive's targets are predicted to the current time at constant velocity. Without a newer one the adversary
    continues, its targets following their objects. A directive that arrives before `start_s` takes effect then.

    Parameters: start_s, max_range_m, assign_radius_m, imitation, id_gap, as for UncoordinatedAttack.
    """

    attach_m = ATTACH_M

    def __post_init__(self) -> None:
        super().__post_init__()
        self._directive: Targets | None = None
        self._directive_ns = 0
        self._targets = Targets.empty()
        self._targets_ns = 0
        self._last_ns = 0

    def _targets_at(
        self, frame: int, time_ns: int, seen: ObjectStates, coverage: Coverage, directive: Targets | None
    ) -> Targets | None:
        self._accept_directive(directive)
        self._last_ns = time_ns
        if time_ns < self._start_ns:
            return None
        return self._targets.propagated((time_ns - self._targets_ns) / NANOSECONDS)

    def _store_targets(self, targets: Targets, time_ns: int) -> None:
        self._targets, self._targets_ns = targets, time_ns

    def _accept_directive(self, directive: Targets | None) -> None:
        if directive is None or directive is self._directive:
            return
        directive_ns = self._last_ns if directive.time_ns is None else directive.time_ns
        if self._directive is None or directive_ns > self._directive_ns:
            self._directive, self._directive_ns = directive, directive_ns
            self._targets, self._targets_ns = directive, directive_ns


POSES_KEPT = 16  #: frames by which a message may be late and still be attacked


#: Types of messages that wait for the pose of their frame.
WAITING = ("detections", "points", "tracks", "picture")


class Victim:
    """One compromised agent, or one of its sensors: its poses, and the messages that wait for them.

    name: of the agent, or agent/sensor; attack: on its messages; sensor: whose view it has; empty: `name`
    """

    def __init__(self, name: str, attack: Attack, sensor: str = "") -> None:
        self.sensor = sensor or name
        self.agent = agent_of(name)
        self.attack = attack
        self.poses: dict[int, Body] = {}
        self.last_view: tuple[bytes, SensorView] | None = None  # latest pose, and the view from it
        self.waiting: dict[str, deque[Received]] = {name: deque() for name in WAITING}
        self.views: deque[Received] = deque()  # claimed views that wait for the lies of their frame
        self.attacked: deque[int] = deque(maxlen=POSES_KEPT)  # frames whose lies are known
        self.heard: dict[str, int] = {}  # frames of arrival of what its attack has heard, by type
        self.reports: list[tuple[Received, Changes]] = []  # that have not been published

    def store_pose(self, frame: int, pose: Body) -> None:
        """Store the true pose of a frame; the first one counts."""
        self.poses.setdefault(frame, pose)
        if len(self.poses) > POSES_KEPT:
            del self.poses[min(self.poses)]

    def view(self, surroundings: Surroundings, pose: Body) -> SensorView:
        """The view of its sensor; cached, because most agents are static."""
        key = pose["position"].tobytes() + pose["rotation"].tobytes()
        if self.last_view is None or self.last_view[0] != key:
            rotation = rotation_from_quaternion(pose["rotation"])
            self.last_view = (key, surroundings.view(self.sensor, pose["position"], rotation))
        return self.last_view[1]


Columns = dict[str, NDArray[Any]]
#: Position (3,) m and rotation (3, 3) of a sensor in the world.
SensorPose = tuple[Floats, Floats]


def sensor_of(sensed: Body, pose: Body) -> SensorPose:
    """The pose of the sensor of a `detections` or `points` message; pose: of its agent."""
    return sensor_pose(
        pose["position"],
        rotation_from_quaternion(pose["rotation"]),
        sensed["mount_position"],
        rotation_from_quaternion(sensed["mount_rotation"]),
    )


def seen_detections(body: Body, sensor: SensorPose) -> ObjectStates:
    """The objects of a `detections` message, world frame; ids are -1, as detections have no identity."""
    seen = to_world(Detections.from_columns(body), *sensor)
    covariance = np.zeros((len(seen), 9, 9))
    covariance[:, :3, :3] = seen.covariance
    return ObjectStates.of(
        seen.position,
        id=np.full(len(seen), -1),
        size=seen.size,
        yaw=seen.yaw,
        score=seen.score,
        class_id=seen.class_id,
        covariance=covariance,
    )


def forged_detections(body: Body, sensor: SensorPose, tampering: Tampering) -> Columns:
    """The columns of a tampered `detections` message; untouched rows keep their bytes."""

    def local(states: ObjectStates) -> Detections:
        covariance = states.covariance[:, :3, :3]
        world = Detections(states.position, states.size, states.yaw, states.score, states.class_id, covariance)
        return to_sensor(world, *sensor)

    columns = Detections.from_columns(body).columns()
    if len(tampering.moved):
        for name, moved in local(tampering.moved).columns().items():
            columns[name] = columns[name].copy()
            columns[name][tampering.moved_index] = moved
    kept = tampering.keep.nonzero()[0]
    for name, added in local(tampering.added).columns().items():
        columns[name] = np.concatenate([columns[name].take(kept, 0), added])
    return columns | {name: body[name] for name in ("mount_position", "mount_rotation")}


def forged_states(body: Body, states: ObjectStates, tampering: Tampering) -> Columns:
    """The columns of a tampered `tracks` or `picture` message; untouched rows keep their bytes.

    states: those of the message, in its frame of reference
    """
    if "origin" not in body:
        return tampering.applied_to(states).columns() | {"support": forged_support(body["support"], tampering)}
    reference = {name: body[name] for name in ("origin", "rotation")}
    forged = replace(
        tampering,
        moved=states_to_local(tampering.moved, **reference),
        added=states_to_local(tampering.added, **reference),
    )
    return forged.applied_to(states).columns() | reference


def forged_support(support: Ints, tampering: Tampering) -> Ints:
    """The support of each object in a forged picture: false objects get the median."""
    usual = int(np.median(support)) if len(support) else 1
    return np.concatenate([support[tampering.keep], np.full(len(tampering.added), usual, np.int64)])


def observed_pose(pose: Body) -> Columns:
    """The pose of an agent as columns of an observation."""
    return {f"agent_{name}": pose[name] for name in ("position", "rotation", "velocity")}


def observed_view(view: SensorView) -> Columns:
    """A view as columns of an observation."""
    return {
        "sensor_position": view.position,
        "sensor_rotation": view.rotation,
        "azimuth": np.array([view.azimuth_min, view.azimuth_max]),
        "elevation": np.array([view.elevation_min, view.elevation_max]),
        "max_range": np.array([view.max_range]),
    }


def claimed_view(body: Body) -> SweptView | None:
    """The view in a `view` message; None if it describes no field of view."""
    try:
        check_view(body)
    except ValueError:
        return None
    limits = *body["azimuth"].tolist(), *body["elevation"].tolist(), float(body["max_range"][0])
    return SweptView(SensorView(body["position"], rotation_from_quaternion(body["rotation"]), *limits), body["free"])


def directed_targets(body: Body, time_ns: int) -> Targets:
    """The targets in a `directive` message of a time, ns."""

    def states(prefix: str) -> ObjectStates:
        if len(body[f"{prefix}_id"]) == 0:
            return ObjectStates.empty()
        names = ("id", "velocity", "size", "yaw", "class_id")
        return ObjectStates.of(body[f"{prefix}_position"], **{name: body[f"{prefix}_{name}"] for name in names})

    return Targets(states("add"), states("remove"), states("move"), body["move_offset"], time_ns)


class SeizedCommands(ObjectsUnchanged, Attack):
    """Puts an acceleration of its own in place of the driver's; the car steers as its driver wants.

    A car carries out only what it can do: a command beyond that is refused (`driving.Actuation`).

    acceleration: m/s², negative: it brakes
    start_s, end_s: s of scene time; end_s None: 2 s after the start
    """

    def __init__(self, *, acceleration: float = -6.0, start_s: float = 4.0, end_s: float | None = None) -> None:
        check("-1000 to 1000", acceleration=acceleration)
        check("0 or more, finite", start_s=start_s)
        end_s = start_s + 2.0 if end_s is None else end_s
        if not end_s > start_s:
            raise ValueError(f"end_s: found {end_s}, expected more than start_s, {start_s}")
        self._acceleration = acceleration
        self._span_ns = start_s * NANOSECONDS, end_s * NANOSECONDS

    def forge_command(self, time_ns: int, acceleration: float, curvature: float) -> tuple[float, float]:
        begin, end = self._span_ns
        return (self._acceleration if begin <= time_ns < end else acceleration), curvature

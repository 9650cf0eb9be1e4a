"""One compromised agent: its poses and messages, and the columns that are forwarded instead of the original."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import rotation_from_quaternion, states_to_local
from mast_zenoh.arrays.states import Detections, Floats, Ints, ObjectStates
from mast_zenoh.attacks.attack import Attack
from mast_zenoh.attacks.surroundings import Surroundings
from mast_zenoh.attacks.targets import Changes, Tampering, Targets
from mast_zenoh.integrity.views import SweptView, check_view
from mast_zenoh.messages.schemas import Body
from mast_zenoh.sensing import sensor_pose, to_sensor, to_world
from mast_zenoh.tracking.view import SensorView
from mast_zenoh.wiring.model import agent_of
from mast_zenoh.wiring.received import Received

POSES_KEPT = 16  #: frames by which a message may be late and still be attacked


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
        self.waiting: dict[str, deque[Received]] = {"detections": deque(), "tracks": deque(), "picture": deque()}
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


def sensor_of(detections: Body, pose: Body) -> SensorPose:
    """The pose of the sensor of a `detections` message; pose: of its agent."""
    return sensor_pose(
        pose["position"],
        rotation_from_quaternion(pose["rotation"]),
        detections["mount_position"],
        rotation_from_quaternion(detections["mount_rotation"]),
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

"""Poses of ROS 2 as ours: Odometry as a `pose`; TFMessage and all other poses as transforms between frames.

Frames of reference that nodes of ROS 2 tell of by /tf and /tf_static, and where they are in the world.

What is kept is limited. The frames that the run itself knows, the world and an agent's, cannot be told of from outside.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np

from mast_ros2 import type_store
from mast_ros2.received_objects import MOST_SPEED
from mast_ros2.spatial import MOST_METRES, Transform, frame_of, is_unit, pose_rows, time_of, vector_rows
from mast_ros2.type_store import RosMessage
from mast_zenoh.arrays.geometry import quaternion_from_rotation, rotation_from_quaternion
from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import MessageError
from mast_zenoh.messages.schemas import Body

#: Transforms of a message, at most: a vehicle has tens.
MOST_TRANSFORMS = 1000


class ReceivedPose(NamedTuple):
    """The pose of a vehicle.

    frame_id, child_frame_id: names of the frame of reference and of the vehicle's frame
    time_ns: ns, of the header
    columns: those of a `pose` message, in the frame of reference
    """

    frame_id: str
    child_frame_id: str
    time_ns: int
    columns: Body


class ReceivedTransforms(NamedTuple):
    """Transforms of a message that can be used, and the number of the others by reason."""

    transforms: tuple[Transform, ...]
    dropped: Mapping[str, int]


def received_pose(message: RosMessage) -> ReceivedPose:
    """The pose in an Odometry; its velocity is turned from the axes of the vehicle into the frame of reference.

    Raises MessageError for another type, an invalid header, and values that are not finite or absurd.
    """
    if message.__msgtype__ != type_store.ODOMETRY:
        raise MessageError(f"{message.__msgtype__}: expected {type_store.ODOMETRY}")
    pose, velocity = pose_rows([message.pose.pose])[0], vector_rows([message.twist.twist.linear])[0]
    reason = _reason(pose)
    if reason:
        raise MessageError(f"{type_store.ODOMETRY}: pose: {reason}")
    with np.errstate(over="ignore"):
        too_fast = not np.linalg.norm(velocity) <= MOST_SPEED
    if too_fast:
        raise MessageError(f"{type_store.ODOMETRY}: twist: velocity: not finite or beyond {MOST_SPEED:g} m/s")
    columns = {
        "position": pose[:3],
        "rotation": pose[3:],
        "velocity": rotation_from_quaternion(pose[3:]) @ velocity,
    }
    frame_id, child = frame_of(message.header.frame_id), frame_of(message.child_frame_id)
    return ReceivedPose(frame_id, child, time_of(message.header.stamp), columns)


def received_transforms(message: RosMessage) -> ReceivedTransforms:
    """The transforms in a TFMessage; raises MessageError for another type or too many of them."""
    if message.__msgtype__ != type_store.TF_MESSAGE:
        raise MessageError(f"{message.__msgtype__}: expected {type_store.TF_MESSAGE}")
    if len(message.transforms) > MOST_TRANSFORMS:
        found = len(message.transforms)
        raise MessageError(f"{type_store.TF_MESSAGE}: found {found} transforms, expected at most {MOST_TRANSFORMS}")
    transforms, dropped = [], Counter[str]()
    for stamped in message.transforms:
        try:
            transforms.append(_transform(stamped))
        except MessageError as error:
            dropped[str(error)] += 1
    return ReceivedTransforms(tuple(transforms), dict(dropped))


def stamped_poses(message: RosMessage) -> ReceivedTransforms:
    """The poses in a message of a type of POSES, as transforms; the child of a pose without one is "".

    A single pose that cannot be used is counted, as those of a TFMessage are. Raises MessageError for another type or
    too many transforms.
    """
    kind = message.__msgtype__
    if kind == type_store.TF_MESSAGE:
        return received_transforms(message)
    if kind not in POSES:
        raise MessageError(f"{kind}: expected {', '.join(POSES)}")
    try:
        if kind == _TRANSFORM_STAMPED:
            return ReceivedTransforms((_transform(message),), {})
        pose = message.pose if kind == _POSE_STAMPED else message.pose.pose
        child = message.child_frame_id.removeprefix("/") if kind == type_store.ODOMETRY else ""
        return ReceivedTransforms((_placed(message.header, child, pose.position, pose.orientation),), {})
    except MessageError as error:
        return ReceivedTransforms((), {str(error): 1})


_POSE_STAMPED, _TRANSFORM_STAMPED = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped"
#: Types that `stamped_poses` reads.
POSES = (
    type_store.ODOMETRY,
    type_store.TF_MESSAGE,
    _POSE_STAMPED,
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    _TRANSFORM_STAMPED,
)


def _transform(stamped: RosMessage) -> Transform:
    """A transform; raises MessageError with a reason without values that the sender chooses."""
    try:
        child = frame_of(stamped.child_frame_id)
    except MessageError:
        raise MessageError("frame_id: invalid") from None
    result = _placed(stamped.header, child, stamped.transform.translation, stamped.transform.rotation)
    if result.parent == child:
        raise MessageError("frame_id: a frame is its own parent")
    return result


def _placed(header: RosMessage, child: str, position: RosMessage, turn: RosMessage) -> Transform:
    """A position and a quaternion; raises MessageError with a reason without values that the sender chooses."""
    values = np.array([position.x, position.y, position.z, turn.w, turn.x, turn.y, turn.z])
    reason = _reason(values)
    if reason:
        raise MessageError(reason)
    try:
        return Transform(frame_of(header.frame_id), child, time_of(header.stamp), values[:3], values[3:])
    except MessageError as error:
        raise MessageError(str(error).partition(":")[0] + ": invalid") from None


def _reason(pose: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    """Why x y z and w x y z are no pose, or ""."""
    if not np.isfinite(pose).all():
        return "a value is not finite"
    if np.abs(pose[:3]).max() > MOST_METRES:
        return f"position: beyond {MOST_METRES:g} m"
    return "" if is_unit(pose[3:]) else "orientation: a quaternion whose length is not 1"


#: Frames that are known, at most; a vehicle has tens.
MOST_FRAMES = 256
#: Transforms of a frame that are kept, those that arrived last: 5 s of one that is sent at 20 Hz.
KEPT = 100
#: Frames between one and the world, at most: more are a loop.
MOST_STEPS = 32
#: s, by which a transform may be older or newer than a stamp; two that are twice as far apart are interpolated.
MOST_AGE_S = 0.5


class Placement(NamedTuple):
    """Where a frame is in another. position: (3,) m, of its origin; rotation: (4,) active quaternion w x y z"""

    position: Floats
    rotation: Floats


IDENTITY = Placement(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))


class _History:
    """Where a frame was in its parent, by time; a static one has one transform, for all times."""

    def __init__(self, parent: str, *, static: bool) -> None:
        self.parent = parent
        self.static = static
        self._times: list[int] = []
        self._arrived: deque[int] = deque()  # the same times, in order of arrival: those of another clock go, too
        self._placements: list[Placement] = []

    def add(self, time_ns: int, placement: Placement) -> None:
        if self.static:
            self._times, self._placements = [time_ns], [placement]
            return
        row = bisect_left(self._times, time_ns)
        if row < len(self._times) and self._times[row] == time_ns:
            return  # the first one counts
        self._times.insert(row, time_ns)
        self._placements.insert(row, placement)
        self._arrived.append(time_ns)
        if len(self._arrived) > KEPT:
            oldest = bisect_left(self._times, self._arrived.popleft())
            del self._times[oldest], self._placements[oldest]

    def at(self, time_ns: int) -> Placement:
        if not self._times:
            raise MessageError("no transform: none yet")
        if self.static:
            return self._placements[0]
        row = bisect_left(self._times, time_ns)
        after = min(row, len(self._times) - 1)
        before = max(row - 1, 0)
        nearest = min(after, before, key=lambda index: abs(self._times[index] - time_ns))
        distance, gap = abs(self._times[nearest] - time_ns), self._times[after] - self._times[before]
        if distance > MOST_AGE_S * 1e9:
            raise MessageError(f"no transform: none within {MOST_AGE_S:g} s of the stamp")
        if distance == 0 or before == after or gap > 2e9 * MOST_AGE_S:
            return self._placements[nearest]
        fraction = (time_ns - self._times[before]) / gap
        return between(self._placements[before], self._placements[after], fraction)


class FrameTransforms:
    """The frames that are known by their transforms.

    world: the frame from which all others hang
    own:   frames that the run itself places, such as an agent's
    """

    def __init__(self, world: str, own: Collection[str] = ()) -> None:
        self.world = world
        self._own = {name: _History(world, static=False) for name in own}
        self._frames: dict[str, _History] = {}

    def place_own(self, frame: str, time_ns: int, placement: Placement) -> None:
        """Place a frame of the run in the world at a time of the scene."""
        self._own[frame].add(time_ns, placement)

    def add(self, parent: str, child: str, time_ns: int, placement: Placement, *, static: bool) -> None:
        """Take a transform from outside; the newest parent of a frame counts.

        Raises MessageError for a frame of the run, and for more than MOST_FRAMES frames.
        """
        if child == self.world or child in self._own:
            raise MessageError("own frame: the run places it itself")
        history = self._frames.get(child)
        if history is None and len(self._frames) >= MOST_FRAMES:
            raise MessageError(f"too many frames: more than {MOST_FRAMES}")
        if history is None or history.parent != parent or history.static != static:
            history = self._frames[child] = _History(parent, static=static)
        history.add(time_ns, placement)

    def place(self, frame: str, stamp_ns: int, time_ns: int) -> Placement:
        """Where a frame was in the world.

        stamp_ns: by the clock of what comes from outside; time_ns: the same in the scene's time

        Raises MessageError for an unknown frame, a loop, and a transform that is not known for that time.
        """
        result = IDENTITY
        for _ in range(MOST_STEPS):
            if frame == self.world:
                return result
            own = self._own.get(frame)
            history = own or self._frames.get(frame)
            if history is None:
                expected = f"expected {self.world!r}, or one with a transform to it"
                raise MessageError(f"unknown frame: found {frame!r:.80}, {expected}")
            placement = history.at(time_ns if own else stamp_ns)
            result = placement if result is IDENTITY else composed(placement, result)
            frame = history.parent
        raise MessageError(f"loop of frames: more than {MOST_STEPS} transforms to the world")


def composed(outer: Placement, inner: Placement) -> Placement:
    """Where a frame is that is in another, which is somewhere itself."""
    turn = rotation_from_quaternion(outer.rotation)
    rotation = quaternion_from_rotation(turn @ rotation_from_quaternion(inner.rotation))
    return Placement(outer.position + turn @ inner.position, rotation)


def between(earlier: Placement, later: Placement, fraction: float) -> Placement:
    """Interpolated: positions on a line, rotations on the shortest arc. fraction: 0 to 1"""
    position = earlier.position + fraction * (later.position - earlier.position)
    one, other = (each.rotation / np.linalg.norm(each.rotation) for each in (earlier, later))
    return Placement(position, slerp(one[None], other[None], np.array([[fraction]]))[0])


def slerp(first: Floats, second: Floats, share: Floats) -> Floats:
    """Quaternions (n, 4) at shares (n, 1) of the way between two, the short way."""
    cosine = np.sum(first * second, axis=1, keepdims=True)
    second = np.where(cosine < 0.0, -second, second)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    near = angle < 1e-4  # there, both ways are the same, and the sine is 0
    sine = np.where(near, 1.0, np.sin(angle))
    weights = [np.where(near, part, np.sin(part * angle) / sine) for part in (1.0 - share, share)]
    return np.asarray(weights[0] * first + weights[1] * second)

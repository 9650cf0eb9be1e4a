"""Frames of reference that nodes of ROS 2 tell of by /tf and /tf_static, and where they are in the world.

What is kept is limited. The frames that the run itself knows, the world and an agent's, cannot be told of from outside.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.geometry import quaternion_from_rotation, rotation_from_quaternion
from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import MessageError

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

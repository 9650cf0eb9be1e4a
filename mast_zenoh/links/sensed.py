"""Detections in transit, and the pose of the agent that they are for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.geometry import heading, rotation_from_quaternion, rotation_from_yaw, wrap_angle
from mast_zenoh.arrays.states import Detections, Floats

_NANOSECONDS = 1e9


class SenderPose(NamedTuple):
    """Pose of a link's agent in an earlier frame.

    time_ns: of the frame; position: (3,) m; rotation: (4,) active quaternion; velocity: (3,) m/s; turn_rate: rad/s
    """

    time_ns: int
    position: Floats
    rotation: Floats
    velocity: Floats
    turn_rate: float

    @classmethod
    def after(
        cls, previous: SenderPose | None, time_ns: int, position: Floats, rotation: Floats, velocity: Floats
    ) -> SenderPose:
        """The pose at `time_ns`; the rate of turning is that since the previous pose."""
        rate = 0.0
        if previous is not None and time_ns > previous.time_ns:
            turn = _heading(rotation) - _heading(previous.rotation)
            rate = float(wrap_angle(np.array(turn))) / (time_ns - previous.time_ns) * _NANOSECONDS
        return cls(time_ns, position, rotation, velocity, rate)

    def at(self, time_ns: int) -> tuple[Floats, Floats]:
        """Position (3,) m and rotation (3, 3) at a time, for an agent that moves and turns on as before."""
        elapsed = (time_ns - self.time_ns) / _NANOSECONDS
        turn = rotation_from_yaw(self.turn_rate * elapsed)
        return self.position + self.velocity * elapsed, turn @ rotation_from_quaternion(self.rotation)


class Sensed(NamedTuple):
    """The detections in a message, with their sensor.

    detections: sensor frame
    mount_position: (3,) m, mount_rotation: (3, 3) active: of the sensor in the agent's frame
    pose: of the agent; None: not known yet
    """

    detections: Detections
    mount_position: Floats
    mount_rotation: Floats
    pose: SenderPose | None


def _heading(quaternion: Floats) -> float:
    return float(heading(rotation_from_quaternion(quaternion)))

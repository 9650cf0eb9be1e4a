"""What a fault of an agent does to its tracks and its view, and how it is told.

A fault is (4,): x and y in m, a turn in rad, and a time offset in s; it moves all tracks of the agent alike.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_yaw
from mast_zenoh.arrays.states import Bools, Floats, ObjectStates
from mast_zenoh.integrity.views import SweptView

#: m, m/s: a track by which turns and delays are compared with displacements.
ARM_M, SPEED_MPS = 30.0, 10.0


def corrected(states: ObjectStates, rows: Bools, estimate: Floats, pivot: Floats) -> ObjectStates:
    """Tracks without a fault (4,): x and y in m, turn in rad, time offset in s.

    rows: (n,) of the agent; pivot: (2,) m
    """
    x, y, turn, delay = estimate.tolist()
    position, velocity, yaw = states.position.copy(), states.velocity.copy(), states.yaw.copy()
    arm = position[rows, :2] - pivot
    moved = np.column_stack([x - turn * arm[:, 1], y + turn * arm[:, 0]]) + delay * velocity[rows, :2]
    position[rows, :2] -= moved
    vx, vy = velocity[rows, :2].T
    velocity[rows, :2] = np.column_stack([vx + turn * vy, vy - turn * vx])
    yaw[rows] -= turn
    return states.with_(position=position, velocity=velocity, yaw=yaw)


def size_m(fault: Floats) -> float:
    """m, by which a fault (4,) moves a track that is ARM_M away and drives at SPEED_MPS."""
    x, y, turn, delay = fault.tolist()
    return float(max(np.hypot(x, y), ARM_M * abs(turn), SPEED_MPS * abs(delay)))


def late(delay: float) -> str:
    """A time offset in words; delay: s, positive if the tracks are ahead."""
    return f"{abs(delay):.2f} s {'early' if delay > 0.0 else 'late'}"


def described(fault: Floats) -> str:
    """A fault (4,) in words."""
    x, y, turn, delay = fault.tolist()
    return f"all its tracks are off by {np.hypot(x, y):.1f} m and {np.degrees(turn):.1f} degrees, and {late(delay)}"


def corrected_view(view: SweptView, fault: Floats) -> SweptView:
    """A view without a fault (4,): its sensor is the pivot of the turn."""
    position = view.view.position - np.array([fault[0], fault[1], 0.0])
    return replace(
        view, view=replace(view.view, position=position, rotation=rotation_from_yaw(-fault[2]) @ view.view.rotation)
    )

"""What a fault of an agent does to its tracks and its view, and how to undo it.

A fault is (4,): x and y in m, a turn in rad, and a lead in s, by which its tracks are ahead; it moves all tracks of the
agent alike.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_yaw
from mast_zenoh.arrays.states import Bools, Floats, ObjectStates
from mast_zenoh.integrity.views import SweptView

#: m, m/s: a track by which turns and delays are compared with displacements.
ARM_M, SPEED_MPS = 30.0, 10.0
#: Variances of a fault before any evidence: (2 m, 2 m, 0.1 rad, 0.3 s) squared.
PRIOR = np.array([4.0, 4.0, 0.01, 0.09])


def displacements(arm: Floats, velocity: Floats) -> Floats:
    """(k, 2, 4) derivatives of the displacement of tracks by a fault.

    arm: (k, 2) m, from the point about which the agent turns; velocity: (k, 2) m/s
    """
    result = np.zeros((len(arm), 2, 4))
    result[:, 0, 0] = result[:, 1, 1] = 1.0
    result[:, 0, 2], result[:, 1, 2] = -arm[:, 1], arm[:, 0]
    result[:, :, 3] = velocity
    return result


def without_fault(states: ObjectStates, rows: Bools, fault: Floats, pivot: Floats) -> ObjectStates:
    """Tracks without the fault (4,) of an agent.

    rows: (n,) of the agent; pivot: (2,) m
    """
    x, y, turn, lead = fault.tolist()
    position, velocity, yaw = states.position.copy(), states.velocity.copy(), states.yaw.copy()
    arm = position[rows, :2] - pivot
    moved = np.column_stack([x - turn * arm[:, 1], y + turn * arm[:, 0]]) + lead * velocity[rows, :2]
    position[rows, :2] -= moved
    vx, vy = velocity[rows, :2].T
    velocity[rows, :2] = np.column_stack([vx + turn * vy, vy - turn * vx])
    yaw[rows] -= turn
    return states.with_(position=position, velocity=velocity, yaw=yaw)


def displacement_m(fault: Floats) -> Floats:
    """(...) m, by which faults (..., 4) move a track that is ARM_M away and drives at SPEED_MPS."""
    shift = np.hypot(fault[..., 0], fault[..., 1])
    return np.asarray(np.maximum(shift, np.maximum(ARM_M * np.abs(fault[..., 2]), SPEED_MPS * np.abs(fault[..., 3]))))


def described(fault: Floats) -> str:
    """A fault (4,) in words, as far as it shows: "all its tracks are shifted by 0.8 m, turned by -0.6°"."""
    x, y, turn, lead = fault.tolist()
    shift, degrees = float(np.hypot(x, y)), float(np.degrees(turn))
    parts = [
        f"shifted by {shift:.1f} m" if round(shift, 1) else "",
        f"turned by {degrees:.1f}°" if round(degrees, 1) else "",
        f"{abs(lead):.2f} s {'early' if lead > 0.0 else 'late'}" if round(lead, 2) else "",
    ]
    return f"all its tracks are {', '.join(part for part in parts if part) or 'slightly off'}"


def view_without_fault(view: SweptView, fault: Floats) -> SweptView:
    """A view without the fault (4,) of its agent; its sensor is the pivot of the turn."""
    position = view.view.position - np.array([fault[0], fault[1], 0.0])
    return replace(
        view, view=replace(view.view, position=position, rotation=rotation_from_yaw(-fault[2]) @ view.view.rotation)
    )

"""What happened to a car that was driven: collisions, hard braking, jerk, progress."""

from __future__ import annotations

from typing import Any

import numpy as np

from mast_zenoh.arrays.rectangles import intersection_area
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.metrics.driving import STANDING_MPS, Drive, Objects, Vehicle

#: m/s^2; harder braking is not comfortable. Source: the bounds of nuPlan's comfort metric (Caesar et al., 2021).
HARD_BRAKING_MPS2 = 4.05
#: m^2; outlines with a smaller intersection only touch.
_TOUCH_M2 = 1e-6


def collisions(car: Vehicle, objects: Objects) -> Ints:
    """Rows (k,) of the n objects whose outlines overlap that of the car in the same frame, ascending."""
    offset = objects.position[:, :2] - car.position[objects.frame, :2]
    reach = 0.5 * (np.hypot(car.length, car.width) + np.hypot(objects.size[:, 0], objects.size[:, 1]))
    near = np.flatnonzero(np.hypot(offset[:, 0], offset[:, 1]) <= reach)
    size = np.tile([car.length, car.width], (len(near), 1))
    heading = car.heading[objects.frame[near]]
    area = intersection_area(offset[near], size, heading, objects.size[near, :2], objects.yaw[near])
    return near[area > _TOUCH_M2]


def accelerations(speed: Floats, period_s: float) -> Floats:
    """Acceleration (f - 1,) m/s^2 from each frame to the next. speed: (f,) m/s"""
    return np.diff(speed) / period_s


def episodes(during: np.ndarray) -> int:
    """Number of uninterrupted times during which a condition (f,) holds."""
    return int(np.count_nonzero(during & ~np.concatenate([[False], during[:-1]])))


def consequences(
    car: Vehicle, objects: Objects, ids: Ints, frames: Ints, by_truth: Drive, period_s: float
) -> dict[str, Any]:
    """What happened to a car in f frames, as numbers for metrics.json.

    objects, ids: all other n objects of these frames, and their ids (n,); frames: (f,) their numbers
    by_truth: the truth in the car's corridor, with the braking rule of the run; period_s: s between two frames

    Returns "collisions" (a list of the object, the frame of the first contact and the speed of the car relative to the
    object, m/s), "hard_brakes" (episodes), "hardest_braking_mps2", "jerk_max_mps3", "progress_m", "standing_s",
    "min_gap_m", "min_ttc_s" (None: nothing was ever ahead, or approached), and "unsafe_s": the time during which the
    braking rule says that the car should brake.
    """
    speed = np.hypot(car.velocity[:, 0], car.velocity[:, 1])
    acceleration = accelerations(speed, period_s)
    hit = collisions(car, objects)
    contacts = []
    for number in np.unique(ids[hit]).tolist():
        row = hit[ids[hit] == number][0]
        relative = objects.velocity[row, :2] - car.velocity[objects.frame[row], :2]
        first = int(frames[objects.frame[row]])
        contacts.append({"object": number, "frame": first, "speed_mps": float(np.hypot(*relative))})
    gap, ttc = float(by_truth.gap_m.min(initial=np.inf)), float(by_truth.ttc_s.min(initial=np.inf))
    return {
        "collisions": contacts,
        "hard_brakes": episodes(acceleration < -HARD_BRAKING_MPS2),
        "hardest_braking_mps2": float(abs(acceleration.min(initial=0.0))),
        "jerk_max_mps3": float(np.abs(np.diff(acceleration)).max(initial=0.0) / period_s),
        "progress_m": float(np.hypot(*np.diff(car.position[:, :2], axis=0).T).sum()),
        "standing_s": float(np.count_nonzero(speed <= STANDING_MPS) * period_s),
        "min_gap_m": gap if np.isfinite(gap) else None,
        "min_ttc_s": ttc if np.isfinite(ttc) else None,
        "unsafe_s": float(np.count_nonzero(by_truth.brake) * period_s),
    }

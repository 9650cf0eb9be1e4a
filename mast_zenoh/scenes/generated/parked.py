"""Cars that are parked in bays between the kerb and the pavement of a generated junction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.scenes.generated.junction import Arm

#: m, from the stop line to the middle of the first bay, and between two; poles stand in between, every 8 m.
_FIRST_BAY, _BAY = 12.0, 8.0
#: m, from the centre of the junction to the end of the last bay: beyond, lanes spread towards the turning loops.
_LAST_BAY = 100.0
#: m, from the kerb to the side of a car; pedestrians walk 2.25 m from the kerb and farther.
_TO_KERB = 0.1
#: (l, w, h) m of the smallest and the largest car.
_SMALLEST, _LARGEST = (3.8, 1.65, 1.4), (5.0, 1.95, 1.9)
_AGAINST_TRAFFIC = 0.1  # share of the cars that face oncoming traffic


@dataclass(frozen=True, eq=False)
class ParkedCars:
    """p cars that never move. position: (p, 2) m, centres, yaw: (p,) rad, size: (p, 3) m; world frame"""

    position: Floats
    yaw: Floats
    size: Floats


def parked_cars(arms: tuple[Arm, ...], random: np.random.Generator, count: int) -> ParkedCars:
    """`count` cars, or as many as there are bays, parked along the arms; some kerbs are fuller than others."""
    bays, weight = [], []
    for arm in arms:
        for side in (1.0, -1.0):
            fullness = random.uniform(0.2, 1.0)
            for along in np.arange(arm.stop + _FIRST_BAY, _LAST_BAY - _BAY / 2, _BAY):
                bays.append((arm, side, float(along)))
                weight.append(fullness)
    share = np.array(weight) / np.sum(weight)
    chosen = np.sort(random.choice(len(bays), size=min(count, len(bays)), replace=False, p=share))
    low, high = np.array(_SMALLEST), np.array(_LARGEST)
    size = np.round(low + (high - low) * random.random((len(chosen), 3)), 2)
    shift, turn = random.uniform(-0.5, 0.5, len(chosen)), random.normal(0.0, np.radians(1.0), len(chosen))
    against = random.random(len(chosen)) < _AGAINST_TRAFFIC
    position, yaw = np.zeros((len(chosen), 2)), np.zeros(len(chosen))
    for k, bay in enumerate(chosen):
        arm, side, along = bays[bay]
        beside = side * (arm.half_width + _TO_KERB + size[k, 1] / 2)
        position[k] = arm.world(np.array([[along + shift[k], beside]]))[0]
        # Lanes with a positive offset lead towards the centre.
        yaw[k] = arm.angle + np.pi * ((side > 0) ^ against[k]) + np.clip(turn[k], *np.radians([-2.0, 2.0]))
    return ParkedCars(position, yaw, size)

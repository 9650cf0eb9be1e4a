"""Places of spoofers, and how well they aim at a lidar.

A spoofer's laser must stay on the receiver of the lidar, a few centimetres wide, from metres to tens of metres away. It
does so in some scans only, fewer the farther it is and the faster the line of sight turns.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import angles_of, wrap_angle
from mast_zenoh.arrays.states import Floats
from mast_zenoh.attacks.surroundings import Surroundings
from mast_zenoh.sensing.points import Points

#: rad; returns within this angle of a spoofer, in direction, azimuth or elevation, tell whether it has sight.
_NEAR_RAD = np.radians(1.2)


@dataclass(frozen=True, kw_only=True)
class Spoofer(ABC):
    """Base class of the places of a spoofer.

    P(aim), of one scan, is that of a pointing error with normal components below `spot_m`: `aim_deg` times the
    distance, and `lag_s` times the speed at which the lidar crosses the line of sight. With the defaults a standing
    spoofer hits a standing lidar in 0.93 of scans at 50 m (SLAMSpoof: up to 50 m), and a passing car almost never, as
    in the published runs at 10 to 60 km/h (Keio-CSG/lidar-spoofing-artifacts, docs/attack_check.json: 2 of 6,392
    frames). The three numbers are fitted to these; nobody has published them.

    aim_deg: deg, rms of each component of the pointing error
    lag_s:   s, age of the direction into which the spoofer points: 2.5, turned by hand; 0.02, with automatic tracking;
             above 0, it misses the first scan, in which it does not know yet how the lidar moves
    spot_m:  m, radius of the spot of light that the lidar's receiver must be in
    body_m:  m, a return this near to the spoofer is from what carries it, and does not hide it
    """

    aim_deg: float = 0.05
    lag_s: float = 2.5
    spot_m: float = 0.1
    body_m: float = 0.5

    def __post_init__(self) -> None:
        check("0 or more, finite", aim_deg=self.aim_deg, lag_s=self.lag_s, body_m=self.body_m)
        check("more than 0, finite", spot_m=self.spot_m)

    @abstractmethod
    def position(self, time_s: float, lidar: tuple[Floats, Floats], surroundings: Surroundings) -> Floats:
        """(3,) m, world frame, at a time in s of scene time.

        lidar: position (3,) m and active rotation (3, 3) of the victim's lidar, world frame
        Raises ValueError for an agent that is not known.
        """

    def aim(self, distance_m: float, across_mps: float) -> float:
        """P(aim), 0 to 1. across_mps: m/s, of the lidar across the line of sight from the spoofer; inf: not known"""
        lag_m = self.lag_s * across_mps if self.lag_s else 0.0
        square = (np.radians(self.aim_deg) * distance_m) ** 2 + lag_m**2
        return float(-np.expm1(-0.5 * self.spot_m**2 / square)) if square > 0.0 else 1.0

    def in_sight(self, points: Points, towards: Floats) -> bool:
        """Whether a scan shows that a spoofer at `towards` (3,) m, in the lidar's frame, has sight of the lidar.

        Its light reaches the receiver only from where beams look: some return at its azimuth, and it is neither above
        nor below all returns and the horizon. The nearest beam does not return from before the spoofer; where none is
        near, no beam above does.

        points: as adversaries before this one on the wire have left them: their order decides
        """
        (azimuth, elevation), (bearing, up) = map(angles_of, (points.position.astype(np.float64), towards))
        beside = np.abs(wrap_angle(azimuth - bearing)) <= _NEAR_RAD
        in_field = elevation.min(initial=0.0) - _NEAR_RAD <= up <= elevation.max(initial=0.0) + _NEAR_RAD
        if not in_field or not beside.any():
            return False
        distance = float(np.linalg.norm(towards))
        range_m = points.range_m()
        along = points.position @ (towards / max(distance, 1e-9)).astype(np.float32)
        cosine = along / np.maximum(range_m, 1e-6)
        nearest, before = int(cosine.argmax()), range_m < distance - self.body_m
        if cosine[nearest] >= np.cos(_NEAR_RAD):
            return not before[nearest]
        return not (before & beside & (elevation > up - _NEAR_RAD)).any()


@dataclass(frozen=True, kw_only=True)
class Roadside(Spoofer):
    """A spoofer that stands still.

    x, y, z: m, world frame
    """

    x: float
    y: float
    z: float = 1.5

    def position(self, time_s: float, lidar: tuple[Floats, Floats], surroundings: Surroundings) -> Floats:
        return np.array([self.x, self.y, self.z])


@dataclass(frozen=True, kw_only=True)
class Following(Spoofer):
    """A spoofer that moves with the victim, as on a car that keeps its distance.

    distance_m: m, ahead of the lidar along its heading; below 0: behind it
    height_m:   m, above the lidar
    """

    distance_m: float = 10.0
    height_m: float = -0.5
    body_m: float = 2.5

    def position(self, time_s: float, lidar: tuple[Floats, Floats], surroundings: Surroundings) -> Floats:
        position, rotation = lidar
        ahead = rotation[:2, 0] / max(float(np.hypot(*rotation[:2, 0])), 1e-9)
        return np.asarray(position + np.append(self.distance_m * ahead, self.height_m), np.float64)


@dataclass(frozen=True, kw_only=True)
class OnCar(Spoofer):
    """A spoofer on another agent, on its usual route.

    agent: its name;  height_m: m, above the route
    """

    agent: str
    height_m: float = 1.5
    body_m: float = 3.0

    def position(self, time_s: float, lidar: tuple[Floats, Floats], surroundings: Surroundings) -> Floats:
        if self.agent not in surroundings.sensors:
            known = ", ".join(surroundings.sensors) or "none"
            raise ValueError(f"agent: found {self.agent!r}, expected one of {known}")
        x, y, z = surroundings.sensors[self.agent].route.position_at(time_s)
        return np.array([x, y, z + self.height_m])

"""Reference position of a message, and the plane around it: WGS84, TS 102 894-2 v2.4.1, ReferencePosition."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import MessageError

#: Values of the standard for what is not known.
UNAVAILABLE_SEMI_AXIS, UNAVAILABLE_ANGLE, UNAVAILABLE_ALTITUDE, UNAVAILABLE_CONFIDENCE = 4095, 3601, 800_001, 15
UNAVAILABLE_LATITUDE, UNAVAILABLE_LONGITUDE = 900_000_001, 1_800_000_001


@dataclass(frozen=True)
class Position:
    """ReferencePosition, in its units.

    latitude, longitude: 1e-7 deg;  altitude: above the ellipsoid, 0.01 m, with its place in AltitudeConfidence
    semi_major, semi_minor: of the 95 % ellipse, 0.01 m;  orientation: of the major axis, 0.1 deg clockwise from north
    """

    latitude: int
    longitude: int
    altitude: int = UNAVAILABLE_ALTITUDE
    altitude_confidence: int = UNAVAILABLE_CONFIDENCE
    semi_major: int = UNAVAILABLE_SEMI_AXIS
    semi_minor: int = UNAVAILABLE_SEMI_AXIS
    orientation: int = UNAVAILABLE_ANGLE


#: Altitudes between these are values; they themselves mean "out of range".
_LOWEST_ALTITUDE, _HIGHEST_ALTITUDE = -100_000, 800_000
#: Distance from the origin, m, beyond which the plane is no map of the ground, and a position is no place in the scene.
REACH_M = 100_000.0
_MAX_ORIGIN_M = 1e8

#: Semi-major axis, m, and squared eccentricity of the WGS84 ellipsoid.
_AXIS, _ECCENTRICITY_2 = 6_378_137.0, 6.694_379_990_141_317e-3


@dataclass(frozen=True)
class LocalPlane:
    """The tangent plane of the ellipsoid at an origin: x east, y north, z up, in m.

    Latitude and longitude are linear in it, by the radii of curvature at the origin. Up to latitude 60, that is within
    0.2 m of the exact plane at 1 km. It is exactly inverted, so all that share an origin agree up to the quantisation
    of 1e-7 deg, about 1 cm.

    latitude, longitude: of the origin, deg;  altitude: above the ellipsoid, m
    origin: x and y, m, of the origin in the world frame, see `Recording.origin`
    """

    latitude: float = 52.0
    longitude: float = 9.0
    altitude: float = 0.0
    origin: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not all(abs(value) <= _MAX_ORIGIN_M for value in self.origin):
            raise ValueError(f"origin: found {self.origin}, expected numbers up to {_MAX_ORIGIN_M:g} m")

    def _metres_per_degree(self) -> tuple[float, float]:
        """North and east."""
        phi = np.radians(self.latitude)
        w = 1.0 - _ECCENTRICITY_2 * np.sin(phi) ** 2
        meridian, normal = _AXIS * (1.0 - _ECCENTRICITY_2) / w**1.5, _AXIS / w**0.5
        return float(np.radians(meridian + self.altitude)), float(np.radians((normal + self.altitude) * np.cos(phi)))

    def to_position(self, point: Floats) -> Position:
        """The reference position at a point (3,) m of the world frame, without confidences."""
        north, east = self._metres_per_degree()
        x, y = point[:2] - self.origin
        latitude, longitude = self.latitude + y / north, self.longitude + x / east
        altitude = self.altitude + point[2]
        return Position(int(np.rint(1e7 * latitude)), int(np.rint(1e7 * longitude)), int(np.rint(100.0 * altitude)))

    def to_point(self, position: Position) -> Floats:
        """The point (3,) m of the world frame at a reference position.

        An altitude that is unavailable or out of range is that of the origin. Raises MessageError if latitude or
        longitude is unavailable, or further than `REACH_M` from the origin.
        """
        if position.latitude == UNAVAILABLE_LATITUDE or position.longitude == UNAVAILABLE_LONGITUDE:
            raise MessageError("referencePosition: found an unavailable latitude or longitude, expected a place")
        north, east = self._metres_per_degree()
        x = (1e-7 * position.longitude - self.longitude) * east
        y = (1e-7 * position.latitude - self.latitude) * north
        if not np.hypot(x, y) <= REACH_M:
            raise MessageError(
                f"referencePosition: found a place {np.hypot(x, y) / 1e3:.0f} km from the scene, "
                f"expected at most {REACH_M / 1e3:.0f}"
            )
        altitude = 0.01 * position.altitude if has_altitude(position) else self.altitude
        return np.array([x + self.origin[0], y + self.origin[1], altitude - self.altitude])


#: The plane with its origin at that of the world.
WORLD_PLANE = LocalPlane()


def has_altitude(position: Position) -> bool:
    """Whether the altitude of a position is a value, not "unavailable" or "out of range"."""
    return _LOWEST_ALTITUDE < position.altitude < _HIGHEST_ALTITUDE

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


#: Semi-major axis, m, and squared eccentricity of the WGS84 ellipsoid.
_AXIS, _ECCENTRICITY_2 = 6_378_137.0, 6.694_379_990_141_317e-3


@dataclass(frozen=True)
class LocalPlane:
    """The tangent plane of the ellipsoid at an origin: x east, y north, z up, in m.

    Latitude and longitude are linear in it, by the radii of curvature at the origin. Up to latitude 60, that is within
    0.2 m of the exact plane at 1 km. It is exactly inverted, so all that share an origin agree up to the quantisation
    of 1e-7 deg, about 1 cm.

    latitude, longitude: deg;  altitude: above the ellipsoid, m
    """

    latitude: float = 52.0
    longitude: float = 9.0
    altitude: float = 0.0

    def _metres_per_degree(self) -> tuple[float, float]:
        """North and east."""
        phi = np.radians(self.latitude)
        w = 1.0 - _ECCENTRICITY_2 * np.sin(phi) ** 2
        meridian, normal = _AXIS * (1.0 - _ECCENTRICITY_2) / w**1.5, _AXIS / w**0.5
        return float(np.radians(meridian + self.altitude)), float(np.radians((normal + self.altitude) * np.cos(phi)))

    def to_position(self, point: Floats) -> Position:
        """The reference position at a point (3,) of the plane, without confidences."""
        north, east = self._metres_per_degree()
        latitude, longitude = self.latitude + point[1] / north, self.longitude + point[0] / east
        altitude = self.altitude + point[2]
        return Position(int(np.rint(1e7 * latitude)), int(np.rint(1e7 * longitude)), int(np.rint(100.0 * altitude)))

    def to_point(self, position: Position) -> Floats:
        """The point (3,) of the plane at a reference position; an unavailable altitude is that of the origin.

        Raises MessageError if latitude or longitude is unavailable.
        """
        if position.latitude == UNAVAILABLE_LATITUDE or position.longitude == UNAVAILABLE_LONGITUDE:
            raise MessageError("referencePosition: found an unavailable latitude or longitude, expected a place")
        north, east = self._metres_per_degree()
        altitude = self.altitude if position.altitude == UNAVAILABLE_ALTITUDE else 0.01 * position.altitude
        return np.array(
            [
                (1e-7 * position.longitude - self.longitude) * east,
                (1e-7 * position.latitude - self.latitude) * north,
                altitude - self.altitude,
            ]
        )

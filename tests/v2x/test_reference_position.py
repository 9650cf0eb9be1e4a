"""Reference positions in WGS84, and the plane around an origin."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.errors import MessageError
from mast_zenoh.v2x.reference_position import LocalPlane, Position

PLANE = LocalPlane(48.76, 11.43, 370.0)
AXIS, ECCENTRICITY_2 = 6_378_137.0, 6.694379990141317e-3


def geocentric(latitude: float, longitude: float, height: float) -> np.ndarray:
    """Earth-centred coordinates (3,), m, of a point in degrees."""
    phi, theta = np.radians([latitude, longitude])
    normal = AXIS / np.sqrt(1 - ECCENTRICITY_2 * np.sin(phi) ** 2)
    across = (normal + height) * np.cos(phi)
    return np.array(
        [across * np.cos(theta), across * np.sin(theta), (normal * (1 - ECCENTRICITY_2) + height) * np.sin(phi)]
    )


@given(st.integers(0, 2**32))
def test_both_sides_use_the_quantised_reference_position(seed):
    point = np.random.default_rng(seed).uniform(-1000, 1000, 3)
    position = PLANE.to_position(point)
    np.testing.assert_allclose(PLANE.to_point(position), point, atol=0.011)
    assert PLANE.to_position(PLANE.to_point(position)) == position


def test_a_degree_of_the_plane_is_as_long_as_on_the_ellipsoid():
    """Lengths of a degree at latitude 45: 111131.745 m and 78846.806 m (WGS84)."""
    plane = LocalPlane(45.0, 0.0)
    north, east, _ = plane.to_point(Position(451_000_000, 0))[[1, 0, 2]]
    np.testing.assert_allclose([10 * north, east], [111_131.745, 0.0], rtol=1e-6)
    np.testing.assert_allclose(10 * plane.to_point(Position(450_000_000, 1_000_000))[0], 78_846.806, rtol=1e-6)


@pytest.mark.parametrize("latitude", [-60.0, 0.0, 45.0, 60.0])
@pytest.mark.parametrize("azimuth", np.linspace(0, 2 * np.pi, 9))
def test_the_plane_is_within_20_centimetres_of_the_exact_one_at_a_kilometre(latitude, azimuth):
    plane, (phi, theta) = LocalPlane(latitude, 9.0, 100.0), np.radians([latitude, 9.0])
    point = 1000 * np.array([np.cos(azimuth), np.sin(azimuth), 0])
    position = plane.to_position(point)
    east = np.array([-np.sin(theta), np.cos(theta), 0])
    up = np.array([np.cos(phi) * np.cos(theta), np.cos(phi) * np.sin(theta), np.sin(phi)])
    axes = np.stack([east, np.cross(up, east), up])
    there = geocentric(1e-7 * position.latitude, 1e-7 * position.longitude, 0.01 * position.altitude)
    np.testing.assert_allclose(axes @ (there - geocentric(latitude, 9.0, 100.0)), point, atol=0.2)


def test_an_unavailable_altitude_is_that_of_the_origin():
    assert PLANE.to_point(Position(487_600_000, 114_300_000))[2] == 0.0


@pytest.mark.parametrize("place", [dict(latitude=900_000_001), dict(longitude=1_800_000_001)])
def test_an_unavailable_place_is_refused(place: dict[str, int]) -> None:
    with pytest.raises(MessageError, match=r"referencePosition.*unavailable.*longitude"):
        LocalPlane().to_point(Position(**{"latitude": 0, "longitude": 0} | place))

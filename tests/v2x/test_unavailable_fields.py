"""What a message says to be unavailable or out of range is no value: TS 102 894-2 v2.4.1."""

from dataclasses import replace

import numpy as np
import pytest

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.errors import MessageError
from mast_zenoh.messages.packed import pack, unpack
from mast_zenoh.messages.schemas import Header, Message
from mast_zenoh.v2x import Vehicle, cam, cpm
from mast_zenoh.v2x.perceived_objects import PerceivedObjects
from mast_zenoh.v2x.reference_position import LocalPlane, Position
from mast_zenoh.v2x.tracks import (
    SIGMAS_95,
    UNKNOWN_DIMENSION,
    UNKNOWN_POSITION,
    UNKNOWN_VELOCITY,
    from_cam,
    from_cpm,
    to_cam,
    to_cpm,
    to_objects,
)

PLANE = LocalPlane()
#: A car of 4.5 m that drives south-east at 10 m/s.
CAR = Vehicle().state(np.array([20.0, 30.0, 0.0]), np.array([7.07, -7.07, 0.0]), -np.pi / 4)
SAID = to_cam(CAR, 7, 1000, PLANE)
FRONT = PLANE.to_point(SAID.position)


def read(**motion: int) -> ObjectStates:
    """The car as a receiver sees it, if these fields of its motion differ."""
    assert SAID.vehicle is not None
    return from_cam(replace(SAID, vehicle=replace(SAID.vehicle, **motion)), PLANE)


def half_widths(states: ObjectStates) -> np.ndarray:
    """(9,) m and m/s, half 95 % intervals of a single row."""
    return SIGMAS_95 * np.sqrt(states.covariance[0].diagonal())


@pytest.mark.parametrize("motion", [{"heading": 3601}, {"heading": 3600}, {"heading_confidence": 126}])
def test_a_car_of_unknown_heading_is_where_its_front_is_and_has_no_velocity(motion: dict[str, int]) -> None:
    states = read(**motion)
    np.testing.assert_allclose(states.position[0, :2], FRONT[:2])
    assert (half_widths(states)[:2] > SIGMAS_95 * 4.5 / 2 / np.sqrt(2)).all(), "its centre is half a length away"
    assert not states.velocity.any()
    np.testing.assert_allclose(half_widths(states)[6:], UNKNOWN_VELOCITY)


@pytest.mark.parametrize("length", [1022, 1023])
def test_a_car_of_unknown_length_is_where_its_front_is(length: int) -> None:
    states = read(length=length)
    np.testing.assert_allclose(states.position[0, :2], FRONT[:2])
    assert states.size[0, 0] == 1.0
    assert half_widths(states)[3] == pytest.approx(UNKNOWN_DIMENSION)
    assert (half_widths(states)[:2] > 5.0).all()
    assert np.hypot(*states.velocity[0, :2]) == pytest.approx(10.0, abs=0.02), "its speed and heading are known"


def test_an_unknown_width_changes_only_the_width() -> None:
    states, known = read(width=62), read()
    np.testing.assert_array_equal(states.position, known.position)
    assert states.size[0].tolist() == [known.size[0, 0], 1.0, known.size[0, 2]]
    assert half_widths(read(width=61))[4] == pytest.approx(UNKNOWN_DIMENSION)


@pytest.mark.parametrize("speed", [16_382, 16_383])
def test_a_speed_that_is_unavailable_or_out_of_range_is_none(speed: int) -> None:
    states = read(speed=speed)
    assert not states.velocity.any()
    np.testing.assert_allclose(half_widths(states)[6:], UNKNOWN_VELOCITY)
    np.testing.assert_array_equal(states.position, read().position)


@pytest.mark.parametrize("altitude", [800_001, 800_000, -100_000])
def test_an_altitude_that_is_unavailable_or_out_of_range_is_that_of_the_plane(altitude: int) -> None:
    states = from_cam(replace(SAID, position=replace(SAID.position, altitude=altitude)), PLANE)
    assert states.position[0, 2] == pytest.approx(0.75), "half the assumed height"
    assert half_widths(states)[2] == pytest.approx(UNKNOWN_POSITION)


def test_confidences_that_are_unavailable_or_out_of_range_are_large() -> None:
    out_of_range = from_cam(replace(SAID, position=replace(SAID.position, altitude_confidence=14)), PLANE)
    assert half_widths(out_of_range)[2] == pytest.approx(400.0), "more than the largest class, 200 m"
    for axis in (0, 4094, 4095):
        position = replace(SAID.position, semi_major=axis, semi_minor=axis)
        assert (half_widths(from_cam(replace(SAID, position=position), PLANE))[:2] > 0.5 * UNKNOWN_POSITION).all()


@pytest.mark.parametrize(
    ("place", "problem"),
    [
        ({"latitude": 900_000_001}, r"unavailable latitude.*longitude"),
        ({"longitude": 1_800_000_001}, r"unavailable latitude.*longitude"),
        ({"latitude": 900_000_000}, r"place 42[0-9]{2}.*scene"),
        ({"latitude": -520_000_000, "longitude": -1_710_000_000}, r"km.*scene.*most"),
    ],
)
def test_a_message_from_nowhere_or_from_far_away_is_refused(place: dict[str, int], problem: str) -> None:
    with pytest.raises(MessageError, match=problem):
        unpack("cam", [cam.encode(replace(SAID, position=replace(SAID.position, **place)))])
    sent = to_cpm(to_objects(CAR, np.array([1]), FRONT), 7, 0, replace(PLANE.to_position(FRONT), **place))
    with pytest.raises(MessageError, match=problem):
        unpack("cpm", [cpm.encode(sent)])


def perceived(**columns: object) -> cpm.Cpm:
    """A CPM about the car and another one 5 m beside it, whose columns are changed."""
    places = CAR.position + np.array([[0.0, 0.0, 0.0], [0.0, 5.0, 0.0]])
    objects = to_objects(ObjectStates.of(places), np.arange(2), FRONT)
    for name, value in columns.items():
        getattr(objects, name)[1] = value
    return to_cpm(objects, 7, 0, PLANE.to_position(FRONT))


@pytest.mark.parametrize(
    "unknown",
    [{"position": [131_071, 0, 0]}, {"position": [0, -131_072, 0]}, {"delta_time": 2047}, {"delta_time": -2048}],
)
def test_an_object_of_unknown_place_or_time_is_left_out_and_counted(unknown: dict[str, object]) -> None:
    body = unpack("cpm", [cpm.encode(perceived(**unknown))])
    assert body["id"].tolist() == [0]
    assert body.left_out == 1


def test_unavailable_fields_of_an_object_have_large_covariances() -> None:
    unknown = perceived(velocity=16_383, dimensions=256, yaw=3601)
    states = from_cpm(cpm.decode(cpm.encode(unknown)), PLANE)
    assert (states.velocity[1].tolist(), states.size[1].tolist(), states.yaw[1]) == ([0.0] * 3, [1.0] * 3, 0.0)
    np.testing.assert_allclose(half_widths(states.select(np.array([1])))[3:], [UNKNOWN_DIMENSION] * 3 + [20.0] * 3)


def test_heights_are_unknown_in_a_message_without_an_altitude() -> None:
    message = perceived()
    states = from_cpm(replace(message, position=replace(message.position, altitude=800_001)), PLANE)
    np.testing.assert_allclose(half_widths(states)[2], UNKNOWN_POSITION)


def test_a_vehicle_of_unknown_orientation_does_not_head_north() -> None:
    message = replace(perceived(), vehicle=(3601, 127), rsu=False)
    assert unpack("cpm", [cpm.encode(message)])["rotation"].tolist() == [1.0, 0.0, 0.0, 0.0]


def test_a_message_says_how_many_objects_its_sender_knows_also_of_those_that_do_not_fit() -> None:
    n = 260
    states = ObjectStates.of(
        np.arange(3.0 * n).reshape(n, 3), id=np.arange(n), covariance=np.tile(np.eye(9), (n, 1, 1))
    )
    frame = {"origin": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}
    header = Header("tracks", "infra_1", 3, 300_000_000, 3)
    for known, expected in ((None, 255), (30, 30)):
        body = pack(Message(header, states.select(np.arange(12 if known else n)).columns() | frame), "cpm", known=known)
        said = {cpm.decode(segment).known_objects for segment in body.body.segments}  # type: ignore[attr-defined]
        assert said == {expected}


def test_objects_of_other_senders_may_lack_all_that_is_optional() -> None:
    objects = PerceivedObjects.empty(1)
    objects.id[:], objects.delta_time[:], objects.position[:, :2], objects.position_confidence[:, :2] = 1, 0, 0, 4096
    (state,) = from_cpm(to_cpm(objects, 1, 0, Position(520_000_000, 90_000_000)), PLANE).position
    np.testing.assert_allclose(state, [-0.005, -0.005, 0.0], atol=1e-9)

"""Tracks to CPM and back, and a vehicle's own state to CAM and back: quantisation, confidences, classes, segmentation.

Positions and velocities are in a plane that sender and receiver share: x east, y north, z up (`LocalPlane`), as
PerceivedObjects of TS 103 324 v2.1.1. Numbers of units are rounded up, as the types of TS 102 894-2 v2.4.1 say (value n
for more than n - 1 and at most n units), so a received n is read as n - 0.5. A confidence is half the two-sided 95 %
interval of a component: 1.96 standard deviations.
"""

from __future__ import annotations

import dataclasses
from bisect import bisect_right

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import CLASS_INDEX, CLASSES, Floats, Ints, ObjectStates
from mast_zenoh.errors import MessageError
from mast_zenoh.v2x import cpm
from mast_zenoh.v2x.asn1.uper import Values
from mast_zenoh.v2x.cam import Cam, VehicleMotion
from mast_zenoh.v2x.cpm import Cpm
from mast_zenoh.v2x.perceived_objects import (
    ABSENT,
    ANIMAL,
    BICYCLIST,
    CARTESIAN,
    MAX_QUALITY,
    MOTORCYCLIST,
    OTHER,
    PEDESTRIAN,
    POLAR,
    VEHICLE,
    VRU,
    PerceivedObjects,
    quality_of_score,
)
from mast_zenoh.v2x.reference_position import LocalPlane, Position, has_altitude

#: Standard deviations in half a two-sided 95 % interval of a normal distribution.
SIGMAS_95 = 1.96

#: Units: position and velocity 0.01 m and 0.01 m/s, dimensions 0.1 m, angles 0.1 deg.
_POSITION, _VELOCITY, _DIMENSION, _ANGLE = 0.01, 0.01, 0.1, 0.1

#: Largest confidence of each type; one more is "out of range", two more "unavailable". CoordinateConfidence,
#: ObjectDimensionConfidence, SpeedConfidence.
_LARGEST_POSITION, _LARGEST_DIMENSION, _LARGEST_VELOCITY = 4094, 30, 125

#: Confidences that a receiver assumes where the sender's is unavailable or absent: m, m, m/s. The first two are far
#: beyond what the types express; the last is the speed of a road user of unknown direction.
UNKNOWN_POSITION, UNKNOWN_DIMENSION, UNKNOWN_VELOCITY = 100.0, 10.0, 20.0
#: What a receiver takes a confidence "out of range" for, in largest ones of its type. The sender has a confidence, and
#: means it: three of four tracks of our agents have a velocity with more than 1.25 m/s, nine of ten of these less than
#: twice that.
_OUT_OF_RANGE = 2

#: Box of an object whose dimensions are absent, m.
UNKNOWN_SIZE = np.array([1.0, 1.0, 1.0])
#: Times between these are values (DeltaTimeMilliSecondSigned), ms.
_LEAST_DELTA, _MOST_DELTA = -2048, 2047
#: From these on, values are "out of range" or "unavailable": Wgs84AngleValue and CartesianAngleValue, SpeedValue,
#: VehicleLengthValue, SemiAxisLength. VehicleWidth is "more than 6 m", then "unavailable".
_NO_ANGLE, _NO_SPEED, _NO_LENGTH, _NO_SEMI_AXIS = 3600, 16_382, 1022, 4094
_WIDE, _NO_WIDTH = 61, 62
#: HeadingConfidence "out of range": the heading is not to be trusted.
_UNTRUSTED_HEADING = 126
#: Largest number of segments (MessageSegmentationInfo).
MOST_SEGMENTS = 8

#: Alternative of ObjectClass, alternative of VruProfileAndSubprofile, and subclass, in the order of `CLASSES`.
_CLASS_CODES = np.array(
    [
        {
            "unknown": (OTHER, ABSENT, 0),
            "car": (VEHICLE, ABSENT, 5),
            "truck": (VEHICLE, ABSENT, 8),
            "bus": (VEHICLE, ABSENT, 6),
            "motorcycle": (VRU, MOTORCYCLIST, 2),
            "bicycle": (VRU, BICYCLIST, 1),
            "pedestrian": (VRU, PEDESTRIAN, 1),
        }[name]
        for name in CLASSES
    ]
)
#: Our class of each TrafficParticipantType; goods vehicles, trailers and tractors are trucks, a tram is a bus.
_VEHICLES = np.zeros(256, np.uint8)
for _name, _codes in {"car": (5,), "bus": (6, 11), "truck": (7, 8, 9, 10, 14)}.items():
    _VEHICLES[list(_codes)] = CLASS_INDEX[_name]
#: Our class of each VRU profile.
_PROFILES = np.zeros(ANIMAL + 1, np.uint8)
for _profile, _name in ((PEDESTRIAN, "pedestrian"), (BICYCLIST, "bicycle"), (MOTORCYCLIST, "motorcycle")):
    _PROFILES[_profile] = CLASS_INDEX[_name]


#: TrafficParticipantType of a station, in the order of `CLASSES`, and our class of each.
_STATION_TYPES = np.array(
    [
        {"unknown": 0, "car": 5, "truck": 8, "bus": 6, "motorcycle": 4, "bicycle": 2, "pedestrian": 1}[name]
        for name in CLASSES
    ]
)
_STATIONS = _VEHICLES.copy()
for _name, _codes in {"pedestrian": (1,), "bicycle": (2, 12), "motorcycle": (3, 4)}.items():
    _STATIONS[list(_codes)] = CLASS_INDEX[_name]
#: Standard deviations of each axis at the edge of a 95 % ellipse of a normal distribution.
_SIGMAS_95_ELLIPSE = 2.4477
#: Bounds of AltitudeConfidence, m.
_ALTITUDES = np.array([0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0])
#: Height of a vehicle that says where it is, m; a CAM does not have it.
_ASSUMED_HEIGHT = 1.5


def _units(values: Floats, unit: float) -> Values:
    """Numbers of units, rounded up except for rounding errors of whole ones."""
    return np.ceil(values / unit - 1e-6).astype(np.int64)


def _confidence(variance: Floats, unit: float, largest: int) -> Values:
    """Confidences of variances (n, k): 1..largest, or out of range."""
    return np.clip(_units(SIGMAS_95 * np.sqrt(np.maximum(variance, 0.0)), unit), 1, largest + 1)


def _variance(confidence: Values, unit: float, largest: int, unknown: float) -> Floats:
    """Variances of confidences (n, k); half widths of `unknown` where they are unavailable or absent."""
    stated = (confidence >= 1) & (confidence <= largest + 1)
    units = np.where(confidence <= largest, confidence, _OUT_OF_RANGE * largest)
    return (np.where(stated, unit * units, unknown) / SIGMAS_95) ** 2


def orientation_of(yaw: float) -> int:
    """Wgs84AngleValue of a yaw in rad (counter-clockwise from east): 0.1 deg clockwise from north."""
    return int(_units(np.array((90.0 - np.degrees(yaw)) % 360.0), _ANGLE)) % 3600


def rotation_of(orientation: int) -> Floats:
    """Active quaternion (4,) of the axes of a vehicle with a Wgs84AngleValue, which is read half a unit lower.

    It is that of the world's axes, which are a roadside unit's, only if the orientation is unavailable.
    """
    if orientation >= _NO_ANGLE:
        return np.array([1.0, 0.0, 0.0, 0.0])
    half = np.radians(90.0 - _ANGLE * (orientation - 0.5)) / 2.0
    return np.array([np.cos(half), 0.0, 0.0, np.sin(half)])


def to_objects(tracks: ObjectStates, wire_id: Ints, reference: Floats) -> PerceivedObjects:
    """Tracks (n) at the reference time as perceived objects.

    wire_id: (n,) 0..65535, object ids, which the sender keeps for its tracks and reuses
    reference: (3,) m, the point of the quantised reference position
    """
    objects = PerceivedObjects.empty(len(tracks))
    variance = tracks.covariance.diagonal(axis1=1, axis2=2)
    objects.id[:], objects.delta_time[:] = wire_id, 0
    objects.position[:] = np.clip(_units(tracks.position - reference, _POSITION), -131_072, 131_071)
    objects.position_confidence[:] = _confidence(variance[:, :3], _POSITION, _LARGEST_POSITION)
    objects.velocity_form[:] = CARTESIAN
    objects.velocity[:] = np.clip(_units(tracks.velocity, _VELOCITY), -16_383, 16_382)
    objects.velocity_confidence[:] = _confidence(variance[:, 6:], _VELOCITY, _LARGEST_VELOCITY)
    objects.yaw[:] = _units(np.degrees(tracks.yaw) % 360.0, _ANGLE) % 3600
    objects.yaw_confidence[:] = 127
    objects.dimensions[:] = np.clip(_units(tracks.size, _DIMENSION), 1, 255)
    objects.dimensions_confidence[:] = _confidence(variance[:, 3:6], _DIMENSION, _LARGEST_DIMENSION)
    objects.quality[:] = quality_of_score(tracks.score)
    classes = np.empty((len(tracks), 5), np.int64)
    classes[:, 0], classes[:, 1:4], classes[:, 4] = np.arange(len(tracks)), _CLASS_CODES[tracks.class_id], 101
    return dataclasses.replace(objects, classes=classes)


def to_cpm(
    objects: PerceivedObjects,
    station_id: int,
    reference_time: int,
    position: Position,
    yaw: float | None = None,
    known: int | None = None,
) -> Cpm:
    """The message of a vehicle with this yaw (rad), or of a roadside unit (None).

    reference_time: ms, TimestampIts;  position: what `objects` are relative to;  known: as `Cpm.known_objects`
    """
    vehicle = None if yaw is None else (orientation_of(yaw), 127)
    return Cpm(station_id, reference_time, position, objects, known, vehicle=vehicle, rsu=yaw is None)


def from_cpm(message: Cpm, plane: LocalPlane) -> ObjectStates:
    """States (m) in the plane.

    Objects whose x, y or time is out of range are left out, as their position is unknown. Ids are object ids. The
    covariance is diagonal. A z that is absent or out of range is that of the reference position; an absent yaw is the
    direction of the velocity. A dimension that is out of range is its least, with UNKNOWN_DIMENSION.
    """
    objects = message.objects
    if objects is None:
        return ObjectStates.empty()
    horizontal = objects.position[:, :2]
    known_place = ((horizontal > -131_072) & (horizontal < 131_071)).all(axis=1)
    kept = np.flatnonzero(known_place & (objects.delta_time > _LEAST_DELTA) & (objects.delta_time < _MOST_DELTA))
    if len(kept) < len(objects):
        objects = objects.take(kept)
    n = len(objects)
    known = (objects.position > -131_072) & (objects.position < 131_071)
    position = np.where(known, _POSITION * (objects.position - 0.5), 0.0) + plane.to_point(message.position)
    velocity, velocity_variance = _velocity(objects)
    yaw = np.where(
        (objects.yaw >= 0) & (objects.yaw < _NO_ANGLE),
        np.radians(_ANGLE * (objects.yaw - 0.5)),
        np.arctan2(velocity[:, 1], velocity[:, 0]),
    )
    # 255 is out of range: a long vehicle, of at least that length.
    sized = (objects.dimensions >= 1) & (objects.dimensions <= 255)
    measured = np.where(sized & (objects.dimensions < 255), objects.dimensions_confidence, 0)
    covariance = np.zeros((n, 9, 9))
    diagonal = np.einsum("nii->ni", covariance)
    confidence = np.where(known, objects.position_confidence, 0)
    confidence[:, 2] *= has_altitude(message.position)
    diagonal[:, :3] = _variance(confidence, _POSITION, _LARGEST_POSITION, UNKNOWN_POSITION)
    diagonal[:, 3:6] = _variance(measured, _DIMENSION, _LARGEST_DIMENSION, UNKNOWN_DIMENSION)
    diagonal[:, 6:] = velocity_variance
    return ObjectStates.of(
        position,
        id=objects.id.copy(),
        velocity=velocity,
        size=np.where(sized, _DIMENSION * (objects.dimensions - 0.5), UNKNOWN_SIZE),
        yaw=np.arctan2(np.sin(yaw), np.cos(yaw)),
        covariance=covariance,
        score=np.where(objects.quality == ABSENT, 1.0, objects.quality / MAX_QUALITY),
        class_id=_class_ids(objects),
    )


def _velocity(objects: PerceivedObjects) -> tuple[Floats, Floats]:
    """Velocities (n, 3), m/s, and their variances; 0 with a large variance where they are unknown."""
    units, confidence = objects.velocity, objects.velocity_confidence
    known = (units > -16_383) & (units < 16_382)
    velocity = np.where(known, _VELOCITY * (units - 0.5), 0.0)
    variance = _variance(np.where(known, confidence, 0), _VELOCITY, _LARGEST_VELOCITY, UNKNOWN_VELOCITY)
    polar = np.flatnonzero(objects.velocity_form == POLAR)
    if len(polar):
        speed, direction = velocity[polar, 0], np.radians(_ANGLE * (units[polar, 1] - 0.5))
        sound = known[polar, 0] & (units[polar, 1] < _NO_ANGLE)
        along = np.stack([np.cos(direction), np.sin(direction)], axis=1)
        velocity[polar, :2] = np.where(sound[:, None], speed[:, None] * along, 0.0)
        of_speed = variance[polar, 0]
        turn = np.radians(np.sqrt(_variance(confidence[polar, 1], _ANGLE, 125, 180.0)))
        of_direction = (speed * turn) ** 2
        unknown = (UNKNOWN_VELOCITY / SIGMAS_95) ** 2
        squared = along**2
        mixed = of_speed[:, None] * squared + of_direction[:, None] * (1.0 - squared)
        variance[polar, :2] = np.where(sound[:, None], mixed, unknown)
    return velocity, variance


def _class_ids(objects: PerceivedObjects) -> NDArray[np.uint8]:
    """Class (n,) of each object's most probable hypothesis, the first of equals; unknown if there is none."""
    result = np.zeros(len(objects), np.uint8)
    row, kind, profile, subclass, confidence = objects.classes.T
    code = np.where(kind == VEHICLE, _VEHICLES.take(subclass, mode="clip"), 0)
    code = np.where(kind == VRU, _PROFILES.take(profile, mode="clip"), code)
    order = np.lexsort((-np.arange(len(row)), confidence % 101))
    result[row[order]] = code[order]
    return result


def to_cam(vehicle: ObjectStates, station_id: int, time_ms: int, plane: LocalPlane) -> Cam:
    """The message of a vehicle (one row) about itself, without its low-frequency container.

    Its reference position is on the ground, in the middle of its front. time_ms: TimestampIts
    """
    ((length, width, height),), (yaw,) = vehicle.size, vehicle.yaw
    along = np.array([np.cos(yaw), np.sin(yaw)])
    velocity, variance = vehicle.velocity[0, :2], vehicle.covariance[0]
    backward = bool(velocity @ along < 0.0)
    front = vehicle.position[0] + 0.5 * np.array([*(length * along), -height])
    spread, axes = np.linalg.eigh(variance[:2, :2])
    minor, major = np.clip(_units(_SIGMAS_95_ELLIPSE * np.sqrt(np.maximum(spread, 0.0)), _POSITION), 1, 4094).tolist()
    position = dataclasses.replace(
        plane.to_position(front),
        altitude_confidence=int(np.searchsorted(_ALTITUDES, SIGMAS_95 * np.sqrt(max(variance[2, 2], 0.0)) - 1e-9)),
        semi_major=major,
        semi_minor=minor,
        orientation=0 if minor == major else orientation_of(float(np.arctan2(axes[1, 1], axes[0, 1]))) % 1800,
    )
    of_speed = along @ variance[6:8, 6:8] @ along
    motion = VehicleMotion(
        heading=orientation_of(yaw + np.pi * backward),
        speed=int(np.clip(_units(np.hypot(*velocity), _VELOCITY), 0, 16_382)),
        speed_confidence=int(_confidence(of_speed, _VELOCITY, _LARGEST_VELOCITY)),
        drive_direction=int(backward),
        length=int(np.clip(_units(length, _DIMENSION), 1, 1022)),
        length_confidence=0,
        width=int(np.clip(_units(width, _DIMENSION), 1, 61)),
    )
    return Cam(station_id, time_ms % 65_536, int(_STATION_TYPES[vehicle.class_id[0]]), position, motion)


def from_cam(message: Cam, plane: LocalPlane) -> ObjectStates:
    """The vehicle that sends it (one row, id 0) in the plane; no row if the sender is none.

    A CAM has no confidences of length and width: they are taken for right to a unit. Its height is assumed, and its
    direction is taken for as good as its speed. A vehicle of unknown drive direction drives forward. If its heading or
    its length is unknown, its centre is where its front is, uncertain by half a length.
    """
    motion, place = message.vehicle, message.position
    if motion is None:
        return ObjectStates.empty()
    headed = motion.heading < _NO_ANGLE and motion.heading_confidence != _UNTRUSTED_HEADING
    yaw = np.radians(90.0 - _ANGLE * (motion.heading - 0.5)) + np.pi * (motion.drive_direction == 1) if headed else 0.0
    along = np.array([np.cos(yaw), np.sin(yaw)])
    units = np.array([motion.length, motion.width])
    sized = units < (_NO_LENGTH, _NO_WIDTH)
    size = np.array([*np.where(sized, _DIMENSION * (units - 0.5), UNKNOWN_SIZE[:2]), _ASSUMED_HEIGHT])
    anchored = headed and bool(sized[0])
    centre = plane.to_point(place) + 0.5 * np.array([*(-size[0] * anchored * along), size[2]])
    moving = motion.speed < _NO_SPEED and headed
    speed = _VELOCITY * max(motion.speed - 0.5, 0.0) * moving * (-1.0 if motion.drive_direction == 1 else 1.0)
    covariance = np.zeros((9, 9))
    covariance[:2, :2] = _ellipse(place)
    if not anchored:  # its centre is anywhere on a circle around its front
        covariance[:2, :2] += 0.5 * np.eye(2) * (0.5 * (size[0] if sized[0] else UNKNOWN_DIMENSION)) ** 2
    covariance[2, 2] = (_height_confidence(place) / SIGMAS_95) ** 2
    half_widths = [*np.where(units < (_NO_LENGTH, _WIDE), _DIMENSION, UNKNOWN_DIMENSION), UNKNOWN_DIMENSION]
    covariance[3:6, 3:6] = np.diag(np.square(half_widths)) / SIGMAS_95**2
    confidence = np.array(motion.speed_confidence if moving else 0)
    covariance[6:, 6:] = np.eye(3) * _variance(confidence, _VELOCITY, _LARGEST_VELOCITY, UNKNOWN_VELOCITY)
    return ObjectStates.of(
        centre[None],
        velocity=np.array([[*(speed * along), 0.0]]),
        size=size[None],
        yaw=np.array([np.arctan2(np.sin(yaw), np.cos(yaw))]),
        covariance=covariance[None],
        class_id=_STATIONS[[message.station_type]],
    )


def _ellipse(position: Position) -> Floats:
    """(2, 2) covariance of a reference position."""
    axes = [position.semi_major, position.semi_minor if position.orientation < _NO_ANGLE else position.semi_major]
    half_widths = (_POSITION * n if 0 < n < _NO_SEMI_AXIS else UNKNOWN_POSITION for n in axes)
    major, minor = (half_width / _SIGMAS_95_ELLIPSE for half_width in half_widths)
    turn = np.radians(90.0 - _ANGLE * (position.orientation - 0.5))
    along = np.array([np.cos(turn), np.sin(turn)])
    return minor**2 * np.eye(2) + (major**2 - minor**2) * np.outer(along, along)


def _height_confidence(position: Position) -> float:
    """Half the 95 % interval of the height of a reference position, m."""
    place = position.altitude_confidence
    if not has_altitude(position) or place > len(_ALTITUDES):
        return UNKNOWN_POSITION
    return float(_ALTITUDES[place] if place < len(_ALTITUDES) else _OUT_OF_RANGE * _ALTITUDES[-1])


def segments(message: Cpm, max_bytes: int) -> list[Cpm]:
    """The message in as few parts of at most `max_bytes` as its order of objects allows, with MessageSegmentationInfo.

    Each part has the containers of the station and the number of all objects.
    """
    objects = message.objects
    if objects is None or len(cpm.encode(message)) <= max_bytes:
        return [message]
    known = len(objects) if message.known_objects is None else message.known_objects
    whole = dataclasses.replace(message, known_objects=known, segment=(1, MOST_SEGMENTS))
    parts: list[Cpm] = []
    first = 0
    while first < len(objects) or not parts:
        sizes = range(first, len(objects) + 1)
        fits = bisect_right(sizes, max_bytes, key=lambda last: len(cpm.encode(_part(whole, first, last))))
        if fits < 2:
            size = len(cpm.encode(_part(whole, first, min(first + 1, len(objects)))))
            raise MessageError(f"perceivedObjects[{first}]: a CPM with it alone has {size} bytes, expected {max_bytes}")
        parts.append(_part(whole, first, first + fits - 1))
        first += fits - 1
    if len(parts) > MOST_SEGMENTS:
        raise MessageError(f"found {len(parts)} segments of {max_bytes} bytes, expected at most {MOST_SEGMENTS}")
    return [dataclasses.replace(part, segment=(number, len(parts))) for number, part in enumerate(parts, 1)]


def _part(message: Cpm, first: int, last: int) -> Cpm:
    """The message with the objects first..last - 1."""
    assert message.objects is not None
    return dataclasses.replace(message, objects=message.objects.take(np.arange(first, last)))

"""Tracks that pass through CPM bytes are as accurate as the standard's units."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plain_values import from_plain
from v2x_messages import MessageMaker, damaged

from mast_zenoh.arrays.states import CLASSES, ObjectStates
from mast_zenoh.errors import MessageError
from mast_zenoh.v2x import cpm
from mast_zenoh.v2x.asn1 import uper
from mast_zenoh.v2x.perceived_objects import ABSENT, GROUP, POLAR, VEHICLE, VRU, PerceivedObjects
from mast_zenoh.v2x.reference_position import LocalPlane, Position
from mast_zenoh.v2x.tracks import (
    SIGMAS_95,
    UNKNOWN_DIMENSION,
    UNKNOWN_POSITION,
    UNKNOWN_VELOCITY,
    from_cpm,
    orientation_of,
    segments,
    to_cpm,
    to_objects,
)

PLANE = LocalPlane(48.76, 11.43, 370.0)


def drawn_tracks(random: np.random.Generator, n: int) -> ObjectStates:
    variance = random.uniform(1e-3, np.repeat([0.4, 0.4, 1.6], 3), (n, 9))
    return ObjectStates.of(
        random.uniform(-400, 400, (n, 3)),
        velocity=random.uniform(-40, 40, (n, 3)),
        size=random.uniform(0.2, 20, (n, 3)),
        yaw=random.uniform(-np.pi, np.pi, n),
        covariance=np.einsum("ni,ij->nij", variance, np.eye(9)),
        score=random.random(n),
        class_id=random.integers(0, len(CLASSES), n).astype(np.uint8),
    )


def sent(tracks: ObjectStates, position: Position) -> cpm.Cpm:
    objects = to_objects(tracks, np.arange(len(tracks)) + 100, PLANE.to_point(position))
    return to_cpm(objects, 7, 690_000_000_000, position, yaw=0.5)


@given(st.integers(0, 2**32), st.integers(0, 30))
def test_states_survive_bytes_within_half_a_unit(seed, n):
    random = np.random.default_rng(seed)
    tracks, position = drawn_tracks(random, n), PLANE.to_position(random.uniform(-300, 300, 3))
    received = from_cpm(cpm.decode(cpm.encode(sent(tracks, position))), PLANE)
    assert received.id.tolist() == list(range(100, 100 + n))
    np.testing.assert_allclose(received.position, tracks.position, atol=0.00501)
    np.testing.assert_allclose(received.velocity, tracks.velocity, atol=0.00501)
    np.testing.assert_allclose(received.size, tracks.size, atol=0.0501)
    np.testing.assert_allclose(np.exp(1j * received.yaw), np.exp(1j * tracks.yaw), atol=np.radians(0.0501))
    np.testing.assert_allclose(received.score, tracks.score, atol=1 / 30)
    np.testing.assert_array_equal(received.class_id, tracks.class_id)


@given(st.integers(0, 2**32))
def test_confidences_are_intervals_of_95_percent_that_are_not_too_small(seed):
    tracks = drawn_tracks(np.random.default_rng(seed), 9)
    received = from_cpm(sent(tracks, PLANE.to_position(np.zeros(3))), PLANE)
    before, after = (np.sqrt(states.covariance.diagonal(axis1=1, axis2=2)) for states in (tracks, received))
    assert np.count_nonzero(received.covariance) == 81
    assert (after >= before - 1e-9).all()
    expressible = SIGMAS_95 * before[:, 6:] <= 1.25
    np.testing.assert_allclose(after[:, :3], before[:, :3], atol=0.01 / SIGMAS_95)
    np.testing.assert_allclose(after[:, 3:6], before[:, 3:6], atol=0.1 / SIGMAS_95)
    np.testing.assert_allclose(after[:, 6:][expressible], before[:, 6:][expressible], atol=0.01 / SIGMAS_95)
    np.testing.assert_allclose(after[:, 6:][~expressible], 2 * 1.25 / SIGMAS_95)


def test_unavailable_confidences_are_read_as_larger_than_those_out_of_range():
    unknown = to_objects(drawn_tracks(np.random.default_rng(1), 2), np.arange(2), np.zeros(3))
    for confidence, largest in (
        (unknown.position_confidence, 4094),
        (unknown.dimensions_confidence, 30),
        (unknown.velocity_confidence, 125),
    ):
        confidence[:] = [[largest + 1] * 3, [largest + 2] * 3]
    received = from_cpm(to_cpm(unknown, 1, 0, PLANE.to_position(np.zeros(3))), PLANE)
    widths = SIGMAS_95 * np.sqrt(received.covariance.diagonal(axis1=1, axis2=2))
    np.testing.assert_allclose(widths[0], np.repeat([81.88, 6.0, 2.5], 3))
    np.testing.assert_allclose(widths[1], np.repeat([UNKNOWN_POSITION, UNKNOWN_DIMENSION, UNKNOWN_VELOCITY], 3))


def test_what_is_out_of_range_has_the_values_of_the_standard():
    tracks = ObjectStates.of(
        np.array([[1310.71, -1310.72, 5000.0], [1.0, 1.0, 1.0]]),
        velocity=np.array([[170.0, -170.0, 0.0], [0.0, 0.0, 0.0]]),
        size=np.array([[30.0, 0.01, 25.4], [1.0, 1.0, 1.0]]),
        covariance=np.stack([1e4 * np.eye(9), np.zeros((9, 9))]),
        score=np.array([2.0, -1.0]),
    )
    objects = to_objects(tracks, np.array([1, 2]), np.zeros(3))
    assert objects.position[0].tolist() == [131071, -131072, 131071]
    assert objects.position_confidence.tolist() == [[4095] * 3, [1] * 3]
    assert objects.velocity.tolist() == [[16382, -16383, 0], [0, 0, 0]]
    assert objects.velocity_confidence.tolist() == [[126] * 3, [1] * 3]
    assert objects.dimensions[0].tolist() == [255, 1, 254]
    assert objects.dimensions_confidence.tolist() == [[31] * 3, [1] * 3]
    assert objects.quality.tolist() == [15, 0]
    received = from_cpm(to_cpm(objects, 1, 0, PLANE.to_position(np.zeros(3))), PLANE)
    assert received.id.tolist() == [2]


def test_a_vehicle_longer_than_can_be_said_is_read_as_long_and_as_uncertain():
    covariance = np.eye(9)[None] * 0.01
    tram = ObjectStates.of(np.ones((1, 3)), size=np.array([[30.0, 2.5, 3.5]]), covariance=covariance)
    received = from_cpm(sent(tram, PLANE.to_position(np.zeros(3))), PLANE)
    np.testing.assert_allclose(received.size, [[25.45, 2.45, 3.45]])
    widths = SIGMAS_95 * np.sqrt(received.covariance[0].diagonal()[3:6])
    np.testing.assert_allclose(widths, [UNKNOWN_DIMENSION, 0.2, 0.2], atol=0.1)


def test_angles_turn_counter_clockwise_from_east_and_orientations_clockwise_from_north():
    states = ObjectStates.of(np.zeros((4, 3)), yaw=np.array([0.0, np.pi / 2, -np.pi / 2, -1e-9]))
    objects = to_objects(states, np.arange(4), np.zeros(3))
    assert objects.yaw.tolist() == [0, 900, 2700, 0]
    assert [orientation_of(yaw) for yaw in (0.0, np.pi / 2, np.pi, -np.pi / 2)] == [900, 0, 2700, 1800]


def test_polar_velocities_and_absent_fields_of_other_senders_are_understood():
    objects = PerceivedObjects.empty(2)
    objects.id[:], objects.delta_time[:], objects.position[:, :2], objects.position_confidence[:] = 1, 0, 0, ABSENT
    objects.velocity_form[0] = POLAR
    objects.velocity[0, :2], objects.velocity_confidence[0, :2] = [1000, 900], [98, 20]
    states = from_cpm(to_cpm(objects, 1, 0, Position(487_600_000, 114_300_000)), PLANE)
    np.testing.assert_allclose(states.velocity[0], [0.0, 10.0, 0.0], atol=0.02)
    np.testing.assert_allclose(states.yaw[0], np.pi / 2, atol=0.01)
    spread = np.sqrt(states.covariance[0].diagonal()[6:8])
    np.testing.assert_allclose(spread, [10 * np.radians(2 / SIGMAS_95), 0.5], rtol=0.02)
    assert states.position[:, 2].tolist() == [0.0, 0.0]
    assert states.velocity[1].tolist() == [0.0, 0.0, 0.0]
    assert (np.isfinite(states.covariance)).all()


def test_the_most_probable_hypothesis_decides_the_class():
    objects = PerceivedObjects.empty(3)
    objects.table[:] = 0
    classes = [
        [0, VRU, 1, 9, 40],
        [0, VEHICLE, ABSENT, 11, 60],
        [1, VEHICLE, ABSENT, 14, 101],
        [1, GROUP, ABSENT, 3, 101],
    ]
    objects = dataclasses.replace(objects, classes=np.array(classes))
    states = from_cpm(to_cpm(objects, 1, 0, Position(487_600_000, 114_300_000)), PLANE)
    assert [CLASSES[class_id] for class_id in states.class_id] == ["bus", "truck", "unknown"]


@pytest.mark.parametrize("max_bytes", [200, 500, 1000])
def test_segments_hold_all_objects_once_and_have_at_most_the_wanted_size(max_bytes):
    message = sent(drawn_tracks(np.random.default_rng(0), 30), PLANE.to_position(np.zeros(3)))
    parts = segments(message, max_bytes)
    assert [part.segment for part in parts] == [(number, len(parts)) for number in range(1, len(parts) + 1)]
    assert all(len(cpm.encode(part)) <= max_bytes for part in parts)
    assert all(part.known_objects == 30 and part.vehicle == message.vehicle for part in parts)
    np.testing.assert_array_equal(np.concatenate([part.objects.table for part in parts]), message.objects.table)
    whole = len(cpm.encode(message))
    assert len(parts) <= -(-whole // (max_bytes - 100))


def test_messages_that_fit_are_not_segmented_and_too_many_segments_are_refused():
    message = sent(drawn_tracks(np.random.default_rng(0), 30), PLANE.to_position(np.zeros(3)))
    assert segments(message, 2000) == [message]
    with pytest.raises(MessageError, match=r"segments.*bytes.*most"):
        segments(message, 120)
    with pytest.raises(MessageError, match=r"perceivedObjects\[0\].*CPM.*alone"):
        segments(message, 40)


def test_whatever_decodes_becomes_finite_states():
    random, layout = np.random.default_rng(6), cpm.LAYOUT
    decoded = 0
    for _ in range(300):
        maker = MessageMaker(random, random.choice([0.1, 0.5, 0.9]), beyond=True)
        try:
            message = cpm.decode(damaged(random, uper.encode(layout, from_plain(layout, maker.draw(layout.type)))))
            states = from_cpm(message, PLANE)
        except MessageError:
            continue
        decoded += 1
        assert all(np.isfinite(column).all() for column in states.columns().values())
        assert (states.size > 0).all()
        assert ((states.score >= 0) & (states.score <= 1)).all()
    assert decoded > 20

"""Tracks travel as Collective Perception Messages: what receivers get is what the bytes say."""

import zlib

import asn1_oracle
import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays.geometry import tracks_in_world
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.errors import MessageError
from mast_zenoh.messages import codec
from mast_zenoh.messages.packed import MAX_SEGMENT_BYTES, MOST_OBJECTS, Packed, codec_of, pack, unpack
from mast_zenoh.messages.schemas import Header, Message
from mast_zenoh.v2x import Vehicle, cam, cpm
from mast_zenoh.v2x.tracks import orientation_of, rotation_of

HEADER = Header("tracks", "infra_1", 3, 300_000_000, 3)


def message(
    n: int,
    seed: int = 0,
    spread_m: float = 80.0,
    origin: tuple[float, float, float] = (3.0, -4.0, 5.0),
    yaw: float | None = None,
) -> Message:
    """Tracks of a roadside unit, or of a vehicle with this yaw (rad), in its own axes."""
    rng = np.random.default_rng(seed)
    root = rng.normal(0.0, 0.1, (n, 9, 9))
    states = ObjectStates.of(
        rng.uniform(-spread_m, spread_m, (n, 3)),
        id=rng.permutation(10 * n + 1)[:n] + 65_500,
        velocity=rng.normal(0.0, 8.0, (n, 3)),
        size=rng.uniform(0.3, 12.0, (n, 3)),
        yaw=rng.uniform(-np.pi, np.pi, n),
        covariance=root @ root.mT + 0.01 * np.eye(9),
        score=rng.uniform(0.0, 1.0, n),
        class_id=rng.integers(0, 7, n).astype(np.uint8),
    )
    frame = {"origin": np.array(origin), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}
    if yaw is not None:
        frame["rotation"] = rotation_of(orientation_of(yaw))
    return codec.conform(HEADER, states.columns() | frame)


YAWS = st.none() | st.sampled_from([0.0, np.pi / 2, np.pi, -np.pi / 2]) | st.floats(-np.pi, np.pi)


def packed(sent: Message, wire_codec: str = "cpm") -> Packed:
    body = pack(sent, wire_codec).body
    assert isinstance(body, Packed)
    return body


@given(st.integers(0, 60), st.integers(0, 1 << 30), YAWS)
def test_what_is_read_is_written_again_with_the_same_bytes(n: int, seed: int, yaw: float | None) -> None:
    received = pack(message(n, seed, yaw=yaw), "cpm")
    again = pack(Message(HEADER, dict(received.body)), "cpm")
    assert packed(again).segments == packed(received).segments
    decoded = codec.decode(codec.encode(received), "tracks")
    assert packed(decoded).segments == packed(received).segments
    for name, column in received.body.items():
        assert decoded.body[name].tobytes() == column.tobytes(), name


@given(st.integers(1, 40), st.integers(0, 1 << 30), YAWS)
def test_receivers_get_the_tracks_within_the_quantisation_of_the_standard(n: int, seed: int, yaw: float | None) -> None:
    sent = message(n, seed, yaw=yaw)
    body = packed(sent)
    before, after = (tracks_in_world(each) for each in (sent.body, body))
    np.testing.assert_allclose(after.position, before.position, atol=0.0051)
    np.testing.assert_allclose(body["origin"], sent.body["origin"], atol=0.02)
    np.testing.assert_allclose(body["rotation"], sent.body["rotation"], atol=1e-9)
    np.testing.assert_allclose(after.velocity, before.velocity, atol=0.0051)
    np.testing.assert_allclose(after.size, before.size, atol=0.051)
    turn = np.angle(np.exp(1j * (after.yaw - before.yaw)))
    assert np.abs(turn).max() <= np.radians(0.051)
    np.testing.assert_allclose(after.score, before.score, atol=0.5 / 15 + 1e-9)
    np.testing.assert_array_equal(after.class_id, before.class_id)
    sigmas = [np.sqrt(each.covariance.diagonal(axis1=1, axis2=2)[:, :2]) for each in (before, after)]
    assert ((sigmas[1] >= sigmas[0] - 1e-9) & (sigmas[1] <= sigmas[0] + 0.01)).all(), "in whole centimetres, of 95 %"
    assert np.count_nonzero(np.abs(after.covariance) > 1e-9) <= 9 * n, "correlations are not sent"


@pytest.mark.parametrize("yaw", [None, 0.0, 0.7, np.pi / 2, -3.0])
def test_a_vehicle_says_that_it_is_one_and_where_it_heads_and_a_pole_that_it_is_a_roadside_unit(yaw) -> None:
    for segment in packed(message(120, yaw=yaw)).segments:
        decoded = cpm.decode(segment)
        assert decoded.rsu == (yaw is None)
        assert decoded.vehicle == (None if yaw is None else (orientation_of(yaw), 127))


@pytest.mark.parametrize("yaw", [None, 0.0, np.pi / 2, -2.0])
def test_positions_in_the_bytes_are_east_and_north_of_the_sender_wherever_it_heads(yaw: float | None) -> None:
    """TS 103 324 v2.1.1, annex A, PerceivedObjects: x east, y north, for vehicles as for roadside units."""
    sent = message(6, yaw=yaw)
    (segment,) = packed(sent).segments
    decoded = cpm.decode(segment)
    assert decoded.objects is not None
    east_north = tracks_in_world(sent.body).position - sent.body["origin"]
    kept = np.argsort(sent.body["id"] % 65_536)
    rows = np.argsort(decoded.objects.id)
    np.testing.assert_allclose(0.01 * decoded.objects.position[rows], east_north[kept], atol=0.03)


@pytest.mark.skipif(not asn1_oracle.FOLDER.is_dir(), reason="no ASN.1 modules in $MAST_DATA/etsi_asn1")
@pytest.mark.parametrize(("yaw", "orientation"), [(None, None), (0.0, 900), (np.pi / 2, 0), (-np.pi / 2, 1800)])
def test_asn1tools_reads_the_container_of_a_vehicle_or_of_a_roadside_unit(yaw, orientation) -> None:
    (segment,) = packed(message(5, yaw=yaw)).segments
    content = asn1_oracle.decode("CPM", cpm.LAYOUT.type, segment)["payload"]["cpmContainers"][0]
    if orientation is None:
        assert content["containerId"] == 2
        assert content["containerData"] == {}
    else:
        assert content["containerId"] == 1
        assert content["containerData"]["orientationAngle"] == {"value": orientation, "confidence": 127}


def test_twenty_objects_take_some_hundred_bytes_and_many_are_segmented() -> None:
    (one,) = packed(message(20)).segments
    assert 500 < len(one) < 900
    many = packed(message(120)).segments
    assert len(many) > 1
    assert max(map(len, many)) <= MAX_SEGMENT_BYTES


def test_of_too_many_objects_those_with_the_best_scores_are_sent() -> None:
    most = MOST_OBJECTS["cpm"]
    sent = message(most + 300)
    body = packed(sent)
    assert len(body["id"]) == most
    assert body["score"].min() >= np.sort(sent.body["score"])[-most] - 0.04


def test_ids_are_reused_and_stay_different() -> None:
    sent = message(3)
    ids = np.array([1, 65_537, 131_073], np.int64)
    assert sorted(packed(Message(HEADER, {**sent.body, "id": ids}))["id"].tolist()) == [1, 2, 3]


def test_what_cannot_be_expressed_is_refused() -> None:
    sent = message(3)
    with pytest.raises(MessageError, match=r"tracks.*value.*finite"):
        pack(Message(HEADER, {**sent.body, "velocity": np.full((3, 3), np.nan)}), "cpm")


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        ({"cpm": []}, r"list.*1.*segments"),
        ({"cpm": b"abc"}, r"list.*1.*segments"),
        ({"cpm": [b""]}, "header"),
        ({"cpm": [b"x" * 2000]}, "most 1400 bytes"),
        ({"cpm": [3]}, "most 1400 bytes"),
        ({"denm": [b"abc"]}, "columns missing"),
        ({"cam": [b"abc"]}, "header"),
        ({"cam": 2 * [b"abc"]}, r"list.*0.*segments"),
    ],
)
def test_other_bodies_are_refused(body: dict, problem: str) -> None:
    payload = msgpack.packb(
        {"schema": "tracks", "version": 1, "source": "a", "frame": 0, "time_ns": 0, "seq": 0, "body": body}
    )
    with pytest.raises(MessageError, match=problem):
        codec.decode(payload, "tracks")


@given(st.integers(0, 1 << 30), YAWS)
def test_what_a_vehicle_says_of_itself_is_read_within_the_units_of_the_standard_and_written_again(seed, yaw) -> None:
    sent = message(1, seed, yaw=yaw)
    rng = np.random.default_rng(seed)
    heading, speed = rng.uniform(-np.pi, np.pi), rng.choice([-3.0, 0.0, 12.0])
    velocity = speed * np.array([[np.cos(heading), np.sin(heading), 0.0]])
    states = tracks_in_world(sent.body).with_(
        yaw=np.array([heading]), velocity=velocity, class_id=np.array([seed % 7], np.uint8)
    )
    still = {"origin": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}
    body = packed(codec.conform(HEADER, states.columns() | still), "cam")
    read = tracks_in_world(body)
    np.testing.assert_allclose(read.position[:, :2], states.position[:, :2], atol=0.04)
    np.testing.assert_allclose(read.velocity, velocity, atol=0.02)
    np.testing.assert_allclose(read.size[0, :2], np.minimum(states.size[0, :2], [99.0, 6.05]), atol=0.051)
    assert abs(np.angle(np.exp(1j * (read.yaw[0] - heading)))) <= np.radians(0.051)
    assert read.class_id.tolist() == [seed % 7]
    np.testing.assert_allclose(read.covariance[0, :2, :2], states.covariance[0, :2, :2], atol=0.02)
    assert len(body.segments[0]) < 50
    again = packed(Message(HEADER, dict(body)), "cam")
    assert again.segments == body.segments
    decoded = codec.decode(codec.encode(Message(HEADER, body)), "tracks")
    assert decoded.body.segments == body.segments


def test_a_message_of_awareness_is_about_one_vehicle_the_best_known_or_is_not_sent() -> None:
    sent = message(5)
    (segment,) = packed(sent, "cam").segments
    best = tracks_in_world(sent.body).select(np.argsort(-sent.body["score"])[:1])
    np.testing.assert_allclose(tracks_in_world(packed(sent, "cam")).position[0, :2], best.position[0, :2], atol=8.0)
    assert packed(message(0), "cam").segments == ()
    assert codec_of(codec.decode(codec.encode(pack(message(0), "cam")), "tracks").body) == "cam"
    assert cam.decode(segment).vehicle is not None


@pytest.mark.skipif(not asn1_oracle.FOLDER.is_dir(), reason="no ASN.1 modules in $MAST_DATA/etsi_asn1")
def test_asn1tools_reads_what_a_vehicle_says_of_itself() -> None:
    vehicle = Vehicle(size=(4.5, 1.8, 1.6), kind="bus", position_std_m=0.5)
    states = vehicle.state(np.array([10.0, 20.0, 0.0]), np.array([0.0, -12.0, 0.0]), -np.pi / 2)
    still = {"origin": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}
    (segment,) = packed(codec.conform(HEADER, states.columns() | still), "cam").segments
    plain = asn1_oracle.decode("CAM", cam.LAYOUT.type, segment)
    assert plain["header"] == {"protocolVersion": 2, "messageId": 2, "stationId": zlib.crc32(b"infra_1")}
    assert plain["cam"]["generationDeltaTime"] == 300
    parameters = plain["cam"]["camParameters"]
    basic = parameters["basicContainer"]
    assert basic["stationType"] == 6
    ellipse = basic["referencePosition"]["positionConfidenceEllipse"]
    assert ellipse["semiMajorAxisLength"] == ellipse["semiMinorAxisLength"] == 123, "cm, 2.45 standard deviations"
    assert basic["referencePosition"]["altitude"] == {"altitudeValue": 0, "altitudeConfidence": "alt-002-00"}
    motion = parameters["highFrequencyContainer"]["basicVehicleContainerHighFrequency"]
    assert motion["heading"] == {"headingValue": 1800, "headingConfidence": 127}
    assert motion["speed"] == {"speedValue": 1200, "speedConfidence": 20}
    assert motion["driveDirection"] == "forward"
    assert motion["vehicleLength"]["vehicleLengthValue"] == 45
    assert motion["vehicleWidth"] == 18
    assert "lowFrequencyContainer" not in parameters


def test_segments_of_different_messages_are_refused() -> None:
    one, other = packed(message(120)), packed(message(120, origin=(9.0, 9.0, 9.0)))
    mixed = Packed(one)
    mixed.codec, mixed.segments = "cpm", (one.segments[0], *other.segments[1:])
    with pytest.raises(MessageError, match=r"segment 2.*message"):
        codec.decode(codec.encode(Message(HEADER, mixed)), "tracks")


@given(st.data(), st.sampled_from(["cpm", "cam"]))
def test_damaged_bytes_are_refused_or_are_another_message(data: st.DataObject, wire_codec: str) -> None:
    payload = bytearray(codec.encode(pack(message(5), wire_codec)))
    for _ in range(data.draw(st.integers(1, 4))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    try:
        decoded = codec.decode(bytes(payload), "tracks")
    except MessageError:
        return
    assert codec_of(decoded.body) == wire_codec
    assert codec.decode(codec.encode(decoded), "tracks").header == decoded.header


def test_messages_without_objects_leave_empty_states_writable() -> None:
    unpack("cam", [])
    assert all(column.flags.writeable for column in ObjectStates.empty().columns().values())

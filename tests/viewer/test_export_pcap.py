"""A capture file, read back with struct alone, holds the bytes that every station sent, behind sound headers."""

import json
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import msgpack
import numpy as np
import pytest
from commands_in_process import command
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

import mast_zenoh as mast
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.errors import ExportError
from mast_zenoh.messages import codec
from mast_zenoh.messages.packed import pack
from mast_zenoh.messages.schemas import Message
from mast_zenoh.run_folder.recording.reader import Recorded, Wanted, read
from mast_zenoh.runs.recorded import open_recorded
from mast_zenoh.show.export import export, pcap
from mast_zenoh.v2x import cam, cpm
from mast_zenoh.v2x.reference_position import Position

SCENE_BEGINS_S = 1_072_915_200  # 2004-01-01
INTERCEPTED = "agent/infra_1/broadcast"
ADVERSARY = b"\x02\x00" + zlib.crc32(b"adversary_1").to_bytes(4, "big")


class Packet(NamedTuple):
    """What a capture file says of a packet.

    time_ns: since 1970;  position: 1e-7 deg;  speed: 0.01 m/s;  heading: 0.1 deg clockwise from north
    payload: behind BTP
    """

    time_ns: int
    source: bytes
    station_type: int
    time_ms: int
    position: tuple[int, int]
    mobile: bool
    speed: int
    heading: int
    port: int
    payload: bytes


def packet_of(time_ns: int, data: bytes) -> Packet:
    """Take an Ethernet frame apart, and check everything that is the same in all."""
    assert data[:6] == b"\xff" * 6
    source, ether_type = struct.unpack("!6sH", data[6:14])
    assert ether_type == 0x8947
    assert source[0] & 3 == 2, "locally administered, one station"
    version_next, reserved, lifetime, hops = data[14:18]
    assert (version_next >> 4, version_next & 15, reserved, lifetime & 3, lifetime >> 2, hops) == (1, 1, 0, 1, 1, 1)
    following, kind, traffic_class, flags, length, most_hops, reserved = struct.unpack("!BBBBHBB", data[18:26])
    assert (following >> 4, kind >> 4, kind & 15, traffic_class, most_hops, reserved) == (2, 5, 0, 2, 1, 0)
    address, link_layer, time_ms, *position, speed, heading, medium = struct.unpack("!H6sIiiHHI", data[26:54])
    assert address >> 15 == 1
    assert link_layer == source
    assert (address & 0x3FF, medium) == (0, 0)
    assert length == len(data) - 54
    port, info = struct.unpack("!HH", data[54:58])
    assert info == 0
    speed = (speed & 0x7FFF ^ 0x4000) - 0x4000
    mobile = bool(flags & 0x80)
    return Packet(time_ns, source, address >> 10 & 31, time_ms, (*position,), mobile, speed, heading, port, data[58:])


def packets(path: Path) -> list[Packet]:
    """All packets of a capture file, which must end after a whole one."""
    content = path.read_bytes()
    assert struct.unpack("<IHHiIII", content[:24]) == (0xA1B23C4D, 2, 4, 0, 0, 65535, 1)
    found, place = [], 24
    while place < len(content):
        seconds, nanoseconds, captured, length = struct.unpack("<IIII", content[place : place + 16])
        assert captured == length
        assert nanoseconds < 1_000_000_000
        place += 16 + length
        found.append(packet_of(seconds * 1_000_000_000 + nanoseconds, content[place - length : place]))
    assert place == len(content)
    return found


def by_key(run: mast.Run) -> dict[str, list[dict]]:
    """Messages with a CPM or a CAM, by the key on which they were sent, in order of frames."""
    found: dict[str, list[dict]] = {}
    with (run.path / "messages.mcap").open("rb") as file:
        for _, channel, recorded in make_reader(file).iter_messages():
            message = msgpack.unpackb(recorded.data)
            for codec_name in {"cpm", "cam"} & message["body"].keys():
                coded = message | {"codec": codec_name, "segments": message["body"][codec_name]}
                found.setdefault(channel.topic, []).append(coded)
    return {key: sorted(messages, key=lambda message: message["frame"]) for key, messages in found.items()}


def in_order(messages: dict[str, list[dict]]) -> list[dict]:
    """Messages by wire as one list."""
    keyed = [(message["frame"], wire, message["seq"], message) for wire, of in messages.items() for message in of]
    return [message for *_, message in sorted(keyed, key=lambda entry: entry[:3])]


def test_the_file_holds_what_each_station_sent_in_order(broadcast: mast.Run, out: Path) -> None:
    assert export(broadcast.path, "pcap", out).paths == (out, out.with_name(f"{out.stem}.jsonl"))
    messages = by_key(broadcast)
    messages[INTERCEPTED] = messages.pop(f"{INTERCEPTED}/@tap/0")
    tracks = {f"agent/{name}/broadcast" for name in ("ego", "mobile_1", "infra_1", "infra_2", "infra_3")}
    assert set(messages) == tracks | {f"agent/{name}/awareness" for name in ("ego", "mobile_1")}
    expected = [(message, segment) for message in in_order(messages) for segment in message["segments"]]
    found = [packet for packet in packets(out) if packet.source != ADVERSARY]
    assert [packet.payload for packet in found] == [segment for _, segment in expected]
    for packet, (message, _) in zip(found, expected, strict=True):
        station = zlib.crc32(message["source"].encode())
        assert packet.source == b"\x02\x00" + station.to_bytes(4, "big")
        assert packet.time_ns == SCENE_BEGINS_S * 1_000_000_000 + message["time_ns"]
        assert packet.time_ms == message["time_ns"] // 1_000_000
        decoded = (cam if message["codec"] == "cam" else cpm).decode(packet.payload)
        assert decoded.station_id == station
        assert packet.position == (decoded.position.latitude, decoded.position.longitude)
        kind = packet.port, packet.station_type, packet.mobile
        if message["codec"] == "cam":
            assert kind == (2001, {"peer_ego": 5, "peer_mobile_1": 8}[message["source"]], True), "a car and a truck"
            motion = decoded.vehicle
            assert packet.speed == motion.speed * (-1 if motion.drive_direction == 1 else 1)
            assert packet.heading == motion.heading
        elif message["source"].startswith("peer_infra"):
            assert kind == (2009, 15, False)
            assert decoded.rsu
            assert decoded.vehicle is None
            assert (packet.speed, packet.heading) == (0, 0)
        else:
            assert kind == (2009, 0, True)
            assert not decoded.rsu
            assert (packet.speed, packet.heading) == (0, decoded.vehicle[0])
    assert {packet.port for packet in found} == {2001, 2009}
    assert len({packet.heading for packet in found}) > 2, "cars say where they head"
    assert len({packet.speed for packet in found}) > 2


def test_what_an_adversary_changes_is_in_packets_of_its_own_and_the_command_says_so(
    broadcast: mast.Run, out: Path
) -> None:
    code, _, err = command("export", str(broadcast.path), "--to", "pcap", "-o", str(out))
    assert code == 0
    messages = by_key(broadcast)
    originals = {message["seq"]: message["segments"] for message in messages[f"{INTERCEPTED}/@tap/0"]}
    lies = [message for message in messages[INTERCEPTED] if message["segments"] != originals[message["seq"]]]
    assert lies
    found = [packet for packet in packets(out) if packet.source == ADVERSARY]
    assert [packet.payload for packet in found] == [segment for lie in lies for segment in lie["segments"]]
    assert {cpm.decode(packet.payload).station_id for packet in found} == {zlib.crc32(b"peer_infra_1")}
    said = f"adversary_1 sends {len(found)} packets to all in place of those on {INTERCEPTED}"
    assert said in " ".join(err.split())
    assert ADVERSARY.hex(":") in err


def test_what_is_passed_on_is_there_once_and_a_lie_to_one_listener_names_it(tmp_path: Path) -> None:
    lies = dict(n_adversaries=1, attack_start_s=0.5, on="pair", codec="cpm")
    run = mast.run("peers", frames=8, n_infrastructure=2, n_mobile=0, **lies, out=tmp_path / "run")
    (sentence,) = export(run.path, "pcap", tmp_path / "run.pcap").missing
    assert sentence.startswith("adversary_1 sends 3")
    assert len(packets(tmp_path / "run.pcap")) == 8 * len(run.agents) + 3


def test_a_wire_that_is_intercepted_during_the_run_is_followed_to_its_publisher(broadcast: mast.Run, out: Path) -> None:
    run = open_recorded(broadcast.path)
    ((_, intercepted),) = run.files.wirings
    plain = replace(
        intercepted,
        wires=tuple(
            replace(wire, legs=(replace(wire.legs[-1], publisher=wire.legs[0].publisher),))
            for wire in intercepted.wires
        ),
    )
    run.files.wirings = [(-1, plain), (5, intercepted)]
    pcap.write(run, out)
    messages = by_key(broadcast)
    before = [message for message in messages[INTERCEPTED] if message["frame"] <= 5]
    since = [message for message in messages.pop(f"{INTERCEPTED}/@tap/0") if message["frame"] > 5]
    assert before
    assert since
    messages[INTERCEPTED] = before + since
    expected = [segment for message in in_order(messages) for segment in message["segments"]]
    assert [packet.payload for packet in packets(out) if packet.source != ADVERSARY] == expected


@given(
    station=st.integers(0, 2**32 - 1),
    time_ms=st.integers(0, 4_398_046_511_103),
    latitude=st.integers(-900_000_000, 900_000_001),
    longitude=st.integers(-1_800_000_000, 1_800_000_001),
    orientation=st.none() | st.integers(0, 3601),
)
def test_headers_hold_station_time_position_and_heading_of_any_message(
    station: int, time_ms: int, latitude: int, longitude: int, orientation: int | None
) -> None:
    rsu = orientation is None
    vehicle = None if orientation is None else (orientation, 127)
    message = cpm.Cpm(station, time_ms, Position(latitude, longitude), vehicle=vehicle, rsu=rsu)
    segment = cpm.encode(message)
    found = packet_of(0, pcap.packet(segment, 2009, pcap.sender_of("cpm", segment), time_ms))
    assert found.payload == segment
    assert int.from_bytes(found.source[2:], "big") == station
    assert found.time_ms == time_ms % 2**32
    assert found.position == (latitude, longitude)
    assert (found.station_type, found.mobile) == ((15, False) if rsu else (0, True))
    unknown = orientation is None or orientation > 3599
    assert found.heading == (0 if unknown else orientation)


@given(
    speed=st.integers(0, 16383),
    drive=st.integers(0, 2),
    heading=st.integers(0, 3601),
    type=st.integers(0, 255),
    rsu=st.booleans(),
)
def test_headers_hold_speed_and_heading_of_a_vehicle_that_says_them(
    speed: int, drive: int, heading: int, type: int, rsu: bool
) -> None:
    motion = cam.VehicleMotion(heading=heading, speed=speed, drive_direction=drive)
    message = cam.Cam(7, 0, type, Position(1, 2), None if rsu else motion)
    found = packet_of(0, pcap.packet(b"", 2001, pcap.sender_of("cam", cam.encode(message)), 0))
    assert found.port == 2001
    assert found.mobile == (not rsu)
    assert found.speed == (0 if rsu or speed >= 16382 else -speed if drive == 1 else speed)
    assert found.heading == (0 if rsu or heading > 3599 else heading)


def spoilt(change: Callable[[Recorded], Recorded]) -> Callable[..., Iterator[Recorded]]:
    """A function that reads a recording, with the ego's first message about its tracks changed."""

    def reading(path: Path, wanted: Wanted) -> Iterator[Recorded]:
        changed = False
        for message in read(path, wanted):
            chosen = not changed and message.wire == "agent/ego/broadcast"
            changed |= chosen
            yield change(message) if chosen else message

    return reading


def in_columns(message: Recorded) -> Recorded:
    """The same tracks as columns, not as a CPM."""
    header, body = codec.decode(message.payload, "tracks")
    return replace(message, payload=codec.encode(codec.conform(header, dict(body))))


@pytest.mark.parametrize(
    "change",
    [
        lambda message: replace(message, payload=message.payload[:-1]),
        lambda message: replace(message, malformed=True, message="nonsense"),
        lambda message: replace(message, time_ns=2**62),
        lambda message: replace(message, message="clock"),
        lambda message: replace(message, payload=b""),
        in_columns,
    ],
    ids=["cut off", "malformed", "beyond the times of the format", "of another type", "empty", "not encoded"],
)
def test_an_invalid_message_is_left_out_and_counted(
    broadcast: mast.Run, out: Path, monkeypatch: pytest.MonkeyPatch, change: Callable[[Recorded], Recorded]
) -> None:
    export(broadcast.path, "pcap", out)
    whole = packets(out)
    out.unlink()
    out.with_suffix(".jsonl").unlink()
    monkeypatch.setattr(pcap, "read", spoilt(change))
    exported = export(broadcast.path, "pcap", out)
    assert exported.missing[1].endswith("left out: 1")
    assert len(packets(out)) == len(whole) - 1


def test_each_segment_of_a_message_is_a_packet(broadcast: mast.Run, out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def of_many_objects(message: Recorded) -> Recorded:
        header, _ = codec.decode(message.payload, "tracks")
        places = np.column_stack([np.arange(150.0), np.zeros((150, 2))])
        objects = ObjectStates.of(places, id=np.arange(150), covariance=np.tile(np.eye(9), (150, 1, 1)))
        frame = dict(origin=np.zeros(3), rotation=np.array([1.0, 0.0, 0.0, 0.0]))
        body = codec.conform(header, objects.columns() | frame).body
        return replace(message, payload=codec.encode(pack(Message(header, body), "cpm")))

    monkeypatch.setattr(pcap, "read", spoilt(of_many_objects))
    export(broadcast.path, "pcap", out)
    segments = [
        (packet, message)
        for packet in packets(out)
        if packet.port == 2009 and (message := cpm.decode(packet.payload)).segment
    ]
    count = len(segments)
    assert count > 2
    assert [message.segment for _, message in segments] == [(number, count) for number in range(1, count + 1)]
    assert len({packet._replace(payload=b"") for packet, _ in segments}) == 1, "their headers are the same"
    ids = [number for _, message in segments if message.objects for number in message.objects.id.tolist()]
    assert sorted(ids) == list(range(150))


def test_damaged_bytes_give_a_sound_file(broadcast: mast.Run, tmp_path: Path) -> None:
    run, out = open_recorded(broadcast.path), tmp_path / "run.pcap"

    @given(st.lists(st.tuples(st.integers(0, 1 << 20), st.integers(0, 255)), min_size=1, max_size=4))
    def check(bytes_at: list[tuple[int, int]]) -> None:
        def change(message: Recorded) -> Recorded:
            payload = bytearray(message.payload)
            for place, value in bytes_at:
                payload[place % len(payload)] = value
            return replace(message, payload=bytes(payload))

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(pcap, "read", spoilt(change))
            pcap.write(run, out)
        for packet in packets(out):
            (cpm if packet.port == 2009 else cam).decode(packet.payload)

    check()


def test_a_run_without_such_messages_is_refused_and_the_error_says_how_to_get_some(
    recorded: mast.Run, out: Path
) -> None:
    code, _, err = command("export", str(recorded.path), "--to", "pcap", "-o", str(out))
    assert code == ExportError.exit_code
    words = " ".join(err.split())
    assert "V2X messages, expected" in words
    assert "--set codec=cpm" in words
    assert "--to parquet" in words
    assert not out.exists()


def test_a_line_of_json_has_the_fields_of_each_packet(broadcast: mast.Run, tmp_path: Path) -> None:
    """For readers without a dissector of CPMs, such as tshark before 4.6."""
    out = tmp_path / "radio.pcap"
    export(broadcast.path, "pcap", out)
    lines = [json.loads(line) for line in (tmp_path / "radio.jsonl").read_text().splitlines()]
    captured = packets(out)
    assert [line["number"] for line in lines] == list(range(1, len(captured) + 1))
    assert {line["adversary"] for line in lines} == {None, "adversary_1"}
    for line, found in zip(lines, captured, strict=True):
        assert line["type"] == {2009: "cpm", 2001: "cam"}[found.port]
        decoded = {"cpm": cpm, "cam": cam}[line["type"]].decode(found.payload)
        assert line["station_id"] == line["message"]["header"]["stationId"] == decoded.station_id
        assert line["time_ns"] == found.time_ns - SCENE_BEGINS_S * 1_000_000_000
        if line["type"] == "cam":
            continue
        contents = [each["containerData"] for each in line["message"]["payload"]["cpmContainers"]]
        (of_objects,) = [each for each in contents if "perceivedObjects" in each]
        assert len(of_objects["perceivedObjects"]) == len(decoded.objects)
        assert of_objects["numberOfPerceivedObjects"] == decoded.known_objects

"""pcap: a capture file of the V2X messages that stations and adversaries sent, as Wireshark opens it; and as JSON.

Collective Perception Messages, and Cooperative Awareness Messages.

Ethernet, GeoNetworking (EN 302 636-4-1, single-hop broadcast, not secured) and BTP-B (EN 302 636-5-1) around each
segment.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from mast_zenoh.errors import ExportError, MessageError
from mast_zenoh.messages import codec
from mast_zenoh.messages.packed import Packed
from mast_zenoh.run_folder.recording.reader import Recorded, read
from mast_zenoh.runs.run import Run
from mast_zenoh.v2x import cam, cpm
from mast_zenoh.v2x.asn1 import uper
from mast_zenoh.v2x.asn1.uper import to_plain
from mast_zenoh.v2x.reference_position import Position
from mast_zenoh.wiring.model import InterposedWire, Wiring

#: When a scene begins, s since 1970: 2004-01-01 00:00 UTC, from which the reference times in CPMs count.
EPOCH_S = 1_072_915_200
_MAX_TIME_NS = (2**32 - EPOCH_S) * 1_000_000_000  # pcap has 32 bits for seconds

#: Nanoseconds, version 2.4, UTC, at most 65535 bytes of a packet, Ethernet.
_FILE_HEADER = struct.pack("<IHHiIII", 0xA1B2_3C4D, 2, 4, 0, 0, 0xFFFF, 1)
_PACKET_HEADER = struct.Struct("<IIII")

#: Destination, source, EtherType.
_ETHERNET = struct.Struct("!6s6sH")
_BROADCAST, _GEONETWORKING = b"\xff" * 6, 0x8947
#: A locally administered address, before the four bytes of the station id.
_LOCAL = b"\x02\x00"

#: Version 1, a common header follows; reserved; lifetime 1 x 1 s; 1 hop remains.
_BASIC = bytes([0x11, 0, 0x05, 1])
#: BTP-B follows; topologically scoped, single hop; traffic class 2; mobile; bytes of the payload; 1 hop at most;
#: reserved.
_COMMON = struct.Struct("!BBBBHBB")
_BTP_B, _SINGLE_HOP, _TRAFFIC_CLASS, _MOBILE = 0x20, 0x50, 2, 0x80
#: Kind of address, link-layer address, ms modulo 2^32, latitude, longitude, speed, heading; data of the medium.
_POSITION = struct.Struct("!H6sIiiHHI")
_CONFIGURED, _ROADSIDE_UNIT, _UNKNOWN_STATION = 0x8000, 15, 0
#: Destination ports, by codec, and their info; fields of the messages.
_PORTS = {"cpm": 2009, "cam": 2001}
_LAYOUTS = {"cpm": cpm.LAYOUT, "cam": cam.LAYOUT}
_BTP = struct.Struct("!HH")


class Sender(NamedTuple):
    """What headers say of a sender.

    station_id: from which its address is made;  type: of the station;  mobile: whether it moves
    position: reference position
    speed: 0.01 m/s, negative backward;  heading: 0.1 deg clockwise from north; both 0 if unknown
    """

    station_id: int
    type: int
    mobile: bool
    position: Position
    speed: int = 0
    heading: int = 0


class _Legs(NamedTuple):
    """The keys of a wiring on which V2X messages are sent.

    wires: of wires;  publishers: of stations;  attackers: on which adversaries send, each with its passage
    """

    wires: frozenset[str]
    publishers: frozenset[str]
    attackers: Mapping[str, InterposedWire]

    @classmethod
    def of(cls, run: Run, wiring: Wiring) -> _Legs:
        """The legs of one of a run's wirings."""
        wires = [wire for wire in wiring.wires if wire.codec in _PORTS]
        keys = frozenset(wire.key for wire in wires)
        passages = [each for each in wiring.passages() if each.wire in keys and run.role(each.node) != "link"]
        return cls(keys, frozenset(wire.legs[0].key for wire in wires), {each.sent: each for each in passages})


def write(run: Run, path: Path) -> None:
    """Write a packet for each segment that a publisher sent, and for each that an adversary sent instead.

    Next to it, STEM.jsonl has a line with the fields of each packet.

    Messages that an adversary passes on as it received them are not repeated. A note names each adversary with packets.

    Raises ExportError if no wire of the run has such messages.
    """
    every = [(frame, _Legs.of(run, wiring)) for frame, wiring in run.files.wirings]
    wires = frozenset().union(*(legs.wires for _, legs in every))
    if not wires:
        raise ExportError(
            f"{run.path}: found no wire with V2X messages, expected one at least: "
            "repeat the run with --set codec=cpm, as the scenarios peers and congested can, or use --to parquet"
        )
    refused = 0
    forged: Counter[tuple[str, str, str]] = Counter()
    with path.open("wb") as file, path.with_name(f"{path.stem}.jsonl").open("w", encoding="utf-8") as lines:
        file.write(_FILE_HEADER)
        written = 0
        for _, group in groupby(
            read(run.path, lambda channel: channel.get("wire") in wires), key=lambda message: message.order[:5]
        ):
            of_one = [(message, _in_force(every, message.step)) for message in group]
            payloads = {message.key: message.payload for message, _ in of_one}
            lies = [(message, legs.attackers.get(message.key)) for message, legs in of_one]
            original: list[tuple[Recorded, InterposedWire | None]]
            original = [(message, None) for message, legs in of_one if message.key in legs.publishers]
            for message, attack in [*original, *((message, attack) for message, attack in lies if attack)]:
                if attack and message.payload == payloads.get(attack.received):
                    continue  # passed on
                try:
                    packets = list(_packets(message, attack.node if attack else None))
                except MessageError:
                    refused += 1
                    continue
                seconds, nanoseconds = divmod(message.time_ns, 1_000_000_000)
                about = {"frame": message.frame, "time_ns": message.time_ns, "wire": message.wire}
                for number, (data, fields) in enumerate(packets, written + 1):  # as Wireshark counts
                    file.write(_PACKET_HEADER.pack(EPOCH_S + seconds, nanoseconds, len(data), len(data)) + data)
                    lines.write(json.dumps({"number": number, **about, **fields}) + "\n")
                written += len(packets)
                if attack:
                    forged[attack.node, attack.wire, attack.before or "all"] += len(packets)
    for (node, wire, listener), count in sorted(forged.items()):
        run.files.note(
            f"{node} sends {count} packets to {listener} in place of those on {wire}: "
            f"both are in the file, its own from {_address(_station_of(node)).hex(':')}"
        )
    if refused:
        run.files.note(f"messages.mcap: invalid messages, which receivers refuse, are left out: {refused}")


def _in_force(every: Sequence[tuple[int, _Legs]], step: int) -> _Legs:
    """The legs when a message was sent in a step of the run; -1: unknown."""
    return next(legs for frame, legs in reversed(every) if frame < step or frame < 0)


def _station_of(node: str) -> int:
    """The station id of a node."""
    return zlib.crc32(node.encode())


def _address(station_id: int) -> bytes:
    """The link-layer address of a station."""
    return _LOCAL + station_id.to_bytes(4, "big")


def _packets(message: Recorded, node: str | None) -> Iterator[tuple[bytes, dict[str, Any]]]:
    """The packets of a message, and what each carries. Raises MessageError, before the first one, if it is no such one.

    node: the adversary that sends it from an address of its own; None: the station that the message names
    """
    if message.malformed:
        raise MessageError(f"{message.key}: found a malformed message, expected a CPM or a CAM")
    body = codec.decode(message.payload, message.type).body
    if not isinstance(body, Packed):
        raise MessageError(f"{message.key}: found columns, expected a CPM or a CAM")
    if message.time_ns >= _MAX_TIME_NS:
        raise MessageError(f"{message.key}: time_ns is {message.time_ns}, expected less than {_MAX_TIME_NS}")
    layout = _LAYOUTS[body.codec]
    for segment in body.segments:
        sender = sender_of(body.codec, segment)
        said = sender.station_id
        sender = sender if node is None else sender._replace(station_id=_station_of(node))
        data = packet(segment, _PORTS[body.codec], sender, message.time_ns // 1_000_000)
        plain = to_plain(layout, uper.decode(layout, segment))
        yield data, {"adversary": node, "station_id": said, "type": body.codec, "message": plain}


def sender_of(name: str, segment: bytes) -> Sender:
    """The sender that a message of a codec names."""
    if name == "cam":
        said = cam.decode(segment)
        motion = said.vehicle or cam.VehicleMotion()
        speed = 0 if motion.speed >= cam.VehicleMotion.speed - 1 else motion.speed  # unavailable, or out of range
        speed *= -1 if motion.drive_direction == 1 else 1
        heading = _heading(motion.heading)
        return Sender(said.station_id, said.station_type % 32, said.vehicle is not None, said.position, speed, heading)
    sender = cpm.decode(segment)
    if sender.rsu:
        return Sender(sender.station_id, _ROADSIDE_UNIT, False, sender.position)
    heading = _heading(sender.vehicle[0]) if sender.vehicle else 0
    return Sender(sender.station_id, _UNKNOWN_STATION, True, sender.position, 0, heading)


def _heading(value: int) -> int:
    """Heading of a header; 0 if it is not available."""
    return value % 3600 if value <= 3600 else 0


def packet(segment: bytes, port: int, sender: Sender, time_ms: int) -> bytes:
    """An Ethernet frame. segment: bytes of a message; port: destination; time_ms: since the scene began"""
    address, position = _address(sender.station_id), sender.position
    kind = _CONFIGURED | sender.type << 10
    # The speed has 15 bits, after the flag of an accurate position.
    place = time_ms % 2**32, position.latitude, position.longitude, sender.speed & 0x7FFF, sender.heading, 0
    length = _BTP.size + len(segment)
    return b"".join(
        [
            _ETHERNET.pack(_BROADCAST, address, _GEONETWORKING),
            _BASIC,
            _COMMON.pack(_BTP_B, _SINGLE_HOP, _TRAFFIC_CLASS, _MOBILE * sender.mobile, length, 1, 0),
            _POSITION.pack(kind, address, *place),
            _BTP.pack(port, 0),
            segment,
        ]
    )

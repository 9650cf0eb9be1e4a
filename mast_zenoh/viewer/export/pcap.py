"""pcap: a capture file of the Collective Perception Messages that stations sent, as Wireshark opens it.

Ethernet, GeoNetworking (EN 302 636-4-1, single-hop broadcast, not secured) and BTP-B (EN 302 636-5-1) around each
segment.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

from mast_zenoh.errors import ExportError, MessageError
from mast_zenoh.messagelog.reader import Recorded, read
from mast_zenoh.messages import codec
from mast_zenoh.messages.packed import Packed
from mast_zenoh.v2x import cpm
from mast_zenoh.viewer.recorded import RecordedRun

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
_CONFIGURED, _ROADSIDE_UNIT, _UNKNOWN_STATION = 0x8000, 15 << 10, 0
#: Destination port of CPMs, and its info.
_BTP = struct.pack("!HH", 2009, 0)


def write(run: RecordedRun, path: Path) -> None:
    """Write a packet for each segment that a publisher sent, before any interposer.

    Raises ExportError if no wire of the run has CPMs.
    """
    #: by frame after which they hold, the keys on which publishers send CPMs, with the keys of their wires
    sources = [
        (frame, {wire.legs[0].key: wire.key for wire in wiring.wires if wire.codec == "cpm"})
        for frame, wiring in run.wirings
    ]
    wires = {wire for _, keys in sources for wire in keys.values()}
    if not wires:
        raise ExportError(
            f"{run.path}: found no wire with Collective Perception Messages, expected one at least: "
            "repeat the run with --set codec=cpm, as the scenarios peers and congested can, or use --to parquet"
        )
    refused = 0
    with path.open("wb") as file:
        file.write(_FILE_HEADER)
        for message in read(run.path, wires.__contains__):
            sent = next(keys for frame, keys in reversed(sources) if frame < message.step or frame < 0)
            if message.key not in sent:
                continue  # behind an interposer
            try:
                file.writelines(_records(message))
            except MessageError:
                refused += 1
    if refused:
        run.note(f"messages.mcap: invalid messages, which receivers refuse, are left out: {refused}")


def _records(message: Recorded) -> Iterator[bytes]:
    """Headers and packets of a message in the file. Raises MessageError, before the first one, if it is no CPM."""
    if message.malformed:
        raise MessageError(f"{message.key}: found a malformed message, expected a CPM")
    body = codec.decode(message.payload, message.type).body
    if not isinstance(body, Packed):
        raise MessageError(f"{message.key}: found columns, expected a CPM")
    if message.time_ns >= _MAX_TIME_NS:
        raise MessageError(f"{message.key}: time_ns is {message.time_ns}, expected less than {_MAX_TIME_NS}")
    seconds, nanoseconds = divmod(message.time_ns, 1_000_000_000)
    sender = cpm.decode(body.segments[0])
    for segment in body.segments:
        data = packet(segment, sender)
        yield _PACKET_HEADER.pack(EPOCH_S + seconds, nanoseconds, len(data), len(data))
        yield data


def packet(segment: bytes, sender: cpm.Cpm) -> bytes:
    """An Ethernet frame. segment: bytes of a CPM; sender: its station, position and time"""
    address = _LOCAL + sender.station_id.to_bytes(4, "big")
    station, mobile = (_ROADSIDE_UNIT, 0) if sender.rsu else (_UNKNOWN_STATION, _MOBILE)
    time_ms, position = sender.reference_time % 2**32, sender.position
    heading = sender.vehicle[0] % 3600 if sender.vehicle and sender.vehicle[0] <= 3600 else 0
    return b"".join(
        [
            _ETHERNET.pack(_BROADCAST, address, _GEONETWORKING),
            _BASIC,
            _COMMON.pack(_BTP_B, _SINGLE_HOP, _TRAFFIC_CLASS, mobile, len(_BTP) + len(segment), 1, 0),
            _POSITION.pack(
                _CONFIGURED | station, address, time_ms, position.latitude, position.longitude, 0, heading, 0
            ),
            _BTP,
            segment,
        ]
    )

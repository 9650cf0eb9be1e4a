"""Bodies that travel in another format: tracks as Collective Perception or Cooperative Awareness Messages.

A wire may have a codec (`[[codec]]` in a key-expression map). What its publisher sends is then only what the format can
express, in one process as on the mesh, and on the mesh only its bytes are sent: `"body": {"cpm": [b"...", ...]}`, a
string for each segment. To read them and to write them again gives the same bytes. A Cooperative Awareness Message is
about one object, its sender; without one, nothing is sent: `{"cam": []}`.

Where the scene is far from the origin of the world, as in UTM coordinates, the stations' plane has its origin there.
Bodies then name it, as all readers of a recording need it: `{"cpm": [...], "origin": [690000.0, 5340000.0]}`.

Only compiled kernels read and write the bytes.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh import kernels
from mast_zenoh.arrays.geometry import (
    NO_OFFSET,
    NO_TURN,
    heading,
    rotation_from_quaternion,
    states_to_local,
    tracks_in_world,
)
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates, concatenate, lowest_rows
from mast_zenoh.errors import MessageError
from mast_zenoh.messages.schemas import Body, Message
from mast_zenoh.v2x import cam, cpm
from mast_zenoh.v2x.reference_position import WORLD_PLANE, LocalPlane
from mast_zenoh.v2x.tracks import (
    MOST_SEGMENTS,
    from_cam,
    from_cpm,
    rotation_of,
    segments,
    to_cam,
    to_cpm,
    to_objects,
)


class Codec(NamedTuple):
    """A format of messages.

    meaning: what it is;  messages: the types that it can carry;  itself: only for wires whose one object is the sender
    """

    meaning: str
    messages: tuple[str, ...]
    itself: bool = False


#: The codecs by name.
CODECS = {
    "cpm": Codec("Collective Perception Messages (ETSI TS 103 324): the tracks of a station", ("tracks",)),
    "cam": Codec(
        "Cooperative Awareness Messages (ETSI TS 103 900): one object, the sender itself", ("tracks",), itself=True
    ),
}

#: Bytes of a segment, at most: what a frame of IEEE 802.11p carries beside its headers.
MAX_SEGMENT_BYTES = 1400
#: Objects of a message, at most, by codec: the segments of a CPM hold so many of the largest.
MOST_OBJECTS = {"cpm": 200, "cam": 1}

_IDS = 1 << 16


def check_kernels(codecs: Mapping[str, str], place: str) -> None:
    """Raise ConfigurationError if wires have codecs, and compiled kernels are not used.

    codecs: by the key of a wire;  place: named in the error
    """
    if kernels.USED == "compiled":
        return
    for key, codec in codecs.items():
        raise kernels.missing(f"{place}: codec {codec} on {key!r}")


class Packed(dict[str, NDArray[Any]]):
    """Columns of a message that travels in another format.

    codec: its name;  segments: its bytes;  plane: of the stations of the run
    known: objects that the sender knows, sent or not
    left_out: objects of unknown position or time, which have no row
    """

    codec: str
    segments: tuple[bytes, ...]
    plane = WORLD_PLANE
    known = 0
    left_out = 0


def pack(message: Message, codec: str, plane: LocalPlane = WORLD_PLANE, known: int | None = None) -> Message:
    """The message as its receivers get it: quantised, and with its bytes.

    plane: that all stations of the run share;  known: objects that the sender knows, None: those of the message

    The sender is a roadside unit if its frame of reference has the axes of the world, otherwise a vehicle with the
    heading of its frame.
    Beyond MOST_OBJECTS, the objects with the lowest scores are left out; of equal ones the last.
    Raises MessageError for columns that the format cannot express.
    """
    header, body = message
    states, most = tracks_in_world(body), MOST_OBJECTS[codec]
    known = len(states) if known is None else known
    if not all(np.isfinite(column).all() for column in (*states.columns().values(), body["origin"])):
        raise MessageError(f"{header.schema}: a value is not finite")
    if len(states) > most:
        states = states.select(lowest_rows([-states.score], most))
    station, time_ms = zlib.crc32(header.source.encode()), header.time_ns // 1_000_000
    if codec == "cam":
        cams = [to_cam(states, station, time_ms, plane)] if len(states) else []
        return Message(header, unpack(codec, [cam.encode(each) for each in cams], plane))
    position, yaw = plane.to_position(body["origin"]), None
    if body["rotation"][1:].any():
        yaw = float(heading(rotation_from_quaternion(body["rotation"])))
    objects = to_objects(states, _wire_ids(states.id), plane.to_point(position))
    whole = to_cpm(objects, station, time_ms, position, yaw, known)
    return Message(header, unpack(codec, [cpm.encode(part) for part in segments(whole, MAX_SEGMENT_BYTES)], plane))


def unpack(codec: str, data: Sequence[object], plane: LocalPlane = WORLD_PLANE) -> Packed:
    """The columns in the bytes of a message.

    Raises MessageError for bytes that are none, for mixed segments, and for any if compiled kernels are not used.
    """
    if codec not in CODECS:
        raise MessageError(f"body: unknown codec {codec[:20]!r}, expected one of {', '.join(CODECS)}")
    if kernels.USED != "compiled":  # of a stranger: `check_kernels` refuses wires that have a codec
        raise MessageError(f"{codec}: only compiled kernels read it: {kernels.remedy()}")
    least, most = (0, 1) if codec == "cam" else (1, MOST_SEGMENTS)
    if not isinstance(data, (list, tuple)) or not least <= len(data) <= most:
        raise MessageError(f"{codec}: expected a list of {least} to {most} segments")
    parts = []
    for number, part in enumerate(data, 1):
        if not isinstance(part, bytes) or len(part) > MAX_SEGMENT_BYTES:
            raise MessageError(f"{codec}: segment {number}: expected at most {MAX_SEGMENT_BYTES} bytes")
        parts.append(part)
    read = _read_cam if codec == "cam" else _read_cpm
    states, origin, rotation, known, n_objects = read(parts, plane)
    body = Packed(states_to_local(states, origin, rotation).columns())
    body["origin"], body["rotation"] = origin, rotation
    if len(set(body["id"].tolist())) != len(body["id"]):
        raise MessageError(f"{codec}: an object id occurs twice")
    for name, column in body.items():
        body[name] = column.view()  # empty columns are those of all empty states
        body[name].setflags(write=False)
    body.codec, body.segments, body.plane = codec, tuple(parts), plane
    body.known, body.left_out = known, n_objects - len(states)
    return body


def unpack_body(body: Mapping[str, object]) -> Packed:
    """The columns of a body as it was sent, see above. Raises MessageError."""
    (codec, data), *others = body.items()
    plane = WORLD_PLANE
    if others:
        ((name, origin),) = others
        if name != "origin" or not isinstance(origin, list) or [type(value) for value in origin] != [float, float]:
            raise MessageError(f"{codec}: expected segments, or segments and x and y of an origin, m")
        try:
            plane = replace(WORLD_PLANE, origin=tuple(origin))
        except ValueError as error:
            raise MessageError(f"{codec}: {error}") from None
    return unpack(codec, data, plane)  # type: ignore[arg-type]  # it checks the type


def sent_body(body: Packed) -> dict[str, object]:
    """The body as it is sent."""
    sent: dict[str, object] = {body.codec: body.segments}
    return sent | ({} if body.plane == WORLD_PLANE else {"origin": body.plane.origin})


#: What the bytes of a message say: objects in the world frame, the sender's frame of reference, how many objects the
#: sender knows, and how many are in the message.
_Reading = tuple[ObjectStates, Floats, Floats, int, int]


def _read_cam(data: Sequence[bytes], plane: LocalPlane) -> _Reading:
    """The sender in its message; none without a message.

    Its frame is the world: in the sender's own frame, a lie about where it is would be no change of an object.
    """
    states = from_cam(cam.decode(data[0]), plane) if data else ObjectStates.empty()
    return states, NO_OFFSET, NO_TURN, len(states), len(states)


def _read_cpm(data: Sequence[bytes], plane: LocalPlane) -> _Reading:
    """The objects in the segments of a message."""
    parts = [cpm.decode(part) for part in data]
    first = parts[0]
    for number, message in enumerate(parts, 1):
        segment = (number, len(parts)) if len(parts) > 1 else None
        if message.segment != segment or _station(message) != _station(first):
            raise MessageError(f"cpm: segment {number}: found {message.segment}, expected {segment} of one message")
    states = concatenate([from_cpm(message, plane) for message in parts])
    rotation = NO_TURN if first.vehicle is None else rotation_of(first.vehicle[0])
    n_objects = sum(0 if message.objects is None else len(message.objects) for message in parts)
    known = n_objects if first.known_objects is None else first.known_objects
    return states, plane.to_point(first.position), rotation, known, n_objects


def _station(message: cpm.Cpm) -> tuple[object, ...]:
    """What all segments of a message have in common."""
    return message.station_id, message.position, message.vehicle


def codec_of(body: Body) -> str:
    """The codec of a body; empty: its columns travel as they are."""
    return body.codec if type(body) is Packed else ""


def check_codec(schema: str, body: Body, codec: str, plane: LocalPlane) -> None:
    """Raise MessageError for a body that does not travel in the codec of its wire (empty: columns), or in the plane."""
    if codec_of(body) != codec:
        raise MessageError(f"codec: {schema}: expected a body in {codec or 'columns'}")
    if type(body) is Packed and body.plane != plane:
        place = f"found a plane with its origin at {body.plane.origin}, expected {plane.origin}"
        raise MessageError(f"codec: {schema}: {place}")


def _wire_ids(ids: Ints) -> Ints:
    """(n,) object ids, 0 to 65535, of tracks with ids (n,): their remainder, or the next one that is free."""
    result = ids % _IDS
    if len(np.unique(result)) < len(result):
        used: set[int] = set()
        for row in np.argsort(ids, kind="stable").tolist():
            each = int(result[row])
            while each in used:
                each = (each + 1) % _IDS
            used.add(each)
            result[row] = each
    return result

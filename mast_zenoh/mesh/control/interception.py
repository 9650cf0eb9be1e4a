"""Requests of a user to insert a node into a wire or release one, and the answers."""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.mesh.control import codec
from mast_zenoh.mesh.control.codec import ControlMessage, Finite, Id, Name, Text, Whole
from mast_zenoh.mesh.control.flow import wiring_of
from mast_zenoh.wiring.insertion import InsertionPoint
from mast_zenoh.wiring.model import Wiring


class Intercept(NamedTuple):
    """Insert a node at a place.

    modules: the user's files with classes that its configuration names
    """

    name: str
    spec: NodeSpec
    place: InsertionPoint
    modules: tuple[str, ...]


class Release(NamedTuple):
    """Release the node of this name, or the only one on this wire."""

    name: str | None
    wire: str | None


class _Spec(ControlMessage, frozen=True):
    file: Text
    type: Text
    role: Text
    config: dict[str, Any]
    on_exit: Text


class _Place(ControlMessage, frozen=True):
    wire: Text
    input: Text
    output: Text
    hears: dict[str, Text]
    says: list[Any]
    before: Text = ""


class _InterceptRequest(ControlMessage, frozen=True, tag_field="do", tag="intercept"):
    number: Id
    name: Name
    spec: _Spec
    place: Any
    modules: tuple[Text, ...]


class _ReleaseRequest(ControlMessage, frozen=True, tag_field="do", tag="release"):
    number: Id
    name: Text | None
    wire: Text | None


class _Answer(ControlMessage, frozen=True):
    action: Text
    node: Text
    wires: list[Text]
    frame: Whole
    took_ms: Finite
    before: Text = ""


def sealed_parts(payload: bytes) -> tuple[bytes, bytes]:
    """(body, digest) of a request; raises MessageError."""
    return codec.decode(tuple[bytes, bytes], payload, "intercept")


def request_of(value: dict[str, Any]) -> Intercept | Release:
    """The request in the body of a sealed message; raises MessageError."""
    request = codec.converted(value, _InterceptRequest | _ReleaseRequest, "intercept")
    if isinstance(request, _ReleaseRequest):
        return Release(request.name, request.wire)
    spec = NodeSpec(**msgspec.structs.asdict(request.spec))
    return Intercept(request.name, spec, place_of(request.place), request.modules)


def answer_of(payload: bytes) -> dict[str, Any]:
    """The launcher's answer: action, node, wires, frame, took_ms, before; raises MessageError."""
    return msgspec.structs.asdict(codec.decode(_Answer, payload, "intercept"))


def place_of(value: object) -> InsertionPoint:
    """The place from its `place_json` form; raises MessageError."""
    place: _Place = codec.converted(value, _Place, "place")
    wires = wiring_of({"wires": place.says, "overhearers": [], "nodes": {}}, "place: says").wires
    return InsertionPoint(place.wire, place.input, place.output, place.hears, wires, place.before)


def place_json(place: InsertionPoint) -> dict[str, Any]:
    """A place as plain values."""
    data = {"wire": place.wire, "input": place.input, "output": place.output, "hears": dict(place.other_inputs)}
    return data | {"says": Wiring(place.published_wires).to_json()["wires"], "before": place.before}

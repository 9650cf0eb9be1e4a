"""What a user asks of a running run: to put a node on a wire, or to take one off; and what is answered."""

from __future__ import annotations

from typing import Any, NamedTuple

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.control import fields
from mast_zenoh.control.flow import wiring_of
from mast_zenoh.errors import MessageError
from mast_zenoh.wiring.insertion import Place
from mast_zenoh.wiring.model import Wiring

_SPEC = ("file", "type", "role", "config", "on_exit")
_PLACE = ("wire", "input", "output", "hears", "says")
_ANSWER = ("action", "node", "wires", "frame", "took_ms")


class Intercept(NamedTuple):
    """Put a node at a place."""

    name: str
    spec: NodeSpec
    place: Place


class Release(NamedTuple):
    """Take the node of this name off its wires, or the only one on this wire."""

    name: str | None
    wire: str | None


def sealed_parts(payload: bytes) -> tuple[bytes, bytes]:
    """(body, digest) of a request; raises MessageError."""
    body, digest = fields.items(fields.unpack(payload, "intercept"), 2, "intercept")
    if type(body) is not bytes or type(digest) is not bytes:
        raise MessageError("intercept: expected a sealed request")
    return body, digest


def request_of(value: dict[str, Any]) -> Intercept | Release:
    """The request in the body of a sealed message; raises MessageError."""
    if value.get("do") == "intercept":
        fields.fields(value, ("do", "number", "name", "spec", "place"), "intercept")
        return Intercept(
            fields.name(value["name"], "intercept: name"),
            _spec(value["spec"]),
            place_of(value["place"]),
        )
    if value.get("do") == "release":
        fields.fields(value, ("do", "number", "name", "wire"), "release")
        name, wire = value["name"], value["wire"]
        return Release(
            None if name is None else fields.text(name, "release: name"),
            None if wire is None else fields.text(wire, "release: wire"),
        )
    raise MessageError(f"intercept: found {fields.shown(value.get('do'))}, expected intercept or release")


def answer_of(payload: bytes) -> dict[str, Any]:
    """What the launcher has done: action, node, wires, frame, took_ms; raises MessageError."""
    found = fields.fields(fields.unpack(payload, "intercept"), _ANSWER, "intercept: answer")
    fields.whole(found["frame"], "intercept: frame")
    fields.finite(found["took_ms"], "intercept: took_ms")
    for wire in fields.listed(found["wires"], "intercept: wires"):
        fields.text(wire, "intercept: wires")
    for part in ("action", "node"):
        fields.text(found[part], f"intercept: {part}")
    return found


def place_of(value: object) -> Place:
    """The place that `place_json` told of; raises MessageError."""
    found = fields.fields(value, _PLACE, "place")
    hears = fields.mapping(found["hears"], "place: hears")
    return Place(
        fields.text(found["wire"], "place: wire"),
        fields.text(found["input"], "place: input"),
        fields.text(found["output"], "place: output"),
        {key: fields.text(port, "place: hears") for key, port in hears.items()},
        wiring_of({"wires": found["says"], "overhearers": []}, "place: says").wires,
    )


def place_json(place: Place) -> dict[str, Any]:
    """A place as plain values."""
    told = {"wire": place.wire, "input": place.input, "output": place.output, "hears": dict(place.hears)}
    return told | {"says": Wiring(place.says).to_json()["wires"]}


def _spec(value: object) -> NodeSpec:
    found = fields.fields(value, _SPEC, "spec")
    texts = {part: fields.text(found[part], f"spec: {part}") for part in _SPEC if part != "config"}
    return NodeSpec(config=fields.mapping(found["config"], "spec: config"), **texts)

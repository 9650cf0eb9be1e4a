"""Requests of a user to insert a node into a wire or release one, and the answers."""

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
    """Insert a node at a place.

    modules: the user's files with classes that its configuration names
    """

    name: str
    spec: NodeSpec
    place: Place
    modules: tuple[str, ...]


class Release(NamedTuple):
    """Release the node of this name, or the only one on this wire."""

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
        fields.fields(value, ("do", "number", "name", "spec", "place", "modules"), "intercept")
        modules = fields.listed(value["modules"], "intercept: modules")
        return Intercept(
            fields.name(value["name"], "intercept: name"),
            _spec(value["spec"]),
            place_of(value["place"]),
            tuple(fields.text(file, "intercept: modules") for file in modules),
        )
    if value.get("do") == "release":
        fields.fields(value, ("do", "number", "name", "wire"), "release")
        name, wire = value["name"], value["wire"]
        return Release(
            None if name is None else fields.text(name, "release: name"),
            None if wire is None else fields.text(wire, "release: wire"),
        )
    raise MessageError(f"intercept: found {fields.abbreviated(value.get('do'))}, expected intercept or release")


def answer_of(payload: bytes) -> dict[str, Any]:
    """The launcher's answer: action, node, wires, frame, took_ms; raises MessageError."""
    answer = fields.fields(fields.unpack(payload, "intercept"), _ANSWER, "intercept: answer")
    fields.whole(answer["frame"], "intercept: frame")
    fields.finite(answer["took_ms"], "intercept: took_ms")
    for wire in fields.listed(answer["wires"], "intercept: wires"):
        fields.text(wire, "intercept: wires")
    for part in ("action", "node"):
        fields.text(answer[part], f"intercept: {part}")
    return answer


def place_of(value: object) -> Place:
    """The place from its `place_json` form; raises MessageError."""
    data = fields.fields(value, _PLACE, "place")
    hears = fields.mapping(data["hears"], "place: hears")
    return Place(
        fields.text(data["wire"], "place: wire"),
        fields.text(data["input"], "place: input"),
        fields.text(data["output"], "place: output"),
        {key: fields.text(port, "place: hears") for key, port in hears.items()},
        wiring_of({"wires": data["says"], "overhearers": []}, "place: says").wires,
    )


def place_json(place: Place) -> dict[str, Any]:
    """A place as plain values."""
    data = {"wire": place.wire, "input": place.input, "output": place.output, "hears": dict(place.other_inputs)}
    return data | {"says": Wiring(place.published_wires).to_json()["wires"]}


def _spec(value: object) -> NodeSpec:
    data = fields.fields(value, _SPEC, "spec")
    texts = {part: fields.text(data[part], f"spec: {part}") for part in _SPEC if part != "config"}
    return NodeSpec(config=fields.mapping(data["config"], "spec: config"), **texts)

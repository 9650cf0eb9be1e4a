"""Control messages of a run's flow: members, counts, wiring changes, and its end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import msgpack

from mast_zenoh.config.process_steps import ACTIONS
from mast_zenoh.control import CONTROLS, fields
from mast_zenoh.errors import MessageError
from mast_zenoh.messages.schemas import SCHEMAS
from mast_zenoh.wiring.model import Wiring

MAX_EPOCH = 1 << 32  #: as in the attachment of data messages

#: What the launcher tells a node on `leave/NODE`: to hand in its results, or to end at once, as if it were killed (only
#: a node that can start over by itself obeys).
LEAVE, KILL = "leave", "kill"

_MAX_COUNTS = CONTROLS["counts"].max_bytes


class Counts(NamedTuple):
    """Numbers of messages that a node has sent and handled in an epoch, by key."""

    epoch: int
    sent: Mapping[str, int]
    handled: Mapping[str, int]


class WiringUpdate(NamedTuple):
    """The wiring in an epoch, and the nodes about to leave.

    active: whether the wiring is in use; otherwise it is only announced
    """

    wiring: Wiring
    active: bool
    leaving: tuple[str, ...] = ()


class Epoch(NamedTuple):
    """The members from now on, name to role; update: None before any wiring change."""

    number: int
    members: dict[str, str]
    update: WiringUpdate | None


class Act(NamedTuple):
    """Actions on processes before a frame: (action, node) of each."""

    frame: int
    steps: tuple[tuple[str, str], ...]


class Rewire(NamedTuple):
    """A change of the wiring; join: added nodes, name to role; leave: removed nodes."""

    wiring: Wiring
    join: dict[str, str]
    leave: tuple[str, ...]


def encode_counts(epoch: int, sent: Mapping[str, int], handled: Mapping[str, int]) -> bytes:
    """Encode Counts."""
    packed: bytes = msgpack.packb([epoch, dict(sent), dict(handled)])
    return packed


def decode_counts(payload: bytes) -> Counts:
    """Decode Counts; raises MessageError."""
    epoch, sent, handled = fields.items(fields.unpack(payload, "counts", _MAX_COUNTS), 3, "counts")
    fields.whole(epoch, "counts: epoch", 1, MAX_EPOCH)
    return Counts(epoch, fields.counters(sent, "counts: sent"), fields.counters(handled, "counts: handled"))


def encode_epoch(number: int, members: Mapping[str, str], update: WiringUpdate | None) -> bytes:
    """Encode an epoch."""
    change = None if update is None else [update.wiring.to_json(), update.active, list(update.leaving)]
    packed: bytes = msgpack.packb([number, dict(members), change])
    return packed


def decode_epoch(payload: bytes) -> Epoch:
    """Decode an epoch; raises MessageError."""
    number, members, change = fields.items(fields.unpack(payload, "epoch"), 3, "epoch")
    fields.whole(number, "epoch: number", 1, MAX_EPOCH)
    update = None
    if change is not None:
        wiring, active, leaving = fields.items(change, 3, "epoch: wiring update")
        update = WiringUpdate(
            wiring_of(wiring, "epoch: wiring"),
            fields.flag(active, "epoch: active"),
            fields.names(leaving, "epoch: leaving"),
        )
    return Epoch(number, fields.roles(members, "epoch: members"), update)


def encode_act(frame: int, steps: list[tuple[str, str]]) -> bytes:
    """Encode an Act."""
    packed: bytes = msgpack.packb([frame, [list(step) for step in steps]])
    return packed


def decode_act(payload: bytes) -> Act:
    """Decode an Act; raises MessageError."""
    frame, steps = fields.items(fields.unpack(payload, "act"), 2, "act")
    checked_steps = []
    for step in fields.listed(steps, "act: steps"):
        action, node = fields.items(step, 2, "act: step")
        if action not in ACTIONS:
            raise MessageError(f"act: found {fields.abbreviated(action)}, expected one of {', '.join(ACTIONS)}")
        checked_steps.append((action, fields.name(node, "act: node")))
    return Act(fields.whole(frame, "act: frame"), tuple(checked_steps))


def decode_stop(payload: bytes) -> str:
    """Why a node is to stop; raises MessageError."""
    return fields.plain_text(payload, "stop")


def decode_drain(payload: bytes) -> str:
    """The key whose pending messages a node must forward; raises MessageError."""
    return fields.key(fields.plain_text(payload, "drain"), "drain")


def encode_rewire(wiring: Wiring, join: Mapping[str, str], leave: list[str]) -> bytes:
    """Encode a Rewire."""
    packed: bytes = msgpack.packb({"wiring": wiring.to_json(), "join": dict(join), "leave": leave})
    return packed


def decode_rewire(payload: bytes) -> Rewire:
    """Decode a Rewire; raises MessageError."""
    change = fields.fields(fields.unpack(payload, "rewire"), ("wiring", "join", "leave"), "rewire")
    return Rewire(
        wiring_of(change["wiring"], "rewire: wiring"),
        fields.roles(change["join"], "rewire: join"),
        fields.names(change["leave"], "rewire: leave"),
    )


def encode_rewired(**answer: Any) -> bytes:
    """Encode the outcome of a change: `frame` and `took_ms`, or `error`."""
    packed: bytes = msgpack.packb(answer)
    return packed


def decode_rewired(payload: bytes) -> dict[str, Any]:
    """The outcome of a change: frame and took_ms, or error; raises MessageError."""
    answer = fields.mapping(fields.unpack(payload, "rewire"), "rewire: answer")
    if "error" in answer:
        return {"error": fields.text(fields.fields(answer, ("error",), "rewire: answer")["error"], "rewire: error")}
    fields.fields(answer, ("frame", "took_ms"), "rewire: answer")
    return {
        "frame": fields.whole(answer["frame"], "rewire: frame"),
        "took_ms": fields.finite(answer["took_ms"], "rewire: took_ms"),
    }


def wiring_of(value: object, what: str) -> Wiring:
    """The wiring that `Wiring.to_json` wrote; raises MessageError for anything else."""
    try:
        wiring = Wiring.from_json(fields.mapping(value, what))
        consistent = wiring.to_json() == value
    except (KeyError, TypeError, IndexError, AttributeError, ValueError, RecursionError) as error:
        raise MessageError(f"{what}: not a wiring: {type(error).__name__}: {str(error)[:100]}") from None
    if not consistent:
        raise MessageError(f"{what}: found a wiring that contradicts itself")
    for wire in wiring.wires:
        fields.key(wire.key, what)
        if wire.subject:
            fields.key(wire.subject, what)
        else:
            fields.text(wire.subject, what)
        if not isinstance(wire.message, str) or wire.message not in SCHEMAS:
            raise MessageError(f"{what}: message type {fields.abbreviated(wire.message)}, not a known one")
        for listener in wire.listeners:
            fields.flag(listener.source, what)
    for wire, leg in wiring.legs():
        fields.key(leg.key, what)
        for end in (leg.publisher, *wire.receivers(leg)):
            fields.name(end.node, what)
            fields.name(end.port, what)
    for end in wiring.overhearers:
        fields.name(end.node, what)
        fields.name(end.port, what)
    return wiring

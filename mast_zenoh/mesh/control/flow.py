"""Control messages of a run's flow: members, counts, wiring changes, and its end."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

from msgspec import Meta

from mast_zenoh.config.resolved import ACTIONS
from mast_zenoh.errors import MessageError
from mast_zenoh.mesh.control import codec
from mast_zenoh.mesh.control.codec import ControlMessage, Finite, FrameOrNone, Key, Name, Roles, Text, Whole, encode
from mast_zenoh.messages.schemas import SCHEMAS
from mast_zenoh.wiring.model import Wiring

MAX_EPOCH = 1 << 32  #: as in the attachment of data messages

#: What the launcher tells a node on `leave/NODE`: to hand in its results, or to end at once, as if it were killed (only
#: a node that can start over by itself obeys).
LEAVE, KILL = "leave", "kill"

T = TypeVar("T")

_Epoch = Annotated[int, Meta(ge=1, lt=MAX_EPOCH)]
_Names = tuple[Name, ...]


class MessageCounts(NamedTuple):
    """Numbers of messages that a node has sent and handled in an epoch, by key."""

    epoch: _Epoch
    sent: dict[str, Whole]
    handled: dict[str, Whole]


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


class _EpochParts(NamedTuple):
    number: _Epoch
    members: Roles
    change: tuple[dict[str, Any], bool, _Names] | None


class Act(NamedTuple):
    """Actions on processes before a frame: (action, node) of each."""

    frame: Whole
    steps: tuple[tuple[Literal[ACTIONS], Name], ...]  # type: ignore[valid-type]  # mypy wants it spelled out


class Rewire(NamedTuple):
    """A change of the wiring; join: added nodes, name to role; leave: removed nodes."""

    wiring: Wiring
    join: dict[str, str]
    leave: tuple[str, ...]


def encode_counts(epoch: int, sent: Mapping[str, int], handled: Mapping[str, int]) -> bytes:
    """Encode counts."""
    return encode((epoch, sent, handled))


def decode_counts(payload: bytes) -> MessageCounts:
    """Decode Counts; raises MessageError."""
    return codec.decode(MessageCounts, payload, "counts")


def encode_epoch(number: int, members: Mapping[str, str], update: WiringUpdate | None) -> bytes:
    """Encode an epoch."""
    return encode((number, members, update and (update.wiring.to_json(), update.active, update.leaving)))


def decode_epoch(payload: bytes) -> Epoch:
    """Decode an epoch; raises MessageError."""
    number, members, change = codec.decode(_EpochParts, payload, "epoch")
    update = None
    if change is not None:
        wiring, active, leaving = change
        update = WiringUpdate(wiring_of(wiring, "epoch: wiring"), active, _unique(leaving, "epoch: leaving"))
    return Epoch(number, members, update)


def encode_act(frame: int, steps: list[tuple[str, str]]) -> bytes:
    """Encode an Act."""
    return encode((frame, steps))


def decode_act(payload: bytes) -> Act:
    """Decode an Act; raises MessageError."""
    return codec.decode(Act, payload, "act")


def decode_stop(payload: bytes) -> str:
    """Why a node is to stop; raises MessageError."""
    return codec.plain_text(payload, "stop")


def decode_drain(payload: bytes) -> str:
    """The key whose pending messages a node must forward; raises MessageError."""
    key: str = codec.converted(codec.plain_text(payload, "drain"), Key, "drain")
    return key


class _Rewire(ControlMessage, frozen=True):
    wiring: dict[str, Any]
    join: Roles
    leave: _Names


class Rewired(ControlMessage, frozen=True):
    """The outcome of a change: the frame that begins with it, or the reason why nothing was changed."""

    frame: FrameOrNone = -1
    took_ms: Finite = 0.0
    error: Text = ""

    def __post_init__(self) -> None:
        if (self.frame < 0) != bool(self.error):
            raise ValueError("expected either a frame or an error")


def encode_rewire(wiring: Wiring, join: Mapping[str, str], leave: list[str]) -> bytes:
    """Encode a Rewire."""
    return encode({"wiring": wiring.to_json(), "join": join, "leave": leave})


def decode_rewire(payload: bytes) -> Rewire:
    """Decode a Rewire; raises MessageError."""
    change = codec.decode(_Rewire, payload, "rewire")
    wiring = wiring_of(change.wiring, "rewire: wiring")
    return Rewire(wiring, change.join, _unique(change.leave, "rewire: leave"))


def decode_rewired(payload: bytes) -> Rewired:
    """The outcome of a change; raises MessageError."""
    return codec.decode(Rewired, payload, "rewire")


class _WiringParts(ControlMessage, frozen=True):
    """The parts of a wiring that need checking."""

    keys: list[Key]
    ends: list[tuple[Name, Name]]
    types: list[str]
    sources: list[bool]


def wiring_of(value: object, what: str) -> Wiring:
    """The wiring that `Wiring.to_json` wrote; raises MessageError for anything else."""
    try:
        wiring = Wiring.from_json(codec.converted(value, dict[str, Any], what))
        consistent = wiring.to_json() == value
    except (KeyError, TypeError, IndexError, AttributeError, ValueError, RecursionError) as error:
        raise MessageError(f"{what}: not a wiring: {type(error).__name__}: {str(error)[:100]}") from None
    if not consistent:
        raise MessageError(f"{what}: found a wiring that contradicts itself")
    wires, legs = wiring.wires, list(wiring.legs())
    ends = [*wiring.overhearers, *(end for wire, leg in legs for end in (leg.publisher, *wire.receivers(leg)))]
    parts = {
        "keys": [wire.key for wire in wires]
        + [wire.subject for wire in wires if wire.subject != ""]
        + [leg.key for _, leg in legs],
        "ends": [(end.node, end.port) for end in ends],
        "types": [wire.message for wire in wires],
        "sources": [listener.source for wire in wires for listener in wire.listeners],
    }
    checked: _WiringParts = codec.converted(parts, _WiringParts, what)
    if unknown := {*checked.types} - SCHEMAS.keys():
        raise MessageError(f"{what}: message type {min(unknown)!r:.60}, not a known one")
    return wiring


def _unique(names: tuple[str, ...], what: str) -> tuple[str, ...]:
    if len({*names}) != len(names):
        raise MessageError(f"{what}: found a name twice")
    return names


MAX_TEXT = 2000  #: characters of the driver's own reason


class StopKind(Enum):
    """Why a run stops; its value is the beginning of the text in messages and results."""

    END = "end"
    STALL = "stall"
    START = "start"
    IMPLAUSIBLE = "implausible"
    REQUESTED = ""


class StopReason(NamedTuple):
    """Why a run stops; detail: as text, "" for END."""

    kind: StopKind
    detail: str = ""


END = StopReason(StopKind.END)


def encode_reason(reason: StopReason) -> str:
    """The text of a reason, which the driver reports and the launcher turns into the run's error.

    end                      all frames have been played
    stall: TEXT              the mesh did not become quiet
    start: TEXT              not every node joined in time
    implausible: TEXT        a node's counters are impossible
    anything else            a stop request with this text
    """
    if reason.kind is StopKind.END:
        return str(reason.kind.value)
    return reason.detail if reason.kind is StopKind.REQUESTED else f"{reason.kind.value}: {reason.detail}"


def decode_reason(text: str) -> StopReason:
    """The reason in a text; never fails."""
    if text == StopKind.END.value:
        return END
    for kind in (StopKind.STALL, StopKind.START, StopKind.IMPLAUSIBLE):
        if text.startswith(f"{kind.value}: "):
            return StopReason(kind, text.removeprefix(f"{kind.value}: "))
    return StopReason(StopKind.REQUESTED, text)

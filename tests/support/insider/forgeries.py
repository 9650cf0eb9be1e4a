"""Forged control messages: malformed, damaged and false ones. Pure functions of a position and a seed."""

import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import msgpack
import numpy as np
import zenoh
from damage import flipped, malformed
from damage import refused as refused_by
from sound_controls import CODECS

from insider.position import FAILURE, MARKER, RESULT, Position, valid_message
from mast_zenoh import streams
from mast_zenoh.mesh.control import CONTROLS, results
from mast_zenoh.mesh.control.results import EVALUATOR

#: Kinds sent as queries; all others are published.
QUERIES = frozenset({"result", "fetch", "file", "drain", "rewire", "intercept"})

#: Defects: decoders reject malformed messages and accept false ones; damaged ones may be either.
MALFORMED, DAMAGED, FALSE = "malformed", "damaged", "false"

#: With at least this many forgeries of a kind, some are heavy.
_HEAVY_FROM = 100
#: Size limit of payloads, bytes; enough for payloads that unpack to many times their size.
HEAVY_BYTES = 8 << 20

#: Share of forgeries on keys of other nodes, for kinds with a key per node.
_FOREIGN = 0.2


class Forgery(NamedTuple):
    """One forged control message.

    control: its kind, of CONTROLS
    key:     below @control/
    defect:  MALFORMED, DAMAGED or FALSE
    """

    control: str
    key: str
    payload: bytes
    defect: str

    @property
    def sender(self) -> str:
        """The node that the key belongs to; "" for a shared key."""
        return self.key.partition("/")[2]


def forgeries(control: str, position: Position, count: int, seed: int = 0) -> list[Forgery]:
    """`count` messages of one kind: a third malformed, a third damaged, a third false.

    For kinds with a key per node, most go to the node's own key.
    """
    random = streams.stream(seed, "forgeries", position.node, control)
    plain, false_values = valid_message(control, position), falsehoods(control, position)
    valid, decode = pack(plain), decoder(control, position.node)
    offset = int(random.integers(len(false_values)))
    own_key, *foreign = keys(control, position)
    messages = [
        Forgery(control, own_key, each, MALFORMED) for each in (heavy(plain, control) if count >= _HEAVY_FROM else ())
    ]
    while len(messages) < count:
        defect = (MALFORMED, DAMAGED, FALSE)[len(messages) % 3]
        key = foreign[int(random.integers(len(foreign)))] if foreign and random.random() < _FOREIGN else own_key
        if defect == MALFORMED:
            payload = malformed(valid, decode, random)
        elif defect == DAMAGED:
            payload = flipped(valid, random)
        else:
            payload = pack(false_values[(offset + len(messages) // 3) % len(false_values)])
        messages.append(Forgery(control, key, payload, defect))
    return messages[:count]


def decoder(control: str, node: str) -> Callable[[bytes], Any]:
    """The decoder of messages of this kind from a node that does not drive the scene."""
    if control == "result":
        return lambda payload: results.decode_result(payload, node, drives=False)
    return CODECS[{"leave": "stop", "fetch": "join", "intercept": "sealed"}.get(control, control)][0]


def refused(control: str, node: str, payload: bytes) -> bool:
    """Whether the decoder refuses a payload; any error but MessageError fails."""
    return refused_by(decoder(control, node), payload)


def pack(value: Any) -> bytes:
    """The bytes of a valid value; a str stands for bare text."""
    return value.encode() if isinstance(value, str) else results.pack(value)


def heavy(value: Any, control: str) -> Iterator[bytes]:
    """Payloads that exhaust the memory of receivers that unpack them unchecked."""
    max_bytes = CONTROLS[control].max_bytes
    if max_bytes < HEAVY_BYTES:
        yield pack(value) + bytes(max_bytes)
    if not isinstance(value, str):
        size = min(max_bytes, HEAVY_BYTES) - (1 << 16)
        inner = b"\xdc\x80\x00" + b"\x90" * (1 << 15)  # lists of accepted length
        count = max(1, size // len(inner))
        yield b"\xdc" + count.to_bytes(2, "big") + inner * count
        if control == "result":
            payload = b"\xdd" + size.to_bytes(4, "big") + b"\x90" * size
            for code in (1, 2):  # of results: an array, and a column of text
                yield results.pack(value | {"results": {"x": msgpack.ExtType(code, payload)}})


def keys(control: str, position: Position) -> list[str]:
    """The keys of a kind below @control/, the node's own first."""
    if CONTROLS[control].own or control in ("leave", "drain"):
        return [f"{control}/{name}" for name in (position.node, *position.others)]
    return [control]


def all_forgeries(position: Position, count: int, seed: int = 0) -> list[Forgery]:
    """`count` forgeries of every kind."""
    return [forgery for control in CONTROLS for forgery in forgeries(control, position, count, seed)]


#: Maximum number of pending queries; below the launcher's limit per node.
_MAX_PENDING = 8

#: s, timeout of queries; those on permitted keys are answered in this time.
_ANSWER_S = 0.3


def send(session: zenoh.Session, prefix: str, messages: Iterable[Forgery]) -> int:
    """Send messages in order; returns how many the router accepted.

    prefix: of all keys of the run
    """
    slots, sent, pending = threading.Semaphore(_MAX_PENDING), 0, 0
    answers = threading.Semaphore(0)

    def answered() -> None:
        slots.release()
        answers.release()

    for message in messages:
        key = f"{prefix}/@control/{message.key}"
        try:
            if message.control in QUERIES:
                slots.acquire()
                handler: Any = zenoh.handlers.Callback(lambda reply: None, answered, indirect=False)
                session.get(key, handler, payload=message.payload, timeout=_ANSWER_S)
                pending += 1
            else:
                session.put(key, message.payload, congestion_control=zenoh.CongestionControl.BLOCK, express=True)
        except zenoh.ZError:  # the run is over
            break
        sent += 1
    for _ in range(pending):
        answers.acquire(timeout=10 * _ANSWER_S)
    return sent


_BILLION = 10**9
_LATE = 1 << 61


def falsehoods(control: str, position: Position) -> list[Any]:
    """All false messages of a kind: plain values, or a str for bare text."""
    return list(_GENERATORS[control](position))


def false_results(position: Position) -> Iterator[dict[str, Any]]:
    """Results that differ from what a node has computed."""
    table, name = {"frame": [0, 1], "rmse_m": [0.0, 0.0]}, position.others[0]
    paths = ("metrics", "objects", "attacks", "x", *position.files, "/dev/null", "..", "a\0b", "a\nb", "x" * 300, "")
    parts: list[dict[str, Any]] = [{"tables": {path: table}} for path in paths]
    parts += [
        {"metrics": {"frames": 666, "agents": {name: {"picture": {"fn": {"mean": 0.0}}}}}},
        {"metrics": {"frames": "many", "settled": False, "agents": 7, "driving": [None]}},
        {"metrics": {"frames": 1 << 63, "agents": {}, "settled": False}},
        {"recorded": {"messages": _BILLION, "lost": 0, "problem": f"\x1b]0;{MARKER}\x07[/red]", "disk_full": True}},
        {"recorded": {"messages": 7, "problem": "forged"}},
        {"collation": {"batches": _BILLION, "late": dict.fromkeys(position.others, _BILLION)}},
        {"tables": {"x": {f"c{i}": [1] for i in range(2000)}}},
        {"tables": {"x": {"a": ["x" * 100_000, *[""] * 20_000]}}},
        {"tables": {"x": {"a": [[1], {"b": None}], "b": [1, "2"]}}},
        {"tables": {f"t{i}": table for i in range(150)}},
        {"tables": [table], "selected": -1, "placed": "all"},
        {"x": np.zeros((1 << 24, 0))},
        {"x": np.zeros(1 << 22, np.uint8)},
        {"x": np.array(["x" * 100_000, *[""] * 20_000], object)},
        {"x" * (1 << 20): list(range(1 << 16))},
        {"x": float("nan"), "y": float("inf"), "z": (1 << 64) - 1, "[/red]": "\x1b[2J\u202e"},
        _nested(20),
    ]
    for part in parts:
        yield RESULT | {"results": part}
    for failure in _failures():
        yield RESULT | {"failures": [failure]}
    keys = [*(f"counts/{other}" for other in position.others), "epoch", "stop", "result/*"]
    yield RESULT | {"invalid": {key: [_BILLION, f"forged by {name}"] for key in keys}}
    yield RESULT | {"foreign": dict.fromkeys((*position.foreign, "x" * 100_000), _BILLION)}
    yield RESULT | {"rejected": {f"{key}: forged": _BILLION for key in position.foreign}}
    yield RESULT | {"rejected": {"clock: forged": 1, "": _LATE}, "first_rejected": {}}
    yield RESULT | {"unsigned": _BILLION}
    yield RESULT | {"rejected": {}, "foreign": {}, "invalid": {}, "first_rejected": {}, "arrived_ns": {"": {}}}
    yield RESULT | {"first_rejected": {key: [-1, f"forged by {name}"] for key in position.foreign}}
    yield RESULT | {"arrived_ns": {key: {0: _LATE} for key in (*position.subscribes, *position.foreign)}}
    yield RESULT | {"process": f"../{MARKER}", "last_frame": _LATE, "cpu_s": -1e15}
    yield RESULT | {"clock": {"offset_ms": -1e12, "round_trip_ms": -1e12}, "versions": {"[/red]": "\x1b[2J"}}
    for field in ("stop_reason", "frames", "wall_s", "sent_ns", "churn"):  # fields of the driver alone
        yield RESULT | {field: "implausible: " + name}


def false_counts(position: Position) -> Iterator[list[Any]]:
    """Counters of the first epochs, with the node's own keys and with others."""
    for epoch in (1, 2, _BILLION):
        yield [epoch, {}, {}]
        for keys in (position.publishes, position.subscribes, position.foreign):
            for count in (0, 3, _BILLION):
                yield [epoch, dict.fromkeys(keys, count), {}]
                yield [epoch, {}, dict.fromkeys(keys, count)]
                yield [epoch, dict.fromkeys(position.publishes, count), dict.fromkeys(position.subscribes, count)]


def _nested(depth: int) -> dict[str, Any]:
    value: dict[str, Any] = {}
    for _ in range(depth):
        value = {"x": [value]}
    return value


def _failures() -> Iterator[dict[str, Any]]:
    for handler in ("start", "finish", "on_nothing", "", f"../{MARKER}", "[/red]", "x" * 300):
        yield FAILURE | {"handler": handler}
    for exception in ("DiskFull: no room", "StartError: forged", "\x1b]0;forged\x07", "[/red][link=file:///]", ""):
        yield FAILURE | {"exception": exception}
    yield FAILURE | {"handler": "start", "exception": "DiskFull: forged"}
    yield FAILURE | {"count": _LATE, "frames": _LATE, "first_frame": -1, "last_frame": _LATE}
    yield FAILURE | {"where": "\x1b[2J" * 1000}


def _epoch(position: Position) -> Iterator[Any]:
    strangers = {"stranger": "agent", position.driver: "agent"}
    for number in (1, 2, 3, (1 << 32) - 1):
        for members in ({}, {position.node: "agent"}, strangers, dict(list(position.roles.items())[:-1])):
            yield [number, members, None]
        yield [number, position.roles, [{"wires": [], "overhearers": []}, True, list(position.others)]]


def _failed(position: Position) -> Iterator[Any]:
    for process, failure in enumerate(_failures()):
        yield [f"{process:016x}", failure]


def _stop(position: Position) -> Iterator[Any]:
    accusation = f"{position.others[0]} reports {_BILLION} messages of {position.driver} handled on clock"
    yield from (
        "",
        "end",
        "interrupted",
        f"implausible: {accusation}",
        "stall: forged",
        "start: forged",
        "\x1b[2J",
        MARKER,
    )


def _leave(position: Position) -> Iterator[Any]:
    yield from ("leave", "", "released", "\0")


def _act(position: Position) -> Iterator[Any]:
    for frame in (0, 1, 3, _LATE):
        for action in ("kill", "leave", "pause", "disconnect"):
            yield [frame, [[action, name] for name in (*position.others, position.driver)]]
        yield [frame, [["start", "stranger"], ["start", position.node]]]
    yield [1, [["kill", name] for name in position.others] * 100]


def _fetch(position: Position) -> Iterator[Any]:
    yield {"do": "clock"}
    for version in (position.version, "0.0.0 (sources forged)", "", f"\x1b[2J[/red]{position.version}"):
        yield {"do": "join", "version": version, "versions": {}}
    yield {"do": "join", "version": position.version, "versions": {f"p{i}": "x" * 300 for i in range(100)}}
    for path in (*position.files, "/etc/passwd", "../../../../../../etc/passwd", "files/0/../../x", "", "a\0b"):
        for offset in (0, 1, _LATE):
            yield {"do": "piece", "path": path, "offset": offset}


def _file(position: Position) -> Iterator[Any]:
    for path in (*position.files, "", "a\0b", f"results/{EVALUATOR}/results.json", ".reserve", "control.key"):
        for offset in (0, 1, _LATE):
            yield {"path": path, "offset": offset, "piece": MARKER.encode()}
    yield {"path": f"../{MARKER}", "offset": 0, "piece": bytes(1 << 20)}


def _drain(position: Position) -> Iterator[Any]:
    yield from (*position.subscribes, *position.foreign, "@control/stop", "..")


def _rewire(position: Position) -> Iterator[Any]:
    own = position.wiring
    empty: dict[str, Any] = {"wires": [], "overhearers": []}
    tapped = own | {"overhearers": [*own["overhearers"], {"node": position.node, "port": "everything"}]}
    for wiring in (own, empty, tapped):
        for leave in ([], [position.driver], list(position.others)):
            yield {"wiring": wiring, "join": {}, "leave": leave}
    yield {"wiring": own, "join": {"stranger": "adversary"}, "leave": []}


def _intercept(position: Position) -> Iterator[Any]:
    spec = {"file": f"/tmp/{MARKER}.py", "type": "Forged", "role": "adversary", "config": {}, "on_exit": "fail"}
    place = {"wire": "clock", "input": "in", "output": "out", "hears": {}, "says": []}
    intercept = {"do": "intercept", "number": "1", "name": MARKER, "spec": spec, "place": place, "modules": []}
    release = {"do": "release", "number": "2", "name": position.others[0], "wire": None}
    for request in (intercept, release):
        for digest in (b"", bytes(32), b"\xff" * 32, MARKER.encode()):
            yield [msgpack.packb(request), digest]


_GENERATORS: dict[str, Callable[[Position], Iterator[Any]]] = {
    "counts": false_counts,
    "epoch": _epoch,
    "failed": _failed,
    "stop": _stop,
    "leave": _leave,
    "act": _act,
    "result": false_results,
    "fetch": _fetch,
    "file": _file,
    "drain": _drain,
    "rewire": _rewire,
    "intercept": _intercept,
}

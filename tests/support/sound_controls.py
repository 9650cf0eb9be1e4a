"""A sound example of every kind of control message, and what decodes it."""

from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np
from insider.position import FAILURE, RESULT

from mast_zenoh.mesh.control import codec, failures, files, flow, interception, results
from mast_zenoh.wiring.model import Endpoint, Leg, Listener, Wire, Wiring

TAP = "agent/ego/tracks/@tap/0"
WIRING = Wiring(
    (
        Wire("clock", "", "clock", (Leg("clock", Endpoint("simulator", "clock"), (Endpoint("ego", "clock"),)),)),
        Wire(
            "agent/ego/tracks",
            "ego",
            "tracks",
            (
                Leg(TAP, Endpoint("ego", "tracks"), (Endpoint("eve", "tracks"),)),
                Leg("agent/ego/tracks", Endpoint("eve", "tracks_out"), (Endpoint("broker", "tracks"),)),
            ),
            (),
            (Listener(Endpoint("spy", "tracks"), True),),
        ),
    ),
    (Endpoint("recorder", "everything"),),
)
MEMBERS = {"simulator": "simulator", "ego": "agent"}
PLACE = {"wire": "clock", "input": "in", "output": "out", "hears": {"clock": "clock"}, "says": []}
SPEC = {"file": "/a/eve.py", "type": "Eve", "role": "adversary", "config": {"gain": 2.0}, "on_exit": "continue"}
INTERCEPT = {"do": "intercept", "number": "ab", "name": "eve", "spec": SPEC, "place": PLACE, "modules": ["/a/lies.py"]}
#: The results of a node, one of whose handlers failed.
OUTCOME = RESULT | {
    "results": {"n": 1, "tables": {"mine": {"a": np.arange(3), "b": np.array(["x", "y", "z"])}}},
    "failures": [FAILURE],
}
#: The results of the node that drives the scene.
DRIVEN = OUTCOME | {
    "frames": 12,
    "wall_s": 1.5,
    "stop_reason": "end",
    "sent_ns": {0: 1_700_000_000_000_000_000},
    "churn": [],
}


def asked(payload: bytes) -> Any:
    return interception.request_of(codec.decode(dict[str, Any], payload, "intercept"))


def answered(kind: type[Any]) -> Callable[[bytes], Any]:
    return lambda payload: files.decode_answer(kind, payload)


def packed(value: Any) -> bytes:
    return bytes(msgpack.packb(value))


#: By name a decoder, and a sound message for it.
CODECS: dict[str, tuple[Callable[[bytes], Any], bytes]] = {
    "counts": (flow.decode_counts, flow.encode_counts(1, {"clock": 3}, {TAP: 3})),
    "epoch": (flow.decode_epoch, flow.encode_epoch(1, MEMBERS, None)),
    "epoch with a wiring": (
        flow.decode_epoch,
        flow.encode_epoch(2, MEMBERS, flow.WiringUpdate(WIRING, True, ("eve",))),
    ),
    "act": (flow.decode_act, flow.encode_act(7, [("kill", "ego"), ("start", "eve")])),
    "stop": (flow.decode_stop, b"end"),
    "drain": (flow.decode_drain, TAP.encode()),
    "rewire": (flow.decode_rewire, flow.encode_rewire(WIRING, {"eve": "adversary"}, ["spy"])),
    "rewired": (flow.decode_rewired, codec.encode(flow.Rewired(frame=7, took_ms=1.5))),
    "not rewired": (flow.decode_rewired, codec.encode(flow.Rewired(error="eve has not joined"))),
    "join": (files.decode_fetch, packed({"do": "join", "version": "1.0", "versions": {"numpy": "2.0"}})),
    "clock": (files.decode_fetch, packed({"do": "clock"})),
    "piece": (files.decode_fetch, packed({"do": "piece", "path": "scenario.json", "offset": 0})),
    "file": (files.decode_file, packed({"path": "messages.mcap", "offset": 0, "piece": b"abc"})),
    "belongings": (answered(files.NodeFiles), packed({"files": {"scenario.json": 17}, "written": ["messages.mcap"]})),
    "clock's answer": (answered(files.LauncherTime), packed({"now_ns": 1_700_000_000_000_000_000})),
    "piece's answer": (answered(files.Content), packed({"piece": b"abc"})),
    "file's answer": (answered(files.Nothing), packed({})),
    "description": (files.decode_description, files.encode_description("run-1", {"a": 1}, {}, b"npz")),
    "failed": (failures.decode_failure, failures.encode_failure("0123", FAILURE)),
    "result": (lambda payload: results.decode_result(payload, "ego", drives=False), results.pack(OUTCOME)),
    "driver's result": (lambda payload: results.decode_result(payload, "sim", drives=True), results.pack(DRIVEN)),
    "intercept": (asked, packed(INTERCEPT)),
    "release": (asked, packed({"do": "release", "number": "ab", "name": None, "wire": "clock"})),
    "intercepted": (
        interception.answer_of,
        packed({"action": "intercept", "node": "eve", "wires": ["clock"], "frame": 7, "took_ms": 1.5}),
    ),
    "sealed": (interception.sealed_parts, packed([b"body", b"digest"])),
}

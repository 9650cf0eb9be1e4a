"""Decoders of control messages return a valid value or raise MessageError."""

import json
import subprocess
import sys
import tracemalloc
from functools import cache
from typing import Any

import msgpack
import numpy as np
import pytest
from damage import damaged
from hypothesis import given
from hypothesis import strategies as st
from insider.forgeries import MALFORMED, forgeries, refused
from insider.position import FAILURE, Position, position
from sound_controls import CODECS, DRIVEN, MEMBERS, OUTCOME, TAP, WIRING, packed

from mast_zenoh import scenario, version
from mast_zenoh.errors import MessageError, RunError
from mast_zenoh.mesh.control import CONTROLS, failures, files, flow, results
from mast_zenoh.mesh.control.results import PartedTables, TablePart
from mast_zenoh.wiring.model import Wiring

every_codec = pytest.mark.parametrize("name", CODECS)
ANYTHING = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(1 << 63), (1 << 64) - 1)
    | st.floats()
    | st.text(max_size=8)
    | st.binary(max_size=8)
    | st.sampled_from(["ego", "clock", "agent/ego/tracks", "kill", "../x", "a/**", b"\xff"]),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6) | st.integers(0, 9), inner, max_size=4)
    ),
    max_leaves=8,
)


def decoded_or_refused(name: str, payload: bytes) -> None:
    """Decode a payload; any error but MessageError fails the test."""
    message = ""
    try:
        CODECS[name][0](payload)
    except MessageError as error:
        message = str(error)
    assert len(message) < 1000, "errors never quote the whole payload"


@every_codec
def test_a_valid_message_is_decoded(name: str) -> None:
    decode, payload = CODECS[name]
    decode(payload)


def test_decoding_inverts_encoding() -> None:
    assert flow.decode_counts(CODECS["counts"][1]) == (1, {"clock": 3}, {TAP: 3})
    epoch = flow.decode_epoch(CODECS["epoch with a wiring"][1])
    assert epoch == (2, MEMBERS, (WIRING, True, ("eve",)))
    assert flow.decode_act(CODECS["act"][1]) == (7, (("kill", "ego"), ("start", "eve")))
    assert flow.decode_rewire(CODECS["rewire"][1]) == (WIRING, {"eve": "adversary"}, ("spy",))
    assert files.decode_fetch(CODECS["piece"][1]) == files.Piece("scenario.json", 0)
    assert failures.decode_failure(CODECS["failed"][1]) == ("0123", FAILURE)
    assert results.decode_result(CODECS["driver's result"][1], "sim", drives=True)["stop_reason"] == "end"
    refusal = files.decode_refusal(files.encode_refusal(RunError("no")))
    assert (type(refusal), str(refusal)) == (RunError, "no")


def test_the_wirings_of_shipped_scenarios_are_accepted() -> None:
    for name in ("baseline", "coordinated", "downlink"):
        wiring = json.loads(json.dumps(scenario.resolve(*scenario.load(name, []), frames=2).wiring))
        assert flow.wiring_of(wiring, "wiring") == Wiring.from_json(wiring)


@every_codec
@given(seed=st.integers(0, 1 << 32))
def test_a_damaged_message_is_decoded_or_refused(name: str, seed: int) -> None:
    random = np.random.default_rng(seed)
    for _ in range(5):
        decoded_or_refused(name, damaged(CODECS[name][1], random))


@every_codec
@given(value=ANYTHING)
def test_any_value_is_decoded_or_refused(name: str, value: Any) -> None:
    decoded_or_refused(name, packed(value))


def without(name: str) -> dict[str, Any]:
    return {key: value for key, value in OUTCOME.items() if key != name}


@pytest.mark.parametrize(
    ("name", "payload"),
    [
        ("counts", packed([1, {}, {}, {}])),
        ("counts", packed([0, {}, {}])),
        ("counts", packed([1 << 32, {}, {}])),
        ("counts", packed([1, {"clock": -1}, {}])),
        ("counts", packed([1, {"clock": 1 << 62}, {}])),
        ("counts", packed([1, {"clock": True}, {}])),
        ("counts", packed([1, {"clock": 1.0}, {}])),
        ("counts", packed([1, {b"clock": 1}, {}])),
        ("counts", packed([1, {"x" * CONTROLS["counts"].max_bytes: 1}, {}])),
        ("epoch", packed([1, {"../ego": "agent"}, None])),
        ("epoch", packed([1, {"ego": "agent"}, [{"wires": []}, True, []]])),
        ("epoch", packed([1, MEMBERS, [WIRING.to_json(), 1, []]])),
        ("epoch", packed([1, MEMBERS, [WIRING.to_json() | {"more": 1}, True, []]])),
        ("epoch", packed([1, MEMBERS, [WIRING.to_json(), True, ["eve", "eve"]]])),
        ("act", packed([-1, [["kill", "ego"]]])),
        ("act", packed([1, [["kick", "ego"]]])),
        ("act", packed([1, [["kill", "ego", 1]]])),
        ("stop", b"\xff\xfe"),
        ("stop", b"x" * 5000),
        ("drain", b"\xff"),
        ("drain", b"agent/**"),
        ("drain", b""),
        ("join", packed({"do": "join", "version": 1, "versions": {}})),
        ("piece", packed({"do": "piece", "path": "a", "offset": float("inf")})),
        ("piece", packed({"do": "piece", "path": "a", "offset": -1})),
        ("piece", packed({"do": "piece", "path": "a", "offset": 0, "more": 0})),
        ("file", packed({"path": "a", "offset": 0, "piece": "text"})),
        ("file", packed({"path": "a", "offset": 0, "piece": bytes(files.PIECE_BYTES + 1)})),
        ("failed", packed(["a", FAILURE | {"count": 0}])),
        ("failed", packed(["a", FAILURE | {"exception": "x" * 301}])),
        ("result", results.pack(OUTCOME | {"stop_reason": "stall: no"})),
        ("result", results.pack(OUTCOME | {"sent_ns": {}})),
        ("result", results.pack(OUTCOME | {"cpu_s": float("nan")})),
        (
            "result",
            results.pack(OUTCOME | {"invalid": {"counts/other": [1, "what the driver alone can have refused"]}}),
        ),
        ("result", results.pack(OUTCOME | {"invalid": {"leave/other": [1, "x"]}})),
        ("result", results.pack(OUTCOME | {"foreign": {"x" * 5000: 1}})),
        ("result", results.pack(OUTCOME | {"rejected": {"x" * 5000: 1}})),
        *(("result", results.pack(OUTCOME | {name: np.arange(3.0)})) for name in ("rejected", "foreign", "arrived_ns")),
        ("rewired", packed({})),
        ("rewired", packed({"frame": 7, "took_ms": 1.5, "error": "eve"})),
        ("rewired", packed({"do": "Rewired", "frame": 7})),
        ("result", results.pack(OUTCOME | {"rejected": {"x": "1"}})),
        ("result", results.pack(OUTCOME | {"rejected": {"x: y\nerror: not this one": 1}})),
        ("result", results.pack(OUTCOME | {"first_rejected": {"clock": [1, "x\nerror: not this one"]}})),
        ("result", results.pack(OUTCOME | {"invalid": {"epoch": [1, "x\nerror: not this one"]}})),
        ("result", results.pack(OUTCOME | {"foreign": {"x\u2028y": 1}})),
        ("result", results.pack(OUTCOME | {"clock": {"offset_ms": 1e300, "round_trip_ms": 1.0}})),
        ("result", results.pack(without("results"))),
        ("result", results.pack(OUTCOME | {"results": {float("nan"): 1}})),
        ("driver's result", results.pack(OUTCOME)),
        ("driver's result", results.pack(DRIVEN | {"wall_s": "fast"})),
    ],
)
def test_out_of_range_values_and_too_many_values_are_refused(name: str, payload: bytes) -> None:
    with pytest.raises(MessageError):
        CODECS[name][0](payload)


def nested(depth: int) -> Any:
    value: Any = []
    for _ in range(depth):
        value = [value]
    return value


def bomb(shape: list[int], dtype: str = "<f8", raw: bytes = b"") -> msgpack.ExtType:
    return msgpack.ExtType(1, packed([dtype, shape, raw]))


@pytest.mark.parametrize(
    "value",
    [
        nested(40),
        nested(1500),
        [[0] * 1000 for _ in range(1100)],
        bomb([1 << 40, 0]),
        bomb([-1], raw=bytes(8)),
        bomb([1], "|O", bytes(8)),
        bomb([1], "<M8[s]", bytes(8)),
        bomb([1], "<f8,<f8", bytes(16)),
        bomb([1], "nonsense", bytes(8)),
        bomb([1], "a8", bytes(8)),
        bomb([1], "d", bytes(8)),
        bomb([1] * 40, raw=bytes(8)),
        msgpack.ExtType(2, packed([1, 2])),
        msgpack.ExtType(2, packed(7)),
        msgpack.ExtType(9, b""),
    ],
)
def test_results_that_are_too_large_or_not_plain_are_refused(value: Any) -> None:
    try:
        payload = msgpack.packb(OUTCOME | {"results": {"x": value}}, default=results.encode_extension)
    except ValueError:  # deeper than msgpack packs, so packed by hand
        payload = results.pack(OUTCOME | {"results": {"x": "here"}}).replace(b"\xa4here", b"\x91" * 1500 + b"\x90")
    with pytest.raises(MessageError):
        results.decode_result(payload, "ego", drives=False)


def test_a_long_table_of_any_node_comes_in_parts() -> None:
    table = {"x": np.zeros(results.MAX_RESULT // 8)}
    payload = results.pack(OUTCOME | {"results": {"tables": {"t": table}}})
    for node in ("ego", results.EVALUATOR):
        with pytest.raises(MessageError, match="expected at most"):
            results.decode_result(payload, node, drives=False)
    parts, tables = list[TablePart](), PartedTables()
    tables.hand_in = parts.append
    tables.append("t", table)
    tables.close({})
    received = [results.decode_part(results.encode_part("p", part))[1] for part in parts]
    assert sum(len(part.columns["x"]) for part in received) == len(table["x"])


@pytest.mark.parametrize(
    "payload",
    [
        results.pack(["p", "t", 0]),
        results.pack(["p", "t", -1, {"x": np.zeros(1)}]),
        results.pack(["p", "../t", 0, {"x": np.zeros(1)}]),
        results.pack(["p", "t", 0, {"x": np.zeros(1), "y": np.zeros(2)}]),
        results.pack(["p", "t", 0, {"x": [[1], [1, 2]]}]),
        results.pack(["p", "t", 0, {1: np.zeros(1)}]),
        results.pack(["p", "t", 0, 7]),
        b"\x94",
    ],
)
def test_a_malformed_part_of_a_table_is_refused(payload: bytes) -> None:
    with pytest.raises(MessageError):
        results.decode_part(payload)


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6, dtype=np.int64).reshape(2, 3),
        np.zeros((0, 3)),
        np.array([[1.5, np.nan], [np.inf, -0.0]]),
        np.array([True, False]),
        np.arange(6).reshape(2, 3).T,
    ],
)
def test_arrays_keep_values_dtype_and_shape(array: np.ndarray) -> None:
    back = results.unpack(results.pack({"table": array}))["table"]
    np.testing.assert_array_equal(back, array)
    assert back.dtype == array.dtype
    assert back.shape == array.shape


@pytest.mark.parametrize(
    "array", [np.array(["ego", "é"], dtype=object), np.array(["ego", "infra_1"]), np.array([], str)]
)
def test_text_arrays_become_object_arrays(array: np.ndarray) -> None:
    back = results.unpack(results.pack(array))
    assert back.dtype == object
    assert back.tolist() == array.tolist()


def test_nested_plain_values_are_unchanged() -> None:
    value = {
        "metrics": {"mean": 1.25, "n": 3, "none": None, "yes": True, "rows": [1, [2.0, "x"]], "empty": {}},
        7: "seven",
    }
    assert results.unpack(results.pack(value)) == value


def test_numpy_numbers_become_plain_numbers() -> None:
    back = results.unpack(results.pack({"n": np.int64(3), "x": np.float64(0.5), "yes": np.bool_(True)}))
    assert back == {"n": 3, "x": 0.5, "yes": True}
    assert [type(value) for value in back.values()] == [int, float, bool]


def test_other_values_are_refused_with_their_type() -> None:
    with pytest.raises(TypeError, match=r"result.*values.*arrays"):
        results.pack({"names": {"ego"}})


def test_arrays_have_at_most_eight_dimensions() -> None:
    assert results.unpack(results.pack(np.zeros((1,) * 8))).shape == (1,) * 8
    with pytest.raises(MessageError):
        results.unpack(results.pack(np.zeros((1,) * 9)))


@pytest.mark.parametrize(
    "array", [np.zeros((1 << 24, 0)), np.zeros(1 << 21, bool), np.array(["x"] * (1 << 21), object)]
)
def test_large_arrays_are_allowed_only_in_tables(array: np.ndarray) -> None:
    results.checked({"tables": {"t": {"x": array}}})
    with pytest.raises(TypeError, match="outside tables"):
        results.checked({"x": [{"y": array}]})


def test_the_place_of_an_invalid_value_is_reported_and_shortened() -> None:
    with pytest.raises(TypeError, match=r"^results\.a\.1\.b.*plain values"):
        results.checked({"a": [0, {"b": {1}}]})
    results.checked({"x" * (1 << 20): {"y" * (1 << 20): list(range(1 << 17))}})  # as many names of 2 MB would be 256 GB
    with pytest.raises(TypeError) as caught:
        results.checked({"x" * (1 << 20): [{1}]})
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("kind", flow.StopKind)
def test_the_reason_of_a_stop_is_read_as_it_was_written(kind: flow.StopKind) -> None:
    reason = flow.StopReason(kind, "" if kind is flow.StopKind.END else "ego: late")
    assert flow.decode_reason(flow.encode_reason(reason)) == reason


FIRST_USES = """
from __future__ import annotations
import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from mast_zenoh.mesh.control.codec import ControlMessage, converted

def new_types():
    class Part(ControlMessage, frozen=True):
        numbers: list[int]
        by_name: dict[str, int]
    class Whole(ControlMessage, frozen=True):
        part: Part
        parts: list[Part]
        rate: float
    sys.modules[__name__].Part = Part
    return Whole

def convert(whole, start):
    start.wait(10)
    for _ in range(20):
        converted(value, whole, "test")

sys.setswitchinterval(1e-6)
part = {"numbers": [1], "by_name": {"one": 1}}
value = {"part": part, "parts": [part], "rate": 1.0}
with ThreadPoolExecutor(4) as threads:
    for _ in range(300):
        whole, start = new_types(), Barrier(4)
        for result in [threads.submit(convert, whole, start) for _ in range(4)]:
            result.result()
"""


def test_threads_can_decode_their_first_message_of_a_type_at_the_same_time() -> None:
    # In another process: what this guards against is a crash.
    ended = subprocess.run([sys.executable, "-c", FIRST_USES], capture_output=True, text=True, timeout=60)
    assert ended.returncode == 0, ended.stderr


@cache
def standing(node: str = "infra_1") -> Position:
    path, loaded = scenario.load("coordinated", ["n_infrastructure=2"])
    return position(scenario.resolve(path, loaded, frames=2, record=True), node, version.version_string())


@pytest.mark.heavy
@pytest.mark.parametrize("control", CONTROLS)
def test_payloads_that_unpack_to_far_more_use_little_memory(control: str) -> None:
    messages = [each for each in forgeries(control, standing(), 200) if each.defect == MALFORMED]
    heavy = sorted((each.payload for each in messages), key=len)[-5:]
    tracemalloc.start()
    try:
        for payload in heavy:
            assert refused(control, "infra_1", payload)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 96 << 20, "from payloads of at most 8 MiB"

"""Encoding and decoding keep messages unchanged; anything else is refused."""

import warnings
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import msgpack
import numpy as np
import pytest
from damage import damaged
from hypothesis import given, settings
from hypothesis import strategies as st

from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.errors import MessageError
from mast_zenoh.integrity.views import collated_columns
from mast_zenoh.messages import codec, layout
from mast_zenoh.messages.layout import BodyLayout
from mast_zenoh.messages.schemas import SCHEMAS, Column, Header, Message, text

finite = st.floats(-1e5, 1e5)


def column_of(column: Column, sizes: dict[str, int], rng: np.random.Generator) -> np.ndarray:
    """Valid values for a column."""
    shape = tuple(sizes[size] if isinstance(size, str) else size for size in column.shape)
    if column.dtype == "str":
        return text([f"agent_{i}" for i in range(shape[0])])
    if column.name == "covariance" and shape[-1] == 9:
        root = rng.normal(size=shape)
        return root @ np.swapaxes(root, -1, -2) + 9 * np.eye(9)
    if column.name == "id":
        return rng.permutation(10 * shape[0] + 1)[: shape[0]].astype(np.int64)
    if column.name == "agent":
        return rng.integers(0, sizes["a"], shape)
    if column.name == "trust":
        return rng.random(shape)
    if column.dtype == "float64":
        return rng.normal(size=shape) * 100
    return rng.integers(0, min(3, column.below), shape).astype(column.dtype)


def message_of(schema: str, sizes: dict[str, int], seed: int = 0) -> Message:
    """A valid message of a schema."""
    rng = np.random.default_rng(seed)
    body = {column.name: column_of(column, sizes, rng) for column in SCHEMAS[schema].columns}
    return codec.conform(Header(schema, "someone", 3, 300_000_000, 7), body)


@pytest.mark.parametrize("schema", sorted(SCHEMAS))
@given(n=st.integers(0, 12), a=st.integers(1, 5), m=st.integers(0, 3), k=st.integers(0, 3), seed=st.integers(0, 99))
@settings(max_examples=15)
def test_every_message_is_unchanged_by_encoding_and_decoding(schema, n, a, m, k, seed) -> None:
    message = message_of(schema, {"n": n, "a": a, "m": m, "k": k}, seed)
    codec.check_values(message)
    payload = codec.encode(message)
    decoded = codec.decode(payload, schema)
    assert decoded.header == message.header
    assert decoded.body.keys() == message.body.keys()
    for name, column in message.body.items():
        np.testing.assert_array_equal(decoded.body[name], column)
        assert decoded.body[name].dtype == column.dtype
    assert codec.encode(decoded) == payload


@pytest.mark.parametrize("schema", sorted(SCHEMAS))
@pytest.mark.parametrize("n", [0, 2, 40, 1500])  # data with a length of 1, 2 and 4 bytes
def test_a_message_is_what_messagepack_makes_of_its_fields(schema: str, n: int) -> None:
    header, body = message = message_of(schema, {"n": n, "a": 3, "m": 2, "k": 2})
    wire = {"float64": "<f8", "float32": "<f4", "int64": "<i8", "int32": "<i4", "uint8": "|u1", "str": "str"}
    columns = {
        column.name: [wire[column.dtype], list(array.shape), list(array) if column.dtype == "str" else array.tobytes()]
        for column, array in zip(SCHEMAS[schema].columns, body.values(), strict=True)
    }
    fields = {"schema": schema, "version": SCHEMAS[schema].version, **dict(list(header._asdict().items())[1:])}
    assert codec.encode(message) == msgpack.packb(fields | {"body": columns})


def test_whole_numbers_of_an_equal_type_are_sent_as_int64() -> None:
    body = {**message_of("status", {}).body, "tracks": np.array([4], np.longlong)}
    sent = codec.conform(Header("status", "someone", 0, 0, 0), body)
    assert sent.body["tracks"].dtype.num == np.dtype(np.int64).num
    assert sent.body["tracks"].tolist() == [4]


def test_messages_are_split_after_any_number_of_others_with_other_lengths(monkeypatch) -> None:
    monkeypatch.setattr(layout, "_MAX_PLANS", 3)
    payloads = [codec.encode(message_of("picture", {"n": n})) for n in range(8)]
    for payload in payloads + payloads[-1:]:
        codec.decode(payload, "picture")
    monkeypatch.setattr(BodyLayout, "unpack", lambda *_: pytest.fail("not split"))
    codec.decode(payloads[-1], "picture")


def test_a_number_that_is_a_signalling_nan_is_refused_without_a_warning() -> None:
    message = message_of("points", {"n": 3})
    position = message.body["position"].tobytes()
    payload = codec.encode(message).replace(position, b"\x01\x00\x80\x7f" + position[4:])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(MessageError, match="not finite"):
            codec.decode(payload, "points")


@given(seed=st.integers(0, 1 << 32))
def test_a_damaged_message_is_refused_or_still_valid(seed: int) -> None:
    random = np.random.default_rng(seed)
    for _ in range(5):
        payload = damaged(codec.encode(message_of("detections", {"n": 3})), random)
        try:
            message = codec.decode(payload, "detections")
        except MessageError:
            continue
        codec.check_values(message)
        assert codec.decode(codec.encode(message), "detections").header == message.header
        for name, column in message.body.items():
            if column.dtype == np.float64:
                assert np.isfinite(column).all(), name


def outcome(payload: bytes) -> tuple | str:
    """What comes of a message, of detections."""
    try:
        header, body = codec.decode(payload, "detections")
    except MessageError as error:
        return str(error)
    return header, [(name, column.shape, column.dtype, column.tobytes()) for name, column in body.items()]


@given(place=st.integers(0, 700), value=st.integers(0, 255), copies=st.sampled_from([0, 1, 2]))
def test_a_message_means_the_same_whether_one_of_its_length_was_decoded_before(place, value, copies) -> None:
    payload = bytearray(codec.encode(message_of("detections", {"n": 3})))
    payload[place : place + 1] = bytes([value]) * copies
    message = bytes(payload)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BodyLayout, "split", lambda *_: None)
        expected = outcome(message)
    outcome(codec.encode(message_of("detections", {"n": 3}, seed=1)))
    assert outcome(message) == expected


@pytest.mark.parametrize("cut", [0, 1, 10, 100, -1])
def test_a_truncated_message_is_refused(cut: int) -> None:
    payload = codec.encode(message_of("picture", {"n": 4}))
    with pytest.raises(MessageError):
        codec.decode(payload[:cut], "picture")


def changed(schema: str, change) -> bytes:
    """The bytes of a valid message after a change of its unpacked form."""
    fields = msgpack.unpackb(codec.encode(message_of(schema, {"n": 3, "a": 2})))
    change(fields)
    return msgpack.packb(fields)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda f: f.update(version=2), "tracks version 1"),
        (lambda f: f.update(schema="picture"), "expected tracks"),
        (lambda f: f.update(frame=-1), "frame"),
        (lambda f: f.update(frame=True), "frame"),
        (lambda f: f.update(seq=2**63), "seq"),
        (lambda f: f.update(source="x" * 300), "source"),
        (lambda f: f.update(extra=1), r"not.*map"),
        (lambda f: f["body"].pop("yaw"), "missing: \\['yaw'\\]"),
        (lambda f: f["body"].update(more=["<f8", [0], b""]), "unknown: \\['more'\\]"),
        (lambda f: f["body"].update(yaw=["<f4", [3], bytes(12)]), "dtype"),
        (lambda f: f["body"].update(yaw=["<f8", [4], bytes(32)]), "shape"),
        (lambda f: f["body"].update(yaw=["<f8", [3], bytes(16)]), "fill"),
        (lambda f: f["body"].update(yaw=["<f8", [-3], bytes(24)]), "shape"),
        (lambda f: f["body"].update(yaw=["<f8", [10**9], b""]), "shape"),
        (lambda f: f["body"].update(yaw=["<f8", [3], np.array([0, np.nan, 0]).tobytes()]), "not finite"),
        (lambda f: f["body"].update(yaw=["<f8", [3], np.array([0, np.inf, -np.inf]).tobytes()]), "not finite"),
        (lambda f: f["body"].update(yaw=["<f8", [3], np.array([0, 1e300, 0]).tobytes()]), "beyond"),
        (lambda f: f["body"].update(class_id=["|u1", [3], bytes([0, 1, len(CLASSES)])]), "index"),
        (lambda f: f["body"].update(id=["<i8", [3], np.array([4, 4, 5]).tobytes()]), "twice"),
    ],
)
def test_an_invalid_message_is_refused_with_its_fault(change, reason: str) -> None:
    with pytest.raises(MessageError, match=reason):
        codec.decode(changed("tracks", change), "tracks")


def test_a_reference_to_a_missing_row_is_refused() -> None:
    with pytest.raises(MessageError, match="outside `agents`"):
        codec.decode(
            changed("collated", lambda f: f["body"].update(agent=["<i8", [3], np.array([0, 1, 2]).tobytes()])),
            "collated",
        )


def test_an_oversized_message_is_refused_before_decoding() -> None:
    for decode in (codec.decode, codec.decode_lazily):
        with pytest.raises(MessageError, match="at most"):
            decode(bytes(codec.MAX_BYTES + 1), "clock")


def test_a_node_cannot_send_a_column_of_the_wrong_shape() -> None:
    sound = message_of("tracks", {"n": 3})
    with pytest.raises(MessageError, match=r"tracks\.yaw: shape \(2,\)"):
        codec.conform(sound.header, {**sound.body, "yaw": np.zeros(2)})
    with pytest.raises(MessageError, match="missing"):
        codec.conform(sound.header, {})


@pytest.mark.parametrize(
    ("column", "value", "reason"),
    [
        ("agents", ["ego"], r"collated.agents.*list.*text\(...\)"),
        ("position", [[1.0], [2.0, 3.0]], "collated.position: .*inhomogeneous"),
    ],
)
def test_a_list_in_place_of_an_array_is_refused_by_its_column(column: str, value: object, reason: str) -> None:
    message = message_of("collated", {"n": 2, "a": 2})
    with pytest.raises(MessageError, match=reason):
        codec.conform(message.header, {**message.body, column: value})


def test_a_message_of_no_views_is_valid_and_each_quaternion_of_several_is_checked() -> None:
    header = Header("views", "broker", 3, 0, 3)
    for turns, valid in (([], True), ([[1.0, 0, 0, 0]], True), ([[1.0, 0, 0, 0], [0.0, 0, 0, 0]], False)):
        bodies = [
            {
                "position": np.zeros(3),
                "rotation": np.array(turn),
                "azimuth": np.array([0.0, 1.0]),
                "elevation": np.array([0.0, 1.0]),
                "max_range": np.array([50.0]),
                "free": np.zeros((0, 0)),
            }
            for turn in turns
        ]
        names = text([f"agent_{row}" for row in range(len(turns))])
        columns = {"agents": names, "age_ns": np.zeros(len(turns), np.int64), **collated_columns(bodies)}
        with nullcontext() if valid else pytest.raises(MessageError, match=r"views.rotation.*quaternion.*length"):
            payload = codec.encode(codec.conform(header, columns))
            assert len(codec.decode(payload, "views").body["rotation"]) == len(turns)


# -- lazily: the header is checked at once, the body on first access ---------------------------------------------------

BODY = {"mobile": np.array([1], np.uint8), "detections": np.array([3]), "tracks": np.array([2])}


def encoded(**header: object) -> bytes:
    fields = dict(schema="status", source="ego", frame=3, time_ns=300, seq=4) | header
    return codec.encode(codec.conform(Header(**fields), BODY))


def test_lazy_decoding_gives_the_same_message() -> None:
    eager, lazy = (function(encoded(), "status") for function in (codec.decode, codec.decode_lazily))
    assert lazy.header == eager.header
    assert len(lazy.body) == 3
    assert {name: column.tolist() for name, column in lazy.body.items()} == {
        name: column.tolist() for name, column in eager.body.items()
    }
    assert codec.encode(lazy) == encoded()


def result_of(decode: Callable[[], Header]) -> Header | str:
    try:
        return decode()
    except MessageError as error:
        return str(error)


@given(
    frame=st.integers(-3, 1 << 63),
    time_ns=st.integers(-3, 1 << 63),
    source=st.text(max_size=20) | st.just("\xa4body") | st.just("x" * 300),
    schema=st.sampled_from(["status", "tracks", "body"]),
    version=st.sampled_from([1, 2, True, 1.0, "1"]),
    order=st.permutations(["schema", "version", "source", "frame", "time_ns", "seq", "body"]),
)
def test_headers_are_checked_as_in_full_decoding(frame, time_ns, source, schema, version, order) -> None:
    fields = dict(schema=schema, version=version, source=source, frame=frame, time_ns=time_ns, seq=0, body={})
    payload = msgpack.packb({name: fields[name] for name in order})
    lazy, full = (lambda: codec.decode_lazily(payload, "status").header), lambda: codec.decode_header(payload, "status")
    assert result_of(lazy) == result_of(full)


@given(cut=st.integers(0, 400), flip=st.integers(0, 399), bit=st.integers(0, 7))
def test_malformed_bytes_are_refused_at_once_or_on_access(cut: int, flip: int, bit: int) -> None:
    payload = bytearray(encoded())
    payload[flip % len(payload)] ^= 1 << bit
    broken = bytes(payload[: max(cut, len(payload) // 2)])
    try:
        expected = codec.decode(broken, "status")
    except MessageError:
        with pytest.raises(MessageError):
            len(codec.decode_lazily(broken, "status").body)
    else:
        message = codec.decode_lazily(broken, "status")
        assert message.header == expected.header
        assert {name: column.tobytes() for name, column in message.body.items()} == {
            name: column.tobytes() for name, column in expected.body.items()
        }


@pytest.mark.parametrize(
    ("largest", "beyond"),
    [(dict(frame=(1 << 62) - 1), dict(frame=1 << 62)), (dict(source="x" * 256), dict(source="x" * 257))],
)
def test_the_numbers_and_the_name_in_a_header_are_limited(largest: dict[str, Any], beyond: dict[str, Any]) -> None:
    assert codec.decode_header(encoded(**largest), "status")
    with pytest.raises(MessageError, match="status: "):
        codec.decode_header(encoded(**beyond), "status")

"""Lazy decoding: the header is checked at once, the body on first access."""

from __future__ import annotations

from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mast_zenoh.errors import MessageError
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header

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


def header_of(payload: bytes) -> Header | str:
    try:
        return codec.decode_header(payload, "status")
    except MessageError as error:
        return str(error)


def lazy_header_of(payload: bytes) -> Header | str:
    try:
        return codec.decode_lazily(payload, "status").header
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
@settings(max_examples=150)
def test_headers_are_checked_as_in_full_decoding(
    frame: int, time_ns: int, source: str, schema: str, version: object, order: list[str]
) -> None:
    fields = dict(schema=schema, version=version, source=source, frame=frame, time_ns=time_ns, seq=0, body={})
    payload = msgpack.packb({name: fields[name] for name in order})
    assert lazy_header_of(payload) == header_of(payload)


@given(cut=st.integers(0, 400), flip=st.integers(0, 399), bit=st.integers(0, 7))
@settings(max_examples=150)
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


def test_an_oversized_message_is_refused_at_once() -> None:
    with pytest.raises(MessageError, match="at most"):
        codec.decode_lazily(encoded() + bytes(codec.MAX_BYTES), "status")


@pytest.mark.parametrize(
    ("largest", "beyond"),
    [(dict(frame=(1 << 62) - 1), dict(frame=1 << 62)), (dict(source="x" * 256), dict(source="x" * 257))],
)
def test_the_numbers_and_the_name_in_a_header_are_limited(largest: dict[str, Any], beyond: dict[str, Any]) -> None:
    assert codec.decode_header(encoded(**largest), "status")
    with pytest.raises(MessageError, match="status: "):
        codec.decode_header(encoded(**beyond), "status")

"""User-defined message types and their definitions are checked like built-in ones."""

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mast_zenoh.errors import MessageError
from mast_zenoh.evaluation.effects import rows
from mast_zenoh.messages import codec, user_types
from mast_zenoh.messages.layout import LAYOUTS
from mast_zenoh.messages.schemas import BUILT_IN, DTYPES, SCHEMAS, Column, Header, Message, Schema, text
from mast_zenoh.node import Node
from mast_zenoh.run_folder.recording.format import DEFINITION, user_schema

LETTERS = ("n", "m", "rows")


@pytest.fixture(autouse=True)
def ours_alone_afterwards() -> Iterator[None]:
    yield
    user_types.use(())


names = st.from_regex(r"[a-z][a-z0-9_]{0,9}", fullmatch=True)
sizes = st.one_of(st.sampled_from(LETTERS), st.integers(1, 4))


@st.composite
def columns(draw: st.DrawFn, name: str) -> Column:
    """A column of a type that a user might define."""
    dtype = draw(st.sampled_from(DTYPES))
    shape = draw(st.lists(sizes, min_size=1, max_size=1 if dtype == "str" else 3))
    below = draw(st.integers(1, 256)) if dtype == "uint8" else 256
    least = draw(st.sampled_from([0.0, 1e-3])) if dtype == "float64" and not set(shape) & set(LETTERS) else 0.0
    return Column(name, dtype, tuple(shape), draw(st.sampled_from(["", "m", "m/s²"])), "", below, least)


@st.composite
def schemas(draw: st.DrawFn) -> Schema:
    """A message type that a user might define."""
    chosen = draw(st.lists(names, max_size=6, unique=True))
    name = draw(names.filter(lambda name: name not in BUILT_IN))
    return Schema(name, draw(st.integers(1, 9)), "of a test", tuple(draw(columns(column)) for column in chosen))


def message_of(schema: Schema, sizes: dict[str, int], seed: int) -> Message:
    """A valid message of a type."""
    random = np.random.default_rng(seed)
    body: dict[str, Any] = {}
    for column in schema.columns:
        shape = tuple(sizes[size] if isinstance(size, str) else size for size in column.shape)
        if column.dtype == "str":
            body[column.name] = text([f"text {number}" for number in range(shape[0])])
        elif column.dtype == "float64":
            body[column.name] = random.normal(size=shape) * 1e3 + 1.0
        else:
            body[column.name] = random.integers(0, column.below, shape).astype(column.dtype)
    return codec.conform(Header(schema.name, "someone", 3, 300_000_000, 7), body)


counts = st.fixed_dictionaries({letter: st.integers(0, 5) for letter in LETTERS})


@given(schema=schemas(), counts=counts, seed=st.integers(0, 99))
def test_every_message_of_a_users_type_is_unchanged_by_encoding_and_decoding(schema, counts, seed) -> None:
    user_types.use([schema])
    message = message_of(schema, counts, seed)
    codec.check_values(message)
    payload = codec.encode(message)
    for expected in (schema.name, schema, user_types.from_json(user_types.to_json(schema))):
        decoded = codec.decode(payload, expected)
        assert decoded.header == message.header
        for name, column in message.body.items():
            np.testing.assert_array_equal(decoded.body[name], column)
            assert decoded.body[name].dtype == column.dtype
            assert column.dtype == object or not decoded.body[name].flags.writeable
        assert codec.encode(decoded) == payload


def spoilt(packed: list[Any], how: str, column: Column) -> list[Any] | None:
    """A packed column with one thing wrong; None: this cannot be wrong in it."""
    dtype, shape, data = packed
    numbers = column.dtype != "str" and data
    if how == "dtype":
        return ["<f4" if column.dtype != "float32" else "<f8", shape, data]
    if how == "shape":
        return [dtype, [*shape, 1], data]
    if how == "fractions":
        return [dtype, [float(size) for size in shape], data]
    if how == "data":
        return [dtype, shape, data[:-1]] if data else None
    if how == "infinite" and column.dtype == "float64" and numbers:
        return [dtype, shape, np.full(len(data) // 8, np.inf).tobytes()]
    if how == "above" and column.below < 256 and numbers:
        return [dtype, shape, bytes([column.below]) * len(data)]
    if how == "long text" and column.dtype == "str" and data:
        return [dtype, shape, ["x" * 300] * len(data)]
    return None


@given(
    schema=schemas(),
    counts=counts,
    how=st.sampled_from(["dtype", "shape", "fractions", "data", "infinite", "above", "long text", "absent", "further"]),
    place=st.integers(0, 5),
)
def test_a_message_with_a_wrong_column_is_refused(schema: Schema, counts: dict[str, int], how: str, place: int) -> None:
    assume(schema.columns)
    user_types.use([schema])
    column = schema.columns[place % len(schema.columns)]
    fields = msgpack.unpackb(codec.encode(message_of(schema, counts, 0)))
    if how == "absent":
        del fields["body"][column.name]
    elif how == "further":
        fields["body"]["unknown_to_all"] = fields["body"][column.name]
    else:
        wrong = spoilt(fields["body"][column.name], how, column)
        assume(wrong is not None)
        fields["body"][column.name] = wrong
    for expected in (schema.name, schema):
        with pytest.raises(MessageError, match=f"^{schema.name}"):
            codec.decode(msgpack.packb(fields), expected)


def test_two_columns_of_one_letter_have_as_many_rows() -> None:
    user_types.use([Schema("pairs", 1, "", (Column("a", "int64", ("n",)), Column("b", "int64", ("n", 2))))])
    with pytest.raises(MessageError, match=r"shape \(3, 2\)"):
        codec.conform(Header("pairs", "x", 0, 0, 0), {"a": np.zeros(2, np.int64), "b": np.zeros((3, 2), np.int64)})


def test_another_version_of_a_users_type_is_refused() -> None:
    wind = Schema("wind", 1, "", (Column("speed", "float64", (1,), "m/s"),))
    user_types.use([wind])
    payload = codec.encode(message_of(wind, {}, 0))
    user_types.use([replace(wind, version=2)])
    with pytest.raises(MessageError, match=r"wind.*version.*version"):
        codec.decode(payload, "wind")
    assert codec.decode(payload, wind).body["speed"].shape == (1,), "that of the recording decodes it"


def test_only_types_of_the_scenario_in_use_are_known() -> None:
    wind, rain = (Schema(name, 1, "", (Column("speed", "float64", (1,)),)) for name in ("wind", "rain"))
    user_types.use([wind])
    user_types.use([rain])
    assert SCHEMAS.keys() == LAYOUTS.keys() == {*BUILT_IN, "rain"}
    user_types.use(())
    assert SCHEMAS == BUILT_IN
    assert LAYOUTS.keys() == BUILT_IN.keys()


A = Column("a", "int64", ("n",))


@pytest.mark.parametrize(
    ("define", "message"),
    [
        (lambda: Column("speed", "float16", (1,)), r"'speed'.*'float16'.*float64"),
        (lambda: Column("Speed", "float64", (1,)), r"'Speed'.*lower-case letters"),
        (lambda: Column("speed", "float64", ()), "column 'speed': shape"),
        (lambda: Column("speed", "float64", (0,)), r"'speed': shape.*0"),
        (lambda: Column("speed", "float64", (True,)), "column 'speed': shape"),
        (lambda: Column("speed", "float64", ("n", "not one")), r"'speed'.*'not one'"),
        (lambda: Column("speed", "float64", ("a", "b", "c", "d")), r"shape.*fewer.*smaller"),
        (lambda: Column("name", "str", ("n", 2)), r"'name': shape.*2"),
        (lambda: Column("kind", "int64", ("n",), below=3), r"below.*3.*uint8"),
        (lambda: Column("kind", "uint8", ("n",), below=0), r"below.*0.*1"),
        (lambda: Column("turn", "int64", (4,), least_length=0.1), r"least_length.*0.1.*int64"),
        (lambda: Column("turn", "float64", (4,), least_length=-1.0), r"least_length.*-1.0.*0"),
        (lambda: Schema("my wind", 1, "", ()), r"'my wind'.*lower-case"),
        (lambda: Schema("wind", 0, "", ()), r"'wind': version.*0"),
        (lambda: Schema("wind", 1, "", (A, A)), r"message.*'wind'.*'a'"),
        (lambda: Schema("wind", 1, "", tuple(replace(A, name=f"a{number}") for number in range(61))), "61 columns"),
    ],
)
def test_what_is_wrong_with_a_definition_is_named(define: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        define()


WIND = Schema("wind", 1, "", (Column("speed", "float64", (1,), "m/s"),))


def test_a_port_has_the_name_of_the_type_that_it_declares() -> None:
    class Station(Node):
        outputs = {"wind": WIND, "alarm": BUILT_IN["status"]}

    class Larger(Station):
        inputs = {"clock": "clock"}

    for node in (Station, Larger):
        assert node.outputs == {"wind": "wind", "alarm": "status"}
        assert node.message_types == {"wind": WIND}
    assert Node.message_types == {}


@pytest.mark.parametrize(
    ("inputs", "outputs", "message"),
    [
        ({}, {"a": replace(WIND, name="tracks")}, r"Bad.outputs\['a'\]: message.*'tracks'"),
        ({"b": WIND}, {"a": replace(WIND, version=2)}, r"Bad.outputs\['a'\]: .*'wind'"),
    ],
)
def test_a_node_cannot_declare_a_type_of_a_taken_name(inputs: Any, outputs: Any, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        type("Bad", (Node,), {"inputs": inputs, "outputs": outputs})


@pytest.mark.parametrize(
    ("dtype", "values"),
    [
        ("int64", np.array([1.7])),
        ("int64", np.array([np.nan])),
        ("int32", np.array([1 << 40])),
        ("uint8", np.array([300])),
        ("uint8", np.array([-1])),
        ("float64", np.array([1j])),
        ("int64", np.array(["2026-01-01"], "datetime64[s]")),
    ],
)
def test_values_that_a_column_cannot_represent_are_refused(dtype: str, values: np.ndarray) -> None:
    user_types.use([Schema("gauge", 1, "", (Column("level", dtype, ("n",)),))])
    with pytest.raises(MessageError, match=r"gauge\.level: found "):
        codec.conform(Header("gauge", "a", 0, 0, 0), {"level": values})


def test_values_that_a_column_can_represent_are_converted() -> None:
    user_types.use([Schema("gauge", 1, "", (Column("level", "int64", ("n",)), Column("share", "float64", ("n",))))])
    body = {"level": np.array([1.0, 2.0]), "share": np.array([0.5, np.nan], np.float32)}
    message = codec.conform(Header("gauge", "a", 0, 0, 0), body)
    assert message.body["level"].tolist() == [1, 2]
    assert message.body["share"].dtype == np.float64


@pytest.mark.parametrize(
    "changed",
    [
        {"columns": [{"name": f"c{i}", "dtype": "int64", "shape": ["n"]} for i in range(50_000)]},
        {"columns": [{"name": "c", "dtype": "int64", "shape": [1] * 200_000}]},
        {"columns": [{"name": "c", "dtype": "int64", "shape": ["n"], "unit": ["m"]}]},
        {"name": "tracks"},
    ],
)
def test_a_forged_definition_in_a_recording_is_refused(changed: dict[str, Any]) -> None:
    definition = user_types.to_json(Schema("gauge", 1, "", (Column("level", "int64", ("n",)),))) | changed
    with pytest.raises(ValueError, match=r"expected|columns"):
        user_schema(json.dumps({DEFINITION: definition}).encode())
    with pytest.raises(ValueError, match=r"nested.*levels deep"):
        user_schema(b'{"definition": ' + b"[" * 100_000)


def test_a_type_whose_rows_vary_in_size_has_no_objects_to_compare_but_those_of_fixed_size() -> None:
    grid = Schema("grid", 1, "", (Column("position", "float64", ("n", 3)), Column("cells", "float64", ("n", "m"))))
    user_types.use([grid])
    assert rows._columns(SCHEMAS["grid"]).rows
    bodies = [{"position": np.zeros((2, 3)), "cells": np.zeros((2, m))} for m in (1, 4)]
    names = rows._columns(grid).rows
    assert rows.Rows.of(bodies, names).columns["position"].shape == (4, 3)

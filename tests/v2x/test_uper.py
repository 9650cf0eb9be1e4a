"""Bits of each kind of type, and what is refused."""

import numpy as np
import pytest
from plain_values import from_plain
from uper_oracle import encode_values

from mast_zenoh.errors import MessageError
from mast_zenoh.v2x.asn1.asn1_types import (
    BOOLEAN,
    Absent,
    Bits,
    Choice,
    Default,
    Demanded,
    Enumerated,
    Integer,
    ListOf,
    Octets,
    Optional,
    Sequence,
    Wrapped,
)
from mast_zenoh.v2x.asn1.layout import EncodingProgram, slot_of
from mast_zenoh.v2x.asn1.uper import decode, encode, to_plain

PAIR = Sequence(a=Integer(0, 3), b=Optional(Integer(0, 255)))
OPEN = Sequence(a=Integer(0, 3)).extensible(b=Optional(Integer(0, 7)))
SHADES = Enumerated("dark light", additions="grey")
DEFAULTS = Sequence(a=Default(Integer(0, 15), 5))
EITHER = Choice(x=Integer(0, 3), y=Integer(0, 255)).extensible(z=Integer(0, 15))
CONTAINER = Wrapped("id", "data", Integer(1, 16), {1: Integer(0, 3), 2: ListOf(Integer(0, 255), 0, 255)})


def packed(bits: str) -> bytes:
    """Bits, padded to octets."""
    bits = bits.replace(" ", "")
    return int(bits.ljust(-(-len(bits) // 8) * 8, "0"), 2).to_bytes(-(-len(bits) // 8))


@pytest.mark.parametrize(
    ("type", "plain", "bits"),
    [
        (Integer(-2, 5), -2, "000"),
        (Integer(-2, 5), 5, "111"),
        (Integer(7, 7), 7, "0"),
        (Integer(0, 2**42 - 1), 2**42 - 1, 42 * "1"),
        (Integer(1, 255, extensible=True), 255, "0 11111110"),
        (Integer(1, 255, extensible=True), 0, "1 00000001 00000000"),
        (Integer(1, 255, extensible=True), -129, "1 00000010 1111111101111111"),
        (Integer(1, 255, extensible=True), -(2**63), "1 00001000 1" + 63 * "0"),
        (BOOLEAN, True, "1"),
        (Enumerated("a b c"), "c", "10"),
        (SHADES, "light", "0 1"),
        (SHADES, "grey", "1 0 000000"),
        (SHADES, "+5", "1 0 000101"),
        (Bits(3), "101", "101"),
        (Bits(1, 13), "10", "0001 10"),
        (Bits(3, extensible=True), "10100", "1 00000101 10100"),
        (Octets(1, 20), "ab", "00000 10101011"),
        (ListOf(Integer(0, 3), 0, 3), [3, 0], "10 11 00"),
        (ListOf(Integer(0, 3), 2, 2), [3, 0], "11 00"),
        (ListOf(Integer(0, 3), 1, 2, extensible=True), [1], "0 0 01"),
        (ListOf(Integer(0, 3), 1, 2, extensible=True), [], "1 00000000"),
        (ListOf(Integer(0, 1), 1, 2, extensible=True), 130 * [1], "1 1000000010000010" + 130 * "1"),
        (PAIR, {"a": 2}, "0 10"),
        (PAIR, {"a": 2, "b": 9}, "1 10 00001001"),
        (OPEN, {"a": 2}, "0 10"),
        (OPEN, {"a": 2, "b": 6}, "1 10 0000000 1 00000001 11000000"),
        (OPEN, {"a": 2, "+2": "f00f"}, "1 10 0000010 001 00000010 1111000000001111"),
        (OPEN, {"a": 2, "b": 6, "+1": None}, "1 10 0000001 10 00000001 11000000"),
        (DEFAULTS, {"a": 5}, "0"),
        (DEFAULTS, {"a": 6}, "1 0110"),
        (EITHER, {"y": 255}, "0 1 11111111"),
        (EITHER, {"z": 15}, "1 0000000 00000001 11110000"),
        (EITHER, {"+1": "ff"}, "1 0000001 00000001 11111111"),
        (CONTAINER, {"id": 1, "data": 3}, "0000 00000001 11000000"),
        (CONTAINER, {"id": 2, "data": 9 * [7]}, "0001 00001010 00001001" + 9 * "00000111"),
        (CONTAINER, {"id": 2, "data": 127 * [7]}, "0001 1000000010000000 01111111" + 127 * "00000111"),
        (CONTAINER, {"id": 16, "data": "00"}, "1111 00000001 00000000"),
        (Wrapped("id", "data", Integer(1, 1), {1: Integer(4, 4)}), {"id": 1, "data": 4}, "00000001 00000000"),
    ],
)  # fmt: skip
def test_each_kind_of_type_has_the_bits_of_the_standard(type, plain, bits):
    layout = EncodingProgram("value", type)
    values = from_plain(layout, plain)
    assert encode(layout, values) == packed(bits)
    np.testing.assert_array_equal(decode(layout, packed(bits)), values)
    assert to_plain(layout, values) == plain
    assert encode_values(layout.program, values)[0] == packed(bits)


@pytest.mark.parametrize(
    ("type", "bits", "message"),
    [
        (Integer(0, 2), "11", "found 3, expected 0..2"),
        (Integer(0, 14).only(0, (5, 11)), "0100", r"4.*0.*5..11"),
        (Integer(1, 255, extensible=True), "1 00000001 00000001", r"encoded longer.*needed"),
        (Integer(1, 255, extensible=True), "1 00000010 00000000 00000000", r"encoded longer.*needed"),
        (Integer(1, 255, extensible=True), "1 00001001" + 72 * "1", r"integer.*octets.*1..8"),
        (Enumerated("a b c"), "11", "found 3, expected"),
        (SHADES, "1 1", "after the 64th"),
        (ListOf(Integer(0, 255), 0, 2), "11", r"3 elements.*0..2"),
        (ListOf(Integer(0, 255), 0, 3).at_most(1), "10 0000000000000000", r"2 elements.*0..1"),
        (ListOf(Integer(0, 3), 1, 2, extensible=True), "1 00000010 0000", r"encoded longer.*needed"),
        (ListOf(Integer(0, 3), 1, 2, extensible=True), "1 10 00000001111111", r"encoded longer.*needed"),
        (ListOf(Integer(0, 3), 1, 2, extensible=True), "1 11 000001", "fragmented length"),
        (Sequence(a=Demanded(BOOLEAN)), "0", r"a.*1.*mandatory"),
        (Sequence(a=Absent(BOOLEAN)), "11", r"a.*presence.*0"),
        (DEFAULTS, "1 0101", r"a.*encoded longer"),
        (OPEN, "1 10 0000000 0", r"extension additions.*absent"),
        (OPEN, "1 10 1", "after the 64th"),
        (OPEN, "1 10 0000000 1 00000000", r"b.*length.*octets"),
        (OPEN, "1 10 0000000 1 00000010 1100000000000000", r"b.*length.*differs"),
        (OPEN, "1 10 0000000 1 00000001 11000001", r"b.*5 padding"),
        (OPEN, "1 10 0000000 1 00000001 110", r"b.*bytes.*bits"),
        (OPEN, "1 10 0000001 01 00000011 11111111", r"\+1.*bytes end"),
        (PAIR, "1 10 000", r"b.*bytes.*needed"),
        (PAIR, "0 10 00001", r"message.*5 padding"),
        (PAIR, "0 10 00000 00000000", r"message.*1 trailing"),
        (PAIR, "", r"bytes.*bits.*left"),
    ],
)
def test_encodings_that_are_not_canonical_are_refused(type, bits, message):
    data = packed(bits) if bits else b""
    with pytest.raises(MessageError, match=message):
        decode(EncodingProgram("value", type), data)


@pytest.mark.parametrize(
    ("type", "plain", "message"),
    [
        (PAIR, {"a": 4}, "a: found 4, expected 0..3"),
        (PAIR, {"a": -1}, "a: found -1, expected 0..3"),
        (ListOf(PAIR, 0, 9), [{"a": 0}, {"a": 0, "b": 256}], r"\[1\].b: found 256, expected 0..255"),
        (ListOf(PAIR, 1, 9), [], r"0 elements.*1..9"),
        (Octets(1, 2), "abcdef", r"3 elements.*1..2"),
        (EITHER, {"z": 16}, "z: found 16, expected 0..15"),
        (EITHER, {"+64": "00"}, "message: found 66"),
        (CONTAINER, {"id": 17, "data": "00"}, "found 17, expected 1..16"),
        (CONTAINER, {"id": 16, "data": ""}, r"data.*0.*1..16383"),
        (OPEN, {"a": 0, "+1": None}, r"extension additions.*absent"),
        (Sequence(a=Absent(BOOLEAN)), {"a": True}, "a: found presence 1"),
    ],
)
def test_values_outside_a_constraint_are_refused_with_the_path_of_the_field(type, plain, message):
    layout = EncodingProgram("value", type)
    with pytest.raises(MessageError, match=message):
        encode(layout, from_plain(layout, plain))


@pytest.mark.parametrize(
    ("type", "plain", "message"),
    [
        (PAIR, {"b": 3}, r"value.*no"),
        (PAIR, {"a": 0, "c": 3}, r"value.*keys \['c'\]"),
        (PAIR, {"a": "0"}, r"value.a.*str.*int"),
        (PAIR, {"a": 1 << 63}, r"value.a.*9223372036854775808.*integer"),
        (PAIR, [], r"value.*list.*dict"),
        (SHADES, "red", r"value.*'red'.*light"),
        (Bits(3), "012", r"value.*'012'.*only"),
        (Octets(1, 2), "abc", r"value.*'abc'.*hexadecimal"),
        (EITHER, {"x": 0, "y": 0}, "value: found keys"),
        (CONTAINER, {"id": 1}, "value: found keys"),
        (OPEN, {"a": 0, "+0": "00"}, r"value.*\['\+0'\].*\+1"),
    ],
)
def test_plain_values_of_the_wrong_kind_are_refused_with_the_path_of_the_field(type, plain, message):
    with pytest.raises(MessageError, match=message):
        from_plain(EncodingProgram("value", type), plain)


def test_slots_that_are_no_presence_or_no_rows_are_refused():
    layout = EncodingProgram("value", PAIR)
    values = from_plain(layout, {"a": 1, "b": 2})
    values[slot_of(PAIR, "b?")] = 2
    with pytest.raises(MessageError, match=r"b.*presence 2"):
        encode(layout, values)
    for start in (-1, 2, 1 << 62):
        with pytest.raises(MessageError, match=f"{start}.*outside.*values"):
            encode(EncodingProgram("list", ListOf(PAIR, 0, 9)), np.array([1, start, 0, 0], np.int64))
    with pytest.raises(MessageError, match=r"rows.*slot 2"):
        encode(layout, values[:2])

"""The field tables are those of ETSI's ASN.1 modules: names, order, options, bounds, extension markers."""

from functools import cache
from typing import Any

import asn1_oracle
import asn1tools
import pytest

from mast_zenoh.v2x import cam, cpm
from mast_zenoh.v2x.asn1.asn1_types import (
    BitString,
    Boolean,
    Choice,
    Default,
    Enumerated,
    Integer,
    ListOf,
    OctetString,
    Optional,
    Sequence,
    Wrapped,
)

pytestmark = pytest.mark.skipif(not asn1_oracle.FOLDER.is_dir(), reason="no ASN.1 modules in $MAST_DATA/etsi_asn1")

#: Sizes that are not extensible where a further constraint ends that (X.680, 50.11).
NOT_EXTENSIBLE = ("cpmContainers", "pathPredicted")


@cache
def types() -> dict[str, dict[str, Any]]:
    """All types of all modules by name."""
    text = "\n".join(file.read_text(encoding="latin-1") for file in sorted(asn1_oracle.FOLDER.glob("*.asn")))
    return {name: type for module in asn1tools.parse_string(text).values() for name, type in module["types"].items()}


def resolved(type: dict[str, Any]) -> dict[str, Any]:
    """A type with the constraints and named numbers of the types that it refers to, the outer ones first."""
    found = dict(type)
    while found["type"] in types():
        found = types()[found["type"]] | {key: value for key, value in found.items() if key != "type"}
    return found


def ranges(type: dict[str, Any], key: str) -> tuple[list[tuple[int, int]], bool]:
    """Ranges of a constraint's root, and whether it is extensible."""
    numbers = type.get("named-numbers", {})
    root: list[tuple[int, int]] = []
    for item in type[key]:
        if item is None:
            return root, True
        pair = item if isinstance(item, tuple | list) else (item, item)
        root.append(tuple(numbers.get(bound, bound) for bound in pair))
    return root, False


def assert_same(ours: Any, theirs: dict[str, Any], path: str) -> None:
    theirs = resolved(theirs)
    if isinstance(ours, Boolean):
        assert theirs["type"] == "BOOLEAN", path
    elif isinstance(ours, Integer):
        root, extensible = ranges(theirs, "restricted-to")
        found = {value for low, high in root for value in (low, high)}
        assert (min(found), max(found), extensible) == (ours.low, ours.high, ours.extensible), path
        if len(root) > 1:
            values = {value for low, high in root for value in range(low, high + 1)}
            assert values == {value for low, high in ours.allowed for value in range(low, high + 1)}, path
    elif isinstance(ours, Enumerated):
        values = theirs["values"]
        assert [value and value[0] for value in values if value] == list(ours.known), path
        assert (None in values) == (ours.additions is not None), path
        assert [value[1] for value in values if value] == list(range(len(ours.known))), path
    elif isinstance(ours, ListOf):
        kind = {BitString: "BIT STRING", OctetString: "OCTET STRING"}.get(type(ours), "SEQUENCE OF")
        (size, *_), extensible = ranges(theirs, "size")
        extensible &= path.rsplit(".")[-1] not in NOT_EXTENSIBLE
        assert (theirs["type"], *size, extensible) == (kind, ours.low, ours.high, ours.extensible), path
        if kind == "SEQUENCE OF":
            assert_same(ours.element, theirs["element"], f"{path}[]")
    elif isinstance(ours, Sequence):
        assert_same_members(ours.fields, ours.additions, theirs, "SEQUENCE", path)
    elif isinstance(ours, Choice):
        assert_same_members(ours.alternatives, ours.additions, theirs, "CHOICE", path)
    else:
        assert isinstance(ours, Wrapped)
        assert [member["name"] for member in theirs["members"]] == [ours.id_name, ours.data_name], path


def assert_same_members(fields: Any, additions: Any, theirs: dict[str, Any], kind: str, path: str) -> None:
    members: list[Any] = []
    for member in theirs["members"]:
        if member and "components-of" in member:
            members += [inner for inner in types()[member["components-of"]]["members"] if inner]
        else:
            members.append(member)
    marker = members.index(None) if None in members else len(members)
    names = [member and member["name"] for member in members]
    assert (theirs["type"], names[:marker]) == (kind, list(fields)), path
    assert (None in members) == (additions is not None), path
    assert names[marker + 1 :] == list(additions or {}), path
    for member in filter(None, members):
        ours = {**fields, **(additions or {})}[member["name"]]
        options = isinstance(ours, Optional) and not isinstance(ours, Default), isinstance(ours, Default)
        assert options == (member.get("optional", False), "default" in member), f"{path}.{member['name']}"
        if options[1]:
            known = resolved(member)
            numbers = known.get("named-numbers", {}) | {
                value[0]: value[1] for value in known.get("values", []) if value
            }
            assert numbers.get(member["default"], member["default"]) == ours.value, path
        inner = ours.type if isinstance(ours, Optional) else ours
        assert_same(inner, member, f"{path}.{member['name']}")


@pytest.mark.parametrize("fields", [cpm, cam], ids=["CPM", "CAM"])
def test_messages_and_containers_have_the_fields_of_the_modules(fields):
    name = fields.LAYOUT.name
    wrapped = cpm.WrappedCpmContainer if name == "CPM" else cam.WrappedExtensionContainer
    assert_same(fields.LAYOUT.type, types()[asn1_oracle.ROOTS[name]], name)
    for container, type in zip(asn1_oracle.CONTAINERS[name], wrapped.contents.values(), strict=True):
        assert_same(type, types()[container], container)

"""Reads YAML files: PyYAML's safe C loader, reduced to plain values, and to NumPy's numbers and arrays as numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from yaml.constructor import ConstructorError, SafeConstructor

from mast_datasets.files import Element
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.detection_tables import read_text

_MAX_BYTES = 10_000_000  # of one file
_MAX_DEPTH = 32  # libyaml has no limit, and a process ends if its stack is full
_MAX_VALUES = 1_000_000  # of one file; PyYAML needs up to 700 bytes for each
_MAX_NUMBERS = 64  # of an array
_TYPES = {"f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "b1"}
_ORDERS = {"<": "<", "=": "<", "|": "<", ">": ">"}  # written on machines that are little-endian


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]  # the C library is optional
    """Knows the tags that are added below, and no others."""

    yaml_constructors: dict[str | None, Any] = {}
    yaml_implicit_resolvers: dict[str, Any] = {}
    depth = values = 0

    def descend_resolver(self, parent: Any, index: Any) -> None:
        """Count a value that begins."""
        self.depth, self.values = self.depth + 1, self.values + 1
        if self.depth > _MAX_DEPTH or self.values > _MAX_VALUES:
            most = f"{_MAX_DEPTH} levels" if self.depth > _MAX_DEPTH else f"{_MAX_VALUES} values"
            raise ConstructorError(None, None, f"found more than {most}", parent.start_mark)

    def ascend_resolver(self) -> None:
        """A value is complete."""
        self.depth -= 1

    def elements(self, node: Any) -> list[Any]:
        """The values of a list."""
        return [self.construct_object(child) for child in node.value]

    def members(self, node: Any) -> dict[Any, Any]:
        """The values of a mapping by key."""
        members: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            key = self.construct_object(key_node)
            if key in members:
                raise ConstructorError(None, None, f"found the key {key!s:.40} twice", key_node.start_mark)
            members[key] = self.construct_object(value_node)
        return members


def _numpy(build: Callable[..., Any]) -> Callable[[_Loader, Any], Any]:
    """A constructor that calls `build` with the arguments of a NumPy object, and with its state, if it has one."""

    def construct(loader: _Loader, node: Any) -> Any:
        try:
            parts = loader.members(node) if isinstance(node, yaml.MappingNode) else {"args": loader.elements(node)}
            return build(*parts["args"], *parts.get("state", ()))
        except (ValueError, TypeError, LookupError, AttributeError) as error:
            raise ConstructorError(None, None, f"found no NumPy value: {error}", node.start_mark) from None

    return construct


def _dtype(code: str, align: Any, copy: Any, version: Any = 3, order: str = "<", *_: Any) -> Any:
    """The type of an array's numbers."""
    if code not in _TYPES:
        raise ValueError(f"numbers of type {code!s:.20}, expected one of {', '.join(sorted(_TYPES))}")
    return np.dtype(_ORDERS[order] + code)


def _numbers(dtype: Any, data: bytes, count: int = 1) -> Any:
    if len(data) != count * dtype.itemsize:
        raise ValueError(f"{len(data)} bytes, expected {count} of {dtype.itemsize}")
    return np.frombuffer(data, dtype)


def _array(
    kind: Any, _: Any, __: Any, version: int, shape: list[int], dtype: Any, by_columns: bool, data: bytes
) -> Any:
    """Nested lists of the numbers of an array; a single number of one without axes."""
    if math.prod(max(length, 1) for length in shape) > _MAX_NUMBERS:
        raise ValueError(f"an array of shape {shape!s:.40}, expected at most {_MAX_NUMBERS} numbers")
    return _numbers(dtype, data, math.prod(shape)).reshape(shape, order="F" if by_columns else "C").tolist()


_YAML, _APPLY = "tag:yaml.org,2002:", "tag:yaml.org,2002:python/object/apply:numpy."
_CONSTRUCTORS: dict[str | None, Callable[..., Any]] = {
    None: SafeConstructor.construct_undefined,  # refuses all other tags
    _YAML + "null": SafeConstructor.construct_yaml_null,
    _YAML + "bool": SafeConstructor.construct_yaml_bool,
    _YAML + "int": lambda loader, node: int(loader.construct_scalar(node)),
    _YAML + "float": SafeConstructor.construct_yaml_float,
    _YAML + "str": SafeConstructor.construct_yaml_str,
    _YAML + "seq": _Loader.elements,
    _YAML + "map": _Loader.members,
    # What PyYAML writes of tuples, and of NumPy's numbers and arrays.
    _YAML + "binary": SafeConstructor.construct_yaml_binary,
    _YAML + "python/tuple": _Loader.elements,
    _YAML + "python/name:numpy.ndarray": lambda loader, node: None,
    _APPLY + "dtype": _numpy(_dtype),
    **{
        _APPLY + f"{core}.multiarray.scalar": _numpy(lambda *parts: _numbers(*parts).item())
        for core in ("core", "_core")
    },
    **{_APPLY + f"{core}.multiarray._reconstruct": _numpy(_array) for core in ("core", "_core")},
}
for _tag, _construct in _CONSTRUCTORS.items():
    _Loader.add_constructor(_tag, _construct)
#: Plain text that is no text; YAML 1.1 takes more for numbers, times and answers.
for _tag, _text, _begins in (
    ("null", r"~|null|Null|NULL|", ["", *"~nN"]),
    ("bool", r"true|True|TRUE|false|False|FALSE", [*"tTfF"]),
    ("int", r"[-+]?(0|[1-9][0-9]{0,38})", [*"-+0123456789"]),
    ("float", r"[-+]?([0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))([eE][-+]?[0-9]+)?", [*"-+.0123456789"]),
    ("float", r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)", [*"-+."]),
):
    _Loader.add_implicit_resolver(_YAML + _tag, re.compile(rf"({_text})\Z"), _begins)


def read_yaml(path: Path) -> Element:
    """The content of a YAML file.

    Raises SceneError if it is missing, too large, not YAML, too deep, or has a key twice or a tag that is not known.
    """
    try:
        size = path.stat().st_size
        if size > _MAX_BYTES:
            raise SceneError(f"{path}: found {size} bytes, expected at most {_MAX_BYTES}")
        return Element(yaml.load(read_text(path), Loader=_Loader), path)
    except (yaml.YAMLError, OSError, ValueError, TypeError, LookupError, ArithmeticError) as error:
        reason = " ".join(str(error).split()).replace('in "<unicode string>",', "at")
        raise SceneError(f"{path}: not YAML that is known: {reason}") from error

"""Values of JSON and YAML files, checked, with their place in the file for messages."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import SceneError, nearest
from mast_zenoh.scenes.files.bounded_file import MAX_FILE_BYTES

_MAX_NAMES = 20  # of the members of an object in a message
_MAX_SHOWN = 80  # characters of a value in a message
_WHOLE = re.compile("-?[0-9]+")
_MAX_SHEAR = 1e-2  # of a rotation matrix, per element of its product with its transpose; files round


class Element:
    """A value in a file: what it is read as decides what is accepted.

    value: as decoded; path: of the file; place: of the value in it, such as "frames.3.objects[7]"

    All methods raise SceneError, which names file, place, what was found and what was expected.
    """

    def __init__(self, value: Any, path: Path, place: str = "") -> None:
        self.value = value
        self.path = path
        self.place = place

    def fail(self, expected: str) -> NoReturn:
        """Raise SceneError: this value is not what was expected."""
        try:
            shown = repr(self.value)
        except RecursionError:  # read by a caller with fewer frames on the stack
            shown = "values nested too deeply"
        shown = shown if len(shown) <= _MAX_SHOWN else shown[:_MAX_SHOWN] + "…"
        place = f"{self.place}: " if self.place else ""
        raise SceneError(f"{self.path}: {place}found {shown}, expected {expected}")

    def __getitem__(self, key: str) -> Element:
        """The value under a key of an object."""
        members = self._object()
        if key not in members:
            place = f"{self.place}: " if self.place else ""
            known = [str(name) for name in list(members)[:_MAX_NAMES]]
            raise SceneError(f"{self.path}: {place}{key} is missing{nearest(key, known)}")
        return Element(members[key], self.path, f"{self.place}.{key}" if self.place else key)

    def get(self, key: str) -> Element | None:
        """The value under a key of an object; None if it has none, or null."""
        return self[key] if self._object().get(key) is not None else None

    def members(self) -> Iterator[tuple[str, Element]]:
        """Keys and values of an object, in the order of the file."""
        for key in self._object():
            yield str(key), Element(self.value[key], self.path, f"{self.place}.{key}" if self.place else str(key))

    def elements(self, count: int | None = None) -> list[Element]:
        """The values of a list, `count` of them if given."""
        if not isinstance(self.value, (list, tuple)) or (count is not None and len(self.value) != count):
            self.fail("a list" if count is None else f"a list of {count}")
        return [Element(value, self.path, f"{self.place}[{index}]") for index, value in enumerate(self.value)]

    def number(self, low: float = -math.inf, high: float = math.inf) -> float:
        """A finite number from `low` to `high`."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
            self.fail(_number("a finite number", low, high))
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.fail(_number("a finite number", low, high))
        return number

    def integer(self, low: float = -(2**63), high: float = 2**63 - 1) -> int:
        """A whole number from `low` to `high`; text of digits is one, too."""
        value = self.value
        if (
            isinstance(value, str)
            and len(value) < 20
            and (digits := value.removeprefix("-")).isascii()
            and digits.isdigit()
        ):
            value = int(value)
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            self.fail(_number("a whole number", low, high))
        return value

    def text(self, choices: Sequence[str] = ()) -> str:
        """Text, one of the choices if there are any."""
        if not isinstance(self.value, str):
            self.fail("text")
        if choices and self.value not in choices:
            self.fail(f"one of {', '.join(choices)}")
        return self.value

    def vector(self, count: int) -> Floats:
        """(count,) finite numbers from a list."""
        return np.array([element.number() for element in self.elements(count)])

    def size(self, count: int = 3) -> Floats:
        """(count,) finite numbers above 0, m."""
        size = self.vector(count)
        if size.min() <= 0:
            self.fail(f"{count} numbers above 0")
        return size

    def matrix(self, rows: int, columns: int) -> Floats:
        """(rows, columns) finite numbers from a list of lists."""
        return np.array([row.vector(columns) for row in self.elements(rows)])

    def rotation(self) -> Floats:
        """(3, 3) rotation matrix, made exactly orthonormal."""
        return orthonormal(self.matrix(3, 3), self)

    def rigid(self) -> tuple[Floats, Floats]:
        """Position (3,) m and rotation (3, 3) of a 4 x 4 matrix."""
        matrix = self.matrix(4, 4)
        if np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > _MAX_SHEAR:
            self.fail("a 4 x 4 matrix whose last row is 0, 0, 0, 1")
        return matrix[:3, 3], orthonormal(matrix[:3, :3], self)

    def _object(self) -> dict[Any, Any]:
        if not isinstance(self.value, dict):
            self.fail("an object with named values")
        return self.value


def orthonormal(matrix: Floats, element: Element) -> Floats:
    """The rotation nearest to a matrix (3, 3) that is one but for rounding.

    element: where it is from, for the message
    """
    large = np.abs(matrix).max() > 1 + _MAX_SHEAR  # so large that products overflow, perhaps
    if large or np.abs(matrix @ matrix.T - np.eye(3)).max() > _MAX_SHEAR or np.linalg.det(matrix) < 0:
        element.fail("an orthonormal, right-handed rotation matrix")
    left, _, right = np.linalg.svd(matrix)
    rotation: Floats = left @ right
    return rotation


def read_json(path: Path) -> Element:
    """The content of a JSON file.

    Raises SceneError if it is missing, too large or not JSON, if a key occurs twice, or for NaN and Infinity.
    """
    try:
        return Element(json.loads(read_text(path), parse_constant=_refuse, object_pairs_hook=_unique), path)
    except (ValueError, RecursionError) as error:
        raise SceneError(f"{path}: not JSON: {error}") from error


def read_text(path: Path) -> str:
    """The content of a text file in UTF-8. Raises SceneError if it is missing or too large."""
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise SceneError(f"{path}: found {size} bytes, expected at most {MAX_FILE_BYTES}")
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: {error}") from error


def _refuse(name: str) -> NoReturn:
    raise ValueError(f"found {name}, expected a finite number")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) != len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"found {next(n for n in names if names.count(n) > 1)!r} twice, expected a key once")
    return members


def _number(kind: str, low: float, high: float) -> str:
    if (math.isinf(low) and math.isinf(high)) or (low == -(2**63) and high == 2**63 - 1):
        return kind
    if math.isinf(high) or high == 2**63 - 1:
        return f"{kind}, {low:g} or more"
    return f"{kind} from {low:g} to {high:g}"

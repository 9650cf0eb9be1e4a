"""Reads files of data sets: bounded in size, and every value checked, with its place in the file for messages."""

from __future__ import annotations

import gzip
import json
import math
import re
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any, NoReturn, cast

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import SceneError, nearest
from mast_zenoh.scenes.detection_tables import MAX_FILE_BYTES, read_text

#: Limit on one line of a text file, bytes.
MAX_LINE = 100_000
_PIECE = 1 << 18
_GZIP = b"\x1f\x8b"


def read_pieces(path: Path, max_bytes: int = MAX_FILE_BYTES) -> Iterator[bytes]:
    """The content of a file, unpacked if it is compressed by gzip.

    Raises SceneError if it cannot be read, or as soon as it exceeds `max_bytes`.
    """
    total = 0
    try:
        with _opened(path) as file:
            while piece := file.read(_PIECE):
                total += len(piece)
                if total > max_bytes:
                    raise SceneError(f"{path}: found more than {max_bytes} bytes unpacked, expected at most as many")
                yield piece
    except (OSError, EOFError, zlib.error) as error:
        raise SceneError(f"{path}: cannot be read: {error}") from error


def read_lines(path: Path, max_bytes: int = MAX_FILE_BYTES) -> Iterator[str]:
    """The lines of a text file in UTF-8, without their ends; compressed or not.

    Raises SceneError if it cannot be read, is too large, has a line that is too long, or is not UTF-8.
    """
    number, rest = 1, b""
    for piece in read_pieces(path, max_bytes):
        *lines, rest = (rest + piece).split(b"\n")
        for line in lines:
            yield _decoded(line, path, number)
            number += 1
        if len(rest) > MAX_LINE:
            _decoded(rest, path, number)
    if rest:
        yield _decoded(rest, path, number)


def _decoded(line: bytes, path: Path, number: int) -> str:
    if len(line) > MAX_LINE:
        raise SceneError(f"{path}: line {number}: found {len(line)} bytes, expected at most {MAX_LINE}")
    try:
        return line.rstrip(b"\r").decode("utf-8-sig" if number == 1 else "utf-8")
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: line {number}: {error}") from error


def _opened(path: Path) -> IO[bytes]:
    with path.open("rb") as file:
        start = file.read(len(_GZIP))
    return cast("IO[bytes]", gzip.open(path, "rb")) if start == _GZIP else path.open("rb")


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


_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,4})?", re.ASCII)
_INTEGER = re.compile(r"[+-]?\d{1,19}", re.ASCII)


class TextElement(Element):
    """A value that its file holds as text, with decimal numbers such as "-1.5e3".

    Space around a number is ignored; "nan", "inf" and digits of other scripts are not numbers.
    """

    def number(self, low: float = -math.inf, high: float = math.inf) -> float:
        """A finite number from `low` to `high`."""
        if not _NUMBER.fullmatch(self.value.strip()):
            return super().number(low, high)
        return self._decoded(float(self.value)).number(low, high)

    def integer(self, low: float = -(2**63), high: float = 2**63 - 1) -> int:
        """A whole number from `low` to `high`, without a decimal point."""
        text = self.value.strip()
        return self._decoded(int(text) if _INTEGER.fullmatch(text) else math.nan).integer(low, high)

    def _decoded(self, value: float) -> _Decoded:
        return _Decoded(value, self)


class _Decoded(Element):
    """A decoded number, which a message shows as it is in the file."""

    def __init__(self, value: float, source: TextElement) -> None:
        super().__init__(value, source.path, source.place)
        self._source = source

    def fail(self, expected: str) -> NoReturn:
        self._source.fail(expected)


#: Limit on a coordinate, m: far beyond any map projection, and its square is far below the limit of a number.
MAX_COORDINATE_M = 1e8
_LAST = np.array([0.0, 0.0, 0.0, 1.0])
_ROUNDING = 1e-6  # of the last row of a matrix, and of a symmetric one


def read_pose(element: Element) -> tuple[Floats, Floats]:
    """Position (3,) m and rotation (3, 3) of a 4 x 4 matrix that is a list of 4 rows.

    Raises SceneError, with the place in the file, unless it is a rotation and a translation.
    """
    for row in element.elements(4):
        for value in row.elements(4):
            value.number(-MAX_COORDINATE_M, MAX_COORDINATE_M)
    return element.rigid()


def read_listed_pose(element: Element) -> tuple[Floats, Floats]:
    """Position (3,) m and rotation (3, 3) of a 4 x 4 matrix: a list of 4 rows, or of 16 numbers.

    Writers of lists disagree on their order. It is by rows if the last four numbers are 0, 0, 0, 1, and by columns if
    every fourth number is. Both are true without a translation: then the matrix must be symmetric, or be 4 rows.
    """
    if not isinstance(element.value, list) or len(element.value) not in (4, 16):
        element.fail("4 rows of 4 numbers, or 16 numbers")
    if len(element.value) == 4:
        return read_pose(element)
    numbers = [value.number(-MAX_COORDINATE_M, MAX_COORDINATE_M) for value in element.elements()]
    matrix = np.array(numbers).reshape(4, 4)
    by_rows, by_columns = (bool(np.abs(end - _LAST).max() <= _ROUNDING) for end in (matrix[3], matrix[:, 3]))
    if not by_rows and not by_columns:
        element.fail("16 numbers of a 4 x 4 matrix whose last row is 0, 0, 0, 1")
    if by_rows and by_columns and np.abs(matrix - matrix.T).max() > _ROUNDING:
        element.fail("4 rows of 4 numbers: without a translation, the order of 16 numbers cannot be known")
    rows = matrix if by_rows else matrix.T
    return Element(rows.tolist(), element.path, element.place).rigid()

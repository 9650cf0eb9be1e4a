"""Reads files of data sets: bounded in size, and every value checked, with its place in the file for messages.

Text, JSON, YAML, and XML in one pass, by defusedxml: without document types or entities.
"""

from __future__ import annotations

import gzip
import math
import re
import reprlib
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import IO, Annotated, Any, NoReturn, cast
from xml.sax import SAXParseException
from xml.sax.handler import ContentHandler
from xml.sax.xmlreader import AttributesImpl

import msgspec
import numpy as np
import yaml
from defusedxml import DefusedXmlException  # type: ignore[import-untyped]
from defusedxml.expatreader import DefusedExpatParser  # type: ignore[import-untyped]
from msgspec import Meta
from yaml.constructor import ConstructorError, SafeConstructor

from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import ConfigurationError, SceneError, nearest
from mast_zenoh.scenes.own_detections import MAX_COORDINATE_M, MAX_FILE_BYTES, MAX_SIZE_M, read_text

#: Limit on one line of a text file, bytes.
MAX_LINE = 100_000
_PIECE = 1 << 18
_MAX_NAMES = 20  # in a message
_GZIP = b"\x1f\x8b"


def read_pieces(
    path: Path, max_bytes: int = MAX_FILE_BYTES, read: Callable[[IO[bytes]], bytes] = lambda file: file.read(_PIECE)
) -> Iterator[bytes]:
    """The content of a file, unpacked if it is compressed by gzip.

    Raises SceneError if it cannot be read, or as soon as it exceeds `max_bytes`.
    """
    total = 0
    try:
        with _opened(path) as file:
            while piece := read(file):
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
    for number, line in enumerate(read_pieces(path, max_bytes, lambda file: file.readline(MAX_LINE + 2)), start=1):
        if len(line) > MAX_LINE + 1:
            raise SceneError(f"{path}: line {number}: found more than {MAX_LINE} bytes, expected at most as many")
        try:
            yield line.rstrip(b"\r\n").decode("utf-8-sig" if number == 1 else "utf-8")
        except UnicodeDecodeError as error:
            raise SceneError(f"{path}: line {number}: {error}") from error


def entries(folder: Path) -> list[Path]:
    """The contents of a folder in the order of their names, without hidden ones. Raises SceneError without a folder."""
    try:
        return sorted(entry for entry in folder.iterdir() if not entry.name.startswith("."))
    except OSError as error:
        raise SceneError(f"{folder}: {error}") from error


def find_folder(path: Path, what: str, is_one: Callable[[Path], bool]) -> Path:
    """`path` or a folder in it, whichever is the only one. what: it is, in the plural. Raises SceneError."""
    if not path.is_dir():
        raise SceneError(f"{path}: no such folder")
    return only(path, what, [folder for folder in (path, *entries(path)) if folder.is_dir() and is_one(folder)])


def find_file(path: Path, what: str, is_one: Callable[[Path], bool]) -> Path:
    """The file `path`, or the only one in that folder. what: it is, in the plural. Raises SceneError."""
    if not path.is_dir() and not path.is_file():
        raise SceneError(f"{path}: no such file or folder")
    return path if path.is_file() else only(path, what, [file for file in entries(path) if is_one(file)])


def only(path: Path, what: str, matches: Sequence[Path]) -> Path:
    """The only match. path: where it was searched; what: it is, in the plural. Raises SceneError for none or more."""
    if len(matches) != 1:
        names = ", ".join(match.name for match in matches[:_MAX_NAMES]) or "none"
        raise SceneError(f"{path}: found {len(matches)} {what} ({names}), expected one; add its name to the path")
    return matches[0]


def choose_name(place: Path, parameter: str, names: Iterable[str], value: str | None) -> str:
    """One of the names: the value of a parameter, or the only one if that is None. place: for the message

    Raises SceneError without names, and ConfigurationError for another value, or for none if there are several.
    """
    names = sorted(names)
    known = ", ".join(names[:_MAX_NAMES]) + (", …" if len(names) > _MAX_NAMES else "")
    if not names:
        raise SceneError(f"{place}: found no {parameter}, expected at least one")
    if value is None and len(names) > 1:
        raise ConfigurationError(f"{place}: {parameter} is not given, expected one of {len(names)}: {known}")
    if value is not None and value not in names:
        hint = nearest(value, names)
        raise ConfigurationError(f"{place}: unknown {parameter} {value!r}{hint}, expected one of {len(names)}: {known}")
    return names[0] if value is None else value


def _opened(path: Path) -> IO[bytes]:
    if path.exists() and not path.is_file():  # a pipe would be waited for
        raise OSError("not a regular file")
    with path.open("rb") as file:
        start = file.read(len(_GZIP))
    return cast("IO[bytes]", gzip.open(path, "rb")) if start == _GZIP else path.open("rb")


_MAX_SHOWN = 80  # characters of a value in a message
_SHORT = reprlib.Repr()  # also of a value that is nested deeply, or that aliases repeat
_SHORT.maxstring = _SHORT.maxlong = _SHORT.maxother = _MAX_SHOWN
_MAX_SHEAR = 1e-2  # of a rotation matrix, per element of its product with its transpose; files round

#: Types of values for `Element.read`, beside those of Python.
Coordinate = Annotated[float, Meta(ge=-MAX_COORDINATE_M, le=MAX_COORDINATE_M)]
Point = tuple[Coordinate, Coordinate, Coordinate]
Side = Annotated[float, Meta(gt=0, le=MAX_SIZE_M)]
Size = tuple[Side, Side, Side]
Angle = Annotated[float, Meta(ge=-1e4, le=1e4)]  # rad
Speed = Annotated[float, Meta(ge=-200, le=200)]  # m/s
Seconds = Annotated[float, Meta(ge=-9e9, le=9e9)]  # to the year 2255; more nanoseconds are no 64 bit number
Whole = Annotated[int, Meta(ge=0, le=10**15)]
Count = Annotated[int, Meta(ge=0, le=2**31 - 1)]
Name = str | Annotated[int, Meta(ge=0, le=2**63 - 1)]
_Row = tuple[Coordinate, Coordinate, Coordinate, Coordinate]


class Element:
    """A value in a file: the type that it is read as decides what is accepted.

    value: as decoded; path: of the file; place: of the value in it, such as "$.frames[3].objects[7]"

    All methods raise SceneError, which names file, place, and what was expected.
    """

    def __init__(self, value: Any, path: Path, place: str = "$") -> None:
        self.value = value
        self.path = path
        self.place = place

    def fail(self, expected: str) -> NoReturn:
        """Raise SceneError: this value is not what was expected."""
        self._refuse(self.place, f"expected {expected}")

    def read(self, kind: Any) -> Any:
        """This value as a type that msgspec knows; text of a number is a number, too."""
        try:
            return msgspec.convert(self.value, kind, strict=False)
        except (msgspec.ValidationError, UnicodeEncodeError) as error:
            reason, _, inner = str(error).partition(" - at `")
            self._refuse(self.place + inner.strip("$`"), reason[0].lower() + reason[1:])

    def __getitem__(self, key: str) -> Element:
        """The value under a key of an object."""
        members = self._object()
        if key not in members:
            known = [str(name) for name in list(members)[:_MAX_NAMES]]
            raise SceneError(f"{self.path}: {self.place}: {key} is missing{nearest(key, known)}")
        return Element(members[key], self.path, f"{self.place}.{key}")

    def get(self, key: str) -> Element | None:
        """The value under a key of an object; None if it has none, or null."""
        return self[key] if self._object().get(key) is not None else None

    def members(self) -> Iterator[tuple[str, Element]]:
        """Keys and values of an object, in the order of the file."""
        for key in self._object():
            yield str(key), Element(self.value[key], self.path, f"{self.place}.{key}")

    def elements(self) -> list[Element]:
        """The values of a list."""
        listed = self.value if isinstance(self.value, list) else self.fail("a list")
        return [Element(value, self.path, f"{self.place}[{index}]") for index, value in enumerate(listed)]

    def several(self, key: str) -> list[Element]:
        """The values under a key of an object, if there is a list; otherwise its only value, if it has one."""
        value = self.get(key)
        return [] if value is None else value.elements() if isinstance(value.value, list) else [value]

    def text(self, choices: Collection[str] = ()) -> str:
        """Text, one of the choices if there are any."""
        text: str = self.read(str)
        return text if not choices or text in choices else self.fail(f"one of {', '.join(choices)}")

    def rotation(self) -> Floats:
        """(3, 3) rotation matrix, made exactly orthonormal."""
        return orthonormal(np.array(self.read(tuple[Point, Point, Point])), self)

    def rigid(self) -> tuple[Floats, Floats]:
        """Position (3,) m and rotation (3, 3) of a 4 x 4 matrix."""
        matrix = np.array(self.read(tuple[_Row, _Row, _Row, _Row]))
        if np.abs(matrix[3] - _LAST).max() > _MAX_SHEAR:
            self.fail("a 4 x 4 matrix whose last row is 0, 0, 0, 1")
        return matrix[:3, 3], orthonormal(matrix[:3, :3], self)

    def _refuse(self, place: str, reason: str) -> NoReturn:
        shown = _SHORT.repr(self.value)
        shown = shown if len(shown) <= _MAX_SHOWN else shown[:_MAX_SHOWN] + "…"
        raise SceneError(f"{self.path}: {place}: found {shown}, {reason}")

    def _object(self) -> dict[Any, Any]:
        return self.value if isinstance(self.value, dict) else self.fail("an object with named values")


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


def closed_outline(corners: Floats, element: Element) -> Floats:
    """(k, 2) m, the corners of a polygon, without repeating the first. element: where it is from, for the message"""
    if len(corners) > 1 and np.array_equal(corners[0], corners[-1]):
        corners = corners[:-1]
    return corners if len(corners) >= 3 else element.fail(f"3 different corners or more, not {len(corners)}")


def read_json(path: Path) -> Element:
    """The content of a JSON file. Raises SceneError if it is missing, too large or not JSON."""
    try:
        return Element(msgspec.json.decode(read_text(path)), path)
    except (msgspec.DecodeError, RecursionError) as error:
        raise SceneError(f"{path}: not JSON: {error}") from error


_LAST = np.array([0.0, 0.0, 0.0, 1.0])
_ROUNDING = 1e-6  # of the last row of a matrix, and of a symmetric one


def read_listed_pose(element: Element) -> tuple[Floats, Floats]:
    """Position (3,) m and rotation (3, 3) of a 4 x 4 matrix: a list of 4 rows, or of 16 numbers.

    Writers of lists disagree on their order. It is by rows if the last four numbers are 0, 0, 0, 1, and by columns if
    every fourth number is. Both are true without a translation: then the matrix must be symmetric, or be 4 rows.
    """
    if not isinstance(element.value, list) or len(element.value) not in (4, 16):
        element.fail("4 rows of 4 numbers, or 16 numbers")
    if len(element.value) == 4:
        return element.rigid()
    matrix = np.array(element.read(list[Coordinate])).reshape(4, 4)
    by_rows, by_columns = (bool(np.abs(end - _LAST).max() <= _ROUNDING) for end in (matrix[3], matrix[:, 3]))
    if not by_rows and not by_columns:
        element.fail("16 numbers of a 4 x 4 matrix whose last row is 0, 0, 0, 1")
    if by_rows and by_columns and np.abs(matrix - matrix.T).max() > _ROUNDING:
        element.fail("4 rows of 4 numbers: without a translation, the order of 16 numbers cannot be known")
    rows = matrix if by_rows else matrix.T
    return Element(rows.tolist(), element.path, element.place).rigid()


_MAX_YAML_BYTES = 10_000_000  # of one file
_MAX_DEPTH = 32  # libyaml has no limit, and a process ends if its stack is full
_MAX_VALUES = 1_000_000  # of one file; PyYAML needs up to 700 bytes for each
_MAX_NUMBERS = 64  # of an array


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]  # the C library is optional
    """Knows the tags that are added below, and no others. Numbers stay text: `Element.read` takes both."""

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


_sequence, _mapping = (
    partial(construct, deep=True) for construct in (_Loader.construct_sequence, _Loader.construct_mapping)
)


def _numpy(build: Callable[..., Any]) -> Callable[[_Loader, Any], Any]:
    """A constructor that calls `build` with the arguments of a NumPy object, and with its state, if it has one."""

    def construct(loader: _Loader, node: Any) -> Any:
        try:
            is_mapping = isinstance(node, yaml.MappingNode)
            parts = _mapping(loader, node) if is_mapping else {"args": _sequence(loader, node)}
            return build(*parts["args"], *parts.get("state", ()))
        except Exception as error:  # of NumPy, which raises many kinds
            raise ConstructorError(None, None, f"found no NumPy value: {error}", node.start_mark) from None

    return construct


def _dtype(code: str, align: Any, copy: Any, version: Any = 3, order: str = "<", *_: Any) -> Any:
    """The type of an array's numbers."""
    return np.dtype("<" + code if order in "=|" else order + code)  # written on machines that are little-endian


def _numbers(dtype: Any, data: bytes, count: int = 1) -> Any:
    if len(data) != count * dtype.itemsize:
        raise ValueError(f"{len(data)} bytes, expected {count} of {dtype.itemsize}")
    return np.frombuffer(data, dtype)


def _array(
    kind: Any, _: Any, __: Any, version: str, lengths: list[str], dtype: Any, by_columns: str, data: bytes
) -> Any:
    """Nested lists of the numbers of an array; a single number of one without axes."""
    shape = [*map(int, lengths)]
    if math.prod(max(length, 1) for length in shape) > _MAX_NUMBERS:
        raise ValueError(f"an array of shape {shape!s:.40}, expected at most {_MAX_NUMBERS} numbers")
    return _numbers(dtype, data, math.prod(shape)).reshape(shape, order="F" if by_columns == "true" else "C").tolist()


_YAML, _APPLY = "tag:yaml.org,2002:", "tag:yaml.org,2002:python/object/apply:numpy."
_CONSTRUCTORS: dict[str | None, Callable[..., Any]] = {
    None: SafeConstructor.construct_undefined,  # refuses all other tags
    _YAML + "null": SafeConstructor.construct_yaml_null,
    _YAML + "str": SafeConstructor.construct_yaml_str,
    _YAML + "seq": _sequence,
    _YAML + "map": _mapping,
    # What PyYAML writes of tuples, and of NumPy's numbers and arrays.
    _YAML + "binary": SafeConstructor.construct_yaml_binary,
    _YAML + "python/tuple": _sequence,
    _YAML + "python/name:numpy.ndarray": lambda loader, node: None,
    _APPLY + "dtype": _numpy(_dtype),
}
for _core in ("core.multiarray.", "_core.multiarray."):
    _CONSTRUCTORS[_APPLY + _core + "scalar"] = _numpy(lambda *parts: _numbers(*parts).item())
    _CONSTRUCTORS[_APPLY + _core + "_reconstruct"] = _numpy(_array)
for _tag, _construct in _CONSTRUCTORS.items():
    _Loader.add_constructor(_tag, _construct)
_Loader.add_implicit_resolver(_YAML + "null", re.compile(r"(~|null|Null|NULL|)\Z"), ["", *"~nN"])


def read_yaml(path: Path) -> Element:
    """The content of a YAML file.

    Raises SceneError if it is missing, too large, not YAML, too deep, or has a key twice or a tag that is not known.
    """
    try:
        size = path.stat().st_size
        if size > _MAX_YAML_BYTES:
            raise SceneError(f"{path}: found {size} bytes, expected at most {_MAX_YAML_BYTES}")
        return Element(yaml.load(read_text(path), Loader=_Loader), path)
    except (yaml.YAMLError, OSError, ValueError, TypeError, LookupError, ArithmeticError) as error:
        reason = " ".join(str(error).split()).replace('in "<unicode string>",', "at")
        raise SceneError(f"{path}: not YAML that is known: {reason}") from error


_MAX_PARTS = 500_000  # elements within one that is read


class XmlElement(Element):
    """An element of an XML file.

    value: its attributes and its children, by name: of a child alone its value, of several with a tag a list of these;
           of a child with neither attributes nor children its text, without space around it
    """

    def __init__(self, tag: str, attributes: dict[str, Any], path: Path, line: int) -> None:
        super().__init__(attributes, path, f"line {line}: <{tag}>")
        self.tag = tag
        self.pieces: list[str] = []

    def refuse(self, reason: str) -> NoReturn:
        """Raise SceneError with file, line, tag and reason."""
        raise SceneError(f"{self.path}: {self.place}: {reason}")

    def add(self, child: XmlElement) -> None:
        """Add a child that is complete."""
        value = child.value or "".join(child.pieces).strip()
        before = self.value.get(child.tag)
        if isinstance(before, list):
            before.append(value)
        else:
            self.value[child.tag] = value if before is None else [before, value]


class XmlHandler(ContentHandler):
    """What is done with the elements of a file. path: of the file; parser: where it is in it"""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self.parser = DefusedExpatParser(forbid_dtd=True)
        self.parser.setContentHandler(self)

    @property
    def line(self) -> int:
        """Number of the line that is parsed."""
        return int(self.parser.getLineNumber())

    def parse(self, max_bytes: int) -> Iterator[None]:
        """Parse the file, compressed by gzip or not, piece by piece.

        Raises SceneError if it is not XML, too large, or has a document type declaration: nothing that is read needs
        one, and entities could expand without limit.
        """
        try:
            for piece in read_pieces(self.path, max_bytes):
                self.parser.feed(piece)
                yield
            self.parser.feed(b"", True)
            yield
        except SAXParseException as error:
            raise SceneError(f"{self.path}: line {self.line}: not XML: {error.getMessage()}") from error
        except DefusedXmlException:
            reason = "found a document type declaration (DOCTYPE), expected none: entities are not expanded"
            raise SceneError(f"{self.path}: line {self.line}: {reason}") from None
        except (ValueError, LookupError) as error:  # an encoding that is unknown or not supported
            raise SceneError(f"{self.path}: line {self.line}: not XML: {error}") from error


def read_xml(
    path: Path, root: str | None, tags: Collection[str] | None, max_bytes: int = MAX_FILE_BYTES
) -> Iterator[XmlElement]:
    """The root of an XML file, without its children; then each element with one of the tags, when it is complete.

    root: the tag expected of the root; None: any; tags: of nested elements, only the outermost are yielded; None: all

    Raises SceneError as `XmlHandler.parse` does, and if the file has another root or an element is too large.
    """
    builder = _Builder(path, root, tags)
    for _ in builder.parse(max_bytes):
        yield from builder.complete
        builder.complete.clear()


def has_root(path: Path, root: str) -> bool:
    """Whether a file named *.xml*, compressed or not, begins with this root."""
    return path.is_file() and ".xml" in path.suffixes and f"<{root}".encode() in next(read_pieces(path), b"")


class _Builder(XmlHandler):
    """Collects elements that are complete."""

    def __init__(self, path: Path, root: str | None, tags: Collection[str] | None) -> None:
        super().__init__(path)
        self._root = root
        self._tags = tags
        self._seen_root = False
        self._parts = 0
        self._open: list[XmlElement] = []
        self.complete: list[XmlElement] = []

    def startElement(self, tag: str, attributes: AttributesImpl) -> None:
        element = XmlElement(tag, dict(attributes.items()), self.path, self.line)
        if not self._seen_root:
            self._seen_root = True
            if self._root is not None and tag != self._root:
                element.refuse(f"found this root, expected <{self._root}>")
            self.complete.append(element)
        elif self._open:
            self._parts += 1
            if self._parts > _MAX_PARTS:
                self._open[0].refuse(f"found more than {_MAX_PARTS} elements in it, expected at most as many")
            self._open.append(element)
        elif self._tags is None or tag in self._tags:
            self._parts = 0
            self._open.append(element)

    def endElement(self, tag: str) -> None:
        if self._open:
            element = self._open.pop()
            if self._open:
                self._open[-1].add(element)
            else:
                self.complete.append(element)

    def characters(self, text: str) -> None:
        if self._open:
            self._open[-1].pieces.append(text)

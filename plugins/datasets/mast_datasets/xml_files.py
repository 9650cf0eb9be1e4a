"""Reads XML files safely: in one pass, within limits, and without document types or entities."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

from mast_datasets.files import TextElement, read_pieces
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.detection_tables import MAX_FILE_BYTES

_MAX_DEPTH = 50
_MAX_PARTS = 500_000  # elements within one that is read
_MAX_CHARACTERS = 20_000_000  # of attributes and text within one that is read
_MAX_NAMES = 12  # of elements or attributes in a message


class XmlElement:
    """An element of an XML file, with its attributes, its children and its line in the file.

    All methods raise SceneError, which names file, line, what was found and what was expected.
    """

    def __init__(self, tag: str, attributes: dict[str, str], path: Path, line: int) -> None:
        self.tag = tag
        self.attributes = attributes
        self.path = path
        self.line = line
        self.children: list[XmlElement] = []
        self.pieces: list[str] = []

    @property
    def place(self) -> str:
        """Line and tag, such as "line 7: <vehicle>"."""
        return f"line {self.line}: <{self.tag}>"

    def fail(self, reason: str) -> NoReturn:
        """Raise SceneError with file, line, tag and reason."""
        raise SceneError(f"{self.path}: {self.place}: {reason}")

    def attribute(self, name: str) -> TextElement:
        """The value of an attribute."""
        value = self.get_attribute(name)
        if value is None:
            known = ", ".join(list(self.attributes)[:_MAX_NAMES]) or "none"
            self.fail(f"attribute {name} is missing; found {known}")
        return value

    def get_attribute(self, name: str) -> TextElement | None:
        """The value of an attribute; None if there is none."""
        value = self.attributes.get(name)
        return None if value is None else TextElement(value, self.path, f"{self.place}: {name}")

    def child(self, tag: str) -> XmlElement:
        """The only child with a tag."""
        match = self.get_child(tag)
        if match is None:
            known = ", ".join(dict.fromkeys(child.tag for child in self.children[:_MAX_NAMES])) or "none"
            self.fail(f"<{tag}> is missing; found {known}")
        return match

    def get_child(self, tag: str) -> XmlElement | None:
        """The only child with a tag; None if there is none."""
        matches = [child for child in self.children if child.tag == tag]
        if len(matches) > 1:
            self.fail(f"found <{tag}> {len(matches)} times, expected it once")
        return matches[0] if matches else None

    @property
    def text(self) -> TextElement:
        """The text in the element, without space around it."""
        return TextElement("".join(self.pieces).strip(), self.path, self.place)


def read_xml(
    path: Path, root: str | None, tags: Collection[str], max_bytes: int = MAX_FILE_BYTES
) -> Iterator[XmlElement]:
    """The root of an XML file, without its children; then each element with one of the tags, when it is complete.

    root: the tag expected of the root; None: any; tags: only the outermost of nested elements are yielded

    The file may be compressed by gzip. Raises SceneError if it is not XML, too large or nested too deeply, has another
    root, or a document type declaration: nothing that is read needs one, and entities could expand without limit.
    """
    builder = _Builder(path, root, tags)
    parser = builder.parser
    try:
        for piece in read_pieces(path, max_bytes):
            parser.Parse(piece, False)
            yield from builder.take()
        parser.Parse(b"", True)
    except expat.ExpatError as error:
        message = expat.errors.messages.get(error.code, str(error))
        raise SceneError(f"{path}: line {error.lineno}: not XML: {message}") from error
    except (ValueError, LookupError) as error:  # an encoding that is unknown or not supported
        raise SceneError(f"{path}: line {parser.CurrentLineNumber}: not XML: {error}") from error
    yield from builder.take()


def has_root(path: Path, root: str) -> bool:
    """Whether a file named *.xml*, compressed or not, begins with this root."""
    return path.is_file() and ".xml" in path.suffixes and f"<{root}".encode() in next(read_pieces(path), b"")


class _Builder:
    """Collects elements from the events of a parser."""

    def __init__(self, path: Path, root: str | None, tags: Collection[str]) -> None:
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._text
        self.parser.StartDoctypeDeclHandler = self._refuse
        self._path = path
        self._root = root
        self._tags = tags
        self._depth = 0
        self._parts = 0
        self._characters = 0
        self._open: list[XmlElement] = []
        self._complete: list[XmlElement] = []

    def take(self) -> list[XmlElement]:
        """The elements that are complete, once."""
        complete, self._complete = self._complete, []
        return complete

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        element = XmlElement(tag, attributes, self._path, self.parser.CurrentLineNumber)
        self._depth += 1
        if self._depth > _MAX_DEPTH:
            element.fail(f"found more than {_MAX_DEPTH} nested elements, expected at most as many")
        if self._depth == 1:
            if self._root is not None and tag != self._root:
                element.fail(f"found this root, expected <{self._root}>")
            self._complete.append(element)
        elif self._open:
            self._parts += 1
            self._count(sum(map(len, attributes.values())))
            if self._parts > _MAX_PARTS:
                self._open[0].fail(f"found more than {_MAX_PARTS} elements in it, expected at most as many")
            self._open[-1].children.append(element)
            self._open.append(element)
        elif tag in self._tags:
            self._parts = 0
            self._characters = 0
            self._open.append(element)
            self._count(sum(map(len, attributes.values())))

    def _end(self, tag: str) -> None:
        self._depth -= 1
        if self._open:
            element = self._open.pop()
            if not self._open:
                self._complete.append(element)

    def _text(self, text: str) -> None:
        if self._open:
            self._open[-1].pieces.append(text)
            self._count(len(text))

    def _count(self, characters: int) -> None:
        self._characters += characters
        if self._characters > _MAX_CHARACTERS:
            self._open[0].fail(f"found more than {_MAX_CHARACTERS} characters in it, expected at most as many")

    def _refuse(self, *_: object) -> None:
        raise SceneError(
            f"{self._path}: line {self.parser.CurrentLineNumber}: found a document type declaration (DOCTYPE), "
            "expected none: entities are not expanded"
        )

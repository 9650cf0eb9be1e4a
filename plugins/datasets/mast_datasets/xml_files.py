"""Reads XML files in one pass, by defusedxml: without document types or entities."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, NoReturn
from xml.sax import SAXParseException
from xml.sax.handler import ContentHandler
from xml.sax.xmlreader import AttributesImpl

from defusedxml import DefusedXmlException  # type: ignore[import-untyped]
from defusedxml.expatreader import DefusedExpatParser  # type: ignore[import-untyped]

from mast_datasets.files import Element, read_pieces
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.detection_tables import MAX_FILE_BYTES

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

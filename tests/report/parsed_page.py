"""A page as tests read it."""

import base64
from html.parser import HTMLParser
from pathlib import Path


class Page(HTMLParser):
    """Tags, loading or linking attributes, images and visible text of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.images: list[dict[str, str | None]] = []
        self.rows: list[tuple[str, str]] = []
        self.ids: list[str] = []
        self.text = ""
        self.source = path.read_text("utf-8")
        self.feed(self.source)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        attributes = dict(attrs)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data", "action")]
        if "id" in attributes:
            self.ids.append(attributes["id"] or "")
        if tag == "img":
            self.images.append(attributes)
        if tag == "tr":
            self.rows.append((attributes.get("class") or "", ""))

    def handle_data(self, data: str) -> None:
        self.text += data
        if self.rows:
            kind, so_far = self.rows[-1]
            self.rows[-1] = kind, so_far + data

    @property
    def embedded(self) -> list[bytes]:
        return [base64.b64decode((image["src"] or "").partition(",")[2]) for image in self.images]

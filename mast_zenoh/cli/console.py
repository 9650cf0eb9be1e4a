"""What `mast` prints on: consoles of Rich that show no control characters of others."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

#: Control characters except tab and line feed, and characters that change the direction of text.
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
_ESCAPES = {code: chr(code).encode("unicode_escape").decode() for code in range(0x2070) if _CONTROL.match(chr(code))}


def escaped(text: str) -> str:
    """A line from a node, without characters that control a terminal: `\\x1b` instead of an escape."""
    return text.translate(_ESCAPES)


class PlainConsole(Console):
    """A console that replaces control characters, from a node's output or a file, by �."""

    def print(self, *objects: Any, **options: Any) -> None:
        super().print(*(_CONTROL.sub("�", text) if isinstance(text, str) else text for text in objects), **options)

    def plain(self, text: object) -> None:
        """Print a line as it is, without markup."""
        self.print(str(text), markup=False, highlight=False)

    def warn(self, text: str, label: str = "") -> None:
        """Print a line as a warning."""
        self.print(f"{label}warning: {text}", style="bold yellow", markup=False, highlight=False)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=_CONTROL.sub("�", segment.text))

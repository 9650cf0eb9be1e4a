"""Values that files hold as text (XML, CSV, tables), checked like those of JSON."""

from __future__ import annotations

import math
import re
from typing import NoReturn

from mast_zenoh.scenes.files.elements import Element

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

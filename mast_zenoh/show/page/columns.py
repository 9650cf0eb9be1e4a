"""Packs columns of integers into few bytes, for a page that unpacks them in the browser.

A column is written as differences (where neighbours are alike), folded to non-negative numbers, and split into planes:
first the lowest byte of every number, then the next. Planes of small differences are mostly zeros, so deflate removes
them. The page's `js/run.js` is the reader.
"""

from __future__ import annotations

import json
import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Of deflate: higher levels take four times as long and save less than a tenth.
_LEVEL = 6
_LIMIT = 1 << 31


class Packer:
    """Columns on their way into a block."""

    def __init__(self) -> None:
        self.entries: list[dict[str, Any]] = []
        self._planes: list[bytes] = []

    def add(self, name: str, values: NDArray[Any], *, scale: float = 1.0, differences: bool = True) -> None:
        """Add a column.

        values: any shape, finite; read back as round(values / scale) * scale, in row order
        scale:  resolution, in the unit of the values
        differences: store each number's difference from the one before
        Raises ValueError if a number does not fit into 31 bits.
        """
        rounded = np.rint(np.asarray(values, np.float64).ravel() / scale)
        if not np.isfinite(rounded).all() or (len(rounded) and np.abs(rounded).max() >= _LIMIT // 2):
            raise ValueError(f"{name}: expected finite numbers below {scale * _LIMIT / 2:g}")
        whole = rounded.astype(np.int64)
        steps = np.diff(whole, prepend=0) if differences else whole
        folded = np.where(steps < 0, -2 * steps - 1, 2 * steps).astype("<u4")
        width = next(size for size in (1, 2, 3, 4) if not len(folded) or int(folded.max()) < 1 << (8 * size))
        planes = folded.view(np.uint8).reshape(-1, 4)[:, :width]
        self._planes.append(np.ascontiguousarray(planes.T).tobytes())
        entry = {"name": name, "rows": len(whole), "width": width, "scale": scale, "differences": differences}
        self.entries.append(entry)

    def block(self, header: dict[str, Any]) -> bytes:
        """The compressed block: length of the header, header as JSON, planes."""
        text = json.dumps({**header, "columns": self.entries}, separators=(",", ":"), allow_nan=False).encode()
        return zlib.compress(struct.pack("<I", len(text)) + text + b"".join(self._planes), _LEVEL)

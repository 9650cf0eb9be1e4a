"""Reads blocks as the page does."""

from __future__ import annotations

import json
import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray


def unpack(block: bytes) -> tuple[dict[str, Any], dict[str, NDArray[np.float64]]]:
    """The header and the columns of a block: what the page reads."""
    content = zlib.decompress(block)
    (length,) = struct.unpack_from("<I", content)
    header, at = json.loads(content[4 : 4 + length]), 4 + length
    columns = {}
    for entry in header["columns"]:
        rows, width = entry["rows"], entry["width"]
        planes = np.frombuffer(content, np.uint8, rows * width, at).reshape(width, rows)
        folded = sum((plane.astype(np.int64) << (8 * i) for i, plane in enumerate(planes)), np.zeros(rows, np.int64))
        steps = np.where(folded % 2, -(folded + 1) // 2, folded // 2)
        columns[entry["name"]] = (np.cumsum(steps) if entry["differences"] else steps) * entry["scale"]
        at += rows * width
    return header, columns

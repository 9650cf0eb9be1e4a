"""Columns of text: their size when every row gets its own copy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow

#: Limit on the unpacked size of a table, bytes.
MAX_TABLE_BYTES = 400_000_000


def longest(column: Any) -> int:
    """Bytes of the longest text of a chunked column, which may be a dictionary.

    Raises ArrowInvalid if it is a column of something else, or not UTF-8.
    """
    kind = column.type
    if pyarrow.types.is_dictionary(kind):
        kind = kind.value_type
    if pyarrow.types.is_null(kind):
        return 0
    known = (pyarrow.types.is_string, pyarrow.types.is_large_string, pyarrow.types.is_binary)
    if not any(is_known(kind) for is_known in known):
        raise pyarrow.ArrowInvalid(f"found a column of {column.type}, expected text")
    texts = (chunk.dictionary if pyarrow.types.is_dictionary(column.type) else chunk for chunk in column.chunks)
    return max((_longest(part) for part in texts), default=0)


def _longest(part: Any) -> int:
    """Bytes of the longest text of an array; a Python object for each text would take ten times its size."""
    part.validate(full=True)
    wide = pyarrow.types.is_large_string(part.type)
    offsets = part.buffers()[1]
    if len(part) == 0 or offsets is None:
        return 0
    ends = np.frombuffer(offsets, np.int64 if wide else np.int32, len(part) + 1, part.offset * (8 if wide else 4))
    return int(np.diff(ends).max())


def check_expanded(column: Any, max_bytes: int = MAX_TABLE_BYTES) -> int:
    """Bytes of a column of text as a NumPy array, where each row is as wide as the longest.

    Raises ArrowInvalid if they are more than `max_bytes`, or if it is no text.
    """
    size = 4 * len(column) * longest(column)
    if size > max_bytes:
        raise pyarrow.ArrowInvalid(
            f"{len(column)} rows of up to {longest(column)} characters: found {size} bytes unpacked, "
            f"expected at most {max_bytes}"
        )
    return size

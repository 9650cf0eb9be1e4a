"""Columns of text: their size when every row gets its own copy."""

from __future__ import annotations

from typing import Any

import pyarrow

#: Limit on the unpacked size of a table, bytes.
MAX_BYTES = 400_000_000


def longest(column: Any) -> int:
    """Characters of the longest text of a chunked column, which may be a dictionary.

    Raises ArrowInvalid if it is a column of something else.
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
    try:
        return max((len(text) for part in texts for text in part.to_pylist() if text is not None), default=0)
    except UnicodeDecodeError as error:
        raise pyarrow.ArrowInvalid(f"found text that is not UTF-8: {error}") from None


def check_expanded(column: Any, max_bytes: int = MAX_BYTES) -> int:
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

"""Digest of the sources from which the kernels are compiled."""

import hashlib
from pathlib import Path


def digest() -> str:
    """Digest of the kernels' sources, 16 hexadecimal digits; compiled into them."""
    folder = Path(__file__).parent
    result = hashlib.blake2b(digest_size=8)
    for path in sorted([*folder.glob("*.p[yx][xd]"), folder / "table_columns.py"]):
        result.update(path.read_bytes())
    return result.hexdigest()

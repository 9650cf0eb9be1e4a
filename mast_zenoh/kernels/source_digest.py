"""What the compiled kernels were made from."""

import hashlib
from pathlib import Path


def digest() -> str:
    """Of the sources that lie beside this file; the build puts it into what it compiles."""
    found = hashlib.blake2b(digest_size=8)
    for path in sorted(Path(__file__).parent.glob("*.p[yx][xd]")):
        found.update(path.read_bytes())
    return found.hexdigest()

"""Where the reference data are that some tests need."""

import os
from pathlib import Path

import pytest


def reference(name: str) -> Path:
    """A file or folder of the reference data; skips if it is missing."""
    root = Path(os.environ.get("MAST_DATA") or Path(__file__).parents[4] / "shared" / "data")
    if not (root / name).exists():
        pytest.skip(f"no reference data: {root / name} is missing (set MAST_DATA)")
    return root / name

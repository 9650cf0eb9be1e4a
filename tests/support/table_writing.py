"""Writes tables as runs have them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pyarrow import parquet

from mast_zenoh.run_folder.tables import to_arrow


def write_table(path: Path, columns: Mapping[str, Any]) -> None:
    """Write columns as a Parquet file."""
    parquet.write_table(to_arrow(columns), path)

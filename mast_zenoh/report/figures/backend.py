"""Imports Matplotlib whatever MPLBACKEND says: figures of reports need no screen, and a wrong name ends the import."""

from __future__ import annotations

import contextlib
import os


def _import_matplotlib() -> None:
    chosen = os.environ.pop("MPLBACKEND", None)
    try:
        import matplotlib
    finally:
        if chosen is not None:
            os.environ["MPLBACKEND"] = chosen
    if chosen:
        with contextlib.suppress(ValueError):
            matplotlib.rcParams["backend"] = chosen  # for a user's own figures in this process


_import_matplotlib()

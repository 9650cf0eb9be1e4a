"""The figures of reports and of studies. All drawing code is here.

Matplotlib is imported here first, without MPLBACKEND, whose value could make the import fail.
"""

from __future__ import annotations

import contextlib
import os


def _import_matplotlib() -> None:
    user_backend = os.environ.pop("MPLBACKEND", None)
    try:
        import matplotlib
    finally:
        if user_backend is not None:
            os.environ["MPLBACKEND"] = user_backend
    if user_backend:
        with contextlib.suppress(ValueError):
            matplotlib.rcParams["backend"] = user_backend  # for a user's own figures in this process


_import_matplotlib()

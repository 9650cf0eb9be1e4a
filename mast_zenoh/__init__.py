"""mast-zenoh: the Multi-Agent Security Testbed as real processes on an Eclipse Zenoh mesh.

    import mast_zenoh as mast
    run = mast.run("uncoordinated", n_adversaries=2, frames=60, seed=3)
    run.plot.over_time("fp")

docs/python.md shows the whole API, docs/stability.md says what stays. A name is imported at its first use: processes
of nodes import this package too, and need none of them.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False  # as type checkers know it; `typing` itself takes longer to import than all of this
if TYPE_CHECKING:
    from typing import Any

    from mast_zenoh.api.catalogue import Listing as Listing
    from mast_zenoh.api.catalogue import list_kind as list
    from mast_zenoh.api.comparisons import Comparison as Comparison
    from mast_zenoh.api.comparisons import compare as compare
    from mast_zenoh.api.execution import open_run as open
    from mast_zenoh.api.execution import run as run
    from mast_zenoh.api.runs import Run as Run
    from mast_zenoh.api.scenes import PreparedScene as PreparedScene
    from mast_zenoh.api.scenes import prepare as scene
    from mast_zenoh.errors import MastError as MastError
    from mast_zenoh.study.interface import FinishedStudy as FinishedStudy
    from mast_zenoh.study.interface import carry_out as study
    from mast_zenoh.version import __version__ as __version__

#: By public name, the module that has it, and its name there. `study` is not among them: the package of that name can
#: be called (see mast_zenoh/study/__init__.py).
_PLACES = {
    "Comparison": ("mast_zenoh.api.comparisons", "Comparison"),
    "FinishedStudy": ("mast_zenoh.study.interface", "FinishedStudy"),
    "Listing": ("mast_zenoh.api.catalogue", "Listing"),
    "MastError": ("mast_zenoh.errors", "MastError"),
    "PreparedScene": ("mast_zenoh.api.scenes", "PreparedScene"),
    "Run": ("mast_zenoh.api.runs", "Run"),
    "__version__": ("mast_zenoh.version", "__version__"),
    "compare": ("mast_zenoh.api.comparisons", "compare"),
    "list": ("mast_zenoh.api.catalogue", "list_kind"),
    "open": ("mast_zenoh.api.execution", "open_run"),
    "run": ("mast_zenoh.api.execution", "run"),
    "scene": ("mast_zenoh.api.scenes", "prepare"),
}

__all__ = [
    "Comparison",
    "FinishedStudy",
    "Listing",
    "MastError",
    "PreparedScene",
    "Run",
    "__version__",
    "compare",
    "list",
    "open",
    "run",
    "scene",
    "study",
]


def __getattr__(name: str) -> Any:
    if name == "study":
        return importlib.import_module("mast_zenoh.study")
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _PLACES[name]
    value = getattr(importlib.import_module(module), attribute)
    globals()[name] = value
    return value


def __dir__() -> Any:
    return sorted({*globals(), *__all__})

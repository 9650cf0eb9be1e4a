"""mast-zenoh: a Multi-Agent Security Testbed on an Eclipse Zenoh mesh.

Nodes are real processes.

    import mast_zenoh as mast
    run = mast.run("uncoordinated", n_adversaries=2, frames=60, seed=3)
    run.plot.over_time("fp")

docs/how-to-python.md shows the whole API, docs/stability.md lists what is stable. Names are imported on first use,
because processes of nodes import this package too and do not need them.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False  # known to type checkers; importing `typing` would take longer than the rest of this module
if TYPE_CHECKING:
    from typing import Any

    from mast_zenoh.api.catalogue import Listing as Listing
    from mast_zenoh.api.catalogue import list_kind as list
    from mast_zenoh.api.runs import OpenedRun as Run
    from mast_zenoh.api.runs import run as run
    from mast_zenoh.api.scenes import PreparedScene as PreparedScene
    from mast_zenoh.api.scenes import prepare as scene
    from mast_zenoh.errors import MastError as MastError
    from mast_zenoh.show.compare import Comparison as Comparison
    from mast_zenoh.show.compare import compare as compare
    from mast_zenoh.study.finished import FinishedStudy as FinishedStudy
    from mast_zenoh.study.finished import open_folder as open
    from mast_zenoh.study.interface import carry_out as study
    from mast_zenoh.version import __version__ as __version__

#: (module, name in it) by public name. `study` is missing because the package of that name is callable
#: (see mast_zenoh/study/__init__.py).
_PLACES = {
    "Comparison": ("mast_zenoh.show.compare", "Comparison"),
    "FinishedStudy": ("mast_zenoh.study.finished", "FinishedStudy"),
    "Listing": ("mast_zenoh.api.catalogue", "Listing"),
    "MastError": ("mast_zenoh.errors", "MastError"),
    "PreparedScene": ("mast_zenoh.api.scenes", "PreparedScene"),
    "Run": ("mast_zenoh.api.runs", "OpenedRun"),
    "__version__": ("mast_zenoh.version", "__version__"),
    "compare": ("mast_zenoh.show.compare", "compare"),
    "list": ("mast_zenoh.api.catalogue", "list_kind"),
    "open": ("mast_zenoh.study.finished", "open_folder"),
    "run": ("mast_zenoh.api.runs", "run"),
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

"""Compiled versions of small functions that run for every message and track.

    @kernel
    def predict(tracks, dt, noise):
        ...                             # NumPy: the reference, used if there is no compiled version

`predict` is then the function of that name in one of the `.pyx` files of this folder, if it was compiled from the
current sources. The environment variable MAST_KERNELS=numpy disables compiled kernels; MAST_KERNELS=compiled requires
them.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from typing import Any, TypeVar

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.kernels.source_digest import digest

Function = TypeVar("Function", bound=Callable[..., Any])

#: The files with kernels.
MODULES = ("attacks", "boxes", "clusters", "columns", "frames", "matching", "medians", "pairs", "rays", "tracks")


def _load() -> dict[str, Callable[..., Any]]:
    """The compiled functions by name; empty if any is missing or outdated."""
    try:
        modules = [importlib.import_module(f"{__name__}.{name}") for name in MODULES]
    except ImportError:
        return {}
    if {module.DIGEST for module in modules} != {digest()}:
        return {}
    return {name: function for module in modules for name, function in vars(module).items() if callable(function)}


_WANTED = os.environ.get("MAST_KERNELS", "")
if _WANTED not in ("", "numpy", "compiled"):
    raise ConfigurationError(f"environment variable MAST_KERNELS: found {_WANTED!r}, expected numpy or compiled")
COMPILED = _load()
if _WANTED == "compiled" and not COMPILED:
    raise ConfigurationError("environment variable MAST_KERNELS: compiled kernels wanted, but none were built")
#: "compiled" or "numpy", whichever is in use.
USED = "compiled" if COMPILED and _WANTED != "numpy" else "numpy"
#: The references by name.
REFERENCES: dict[str, Callable[..., Any]] = {}


def kernel(reference: Function) -> Function:
    """The compiled function with the name of `reference`, or `reference` itself."""
    name = reference.__name__
    assert name not in REFERENCES, f"two kernels are called {name}"
    REFERENCES[name] = reference
    return COMPILED[name] if USED == "compiled" else reference  # type: ignore[return-value]

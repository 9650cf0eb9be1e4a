"""Compiled versions of small functions that run for every message and track.

    @kernel
    def predict(tracks, dt, noise):
        ...                             # NumPy: the reference, used if there is no compiled version

`predict` is then the function of that name in one of the `.pyx` files of this folder, if it was compiled from the
current sources. A function that has no NumPy version raises `missing`. The environment variable MAST_KERNELS=numpy
disables compiled kernels; MAST_KERNELS=compiled requires them.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.kernels.source_digest import digest

Function = TypeVar("Function", bound=Callable[..., Any])

#: The files with kernels.
MODULES = tuple(sorted(path.stem for path in Path(__file__).parent.glob("*.pyx")))

#: The build writes here why it compiled no kernels: a reason, and the compiler's last line.
NOT_COMPILED = Path(__file__).with_name("not_compiled.txt")

#: How to get compiled kernels.
HOW = "install mast-zenoh again (in a checkout: make kernels), with gcc and python3-dev installed"


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


def why_not(folder: Path = Path(__file__).parent) -> str:
    """Why compiled kernels are not in use; "" if they are. folder: with the kernels"""
    if USED == "compiled":
        return ""
    if COMPILED:
        return "MAST_KERNELS=numpy disables them"
    import platform  # only needed here
    from importlib.machinery import EXTENSION_SUFFIXES

    name = MODULES[0]
    files = [path.name for suffix in ("so", "pyd") for path in sorted(folder.glob(f"{name}*.{suffix}"))]
    if any(f"{name}{suffix}" in files for suffix in EXTENSION_SUFFIXES):
        return "their sources have changed since they were compiled, or they cannot be loaded"
    if files:
        python = f"{platform.python_implementation()} {platform.python_version()} on {platform.machine()}"
        return f"they were compiled for another Python ({files[0]}), this is {python}"
    note = folder / NOT_COMPILED.name
    reason = note.read_text(encoding="utf-8", errors="replace").strip() if note.is_file() else ""
    return reason or "this installation was made without compiling them"


def notice() -> str:
    """A line that says why compiled kernels are not in use, and how to get them; "" if they are."""
    reason = why_not()
    if not reason:
        return ""
    return f"compiled kernels are not used, which is slower: {reason}" + ("" if COMPILED else f"; to get them, {HOW}")


def remedy() -> str:
    """What to do to use compiled kernels."""
    return "unset MAST_KERNELS" if COMPILED else HOW


def missing(what: str) -> ConfigurationError:
    """The error of what has no NumPy version; what: the subject of its sentence"""
    reason = f"which are not used: {why_not()}; to use them, {remedy()}"
    return ConfigurationError(f"{what} needs compiled kernels, {reason}")


#: The references by name.
REFERENCES: dict[str, Callable[..., Any]] = {}


def kernel(reference: Function) -> Function:
    """The compiled function with the name of `reference`, or `reference` itself."""
    name = reference.__name__
    assert name not in REFERENCES, f"two kernels are called {name}"
    REFERENCES[name] = reference
    return COMPILED[name] if USED == "compiled" else reference  # type: ignore[return-value]

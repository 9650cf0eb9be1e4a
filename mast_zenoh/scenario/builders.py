"""Functions that build Stone Soup trackers, named in a scenario as `builder="FILE.py:FUNCTION"`."""

from __future__ import annotations

import re
from collections.abc import Iterator, MutableMapping
from pathlib import Path
from types import ModuleType
from typing import Any

from mast_zenoh.config import loading, registry
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.tracking import StoneSoupTracker
from mast_zenoh.tracking.stone_soup_tracker import INSTALL

_FUNCTION = re.compile(r"(?P<file>.+\.py):(?P<name>\w+)")


def load_builders(scenario: Any, path: Path) -> tuple[Path, ...]:
    """Load the files of all builders in a scenario, and give their absolute paths to it.

    path: of the scenario. A file is searched in its folder, then in the current one.

    Returns the files. Raises ConfigurationError for a missing file or function.
    """
    files = []
    for parent, place in _named(scenario, ""):
        match = _FUNCTION.fullmatch(parent["builder"])
        assert match is not None
        found = [folder / match["file"] for folder in (path.parent, Path()) if (folder / match["file"]).is_file()]
        if not found:
            raise ConfigurationError(f"{path}: {place}: no file {match['file']!r} next to it or in the current folder")
        file = found[0].resolve()
        functions = {name for name, value in vars(_module(file)).items() if callable(value)}
        if match["name"] not in functions:
            raise ConfigurationError(
                f"{path}: {place}: {file} defines no function {match['name']!r}{nearest(match['name'], functions)}"
            )
        parent["builder"] = f"{file}:{match['name']}"
        files.append(file)
    return tuple(dict.fromkeys(files))


def _module(file: Path) -> ModuleType:
    try:
        return loading.module(file)
    except ConfigurationError as error:
        missing = error.__cause__.name if isinstance(error.__cause__, ModuleNotFoundError) else None
        if (missing or "").partition(".")[0] == "stonesoup":
            raise ConfigurationError(f"{error}: {INSTALL}") from None
        raise


def _named(value: Any, place: str) -> Iterator[tuple[MutableMapping[str, Any], str]]:
    """(dict, path of its `builder`) of all trackers that name a function, in nested dicts and lists."""
    if isinstance(value, MutableMapping):
        is_tracker = str(value.get("type")) in registry.known_types(StoneSoupTracker)
        if is_tracker and isinstance(builder := value.get("builder"), str) and _FUNCTION.fullmatch(builder):
            yield value, f"{place}.builder".lstrip(".")
        for key, item in value.items():
            yield from _named(item, f"{place}.{key}")
    elif isinstance(value, (list, tuple)):
        for index, item in enumerate(value):
            yield from _named(item, f"{place}[{index}]")

"""Finds deployment engines: built-in ones by name, one of a plugin by its class, a user's by its file.

A built-in engine is loaded only when it is used: its dependencies may be missing. One of a
user is a subclass of `Engine` in a file: FILE.py, or FILE.py:CLASS if there are several.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from mast_zenoh.config import loading, plugins, registry, settings
from mast_zenoh.errors import ConfigurationError, EngineError, nearest
from mast_zenoh.launch.engine import Engine

_BUILT_IN = {"compose": ("compose", "Compose"), "ssh": ("ssh.engine", "Ssh")}
#: What serves instead of an engine that there is no more.
_GONE = {"swarm": "--engine compose runs the nodes on this machine, --engine ssh on several (docs/how-to-hosts.md)"}
#: How an engine in a user's file is named.
FILE = re.compile(r"(.*\.py)(?::(\w+))?")


def names() -> tuple[str, ...]:
    """The names of our engines and of those in plugins."""
    return (*_BUILT_IN, *_of_plugins())


def load(name: str) -> type[Engine]:
    """The engine of this name, or in this file.

    Raises EngineError, PluginError, and ConfigurationError for a file that cannot be loaded.
    """
    if match := FILE.fullmatch(name):
        return _of_file(Path(match[1]), match[2])
    if name in _BUILT_IN:
        module, kind = _BUILT_IN[name]
        try:
            engine: type[Engine] = getattr(import_module(f"mast_zenoh.deploy.{module}"), kind)
        except ModuleNotFoundError as error:
            if error.name != "asyncssh":
                raise
            raise EngineError("asyncssh is not installed: pip install 'mast-zenoh[deploy]'") from None
        return engine
    if name in _GONE:
        raise EngineError(f"engine {name} is gone: {_GONE[name]}")
    found = _of_plugins()
    if name not in found:
        raise plugins.not_found(f"there is no engine {name!r}", name, (*_BUILT_IN, *found), EngineError)
    found[name].name = name
    return found[name]


def _of_plugins() -> dict[str, type[Engine]]:
    plugins.load()
    return {name: kind for name, kind in registry.known_types(Engine).items() if plugins.plugin_of(kind)}


def _of_file(file: Path, name: str | None) -> type[Engine]:
    if not file.is_file():
        raise EngineError(
            f"{file}: no such file, expected one that defines a subclass of mast_zenoh.launch.engine.Engine"
        )
    module = loading.module(file)
    known = loading.concrete([module], Engine)
    classes: dict[str, type[Engine]] = {each.__name__: each for each in known if each.__module__ == module.__name__}
    if name is None and len(classes) != 1:
        engines = ", ".join(sorted(classes)) or "none"
        raise EngineError(f"{file}: found the engines {engines}, expected one, or --engine {file}:NAME")
    if name is not None and name not in classes:
        raise EngineError(f"{file}: defines no engine {name!r}{nearest(name, classes)}")
    return classes[name] if name else next(iter(classes.values()))


def options(kind: type[Engine], words: Sequence[str]) -> dict[str, Any]:
    """An engine's parameters from `--option KEY=VALUE`; raises ConfigurationError."""
    takes = inspect.signature(kind, eval_str=True).parameters
    for word in words:
        key, _ = settings.key_and_value(word, "--option")
        if key.partition(".")[0] not in takes:
            raise ConfigurationError(f"--option {word}: engine {kind.name} has no such parameter{nearest(key, takes)}")
    values = settings.nested(words)
    paths = {key for key, value in values.items() if isinstance(value, str) and takes[key].annotation is Path}
    return values | {key: Path(values[key]) for key in paths}


def make(kind: type[Engine], values: Mapping[str, Any]) -> Engine:
    """An engine with these parameters; raises ConfigurationError for wrong types."""
    made: Engine = registry.construct(kind, values, f"engine {kind.name}")
    return made

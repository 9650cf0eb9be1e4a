"""Short names of scenes, such as `intersection:2` and `av2:PATH`, and the recognition of their files."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

from mast_zenoh import scenes
from mast_zenoh.config import plugins, registry
from mast_zenoh.errors import ConfigurationError, PluginError, SceneError, nearest

#: Short names of scenes of our plugin for data sets, with their classes, for the error if it is not installed.
_DATA_SETS = {data_set.short_name: name for name, data_set in plugins.DATA_SETS.items()}


def short_names() -> dict[str, type[scenes.Scene]]:
    """All scenes with a short name, by that name; also those of plugins."""
    plugins.load()
    return _known()


def has_short_name(text: str) -> bool:
    """Whether a text begins with the short name of a scene."""
    name, colon, _ = text.partition(":")
    return name in _known() or name in _DATA_SETS or (colon != "" and name in short_names())


def parse_scene(text: str) -> dict[str, Any]:
    """The configuration of a scene from its short name.

    A short name, a colon and a value: a path, or of `intersection` an index, which it does not need.
    Raises ConfigurationError, listing the known names, for anything else.
    """
    name, colon, argument = text.partition(":")
    known = _known()
    if name not in known:
        known = short_names()
    if name not in known and name in _DATA_SETS:
        raise plugins.not_found(f"scene {text!r}", _DATA_SETS[name])
    if name not in known:
        forms = "NAME:PATH, intersection or intersection:INDEX"
        raise plugins.not_found(f"scene {text!r}: unknown name {name!r}{nearest(name, known)}; expected {forms}", "")
    cls = known[name]
    takes = inspect.signature(cls).parameters[cls.short_argument]
    if takes.default is takes.empty:
        if not argument:
            raise ConfigurationError(f"scene {text!r}: no path, expected {name}:PATH")
        return {"type": cls.__name__, takes.name: argument}
    if colon and not argument.isdecimal():
        raise ConfigurationError(f"scene {text!r}: {argument!r} is not an index, expected {name}:INDEX, 0 or more")
    return {"type": cls.__name__} | ({takes.name: int(argument)} if colon else {})


def recognised(scene: str) -> str:
    """A scene's short name, such as av2:PATH, from a short name, a file or a folder.

    Raises ConfigurationError for a name that is neither, and SceneError for a file or folder of no known type, or of
    several.
    """
    name, colon, _ = scene.partition(":")
    path = Path(scene)
    if (colon or not path.exists()) and has_short_name(scene):
        return scene
    known = short_names()
    if not path.exists():
        raise ConfigurationError(f"scene {scene!r}: no such file or folder, and no short name{nearest(name, known)}")
    kinds = [short for short, cls in known.items() if cls.recognises(path)]
    if len(kinds) > 1:
        raise SceneError(f"{path}: found files of {' and of '.join(kinds)}; name one of them, {kinds[0]}:{path}")
    if not kinds:
        entries = sorted(entry.name for entry in path.iterdir())[:8] if path.is_dir() else [path.name]
        found = ", ".join(entries) or "nothing"
        message = f"{path}: found {found}; expected the files of one of {', '.join(short for short in known)}"
        if missing := sorted(_DATA_SETS.keys() - known.keys()):
            message += f"; readers of {', '.join(missing)} are in the plugin mast-zenoh-datasets"
        raise SceneError(message)
    return f"{kinds[0]}:{path}"


def _known() -> dict[str, type[scenes.Scene]]:
    """The scenes that are loaded by short name. Raises PluginError if two have the same one."""
    known: dict[str, type[scenes.Scene]] = {}
    for cls in registry.known_types(scenes.Scene).values():
        assert issubclass(cls, scenes.Scene)
        if not (short := vars(cls).get("short_name")):  # that of a base class names the base
            continue
        if (other := known.get(short)) is not None:
            raise PluginError(
                f"scene {short!r}: found this short name in {other.__module__}.{other.__name__} and "
                f"{cls.__module__}.{cls.__name__}, expected different ones"
            )
        known[short] = cls
    return known

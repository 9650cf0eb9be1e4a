"""Short names of scenes, such as `intersection:2` and `av2:PATH`, and the recognition of their files."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

from mast_zenoh import scenes
from mast_zenoh.config import plugins, registry
from mast_zenoh.errors import ConfigurationError, SceneError, nearest

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

    A short name, a colon and a value: a path, or a whole number, which may be left out.
    Raises ConfigurationError, listing the known names, for anything else.
    """
    name, colon, argument = text.partition(":")
    known = _known()
    if name not in known:
        known = short_names()
    if name not in known and name in _DATA_SETS:
        raise plugins.not_found(f"scene {text!r}", _DATA_SETS[name])
    if name not in known:
        forms = {short_form(cls).replace(f"{short}:PATH", "NAME:PATH") for short, cls in known.items()}
        problem = f"scene {text!r}: unknown name {name!r}, expected one of {', '.join(sorted(forms))}"
        raise plugins.not_found(problem, name, known)
    cls = known[name].named(argument)
    takes = inspect.signature(cls).parameters.get(cls.short_argument)
    if takes is None:
        where = f"{cls.__module__}.{cls.__name__}.short_argument"
        expected = f"expected one of its parameters{nearest(cls.short_argument, inspect.signature(cls).parameters)}"
        raise ConfigurationError(f"scene {text!r}: {where} is {cls.short_argument!r}, {expected}")
    if takes.default is takes.empty:
        if not argument:
            raise ConfigurationError(f"scene {text!r}: no {takes.name}, expected {short_form(cls)}")
        return {"type": cls.__name__, takes.name: argument}
    if colon and not argument.isdecimal():
        expected = f"expected {short_form(cls)}, 0 or more"
        raise ConfigurationError(f"scene {text!r}: {argument!r} is not a whole number, {expected}")
    return {"type": cls.__name__} | ({takes.name: int(argument)} if colon else {})


def short_form(cls: type[scenes.Scene]) -> str:
    """How a scene with a short name is written: `av2:PATH`."""
    return f"{cls.short_name}:{cls.short_argument.upper()}"


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
        problem = f"scene {scene!r}: no such file or folder, and no short name"
        if name.isidentifier():
            raise plugins.not_found(problem, name, known)
        raise ConfigurationError(f"{problem}{nearest(name, known)}")
    kinds = [short for short, cls in known.items() if cls.recognises(path)]
    if len(kinds) > 1:
        raise SceneError(f"{path}: found files of {' and of '.join(kinds)}; name one of them, {kinds[0]}:{path}")
    if not kinds:
        entries = sorted(entry.name for entry in path.iterdir())[:8] if path.is_dir() else [path.name]
        found = ", ".join(entries) or "nothing"
        of_files = ", ".join(short for short, cls in known.items() if _reads_files(cls))
        message = f"{path}: found {found}; expected the files of one of {of_files}"
        if not plugins.is_installed(project := plugins.DATA_SETS_PLUGIN):
            message += (
                f"; readers of {', '.join(_DATA_SETS)} are in the plugin {project}: {plugins.command_for(project)}"
            )
        raise SceneError(message)
    return f"{kinds[0]}:{path}"


def _known() -> dict[str, type[scenes.Scene]]:
    """The scenes that are loaded by short name, of which that of a base class names the base."""
    classes = registry.known_types(scenes.Scene).values()
    return {short: cls for cls in classes if (short := vars(cls).get("short_name"))}


def _reads_files(cls: type[scenes.Scene]) -> bool:
    return bool(cls.files) or cls.recognises.__func__ is not scenes.Scene.recognises.__func__  # type: ignore[attr-defined]

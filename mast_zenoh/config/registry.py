"""Builds objects from dicts: `dict(type="ClassName", parameter=…)`.

`type` may also be the class itself.

Any subclass of a base can be named where that base is expected; there is nothing to register. A package imports
all its modules that define algorithms, so that they exist as soon as their base does; those of plugins are found when
no other class has a name. Parameters are checked
against the class's `__init__`: unknown names, missing ones and wrong types raise an error with their path.

Short names of scenes, such as `intersection:2` and `av2:PATH`, and the recognition of their files.
"""

from __future__ import annotations

import inspect
import types
import typing
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

from mast_zenoh import scenes
from mast_zenoh.config import plugins
from mast_zenoh.errors import ConfigurationError, SceneError, nearest

_Signature = tuple[dict[str, inspect.Parameter], dict[str, Any]]


class ClassName(str):
    """A class name that also holds the class, from `type=MyAttack`; a name in JSON."""

    cls: type

    def __new__(cls, named: type) -> ClassName:
        name = super().__new__(cls, named.__name__)
        name.cls = named
        return name


def own_copy(value: Any) -> Any:
    """A deep copy of nested dicts and lists, with classes in `type` as ClassName."""
    if isinstance(value, dict):
        return {
            key: ClassName(item) if key == "type" and isinstance(item, type) else own_copy(item)
            for key, item in value.items()
        }
    return type(value)(map(own_copy, value)) if type(value) in (list, tuple) else value


def type_names(value: Any) -> Iterator[str]:
    """The values of `type` in nested dicts and lists; some are of type ClassName."""
    if isinstance(value, Mapping) and isinstance(value.get("type"), str):
        yield value["type"]
    for item in value.values() if isinstance(value, Mapping) else value if isinstance(value, (list, tuple)) else ():
        yield from type_names(item)


def known_types(base: type, name: object = None) -> dict[str, type]:
    """The concrete classes that can be named where `base` is expected, by name.

    name: one that is looked up; if no loaded class has it, plugins are loaded first
    """
    classes = _concrete(base, plugins.refused_packages())
    if not isinstance(name, str) or name in classes:
        return classes
    plugins.load()
    return _concrete(base, plugins.refused_packages())


def _concrete(base: type, refused: Collection[str]) -> dict[str, type]:
    """Concrete classes by name. refused: packages whose classes do not count"""
    if refused and base.__module__.partition(".")[0] in refused:
        return {}
    classes: dict[str, type] = {} if inspect.isabstract(base) else {base.__name__: base}
    subclasses: list[type] = base.__subclasses__()
    for subclass in subclasses:
        classes |= _concrete(subclass, refused)
    return classes


def build(spec: object, base: type, path: str) -> Any:
    """Build the object that `spec` describes, of a subclass of `base`.

    path: of the spec in its scenario. Raises ConfigurationError, which names the path.
    """
    if not isinstance(spec, Mapping):
        raise ConfigurationError(f"{path}: found {spec!r}, expected a dict(type=…) naming a {base.__name__}")
    classes = known_types(base, spec.get("type"))
    if "type" not in spec:
        default = [name for name, cls in classes.items() if plugins.plugin_of(cls) is None]
        if len(default) != 1:
            raise ConfigurationError(f"{path}: no type given{nearest('', classes)}")
        spec = {"type": default[0], **spec}
    name = ClassName(spec["type"]) if isinstance(spec["type"], type) else spec["type"]
    if isinstance(name, ClassName) and issubclass(name.cls, base):
        classes = {name: name.cls}  # several classes may have this name
    if not isinstance(name, str) or name not in classes:
        for unfinished in plugins.subclasses(base):
            if unfinished.__name__ == name and inspect.isabstract(unfinished):
                methods = ", ".join(sorted(unfinished.__abstractmethods__))
                problem = f"{name} does not define {methods}, expected of every {base.__name__}"
                raise ConfigurationError(f"{path}.type: {problem}")
        raise plugins.not_found(f"{path}.type: no {base.__name__} named {name!r}", str(name), classes)
    return construct(classes[name], {key: value for key, value in spec.items() if key != "type"}, path)


def construct(cls: type, arguments: Mapping[str, Any], path: str) -> Any:
    """An object of `cls` from plain values; nested dicts are built by annotation."""
    parameters, hints = _signature(cls)
    for key in arguments:
        if key not in parameters:
            hint = nearest(str(key), parameters)
            raise ConfigurationError(f"{path}.{key}: {cls.__name__} has no such parameter{hint}")
    missing = [k for k, p in parameters.items() if p.default is p.empty and k not in arguments]
    if missing:
        raise ConfigurationError(f"{path}: {cls.__name__} needs {', '.join(missing)}")
    values = {key: built(value, hints.get(key, Any), f"{path}.{key}") for key, value in arguments.items()}
    try:
        return cls(**values)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from None
    except (ValueError, TypeError) as error:
        raise ConfigurationError(f"{path}: {cls.__name__}: {error}") from None


#: Cache of `_signature`. The keys are weak, so deleted classes are removed.
_SIGNATURES: WeakKeyDictionary[type, _Signature] = WeakKeyDictionary()


def parameters_of(cls: type) -> Mapping[str, inspect.Parameter]:
    """The parameters of a class by name, with those of base classes to which it passes `**others` on."""
    return _signature(cls)[0]


def _signature(cls: type) -> _Signature:
    """The parameters of a class, and their annotations.

    An `__init__` that passes `**others` on to its base class has the parameters of that one too.
    """
    if cls not in _SIGNATURES:
        own = inspect.signature(cls).parameters.values()
        parameters = {p.name: p for p in own if p.kind is not p.VAR_KEYWORD}
        line = [each for each in cls.__mro__[:-1] if "__init__" in vars(each)] or [object]
        # Fields that a dataclass inherits are annotated with names of the module of their own class.
        generated = "__dataclass_params__" in vars(line[0]) and getattr(line[0], "__dataclass_params__").init  # noqa: B009
        hints = typing.get_type_hints(line[0] if generated else vars(line[0])["__init__"])
        if len(parameters) < len(own) and len(line) > 1:
            inherited, of_inherited = _signature(line[1])
            parameters, hints = {**inherited, **parameters}, {**of_inherited, **hints}
        _SIGNATURES[cls] = parameters, hints
    return _SIGNATURES[cls]


def built(value: object, hint: Any, path: str) -> Any:
    """`value`, converted to the type that the annotation `hint` requires.

    path: of the value, for messages. Raises ConfigurationError for a value that is not of that type.
    """
    if hint is Any or (isinstance(hint, type) and hint not in (float, int) and isinstance(value, hint)):
        return value
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        options = typing.get_args(hint)
        if value is None and type(None) in options:
            return None
        options = tuple(option for option in options if option is not type(None))
        for option in options[:-1]:
            try:
                return built(value, option, path)
            except ConfigurationError:
                continue
        return built(value, options[-1], path)
    if origin is typing.Literal:
        if value not in typing.get_args(hint):
            known = [str(option) for option in typing.get_args(hint)]
            raise ConfigurationError(f"{path}: found {value!r}{nearest(str(value), known)}")
        return value
    if origin in (tuple, list):
        return _sequence(value, hint, path)
    if origin is dict or hint in (dict, Mapping) or origin is Mapping:
        items = _expect(value, Mapping, "a dict", path)
        (*_, of_value) = typing.get_args(hint) or (Any,)
        if typing.get_origin(of_value) is not tuple:
            return items
        return {key: built(item, of_value, f"{path}[{key!r}]") for key, item in items.items()}
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if hint in (int, float, str, bool):
        if type(value) is not hint:
            raise ConfigurationError(f"{path}: found {value!r}, expected {_PLAIN[hint]}")
        return value
    if isinstance(value, str) and hasattr(hint, "load"):
        return hint.load(Path(value))
    return build(value, hint, path)


_PLAIN = {int: "a whole number", float: "a number", str: "a string", bool: "True or False"}


def _sequence(value: object, hint: Any, path: str) -> Any:
    items = list(_expect(value, (list, tuple), "a list", path))
    arguments = typing.get_args(hint)
    if typing.get_origin(hint) is list or (len(arguments) == 2 and arguments[1] is Ellipsis):
        arguments = (arguments[0],) * len(items)
    if len(arguments) != len(items):
        raise ConfigurationError(f"{path}: found {len(items)} values, expected {len(arguments)}")
    converted = [
        built(item, item_hint, f"{path}[{i}]") for i, (item, item_hint) in enumerate(zip(items, arguments, strict=True))
    ]
    return converted if typing.get_origin(hint) is list else tuple(converted)


def _expect(value: object, kind: Any, expected: str, path: str) -> Any:
    if not isinstance(value, kind):
        raise ConfigurationError(f"{path}: found {value!r}, expected {expected}")
    return value


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
    classes = known_types(scenes.Scene).values()
    return {short: cls for cls in classes if (short := vars(cls).get("short_name"))}


def _reads_files(cls: type[scenes.Scene]) -> bool:
    return bool(cls.files) or cls.recognises.__func__ is not scenes.Scene.recognises.__func__  # type: ignore[attr-defined]

"""Loads the Python files that users write: scenarios, studies and nodes.

Which code that a run folder names may run: shipped files, and those that the user names or confirms.

A run folder is data. Its scenario names Python files, and reading one never runs them: `Resolved.read` turns every name
that is not allowed into an `UntrustedFile`, which can be shown but not opened.
"""

from __future__ import annotations

import difflib
import filecmp
import hashlib
import importlib.util
import inspect
import os
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any
from weakref import WeakKeyDictionary

from mast_zenoh.config import bundle, registry
from mast_zenoh.errors import ConfigurationError, NodeFileError, UntrustedCode, nearest, place_of
from mast_zenoh.node import Node, check_handlers


def module(path: Path) -> ModuleType:
    """Load the module in a file; loaded again after it or a sibling import changes.

    Files in the same folder can be imported by name, and shipped nodes, as in `from agent import Agent`; such imports
    are not kept. Raises ConfigurationError, with file and line, if it fails.
    """
    path = path.resolve()
    # Dataclasses look up their module in sys.modules. It gets a unique name there, so that a user's file called
    # `types.py` does not replace another module.
    name = _name_of(path)
    if name in sys.modules and _unchanged(sys.modules[name]):
        return sys.modules[name]
    if not path.is_file():
        raise ConfigurationError(f"{path}: no such file: expected a Python file")
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ConfigurationError(f"{path}: not a Python file, expected the suffix .py")
    loaded = importlib.util.module_from_spec(spec)
    sys.modules[name] = loaded
    before = set(sys.modules)
    folders = (path.parent, bundle.ROOT / "nodes")
    sys.path.insert(0, str(folders[0]))
    sys.path.append(str(folders[1]))
    try:
        spec.loader.exec_module(loaded)
    except Exception as error:
        del sys.modules[name]
        place = f"{path}:{error.lineno}" if isinstance(error, SyntaxError) else place_of(error, {name}) or f"{path}:0"
        if isinstance(error, ModuleNotFoundError) and error.name:
            raise ConfigurationError(f"{place}: {_missing_module(error.name, path)}") from error
        raise ConfigurationError(f"{place}: {type(error).__name__}: {error}") from error
    finally:
        for folder in folders:
            sys.path.remove(str(folder))
        files = [path]
        for sibling in set(sys.modules) - before - {name}:
            if _folder(sys.modules[sibling]) in folders:
                files.append(Path(sys.modules[sibling].__file__ or path))
                del sys.modules[sibling]
        _SOURCES[loaded] = {file: _changed_at(file) for file in files}
    return loaded


def _missing_module(name: str, path: Path) -> str:
    """Says what a file can import instead of a module that does not exist."""
    shipped = {file.removesuffix(".py") for file in bundle.names("scenarios")}
    siblings = {file.stem for file in path.parent.glob("*.py")} - {path.stem}
    found = f"no module {name!r}: expected an installed package, or a file in {path.parent}"
    if close := difflib.get_close_matches(name, shipped | siblings, n=1):
        found += "" if close[0] == name else f"; did you mean {close[0]!r}?"
        name = close[0]
    if name in shipped - siblings:
        found += (
            f"; to use the scenario {name!r} that comes with mast: "
            f'`from mast_zenoh.scenario import load`, `_, base = load("{name}")`'
        )
    return found


def _name_of(path: Path) -> str:
    """A unique name for a file's module in sys.modules."""
    return f"{path.stem.replace('.', '_')}_{hashlib.blake2b(os.fsencode(path), digest_size=6).hexdigest()}"


#: By loaded module: its source files, with time of change in ns and size.
_SOURCES: WeakKeyDictionary[ModuleType, dict[Path, tuple[int, int] | None]] = WeakKeyDictionary()


def _unchanged(loaded: ModuleType) -> bool:
    return all(_changed_at(file) == changed for file, changed in _SOURCES.get(loaded, {}).items())


def _changed_at(file: Path) -> tuple[int, int] | None:
    """(time of change in ns, size); None if there is no such file."""
    try:
        stat = file.stat()
    except OSError:
        return None
    return stat.st_mtime_ns, stat.st_size


def function(kind: str, name: str, function_name: str) -> tuple[Path, Callable[..., Any]]:
    """(file, function) for a path, or for the name of a shipped file of a kind."""
    path = Path(name)
    if not path.is_file():
        short = path.name if path.suffix == ".py" else f"{path.name}.py"
        shipped = bundle.find(kind, short) if path.parent.name in ("", kind) else None
        if shipped is None:
            if name and path.is_dir():
                raise ConfigurationError(f"{name}: is a folder, expected a Python file or the name of a shipped one")
            known = bundle.names(kind, path.parent if path.parent.is_dir() else None)
            hint = f"; did you mean {near[0]!r}?" if (near := difflib.get_close_matches(short, known, n=1)) else ""
            available = ", ".join(file_name.removesuffix(".py") for file_name in bundle.names(kind))
            raise ConfigurationError(f"{name}: no such file{hint}; {kind} that come with mast: {available}")
        path = shipped
    target = getattr(module(path), function_name, None)
    if not callable(target):
        raise ConfigurationError(f"{path}: defines no function `{function_name}`")
    return path.resolve(), target


def loaded_module(path: Path) -> ModuleType | None:
    """The up-to-date module of a file if it is loaded already, else None.

    Runs no code.
    """
    known = sys.modules.get(_name_of(path.resolve()))
    return known if known is not None and _unchanged(known) else None


def concrete(modules: Iterable[ModuleType], base: type) -> list[Any]:
    """The concrete subclasses of a base in users' modules, without built-in ones."""
    values = [value for each in modules for value in vars(each).values() if isinstance(value, type)]
    return [
        value
        for value in dict.fromkeys(values)
        if issubclass(value, base) and not inspect.isabstract(value) and not value.__module__.startswith("mast_zenoh.")
    ]


def class_name(text: str, base: type) -> str:
    """The name of a class from its name, FILE.py or FILE.py:CLASS; a file is loaded first.

    Raises ConfigurationError for a folder, and for a file without a subclass of `base`, or with several and no name.
    """
    file, _, name = text.partition(":")
    if not file.endswith(".py"):
        if not text.isidentifier() and Path(file).is_dir():
            raise ConfigurationError(f"{file}: is a folder, expected a class, FILE.py or FILE.py:CLASS")
        return text
    loaded = module(Path(file))
    known = {cls.__name__: cls for cls in concrete([loaded], base)}
    if not known:
        expected = f"expected a class derived from {base.__name__}"
        raise ConfigurationError(f"{file}: defines {_unsuitable(loaded, base)}, {expected}")
    if name and name not in known:
        raise ConfigurationError(f"{file}: defines no {base.__name__} named {name!r}{nearest(name, known)}")
    if not name and len(known) != 1:
        raise ConfigurationError(
            f"{file}: defines {len(known)} classes of type {base.__name__} ({', '.join(sorted(known))}): "
            "expected FILE.py:CLASS to choose one"
        )
    return name or next(iter(known))


def _unsuitable(loaded: ModuleType, base: type) -> str:
    """The classes of a module without a concrete subclass of `base`: `Convoy, a subclass of Attack`."""
    parts = []
    for cls in vars(loaded).values():
        if not isinstance(cls, type) or cls.__module__ != loaded.__name__ or not _is_derived(cls):
            continue
        if issubclass(cls, base):
            missing = ", ".join(sorted(getattr(cls, "__abstractmethods__", ())))
            parts.append(f"{cls.__name__} without {missing}, which every {base.__name__} has")
        else:
            ours = next(each for each in cls.__mro__[1:] if each.__module__.startswith("mast_zenoh."))
            parts.append(f"{cls.__name__}, a subclass of {ours.__name__}")
    return " and ".join(parts) or f"no {base.__name__}"


def defining_file(function: Callable[..., Any]) -> Path:
    """The file that defines a function.

    For a function of a notebook or script: its name in the folder of the notebook or script.
    """
    home = sys.modules.get(function.__module__)
    file = getattr(home, "__file__", None)
    if file and function.__module__ != "__main__":
        return Path(file).resolve()
    folder = Path(file).resolve().parent if file else Path()
    return folder / getattr(function, "__name__", "scenario").strip("<>")


def file_of_class(cls: type) -> Path | None:
    """The file of a class for other processes; None for notebooks and scripts."""
    file = getattr(sys.modules.get(cls.__module__), "__file__", None)
    return Path(file).resolve() if file and cls.__module__ != "__main__" else None


def class_defined_elsewhere(name: str, path: Path) -> type | None:
    """A class of this name from a loaded file, unless `path` or a file that it imports defines one.

    A scenario that is made from another one, by `scenario.load`, uses classes of a file that it does not import.
    """
    imported = _SOURCES.get(module(path), {}) if path.suffix else {}
    newest = None
    for loaded in list(_SOURCES):
        cls = vars(loaded).get(name)
        if isinstance(cls, type) and cls.__module__ == loaded.__name__ and _is_derived(cls):
            if file_of_class(cls) in imported:
                return None
            newest = cls
    return newest


def session_classes() -> dict[str, type]:
    """Classes that `type=…` can name and that a notebook or script defines, by name."""
    classes = [value for value in vars(sys.modules["__main__"]).values() if isinstance(value, type)]
    return {cls.__name__: cls for cls in classes if cls.__module__ == "__main__" and _is_derived(cls)}


def _is_derived(cls: type) -> bool:
    """Whether a class derives from one of this package."""
    return any(base.__module__.startswith("mast_zenoh.") for base in cls.__mro__[1:])


def defines_algorithms(loaded: ModuleType) -> bool:
    """Whether a user's module, or a sibling that it imports, defines algorithms."""
    classes = [value for value in vars(loaded).values() if isinstance(value, type)]
    for value in vars(loaded).values():
        if isinstance(value, ModuleType) and _folder(value) == _folder(loaded):
            classes += [item for item in vars(value).values() if isinstance(item, type)]
    return any(not cls.__module__.startswith("mast_zenoh.") and _is_derived(cls) for cls in classes)


def _folder(loaded: ModuleType) -> Path | None:
    """The folder of a module's file; None for built-in and namespace packages."""
    file = getattr(loaded, "__file__", None)
    return Path(file).parent if file else None


_nodes: dict[tuple[str, str | None], type[Node]] = {}


#: Placeholder for the file of a node class that a notebook or script defines.
SESSION = Path("__main__")


def node_file(name: object) -> Path | None:
    """The file of a node class that a scenario names without its file; None: unknown.

    name: the class or its name

    Raises NodeFileError for a class whose handlers do not fit its ports.
    """
    named = {cls.__name__: cls for cls in registry.known_types(Node).values() if cls.__module__ == "__main__"}
    cls = name.cls if isinstance(name, registry.ClassName) else named.get(str(name))
    if cls is None:
        return None
    if not issubclass(cls, Node):
        raise NodeFileError(f"type={cls.__name__}: is not a node, expected a subclass of mast_zenoh.node.Node")
    file = file_of_class(cls)
    if file is None:
        _nodes[str(SESSION), cls.__name__] = _with_valid_handlers(cls, SESSION)
    return file or SESSION


def node_class(file: Path, name: str | None = None) -> type[Node]:
    """The node class in a file: the one called `name`, or the only one."""
    if name is not None and not isinstance(name, str):
        raise NodeFileError(f"{file}: type is {name!r}, expected the name of a node")
    known = _nodes.get((str(file), name))
    if file == SESSION and known is not None:
        return known
    loaded = module(file)
    if known is not None and _defines(loaded, known):
        return known
    classes = {
        key: value
        for key, value in vars(loaded).items()
        if isinstance(value, type) and issubclass(value, Node) and value.__module__ == loaded.__name__
    }
    if name is not None and name not in classes:
        raise NodeFileError(f"{file}: defines no node {name!r}{nearest(name, classes)}")
    if name is None and len(classes) != 1:
        raise NodeFileError(
            f"{file}: defines {len(classes)} nodes ({', '.join(sorted(classes))}): expected type=… to select one"
        )
    cls = classes[name] if name else next(iter(classes.values()))
    _nodes[str(file), name] = _with_valid_handlers(cls, file)
    return cls


def _defines(loaded: ModuleType, cls: type) -> bool:
    """Whether a module, as it is loaded now, defines a class."""
    return cls.__module__ == loaded.__name__ and getattr(loaded, cls.__name__, None) is cls


def _with_valid_handlers(cls: type[Node], file: Path) -> type[Node]:
    """A node class whose handlers fit its ports; raises NodeFileError for any other."""
    try:
        check_handlers(cls)
    except TypeError as error:
        raise NodeFileError(f"{file}: {error}") from None
    return cls


_KINDS = ("nodes", "scenarios", "studies")
#: Of nodes that play what was recorded; they are part of the package.
_PLAYER = ("mast_zenoh", "mesh", "player.py")


@dataclass(frozen=True)
class AllowedCode:
    """The code of a run folder that may run besides shipped files.

    files:     named by the user, on this command line
    confirmed: whether all files that the run folder names may run (`--trust`)
    announce:  gets a sentence with the names of these files before they run
    """

    files: frozenset[Path] = frozenset()
    confirmed: bool = False
    announce: Callable[[str], object] | None = None

    @classmethod
    def of(
        cls, *named: str | Path | None, confirmed: bool = False, announce: Callable[[str], object] | None = None
    ) -> AllowedCode:
        """Files that the user has named; None: none."""
        return cls(frozenset(Path(file).resolve() for file in named if file is not None), confirmed, announce)

    def files_in(self, origin: str, folder: Path | None, names: Iterable[str]) -> dict[str, str | UntrustedFile]:
        """By name in a scenario, the file to run, or an UntrustedFile.

        origin: where the scenario comes from, for messages;  folder: the run folder, None: none
        """
        shipped = {name: _shipped(name) for name in names}
        own = {name: _found(name, folder) for name, file in shipped.items() if file is None}
        allowed = {name: path for name, path in own.items() if self.confirmed or path.resolve() in self.files}
        if refused := [str(path) for name, path in own.items() if name not in allowed]:
            error = UntrustedCode(
                f"{origin}: names code that does not come with mast: {', '.join(sorted(refused))}: nothing of it was "
                "run; read it, and if you trust it, confirm it with --trust"
            )
            return {
                name: file or (str(allowed[name]) if name in allowed else UntrustedFile(name, error))
                for name, file in shipped.items()
            }
        confirmed = sorted(str(path) for path in allowed.values() if path.resolve() not in self.files)
        if confirmed and self.announce is not None:
            self.announce(f"--trust: running code that {origin} names: {', '.join(confirmed)}")
        return {name: file or str(allowed[name]) for name, file in shipped.items()}


#: Shipped files alone, and all of a run that this process is a part of.
SHIPPED, OWN_RUN = AllowedCode(), AllowedCode(confirmed=True)


class UntrustedFile(os.PathLike[str]):
    """The name of a Python file in a scenario that a third party may have written.

    It has a text, but is no path: everything that would open it raises UntrustedCode.
    """

    def __init__(self, name: str, error: UntrustedCode) -> None:
        self._name, self._error = name, error

    def __str__(self) -> str:
        return self._name

    def __fspath__(self) -> str:
        raise self._error


def _shipped(name: str) -> str | None:
    """The shipped file that a recorded name stands for, perhaps of another installation; None: it is a user's."""
    path = Path(name)
    if path == SESSION:  # a class of this session, which has run already
        return name
    if path.parts[-4:] == _PLAYER:
        return str(Path(__file__).parents[1].joinpath(*_PLAYER[1:]))
    known = [found for kind in _KINDS if (found := bundle.find(kind, path.name)) is not None]
    if not path.is_file():
        return next((str(found) for found in known if path.is_absolute()), None)
    return next((str(found) for found in known if filecmp.cmp(path, found, shallow=False)), None)


def _found(name: str, folder: Path | None) -> Path:
    """The file of a name: where it was in the run, or of the same name in the run folder."""
    path = Path(name)
    beside = None if folder is None else folder / path.name
    return (beside if beside is not None and not path.is_file() and beside.is_file() else path).absolute()

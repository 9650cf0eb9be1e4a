"""Loads the Python files that users write: scenarios, studies and nodes."""

from __future__ import annotations

import difflib
import hashlib
import importlib.util
import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from mast_zenoh.config import bundle
from mast_zenoh.errors import ConfigurationError, NodeFileError, nearest
from mast_zenoh.node import Node, handler_names


def module(path: Path) -> ModuleType:
    """Load a file as a module, once; it can import files beside it by name, which do not stay in sys.modules.

    Raises ConfigurationError, with file and line, when it fails.
    """
    path = path.resolve()
    # Dataclasses look their module up in sys.modules. It gets a unique name there, so that a user's file called
    # `types.py` replaces no other module.
    name = f"{path.stem.replace('.', '_')}_{hashlib.blake2b(os.fsencode(path), digest_size=6).hexdigest()}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ConfigurationError(f"{path}: not a Python file, expected the suffix .py")
    loaded = importlib.util.module_from_spec(spec)
    sys.modules[name] = loaded
    before = set(sys.modules)
    sys.path.insert(0, str(path.parent))
    try:
        spec.loader.exec_module(loaded)
    except Exception as error:
        del sys.modules[name]
        line = error.lineno if isinstance(error, SyntaxError) else _line(error, path)
        raise ConfigurationError(f"{path}:{line}: {type(error).__name__}: {error}") from error
    finally:
        sys.path.remove(str(path.parent))
        for sibling in set(sys.modules) - before:
            if _folder(sys.modules[sibling]) == path.parent:
                del sys.modules[sibling]
    return loaded


def function(kind: str, name: str, function_name: str) -> tuple[Path, Callable[..., Any]]:
    """(file, function) in a file of a kind; `name` is a path, or the name of a shipped file with or without .py."""
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


def defines_algorithms(loaded: ModuleType) -> bool:
    """Whether a user's module, or one beside it that it imports, adds classes that `type=…` can name."""
    classes = [value for value in vars(loaded).values() if isinstance(value, type)]
    for value in vars(loaded).values():
        if isinstance(value, ModuleType) and _folder(value) == _folder(loaded):
            classes += [item for item in vars(value).values() if isinstance(item, type)]
    return any(
        not cls.__module__.startswith("mast_zenoh.")
        and any(base.__module__.startswith("mast_zenoh.") for base in cls.__mro__[1:])
        for cls in classes
    )


def _folder(loaded: ModuleType) -> Path | None:
    """The folder of a module's file; None for built-in modules and namespace packages, which have no file."""
    file = getattr(loaded, "__file__", None)
    return Path(file).parent if file else None


_nodes: dict[tuple[str, str | None], type[Node]] = {}


def node_class(file: Path, name: str | None = None) -> type[Node]:
    """The node class in a file: the one called `name`, or the only one that the file defines."""
    if name is not None and not isinstance(name, str):
        raise NodeFileError(f"{file}: type is {name!r}, expected the name of a node")
    if (str(file), name) in _nodes:
        return _nodes[str(file), name]
    loaded = module(file)
    classes = {
        key: value
        for key, value in vars(loaded).items()
        if isinstance(value, type) and issubclass(value, Node) and value.__module__ == loaded.__name__
    }
    if name is not None and name not in classes:
        raise NodeFileError(f"{file}: defines no node {name!r}{nearest(name, classes)}")
    if name is None and len(classes) != 1:
        raise NodeFileError(f"{file}: defines {len(classes)} nodes ({', '.join(sorted(classes))}): say which by type=…")
    cls = classes[name] if name else next(iter(classes.values()))
    try:
        handler_names(cls)
    except TypeError as error:
        raise NodeFileError(f"{file}: {error}") from None
    _nodes[str(file), name] = cls
    return cls


def _line(error: Exception, path: Path) -> int:
    line, trace = 0, error.__traceback__
    while trace:
        if trace.tb_frame.f_code.co_filename == str(path):
            line = trace.tb_lineno
        trace = trace.tb_next
    return line

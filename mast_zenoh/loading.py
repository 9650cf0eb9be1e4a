"""Loads the Python files that users write: scenarios, studies and nodes."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from mast_zenoh import bundle
from mast_zenoh.errors import ConfigurationError, NodeFileError, nearest
from mast_zenoh.node import Node


def module(path: Path) -> ModuleType:
    """The module in a file. Files beside it can be imported by name; what it imports that way is not kept.

    Raises ConfigurationError, with file and line, when it fails.
    """
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    before = set(sys.modules)
    sys.path.insert(0, str(path.parent))
    try:
        spec.loader.exec_module(loaded)
    except Exception as error:
        line = error.lineno if isinstance(error, SyntaxError) else _line(error, path)
        raise ConfigurationError(f"{path}:{line}: {type(error).__name__}: {error}") from error
    finally:
        sys.path.remove(str(path.parent))
        for name in set(sys.modules) - before:
            file = getattr(sys.modules[name], "__file__", None)
            if file and Path(file).parent == path.parent:
                del sys.modules[name]
    return loaded


def function(kind: str, name: str, what: str) -> tuple[Path, Callable[..., Any]]:
    """(file, function) `what` in a file of a kind: a path, or the name of one of ours with or without .py."""
    path = Path(name)
    if not path.is_file():
        short = path.name if path.suffix == ".py" else f"{path.name}.py"
        ours = bundle.find(kind, short) if path.parent.name in ("", kind) else None
        if ours is None:
            hint = nearest(short, bundle.names(kind, path.parent if path.parent.is_dir() else None))
            raise ConfigurationError(f"{name}: no such file{hint}")
        path = ours
    found = getattr(module(path), what, None)
    if not callable(found):
        raise ConfigurationError(f"{path}: defines no function `{what}`")
    return path.resolve(), found


_nodes: dict[tuple[str, str | None], type[Node]] = {}


def node_class(file: Path, name: str | None = None) -> type[Node]:
    """The node class in a file: the one called `name`, or the only one that the file defines."""
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
    found = classes[name] if name else next(iter(classes.values()))
    _nodes[str(file), name] = found
    return found


def _line(error: Exception, path: Path) -> int:
    line, trace = 0, error.__traceback__
    while trace:
        if trace.tb_frame.f_code.co_filename == str(path):
            line = trace.tb_lineno
        trace = trace.tb_next
    return line

"""Damages of a data set: changes of text, of values in JSON and YAML, and of folders."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml

from mast_zenoh.errors import SceneError

#: In place of a value: remove it.
GONE = object()


class Damage(NamedTuple):
    """A change in a data set's folder. file: the one that a message names, "" if it names another place"""

    file: str
    apply: Callable[[Path], object]


def assert_refused(read: Callable[[Path], object], root: Path, damage: Damage, message: str) -> None:
    """The message of the refusal names the file before what it says."""
    damage.apply(root)
    with pytest.raises(SceneError, match=rf"{re.escape(damage.file)}.*{message}"):
        read(root)


def text(file: str, old: str, new: str, count: int = 1) -> Damage:
    """Replace text of a file, the first time that it occurs or more often."""

    def change(root: Path) -> None:
        content = (root / file).read_text()
        assert old in content
        (root / file).write_text(content.replace(old, new, count))

    return Damage(file, change)


def content(file: str, data: bytes) -> Damage:
    """Write a file."""

    def change(root: Path) -> None:
        (root / file).parent.mkdir(exist_ok=True)
        (root / file).write_bytes(data)

    return Damage(file, change)


def removed(pattern: str) -> Damage:
    """Remove files or empty folders."""
    return Damage("", lambda root: [path.rmdir() if path.is_dir() else path.unlink() for path in root.glob(pattern)])


def value(file: str, place: str, new: Any) -> Damage:
    """Put a value at a place in a JSON or YAML file, such as "[0].3d_location.x"; "": the whole.

    new: GONE removes it; a function makes it from the old one
    """
    is_json = file.endswith(".json")

    def change(root: Path) -> None:
        old = (root / file).read_text()
        whole = [json.loads(old) if is_json else yaml.load(old, Loader=yaml.CSafeLoader)]
        put(whole, f"[0].{place}", new)
        (root / file).write_text(json.dumps(whole[0]) if is_json else yaml.dump(whole[0], Dumper=yaml.CDumper))

    return Damage(file, change)


def put(whole: Any, place: str, new: Any) -> None:
    """Put a value at a place in nested lists and dicts, as `value` does."""
    *steps, last = re.findall(r"[^.\[\]]+", place)
    for step in steps:
        whole = whole[_key(whole, step)]
    key = _key(whole, last)
    if new is GONE:
        del whole[key]
    else:
        whole[key] = new(whole[key]) if callable(new) else new


def _key(holder: Any, step: str) -> Any:
    return step if step in holder or not step.isdigit() else int(step)

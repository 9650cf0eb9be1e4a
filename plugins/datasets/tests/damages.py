"""Damages of a data set: changes of text, of values in JSON and YAML, and of folders; some of them random."""

import contextlib
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml
from hypothesis import strategies as st

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
        whole: Any = [json.loads(old) if is_json else yaml.load(old, Loader=yaml.CSafeLoader)]
        holder, key = whole, 0
        for step in re.findall(r"[^.\[\]]+", place):
            holder = holder[key]
            key = step if step in holder or not step.isdigit() else int(step)
        if new is GONE:
            del holder[key]
        else:
            holder[key] = new(holder[key]) if callable(new) else new
        (root / file).write_text(json.dumps(whole[0]) if is_json else yaml.dump(whole[0], Dumper=yaml.CDumper))

    return Damage(file, change)


EXTREME = [None, True, 0, -1, 1e308, -1e308, 10**400, float("nan"), float("inf"), "", "\x00", "\ud800", "1", [], {}]
ANYTHING = st.sampled_from(EXTREME) | st.recursive(
    st.integers() | st.floats() | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=17) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=20,
)
#: Changes of a file: bytes at places, its end cut off, or a value of its JSON replaced.
DAMAGE = (
    st.tuples(st.just("bytes"), st.lists(st.tuples(st.floats(0, 0.999), st.integers(0, 255)), min_size=1, max_size=4))
    | st.tuples(st.just("cut"), st.floats(0, 1))
    | st.tuples(st.just("value"), st.tuples(st.floats(0, 0.999), ANYTHING))
    | st.tuples(st.just("value"), st.tuples(st.floats(0, 0.999), ANYTHING))
)


def damaged(content: bytes, damage: tuple[str, Any]) -> bytes:
    """The content of a file with a change."""
    kind, change = damage
    if kind == "cut":
        return content[: int(len(content) * change)]
    if kind == "value":
        with contextlib.suppress(ValueError):
            whole = json.loads(content)
            places = places_of(whole)
            holder, key = places[int(len(places) * change[0])]
            holder[key] = change[1]
            return json.dumps(whole).encode()
        return content
    changed = bytearray(content)
    for place, byte in change:
        changed[int(len(content) * place)] = byte
    return bytes(changed)


def places_of(value: Any) -> list[tuple[Any, Any]]:
    """All holders and keys of values in decoded JSON."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [place for key, inner in items for place in ((value, key), *places_of(inner))]

"""Defences and adversaries by name, file or dict."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mast_zenoh.attacks import Attack, Coordination
from mast_zenoh.config import loading, registry
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.scenario.names import name_of_file
from mast_zenoh.study.defences.fault_presets import PREFIX

#: The name of a class, FILE.py or FILE.py:CLASS; or a dict with one of these as `type`, and parameters.
Choice = str | dict[str, Any]

#: The adversaries of the scenarios of these names: on tracks alone, without a budget and without knowledge.
COORDINATED, UNCOORDINATED = "coordinated", "uncoordinated"


def words(text: str | Sequence[str]) -> list[str]:
    """The words of a text with commas, or a list; empty text has none."""
    return [word.strip() for word in text.split(",") if text.strip()] if isinstance(text, str) else list(text)


def several(value: Any) -> list[Any]:
    """A list of one value or several."""
    return list(value) if isinstance(value, (list, tuple)) else [value]


def junctions(first: int, last: int) -> str:
    """The short names of generated junctions, from one to another."""
    return ",".join(f"intersection:{index}" for index in range(first, last + 1))


def with_preset(presets: Mapping[str, Mapping[str, Any]], preset: str, **arguments: Any) -> dict[str, Any]:
    """The arguments of a study, those that are None from a preset. Raises ConfigurationError for an unknown preset."""
    if preset not in presets:
        raise ConfigurationError(f"preset: found {preset!r}{nearest(preset, presets)}")
    return {**presets[preset], **{key: value for key, value in arguments.items() if value is not None}}


def parse_choices(text: str | list[Choice] | tuple[Choice, ...], setting: str) -> list[Choice]:
    """Choices from names separated by commas, or from a Python list of names and dicts; files with absolute paths.

    Empty text has none. setting: its name, for errors. Raises ConfigurationError.
    """
    choices: Any = text
    if isinstance(text, str):
        try:
            literal = text.lstrip().startswith(("[", "(", "{"))
            choices = ast.literal_eval(text) if literal else text.split(",") if text.strip() else []
        except (ValueError, SyntaxError):
            raise ConfigurationError(
                f"{setting}: found {text!r}, expected names, or a list of names and dicts"
            ) from None
    choices = [choices] if isinstance(choices, Mapping) else choices
    result = []
    for choice in choices:
        name = choice if isinstance(choice, str) else choice.get("type") if isinstance(choice, Mapping) else None
        if not isinstance(name, str) or not name.strip():
            raise ConfigurationError(f"{setting}: found {choice!r}, expected a name, a file or a dict with `type`")
        name = _absolute(name.strip())
        result.append(name if isinstance(choice, str) else {**choice, "type": name})
    return result


def resolve_choice(choice: Choice, base: type) -> dict[str, Any]:
    """A dict with the name of a class as `type`; its file is loaded.

    choice: text may also be that of a dict. Raises ConfigurationError.
    """
    choice = _literal(choice)
    spec = {"type": choice} if isinstance(choice, str) else dict(choice)
    return spec | {"type": loading.class_name(spec["type"], base)}


def adversary_base(choice: Choice) -> type:
    """Coordination if the adversaries of a choice are directed by a coordinator, otherwise Attack."""
    choice = _literal(choice)
    text = choice if isinstance(choice, str) else str(choice["type"])
    if ".py" in text:
        file, _, name = text.partition(":")
        classes = loading.concrete([loading.module(Path(file))], Coordination)
        return Coordination if any(name in ("", cls.__name__) for cls in classes) else Attack
    if text in registry.known_types(Attack):  # ours: no plugin needs to be loaded
        return Attack
    return Coordination if text in registry.known_types(Coordination, text) else Attack


def has_budget(choice: Choice) -> bool:
    """Whether an adversary has a parameter `budget` that the choice leaves open."""
    if isinstance(choice, str) and (choice in (COORDINATED, UNCOORDINATED) or choice.startswith(PREFIX)):
        return False
    base = adversary_base(choice)
    spec = resolve_choice(choice, base)
    known = registry.known_types(base, spec["type"]).get(spec["type"])
    return known is not None and "budget" not in spec and "budget" in inspect.signature(known).parameters


def short_name(choice: Choice) -> str:
    """A short name for tables: the class, and parameters if there are any."""
    text = choice if isinstance(choice, str) else str(choice["type"])
    if text.startswith(PREFIX):
        return text
    file, _, name = text.partition(":")
    name = name or (Path(file).stem if file.endswith(".py") else file)
    parameters = {} if isinstance(choice, str) else {key: value for key, value in choice.items() if key != "type"}
    return name_of_file(" ".join([name, *(f"{key}={value}" for key, value in parameters.items())]))


def _literal(choice: Choice) -> Choice:
    """A choice whose text is that of a dict, as a dict."""
    if not isinstance(choice, str) or not choice.startswith("{"):
        return choice
    try:
        spec: dict[str, Any] = ast.literal_eval(choice)
    except (ValueError, SyntaxError):
        raise ConfigurationError(f"found {choice!r}, expected a dict(type=…)") from None
    return spec


def _absolute(text: str) -> str:
    file, colon, name = text.partition(":")
    return f"{Path(file).resolve()}{colon}{name}" if file.endswith(".py") else text

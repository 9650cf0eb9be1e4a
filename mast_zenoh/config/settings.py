"""Launch-time settings, `--set KEY=VALUE`: parsed, typed and applied."""

from __future__ import annotations

import ast
import inspect
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from mast_zenoh.config import plugins
from mast_zenoh.config.outside_meshes import outside_meshes
from mast_zenoh.errors import ConfigurationError, nearest

#: The keys of a scenario; parts of plugins have others.
KEYS = {
    "name": "name of the scenario; by default the file's",
    "scene": "a short name, such as intersection:3 or av2:PATH, or dict(type=…)",
    "agents": "name or pattern to configuration of an agent; a full name, else the longest pattern counts",
    "points": "how lidars scan, and what detects objects in their points; None: detections are modelled",
    "broker": "configuration of the broker, None: no broker",
    "command_center": "configuration of the command centre, None: no centre; also written commandcenter",
    "centers": "name to configuration of a regional centre",
    "peers": "name or pattern of an agent to configuration of its peer, which fuses on board",
    "channel": "configuration of the radio channel of peers, None: nothing is lost",
    "evaluator": "configuration of the evaluator",
    "drivers": "agent to configuration of the driver of its car",
    "world": "options of the simulator that drivers command; only together with `drivers`",
    "adversaries": "name to configuration of an adversary; agent=[]: it attacks nobody",
    "coordinator": "configuration of what directs the adversaries, None: nothing",
    "nodes": "name to configuration of a further node: its role, its file and its parameters",
    "links": "name or pattern of an agent to a profile, or to dict(type=profile, up=[rules], down=[rules])",
    "faults": "list of dict(type=…)",
    "hosts": "name to a host with its own network, on which nodes run",
    "keyexpr": "dict(map=…, rewrites=[…]): files of maps, or dicts of the same form; by default testbed.toml and none",
    "run": "how the run is played",
}
#: Those of them that hold a list, which a setting can replace.
LISTS = ("faults",)
#: Alternative spellings of keys, from the paper's configuration listing.
ALIASES = {"commandcenter": "command_center"}
#: Units by the end of a parameter's name, longest first.
_UNITS = {
    "bits_per_s": "bit/s",
    "_per_m2": "1/m²",
    "_rad_s": "rad/s",
    "_per_s": "1/s",
    "_mps2": "m/s²",
    "_mbps": "Mbit/s",
    "_mps": "m/s",
    "_dbm": "dBm",
    "_deg": "°",
    "_rad": "rad",
    "_hz": "Hz",
    "_ms": "ms",
    "_mb": "MB",
    "_db": "dB",
    "_s": "s",
    "_m": "m",
}


def split(
    settings: Sequence[str], function: Callable[..., Any], place: str, whole: Sequence[str] = ()
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split settings into (parameters of the function, dotted settings), typed.

    whole: keys of the function's result that can be set without a dot
    """
    known = inspect.signature(function).parameters
    parameters: dict[str, Any] = {}
    dotted: dict[str, Any] = {}
    for setting in settings:
        key, value = key_and_value(setting)
        if key in known:
            parameters[key] = _typed(value, known[key].default, f"{place}: --set {key}")
        elif "." in key or key in whole:
            dotted[key] = literal(value)
        else:
            hint = nearest(key, {*known, *whole})
            raise ConfigurationError(f"{place}: --set {key}: no such launch-time parameter{hint}")
    return parameters, dotted


def from_values(
    values: Mapping[str, Any],
    function: Callable[..., Any] | None,
    place: str,
    known: Iterable[str] = (),
    whole: Sequence[str] = (),
) -> tuple[dict[str, Any], dict[str, Any]]:
    """(parameters of the function, dotted settings) from Python values.

    function: None for a scenario given as a dict
    known: other names to suggest in place of an unknown one
    whole: as in `split`
    """
    accepted = inspect.signature(function).parameters if function is not None else {}
    parameters = {
        key: _checked(value, accepted[key].default, f"{place}: {key}", value)
        for key, value in values.items()
        if key in accepted
    }
    dotted = {key: value for key, value in values.items() if key not in accepted and ("." in key or key in whole)}
    for key in values:
        if key not in accepted and key not in dotted:
            raise ConfigurationError(f"{place}: {key}: no such parameter{nearest(key, {*accepted, *whole, *known})}")
    return parameters, dotted


def key_and_value(setting: str, option: str = "--set") -> tuple[str, str]:
    """Key and value of KEY=VALUE; raises ConfigurationError for anything else."""
    key, equals, value = setting.partition("=")
    if not equals:
        raise ConfigurationError(f"{option} {setting}: expected KEY=VALUE")
    return key, value


def nested(settings: Sequence[str]) -> dict[str, Any]:
    """Settings as nested dicts: `a.b=1` becomes {"a": {"b": 1}}."""
    result: dict[str, Any] = {}
    for setting in settings:
        key, value = key_and_value(setting)
        *steps, last = key.split(".")
        level = result
        for step in steps:
            level = level.setdefault(step, {})
            if not isinstance(level, dict):
                raise ConfigurationError(f"--set {setting}: {step} is {level!r}, not a dict")
        level[last] = literal(value)
    return result


def set_dotted(scenario: dict[str, Any], dotted: str, value: Any, place: str) -> None:
    """Set the value that a dotted key names; a number counts the items of a list from 0.

    Every step but the last must exist; the last one is checked later. The number after the last item adds one.
    """
    *steps, last = dotted.split(".")
    if steps:
        steps[0] = ALIASES.get(steps[0], steps[0])
        if (key := steps[0]) not in scenario:
            if key not in KEYS and key not in outside_meshes(key):
                raise plugins.not_found(f"{place}: --set {dotted}: no {key!r} there", key, scenario)
            scenario[key] = [] if key in LISTS else {}
    level: Any = scenario
    for step in steps:
        key = _key(level, step, f"{place}: --set {dotted}")
        if isinstance(level[key], tuple):
            level[key] = list(level[key])
        level = level[key]
    if isinstance(level, list):
        level += [None] * (last == str(len(level)))
        level[_key(level, last, f"{place}: --set {dotted}")] = value
    elif isinstance(level, dict):
        level[last] = value
    else:
        raise ConfigurationError(f"{place}: --set {dotted}: {'.'.join(steps)} is {level!r}, not a dict")


def _key(level: Any, step: str, place: str) -> Any:
    """The key in a dict, or the index in a list, that a step names; raises ConfigurationError."""
    if isinstance(level, list):
        if step.isdecimal() and int(step) < len(level):
            return int(step)
        expected = f"one of 0 to {len(level) - 1}" if level else "a whole item as 0 first: it is empty"
        raise ConfigurationError(f"{place}: no {step!r} there: it is a list, expected {expected}")
    if not isinstance(level, Mapping) or step not in level:
        raise ConfigurationError(
            f"{place}: no {step!r} there{nearest(step, level if isinstance(level, Mapping) else ())}"
        )
    return step


def literal(value: str) -> Any:
    """A setting as a Python value: a literal, JSON, true, false, none, or else text."""
    try:
        return ast.literal_eval(value)
    except (ValueError, SyntaxError):
        if value[:1] in ("[", "{"):
            with suppress(ValueError):
                return json.loads(value)
        return {"true": True, "false": False, "none": None}.get(value.lower(), value)


def unit_of_name(name: str) -> str:
    """The unit of a parameter, from the end of its name; "": it has none."""
    return next((unit for suffix, unit in _UNITS.items() if name.endswith(suffix)), "")


def _typed(value: str, default: Any, place: str) -> Any:
    """A setting in the type of its default."""
    if isinstance(default, str):
        return value
    return _checked(literal(value), default, place, value)


def _checked(value: Any, default: Any, place: str, written: Any) -> Any:
    """Check that a value has the type of a parameter's default, and return it.

    Any value is valid if the default is text or a class. If it is a list, one value is a list of one. If it is None,
    text is refused where the name ends with a unit.
    place: ends with the name;  written: the value as the user wrote it
    """
    if default is None and isinstance(value, str) and (unit := unit_of_name(place)):
        raise ConfigurationError(f"{place}: found {written!r}, expected a number, in {unit}")
    if default is None or default is inspect.Parameter.empty or isinstance(default, (str, type)):
        return value
    if isinstance(default, float) and type(value) is int:
        return float(value)
    if isinstance(default, (list, tuple)) and not isinstance(value, (list, tuple, dict)) and value is not None:
        return [value]
    if type(value) is not type(default) and not (
        isinstance(default, (list, tuple)) and isinstance(value, (list, tuple))
    ):
        kind, example = type(default).__name__, default
        if isinstance(default, tuple):
            kind, example = "list", list(default)
        raise ConfigurationError(f"{place}: found {written!r}, expected {kind} as in {example!r}")
    return value

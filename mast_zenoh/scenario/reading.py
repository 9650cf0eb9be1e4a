"""Reads a user's scenario file: runs it, applies the launch-time settings, and checks its keys."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from mast_zenoh import scenes
from mast_zenoh.config import loading, plugins, registry
from mast_zenoh.config.outside_meshes import outside_meshes
from mast_zenoh.config.registry import parse_scene
from mast_zenoh.config.settings import ALIASES, KEYS, LISTS, from_values, set_dotted, split
from mast_zenoh.errors import ConfigurationError, MastError, nearest
from mast_zenoh.scenes.agents import best_pattern
from mast_zenoh.wiring.plain_shapes import MAX_NAME, REFUSED, is_name


def checked_name(name: object, place: str) -> str:
    """Return a name; raises ConfigurationError if it could escape its folder or key."""
    if not isinstance(name, str) or not is_name(name) or name[0] in "@-":
        raise ConfigurationError(
            f"{place}: found {name!r:.120}, expected at most {MAX_NAME} characters, none of / \\ * # ? $, "
            "and no . @ or - at the beginning"
        )
    return name


def name_of_file(stem: str) -> str:
    """A valid name made from a file's stem, for a scenario or study without one."""
    return REFUSED.sub("_", stem).lstrip(".@-")[:MAX_NAME] or "unnamed"


MODES = ("lockstep", "realtime")


@dataclass(frozen=True)
class RunOptions:
    """The `run` part of a scenario.

    mode:   the next frame begins when all messages are handled, or by the clock
    rate:   speed relative to the wall clock, in real time;  frames: how many to play, None: all
    seed:   of all random draws;  record: whether every message is written to messages.mcap
    max_rows: most objects that a message of one agent may have; None: as many as the scene needs
    """

    mode: Literal["lockstep", "realtime"] = "lockstep"
    rate: float = 1.0
    frames: int | None = None
    seed: int = 0
    record: bool = True
    max_rows: int | None = None


RUN_DEFAULTS = asdict(RunOptions())
#: Keys whose values are no dicts, and those of what a run can do without, which may be None.
_NO_DICTS = ("name", "scene", *LISTS)
_OPTIONAL = ("points", "broker", "command_center", "channel", "coordinator")


def normalise_keys(scenario: Mapping[str, Any], place: str) -> dict[str, Any]:
    """The scenario with alternative spellings of keys replaced by the usual ones."""
    renamed = {ALIASES.get(key, key): value for key, value in scenario.items()}
    if len(renamed) < len(scenario):
        duplicates = [f"{key} and {usual}" for key, usual in ALIASES.items() if {key, usual} <= scenario.keys()]
        raise ConfigurationError(f"{place}: {', '.join(duplicates)} are the same: expected one of them")
    return renamed


def checked(scenario: Mapping[str, Any], place: str) -> Mapping[str, Any]:
    """Return a scenario; raises ConfigurationError for invalid keys or values."""
    for key, value in scenario.items():
        meshes = () if key in KEYS else outside_meshes(str(key))
        if key not in KEYS and key not in meshes:
            raise plugins.not_found(f"{place}: {key}: unknown key", str(key), KEYS)
        if (key in _OPTIONAL or key in meshes) and value is None:
            continue
        if key not in _NO_DICTS and not isinstance(value, Mapping):
            raise ConfigurationError(f"{place}: {key}: found {value!r}, expected a dict")
    return scenario


def check_run(options: Mapping[str, Any], place: str) -> None:
    """Raise ConfigurationError for an invalid `run` part."""
    for key in options:
        if key not in RUN_DEFAULTS:
            raise ConfigurationError(f"{place}: run.{key}: unknown key{nearest(key, RUN_DEFAULTS)}")
    if options["mode"] not in MODES:
        raise ConfigurationError(f"{place}: run.mode: found {options['mode']!r}{nearest(str(options['mode']), MODES)}")
    rate, optional = options["rate"], [key for key in ("frames", "max_rows") if options[key] is not None]
    for key, valid, expected in (
        ("seed", _is_whole(options["seed"], 0), "a whole number from 0"),
        *((key, _is_whole(options[key], 1), "a whole number from 1") for key in optional),
        ("record", type(options["record"]) is bool, "True or False"),
        ("rate", isinstance(rate, (int, float)) and 0 < rate < float("inf"), "a number above 0"),
    ):
        if not valid:
            raise ConfigurationError(f"{place}: run.{key}: found {options[key]!r}, expected {expected}")


def _is_whole(value: object, minimum: int) -> bool:
    return type(value) is int and value >= minimum


def choose_scene(scene: str | Mapping[str, Any], **options: Any) -> dict[str, Any]:
    """The spec of a scene, from a short name or a dict, with options set.

    scene: "intersection", "avstack:PATH", … or a dict

    Options that are None are ignored. `detections`, of any scene: a path, or a dict of it and `first_frame`, see
    `scenes.OwnDetections`. Raises ConfigurationError for an option that the scene's type does not take, or that
    contradicts the scene.
    """
    if not isinstance(scene, (str, Mapping)):
        raise ConfigurationError(f"scene: found {scene!r}, expected a short name or a dict(type=…)")
    spec = registry.own_copy(dict(scene)) if isinstance(scene, Mapping) else parse_scene(scene)
    type_ = registry.known_types(scenes.Scene, spec.get("type")).get(str(spec.get("type")))
    accepted = inspect.signature(type_).parameters if type_ else options  # an unknown type is refused when it is built
    for name, value in options.items():
        if value is None:
            continue
        if name not in accepted and name != "detections":
            raise ConfigurationError(f"scene: {spec['type']} has no parameter {name!r}{nearest(name, accepted)}")
        if spec.setdefault(name, value) != value:
            raise ConfigurationError(f"scene: {name} is {value!r}, but {spec[name]!r} in {scene!r}: expected one value")
    return spec if "detections" in accepted else _with_own_detections(spec)


def _with_own_detections(spec: dict[str, Any]) -> dict[str, Any]:
    """The spec of a scene, inside one that replays its `detections`, if it has any."""
    detections = spec.pop("detections", None)
    if detections is None:
        return spec
    files = dict(detections) if isinstance(detections, Mapping) else {"path": detections}
    return {"type": "OwnDetections", "scene": spec, **files}


def agents_of(scene: str | Mapping[str, Any]) -> tuple[str, ...]:
    """The names of a scene's agents, the ego first.

    For scenarios that refer to agents by name.
    Raises ConfigurationError (scene parameters), SceneError (scene data).
    """
    spec = choose_scene(scene)
    prepared = registry.build(spec, scenes.Scene, "scene")
    return scenes.prepare(prepared, 0, 1, json.dumps(spec, sort_keys=True)).agent_names


def victims_of(scene: str | Mapping[str, Any], count: int, first: Sequence[str] = ()) -> tuple[str, ...]:
    """The names of `count` agents to compromise: static ones first, the ego only if it is named.

    first: agents that come before all others, in this order
    Raises ConfigurationError if the scene has fewer, or not these.
    """
    every = agents_of(scene)
    for name in first:
        if name not in every:
            raise ConfigurationError(f"compromised: no agent {name!r}{nearest(str(name), every)}")
    static = [name for name in every[1:] if name.startswith("infra")]
    victims = tuple(dict.fromkeys((*first, *static, *every[1:])))
    if not 0 <= count <= len(victims):
        raise ConfigurationError(f"n_adversaries: found {count}, expected 0 to {len(victims)}: {', '.join(victims)}")
    return victims[:count]


def load(name: str, settings: Sequence[str] = (), /, **values: Any) -> tuple[Path, dict[str, Any]]:
    """(file, scenario dict) of a scenario file, with settings: to base another scenario on it.

    settings: `key=value`, as for `--set`;  values: the same as Python values, which take precedence
    A key without a dot is a parameter of the file's `scenario` function, typed like its default; a dotted key
    names a value in the dict that it returns, and `faults` its list of faults.
    """
    path, function = loading.function("scenarios", name, "scenario")
    parameters, dotted = split(settings, function, str(path), LISTS)
    more, more_dotted = from_values(values, function, str(path), (), LISTS)
    return path, _call(path, function, registry.own_copy(parameters | more), dotted | more_dotted)


def load_values(
    source: str | Path | Mapping[str, Any] | Callable[..., Any], values: Mapping[str, Any], known: Iterable[str] = ()
) -> tuple[Path, dict[str, Any]]:
    """(file, scenario dict) of a scenario, with settings as Python values.

    source: a file, the name of a shipped scenario, a dict or a function
    A dict, or a function that no file defines (of a notebook, say), has a path without suffix. Errors use it as the
    name, and its folder is searched for files.
    known: other names to suggest in place of an unknown setting
    """
    if isinstance(source, Mapping):
        path, function = Path("scenario"), None
    elif callable(source):
        path, function = loading.defining_file(source), source
    elif isinstance(source, (str, Path)):
        path, function = loading.function("scenarios", str(source), "scenario")
    else:
        raise ConfigurationError(f"scenario: found {source!r}, expected a name, a file, a dict or a function")
    parameters, dotted = from_values(values, function, str(path), known, LISTS)
    if function is not None:
        return path, _call(path, function, registry.own_copy(parameters), dotted)
    assert isinstance(source, Mapping)
    return path, _with_settings(path, dict(source), dotted)


def _call(
    path: Path, function: Callable[..., Any], parameters: Mapping[str, Any], dotted: Mapping[str, Any]
) -> dict[str, Any]:
    """The result of a scenario function, with dotted settings applied."""
    try:
        scenario = function(**parameters)
    except MastError as error:
        raise type(error)(f"{path}: {error}") from None
    except Exception as error:
        raise ConfigurationError(f"{path}: scenario(...): {type(error).__name__}: {error}") from error
    if not isinstance(scenario, dict):
        raise ConfigurationError(f"{path}: scenario(...) returned {type(scenario).__name__}, expected a dict")
    return _with_settings(path, scenario, dotted)


def _with_settings(path: Path, scenario: Mapping[str, Any], dotted: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of a scenario with dotted settings applied.

    Shared dicts are copied: a setting in one must not change another.
    """
    result: dict[str, Any] = registry.own_copy(normalise_keys(scenario, str(path)))
    created = []
    for key in sorted(dotted, key=_generality):
        first, _, others = key.partition(".")
        agent, _, deeper = others.partition(".")
        entries = [agent]
        if first == "scene" and deeper:
            result["scene"] = _with_default(choose_scene(result.get("scene", "intersection")), agent)
        if first in OF_AGENTS and deeper:
            entries, is_new = _entries_of_agent(result, first, agent, f"{path}: --set {key}")
            created += [(key, agent)] * is_new
        for entry in entries:
            set_dotted(result, f"{first}.{entry}.{deeper}" if deeper else key, dotted[key], str(path))
    _check_agents(result, created, str(path))
    return result


def _with_default(spec: dict[str, Any], name: str) -> dict[str, Any]:
    """The spec of a scene, with the component that a parameter has by default, such as its detector, written out.

    A setting can then change a part of it.
    """
    type_ = registry.known_types(scenes.Scene, spec.get("type")).get(str(spec.get("type")))
    parameter = registry.parameters_of(type_).get(name) if type_ else None
    if parameter is None or type(parameter.default).__module__ == "builtins":
        return spec
    return {name: {"type": type(parameter.default).__name__}, **spec}


#: Keys of a scenario that configure agents by name or pattern, each with the entries that it has if it is left out.
OF_AGENTS: dict[str, dict[str, Any]] = {"agents": {"*": {}}, "peers": {}}


def _generality(key: str) -> tuple[bool, int]:
    """Sorts settings: those of agents come last, from patterns to names.

    What is set for all agents thus also holds for one that gets its own entry. Whole lists come before their items.
    """
    first, _, others = key.partition(".")
    name = others.partition(".")[0]
    return (not set("*?[") & set(name), len(name)) if first in OF_AGENTS else (False, bool(others) - 1)


def _entries_of_agent(scenario: dict[str, Any], first: str, name: str, place: str) -> tuple[list[str], bool]:
    """The entries that a setting of an agent, or of all agents of a pattern, changes, and whether one of them is new.

    first: the key of the entries, see OF_AGENTS. An agent or a pattern that a more general entry configures gets a
    copy of that as its own entry. A pattern also changes the entries that match it.
    Raises ConfigurationError if no entry configures it.
    """
    configured = scenario.setdefault(first, dict(OF_AGENTS[first]))
    if not isinstance(configured, dict):
        return [name], False
    entries = [entry for entry in configured if entry == name or best_pattern([name], entry)]
    is_new = name not in configured and (general := best_pattern(configured, name)) is not None
    if is_new:
        configured[name] = registry.own_copy(configured[general])
        entries.append(name)
    if not entries:
        raise ConfigurationError(f"{place}: no {name!r} there{nearest(name, configured)}")
    return entries, is_new


def _check_agents(scenario: Mapping[str, Any], created: Sequence[tuple[str, str]], place: str) -> None:
    """Raise ConfigurationError for a setting of an agent that the scene does not have.

    created: each setting, and the name or pattern of the entry that it has created
    """
    if not created:
        return
    try:
        names = agents_of(scenario.get("scene", "intersection"))
    except MastError:
        return  # an error of the scene, which `resolve` reports
    for key, pattern in created:
        if not any(best_pattern([pattern], name) for name in names):
            raise ConfigurationError(
                f"{place}: --set {key}: no agent {pattern!r} in this scene{nearest(pattern, names)}"
            )

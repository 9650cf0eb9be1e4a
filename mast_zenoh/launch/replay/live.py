"""The live nodes of a replay: as recorded, or changed by settings or a scenario file."""

from __future__ import annotations

import inspect
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from mast_zenoh import scenario
from mast_zenoh.config import loading, registry
from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.config.settings import ALIASES, KEYS, key_and_value, literal, set_dotted
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.run_folder.recording.writer import FILE, MessageLog
from mast_zenoh.scenario.nodes import node_spec
from mast_zenoh.scenario.resolution import load_builders, modules_of
from mast_zenoh.scenes.agents import best_pattern

#: Parts of a scenario that configure one node, and those that configure several by name.
_SINGLE = ("broker", "command_center", "evaluator", "coordinator")
_SEVERAL: Mapping[str, str] = {"agents": "agent", "adversaries": "adversary"}
#: Parts of a scenario file that a replay uses; the others describe what is recorded.
_OF_FILE = ("broker", "command_center", "evaluator", "agents")
#: Parameters of nodes that describe the recorded scene rather than the scenario.
_OF_SCENE = (
    *("agents", "picture_ages_s", "estimate_ages_s", "take_over_s", "hold_s", "car_limits"),
    *("faults", "lidar", "mobile", "acts", "input_limit", "played_drivers", "drivers"),
)


@dataclass(frozen=True)
class Live:
    """The live nodes of a replay.

    nodes:   the spec of each;  changed: by node, the settings that are not those of the recording
    modules: files of the user's classes
    """

    nodes: Mapping[str, NodeSpec]
    changed: Mapping[str, list[str]]
    modules: tuple[str, ...]


def live_nodes(recorded: Resolved, live: Collection[str], file: str | None, settings: Sequence[str]) -> Live:
    """The specs of the live nodes of a recorded run.

    file: a scenario file, whose broker, command centre, evaluator and agents replace the
    recorded ones; None: none;  settings: as `KEY=VALUE`

    Raises ConfigurationError for a setting of a node that is not live, and for anything that the nodes refuse.
    """
    specs = {name: _with_own_log(spec) for name, spec in recorded.nodes.items() if name in live}
    path, content = Path("scenario.json"), _content(specs)
    modules: tuple[str, ...] = recorded.modules
    recorded.load_modules()
    if file is not None:
        path, loaded = scenario.load(file, settings)
        content |= _of_file(path, loaded, specs)
        modules = tuple(dict.fromkeys([*modules, *modules_of(path, loaded, load_builders(content, path))]))
    else:
        for setting in settings:
            _set(content, *key_and_value(setting), specs, recorded)
    named = {name for name, spec in specs.items() if file is not None and (name in _OF_FILE or spec.role == "agent")}
    nodes = {
        name: _changed(path, name, spec, _part(content, name, spec.role), defaults=name not in named)
        for name, spec in specs.items()
    }
    changed = {name: list(_differences(specs[name], spec)) for name, spec in nodes.items()}
    return Live(nodes, {name: keys for name, keys in changed.items() if keys}, modules)


def _with_own_log(spec: NodeSpec) -> NodeSpec:
    """A recorded node's spec, with a log of its own."""
    config = {key: MessageLog() if value == FILE else value for key, value in spec.config.items()}
    return replace(spec, config=config)


def _content(specs: Mapping[str, NodeSpec]) -> dict[str, Any]:
    """The live nodes as the dict of a scenario; agents and adversaries by their full names."""
    content: dict[str, Any] = {}
    for name, spec in specs.items():
        config = registry.own_copy(spec.config)
        part = next((part for part, role in _SEVERAL.items() if role == spec.role), "nodes")
        if name in _SINGLE:
            content[name] = config
        else:
            content.setdefault(part, {})[name] = config
    return content


def _part(content: Mapping[str, Any], name: str, role: str) -> dict[str, Any]:
    """The configuration of a node in the dict that `_content` made."""
    part = next((part for part, part_role in _SEVERAL.items() if part_role == role), "nodes")
    config = content[name] if name in _SINGLE else content[part][name]
    if not isinstance(config, dict):
        raise ConfigurationError(f"{name}: found {config!r}, expected a dict")
    return config


def _of_file(path: Path, loaded: Mapping[str, Any], specs: Mapping[str, NodeSpec]) -> dict[str, Any]:
    """The parts of a scenario file that configure live nodes."""
    content: dict[str, Any] = {}
    for name, spec in specs.items():
        own = {key: value for key, value in spec.config.items() if key in _OF_SCENE}
        if name in _OF_FILE:
            content[name] = own | dict(loaded.get(name, {}))
        elif spec.role == "agent":
            patterns = loaded.get("agents", {"*": {}})
            pattern = best_pattern(patterns, name)
            if pattern is None:
                raise ConfigurationError(f"{path}: agents: no entry for {name!r}{nearest(name, patterns)}")
            content.setdefault("agents", {})[name] = own | dict(patterns[pattern])
    return content


def _set(content: dict[str, Any], key: str, value: str, specs: Mapping[str, NodeSpec], recorded: Resolved) -> None:
    """Apply a setting to the live nodes that it names."""
    first, *others = key.split(".")
    first = ALIASES.get(first, first)
    live = ", ".join(sorted(specs))
    if not others:
        raise ConfigurationError(
            f"--set {key}: a recorded run has no launch-time parameters: expected a dotted path, such as "
            "command_center.pipeline.clustering.assign_radius, or a scenario file (--scenario)"
        )
    if first not in KEYS:
        raise ConfigurationError(f"--set {key}: unknown key{nearest(first, KEYS)}")
    named = others[0] if first in (*_SEVERAL, "nodes") else first
    matching = [name for name in content.get(first, {}) if fnmatchcase(name, named)] if first != named else [named]
    if (first == named and named not in content) or not matching:
        what = "is played from the recording" if named in recorded.nodes else "is no live node"
        raise ConfigurationError(f"--set {key}: {named} {what}: expected one of the live nodes: {live}")
    for name in matching:
        dotted = ".".join([first, *others]) if first == named else ".".join([first, name, *others[1:]])
        set_dotted(content, dotted, literal(value), "recorded run")


def _changed(path: Path, name: str, spec: NodeSpec, config: dict[str, Any], *, defaults: bool) -> NodeSpec:
    """The spec of a node with another configuration.

    defaults: without `file`, the node has the file and the class of the recorded node, and another class keeps those of
              its parameters that it accepts; otherwise file and class are those of its role
    """
    if config == spec.config:
        return spec
    if not defaults or "file" not in config:
        own = {"file": spec.file, "type": spec.type} if defaults else {}
        return node_spec(path, name, spec.role, {"on_exit": spec.on_exit, **own, **config})
    other = node_spec(path, name, spec.role, {"on_exit": spec.on_exit, **config})
    accepted = inspect.signature(loading.node_class(Path(other.file), other.type)).parameters
    kept = {key: value for key, value in other.config.items() if key in accepted or value != spec.config.get(key)}
    return replace(other, config=kept)


def _differences(recorded: NodeSpec, now: NodeSpec) -> list[str]:
    """Dotted names of the settings of a node that differ from the recorded ones."""
    names = [name for name in ("file", "type") if getattr(recorded, name) != getattr(now, name)]
    here, there = recorded.config, now.config
    for key in dict.fromkeys([*here, *there]):
        if key not in here or key not in there:
            names.append(key)
            continue
        leaves, others = dict(_leaves(key, here[key])), dict(_leaves(key, there[key]))
        missing = object()
        names += [
            name for name in dict.fromkeys([*leaves, *others]) if leaves.get(name, missing) != others.get(name, missing)
        ]
    return names


def _leaves(prefix: str, value: Any) -> list[tuple[str, Any]]:
    if not isinstance(value, Mapping):
        return [(prefix, list(value) if isinstance(value, tuple) else value)]
    return [leaf for key, item in value.items() for leaf in _leaves(f"{prefix}.{key}", item)]

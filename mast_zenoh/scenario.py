"""Scenarios: a Python file of plain dicts in, everything that a run needs out, checked before any process starts.

    mast_zenoh.loading     runs the user's file
    load                   calls its `scenario(...)` with the launch-time parameters, and applies dotted settings
    resolve                prepares the scene, builds every node once, and resolves the key of every port

Processes get the resolved scenario as JSON (`Resolved.to_json`), never the Python file.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mast_zenoh import bundle, keyexpr, loading, registry, scenes
from mast_zenoh.errors import ConfigurationError, NodeFileError, nearest
from mast_zenoh.faults.steps import ProcessStep
from mast_zenoh.messagelog.writer import MessageLog
from mast_zenoh.node import Node
from mast_zenoh.scenes.recording import Recording, SceneAgent
from mast_zenoh.settings import ALIASES, KEYS, reach, split
from mast_zenoh.wiring import Wiring

ON_EXIT = ("fail", "continue", "restart")
MODES = ("lockstep", "realtime")

#: The `run` part of a scenario.
RUN_DEFAULTS: dict[str, Any] = {"mode": "lockstep", "rate": 1.0, "frames": None, "seed": 0, "record": True}
_SINGLE = ("broker", "command_center", "evaluator", "coordinator")
_DEFAULT_ON_EXIT = {"agent": "continue", "adversary": "continue", "coordinator": "continue", "link": "continue"}
_CONTROLS = ("type", "file", "on_exit", "role")


@dataclass(frozen=True, slots=True)
class NodeSpec:
    """One node of a run: its role, file, class, parameters, and what its end means for the run."""

    role: str
    file: str
    type: str
    config: dict[str, Any]
    on_exit: str


@dataclass(frozen=True)
class Resolved:
    """A scenario with nothing left to decide.

    modules: the user's Python files that define algorithms named in it; whoever builds its nodes runs them first
    steps: what happens to processes, by frame; timeline: attacks and faults as the report shows them; network: hosts
    """

    name: str
    seed: int
    mode: str
    rate: float
    frames: int
    period_ns: int
    nodes: dict[str, NodeSpec]
    wiring: dict[str, Any]
    scene: dict[str, Any]
    modules: tuple[str, ...] = ()
    steps: tuple[ProcessStep, ...] = ()
    timeline: tuple[dict[str, Any], ...] = ()
    network: dict[str, Any] = field(default_factory=dict)
    recording: Recording | None = field(default=None, compare=False)

    def to_json(self) -> dict[str, Any]:
        """The form of scenario.json, without the wiring, which has a file of its own."""
        nodes = {
            name: {"role": s.role, "file": s.file, "type": s.type, "on_exit": s.on_exit, "config": _plain(s.config)}
            for name, s in self.nodes.items()
        }
        names = ("name", "seed", "mode", "rate", "frames", "period_ns", "scene", "modules", "timeline", "network")
        steps = [step._asdict() for step in self.steps]
        return {**{name: getattr(self, name) for name in names}, "steps": steps, "nodes": nodes}

    @classmethod
    def from_json(cls, data: Mapping[str, Any], wiring: dict[str, Any]) -> Resolved:
        """What `to_json` wrote."""
        nodes = {name: NodeSpec(**spec) for name, spec in data["nodes"].items()}
        steps = tuple(ProcessStep(**step) for step in data["steps"])
        lists = {name: tuple(data[name]) for name in ("modules", "timeline")}
        return cls(**{**data, **lists, "nodes": nodes, "wiring": wiring, "steps": steps})

    @classmethod
    def read(cls, run_folder: Path) -> Resolved:
        """The resolved scenario in a run folder."""
        scenario = json.loads((run_folder / "scenario.json").read_text(encoding="utf-8"))
        return cls.from_json(scenario, json.loads((run_folder / "wiring.json").read_text(encoding="utf-8")))

    def in_folder(self, run_folder: Path) -> Resolved:
        """The same, with what its nodes write placed in a run folder: for those that are built in another directory."""

        def placed(value: Any) -> Any:
            return MessageLog(run_folder / value.path) if isinstance(value, MessageLog) else value

        return replace(
            self,
            nodes={
                name: replace(spec, config={key: placed(value) for key, value in spec.config.items()})
                for name, spec in self.nodes.items()
            },
        )

    def write(self, run_folder: Path) -> None:
        """scenario.json, wiring.json and scene.npz: all that the nodes of the run need."""
        if self.recording is not None:
            self.recording.save(run_folder / RECORDING)
        for name, content in (("scenario.json", self.to_json()), ("wiring.json", self.wiring)):
            (run_folder / name).write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


RECORDING = "scene.npz"


def choose_scene(scene: str | Mapping[str, Any], **options: Any) -> dict[str, Any]:
    """The scene of a short name ("intersection", "avstack:PATH", …), with those options that its type takes."""
    if not isinstance(scene, (str, Mapping)):
        raise ConfigurationError(f"scene: found {scene!r}, expected a short name or a dict(type=…)")
    spec = dict(scene) if isinstance(scene, Mapping) else scenes.parse_scene(scene)
    type_ = registry.known_types(scenes.Scene).get(str(spec.get("type")))
    if type_ is not None:
        takes = inspect.signature(type_).parameters
        spec = {**{name: value for name, value in options.items() if name in takes}, **spec}
    return spec


def load(name: str, settings: Sequence[str] = ()) -> tuple[Path, dict[str, Any]]:
    """(file, scenario dict) of a scenario file, under settings `key=value` as given to `--set`.

    A key without a dot is a parameter of the file's `scenario` function, typed from its default; one with dots
    reaches into the dict that it returns.
    """
    path, function = loading.function("scenarios", name, "scenario")
    parameters, dotted = split(settings, function, str(path))
    try:
        scenario = function(**parameters)
    except ConfigurationError as error:
        raise type(error)(f"{path}: {error}") from None
    except Exception as error:
        raise ConfigurationError(f"{path}: scenario(...): {type(error).__name__}: {error}") from error
    if not isinstance(scenario, dict):
        raise ConfigurationError(f"{path}: scenario(...) returned {type(scenario).__name__}, expected a dict")
    scenario = _own(_spelt(scenario, str(path)))
    for key, value in dotted.items():
        reach(scenario, key, value, str(path))
    return path, scenario


def resolve(
    path: Path,
    scenario: Mapping[str, Any],
    *,
    seed: int | None = None,
    frames: int | None = None,
    record: bool = False,
    **run: Any,
) -> Resolved:
    """The scenario of a file with nothing left to decide; arguments that are not None win over its `run` part.

    record: add a recorder, unless the scenario's `run.record` is False

    Raises ConfigurationError (of a scenario), WiringError (of a map), SceneError (of the scene's data).
    """
    scenario = _checked(_spelt(scenario, str(path)), str(path))
    given = {key: value for key, value in dict(run, seed=seed, frames=frames).items() if value is not None}
    options = RUN_DEFAULTS | dict(scenario.get("run", {})) | given
    _check_run(options, str(path))
    try:
        scene_spec = choose_scene(scenario.get("scene", "intersection"))
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from None
    scene = registry.build(scene_spec, scenes.Scene, f"{path}: scene")
    cache_key = json.dumps(scene_spec, sort_keys=True)
    recording = scenes.prepare(scene, options["seed"], options["frames"], cache_key)
    played = len(recording) if options["frames"] is None else min(options["frames"], len(recording))
    nodes = _nodes(path, scenario, recording, played, record and options["record"])
    for name, spec in nodes.items():
        build_node(spec, name, str(path))
    wiring = _wiring(path, scenario, nodes)
    return Resolved(
        name=str(scenario.get("name", path.stem)),
        seed=options["seed"],
        mode=options["mode"],
        rate=float(options["rate"]),
        frames=played,
        period_ns=recording.period_ns,
        nodes=nodes,
        wiring=wiring.to_json(),
        scene=scene_spec,
        modules=(str(path),) if loading.defines_algorithms(loading.module(path)) else (),
        recording=recording,
    )


def build_node(spec: NodeSpec, name: str, place: str = "scenario.json") -> Node:
    """The node of a spec, newly made."""
    cls = loading.node_class(Path(spec.file), spec.type)
    node = registry.construct(cls, spec.config, f"{place}: {name}")
    assert isinstance(node, Node)
    return node


def _nodes(
    path: Path, scenario: Mapping[str, Any], recording: Recording, frames: int, record: bool
) -> dict[str, NodeSpec]:
    """All nodes, the simulator first."""
    specs: dict[str, NodeSpec] = {}

    def add(name: str, role: str, config: Mapping[str, Any]) -> None:
        if name in specs:
            raise ConfigurationError(f"{path}: {name}: there is a node of this name already")
        specs[name] = _spec(path, name, role, config)

    add("simulator", "simulator", {"recording": recording, "frames": frames})
    patterns = scenario.get("agents", {"*": {}})
    for agent in recording.agents:
        config = _matching(patterns, agent.name, f"{path}: agents")
        add(agent.name, "agent", {**_of_scene(agent), **config})
    for role in ("broker", "command_center"):
        add(role, role, scenario.get(role, {}))
    agents = [agent.name for agent in recording.agents]
    adversaries = scenario.get("adversaries", {})
    for name, config in _named(adversaries, f"{path}: adversaries"):
        if config.get("agent") not in agents:
            found = str(config.get("agent"))
            raise ConfigurationError(
                f"{path}: adversaries.{name}.agent: no agent {found!r} in this scene{nearest(found, agents)}"
            )
        add(name, "adversary", config)
    if scenario.get("coordinator") is not None:
        add("coordinator", "coordinator", {"adversaries": list(adversaries), **scenario["coordinator"]})
    add("evaluator", "evaluator", {"agents": agents, **scenario.get("evaluator", {})})
    for name, config in _named(scenario.get("nodes", {}), f"{path}: nodes"):
        add(name, str(config.get("role", "")), config)
    if record:
        add("recorder", "recorder", {"log": MessageLog()})
    return specs


def _named(configs: Mapping[Any, Any], place: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """The (name, configuration) of nodes, checked to be that."""
    for name, config in configs.items():
        if not isinstance(name, str):
            raise ConfigurationError(f"{place}: found the name {name!r}, expected a string")
        if not isinstance(config, Mapping):
            raise ConfigurationError(f"{place}.{name}: found {config!r}, expected a dict")
        yield name, config


def _of_scene(agent: SceneAgent) -> dict[str, Any]:
    """What an agent is told of itself by the scene."""
    sensor = agent.sensor
    names = ("azimuth_min_deg", "azimuth_max_deg", "elevation_min_deg", "elevation_max_deg", "max_range_m")
    return {"lidar": {name: getattr(sensor, name) for name in names}, "mobile": agent.kind == "mobile"}


def _spec(path: Path, name: str, role: str, config: Mapping[str, Any]) -> NodeSpec:
    """A node's spec; its file is the one named, else that of its role."""
    place = f"{path}: {name}"
    if not isinstance(config, Mapping):
        raise ConfigurationError(f"{place}: found {config!r}, expected a dict")
    file_name = str(config.get("file", f"{role}.py"))
    file = bundle.find("nodes", file_name, path.parent)
    if file is None:
        hint = nearest(file_name, bundle.names("nodes", path.parent))
        raise NodeFileError(f"{place}: no node file {file_name!r}{hint}")
    cls = loading.node_class(file, config.get("type"))
    if cls.role != role:
        raise NodeFileError(f"{place}: {cls.__name__} in {file} has the role {cls.role!r}, expected {role!r}")
    on_exit = config.get("on_exit", _DEFAULT_ON_EXIT.get(role, "fail"))
    if on_exit not in ON_EXIT:
        raise ConfigurationError(f"{place}.on_exit: found {on_exit!r}{nearest(str(on_exit), ON_EXIT)}")
    parameters = {key: value for key, value in config.items() if key not in _CONTROLS}
    if "agent" in parameters and "agent" not in inspect.signature(cls).parameters:
        raise NodeFileError(f"{place}: {cls.__name__} takes no parameter `agent`, by which it is put on a wire")
    return NodeSpec(role, str(file), cls.__name__, parameters, on_exit)


def _wiring(path: Path, scenario: Mapping[str, Any], nodes: Mapping[str, NodeSpec]) -> Wiring:
    options = {"map": "testbed.toml", "rewrites": [], **scenario.get("keyexpr", {})}
    for key in options:
        if key not in ("map", "rewrites"):
            raise ConfigurationError(f"{path}: keyexpr.{key}: unknown{nearest(key, ('map', 'rewrites'))}")
    if not isinstance(options["rewrites"], (list, tuple)):
        raise ConfigurationError(f"{path}: keyexpr.rewrites: found {options['rewrites']!r}, expected a list")
    sources: list[tuple[str, Mapping[str, Any]]] = []
    for index, source in enumerate([options["map"], *options["rewrites"]]):
        if isinstance(source, Mapping):
            sources.append((f"{path}: keyexpr.rewrites[{index - 1}]", source))
        else:
            file = bundle.find("keyexpr_maps", str(source), path.parent)
            sources.append((str(source), keyexpr.load(file or bundle.ROOT / "keyexpr_maps" / str(source))))
    views = {}
    for name, spec in nodes.items():
        cls = loading.node_class(Path(spec.file), spec.type)
        bound = {key: value for key, value in spec.config.items() if isinstance(value, str)}
        views[name] = keyexpr.NodeOptions(spec.role, bound, cls.inputs, cls.outputs)
    return keyexpr.resolve(sources, views, _usual_ports())


def _usual_ports() -> dict[str, set[str]]:
    """By role, the ports of our own node: a user's node of that role may do without any of them."""
    ours = [loading.node_class(bundle.ROOT / "nodes" / name) for name in bundle.names("nodes")]
    return {cls.role: {*cls.inputs, *cls.outputs} for cls in ours}


def _spelt(scenario: Mapping[str, Any], place: str) -> dict[str, Any]:
    """The scenario with the keys that it may be written with as we write them."""
    spelt = {ALIASES.get(key, key): value for key, value in scenario.items()}
    if len(spelt) < len(scenario):
        twice = [f"{key} and {same}" for key, same in ALIASES.items() if {key, same} <= scenario.keys()]
        raise ConfigurationError(f"{place}: {', '.join(twice)} are the same: expected one of them")
    return spelt


def _own(value: Any) -> Any:
    """A copy in which no dict stands in two places: what is set in one must not change the other."""
    if isinstance(value, dict):
        return {key: _own(item) for key, item in value.items()}
    return [_own(item) for item in value] if isinstance(value, list) else value


def _checked(scenario: Mapping[str, Any], place: str) -> Mapping[str, Any]:
    for key, value in scenario.items():
        if key not in KEYS:
            raise ConfigurationError(f"{place}: {key}: unknown key{nearest(str(key), KEYS)}")
        if key == "coordinator" and value is None:
            continue
        if key in (*_SINGLE, "agents", "adversaries", "nodes", "keyexpr", "run") and not isinstance(value, Mapping):
            raise ConfigurationError(f"{place}: {key}: found {value!r}, expected a dict")
    return scenario


def _check_run(options: Mapping[str, Any], place: str) -> None:
    for key in options:
        if key not in RUN_DEFAULTS:
            raise ConfigurationError(f"{place}: run.{key}: unknown key{nearest(key, RUN_DEFAULTS)}")
    if options["mode"] not in MODES:
        raise ConfigurationError(f"{place}: run.mode: found {options['mode']!r}{nearest(str(options['mode']), MODES)}")
    if type(options["seed"]) is not int or options["seed"] < 0:
        raise ConfigurationError(f"{place}: run.seed: found {options['seed']!r}, expected a whole number from 0")
    if options["frames"] is not None and (type(options["frames"]) is not int or options["frames"] < 1):
        raise ConfigurationError(f"{place}: run.frames: found {options['frames']!r}, expected a whole number from 1")
    if type(options["record"]) is not bool:
        raise ConfigurationError(f"{place}: run.record: found {options['record']!r}, expected True or False")
    if not isinstance(options["rate"], (int, float)) or not 0 < options["rate"] < float("inf"):
        raise ConfigurationError(f"{place}: run.rate: found {options['rate']!r}, expected a number above 0")


def _matching(patterns: Mapping[str, Any], name: str, place: str) -> Mapping[str, Any]:
    """The configuration of the longest pattern that matches, so that a name wins over a wildcard."""
    from fnmatch import fnmatchcase

    matching = [pattern for pattern in patterns if fnmatchcase(name, pattern)]
    if not matching:
        raise ConfigurationError(f"{place}: no entry for {name!r}{nearest(name, patterns)}")
    config = patterns[max(matching, key=lambda pattern: (pattern == name, len(pattern)))]
    if not isinstance(config, Mapping):
        raise ConfigurationError(f"{place}: {name}: found {config!r}, expected a dict")
    return config


def _plain(value: Any) -> Any:
    """A configuration as JSON: the recorded scene and the log are named by their files."""
    if isinstance(value, Recording):
        return RECORDING
    if isinstance(value, MessageLog):
        return str(value.path)
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value

"""The nodes of a scenario: their names, files and parameters, and what attackers know about the scene."""

from __future__ import annotations

import inspect
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.arrays.geometry import quaternion_from_rotation
from mast_zenoh.arrays.states import CLASSES, Floats, Ints
from mast_zenoh.config import bundle, loading, plugins
from mast_zenoh.config.outside_meshes import outside_meshes
from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.errors import ConfigurationError, NodeFileError, nearest
from mast_zenoh.fusion.pipelines.agent import DUE, IDLE
from mast_zenoh.metrics.achievement import ALL
from mast_zenoh.run_folder.recording.writer import MessageLog
from mast_zenoh.scenario import driving, points
from mast_zenoh.scenes.agents import best_pattern
from mast_zenoh.scenes.recording import NO_MEASUREMENT, Recording
from mast_zenoh.sensing import LidarSensor
from mast_zenoh.wiring.model import peer_of

ON_EXIT = ("fail", "continue", "restart")

#: s, between two rows of a route.
ROUTE_STEP_S = 0.5

_DEFAULT_ON_EXIT = dict.fromkeys(
    ("agent", "detector", "peer", "driver", "adversary", "coordinator", "link"), "continue"
)
#: Keys that the configuration of every node may have besides the node's parameters.
CONTROLS = {
    "type": "name of the class in the node's file; needed if the file has several",
    "file": "a node file next to the scenario, or a shipped one; by default that of the role",
    "on_exit": f"what the run does when the node's process ends: {', '.join(ON_EXIT)}; by default continue for the "
    f"roles {', '.join(_DEFAULT_ON_EXIT)}, and fail for all others",
    "role": "of the node, in `nodes`",
    "python": "an interpreter of the node's own, such as .venv-torch/bin/python next to the scenario, in whose "
    "environment the same mast-zenoh is installed; only as processes of this machine",
}


def nodes_of(
    path: Path,
    scenario: Mapping[str, Any],
    recording: Recording,
    frames: int,
    record: bool,
    scene: Mapping[str, Any],
) -> dict[str, NodeSpec]:
    """The specs of all nodes except the links, the simulator first. scene: its spec"""
    specs: dict[str, NodeSpec] = {}
    lidars = points.described(path, scenario)

    def add(name: str, role: str, config: Mapping[str, Any]) -> None:
        if name == ALL:
            raise ConfigurationError(
                f"{path}: {name}: this name stands for all adversaries together: choose another one"
            )
        if name in specs:
            raise ConfigurationError(f"{path}: {name}: another node already has this name")
        specs[name] = node_spec(path, name, role, config)

    of_scene = driving.simulator_config(path, scenario, recording, frames, scene)
    add("simulator", "simulator", {**of_scene, **points.simulator_config(lidars)})
    patterns = scenario.get("agents", {"*": {}})
    for row, agent in enumerate(recording.agents):
        pattern = best_pattern(patterns, agent.name)
        if pattern is None:
            raise ConfigurationError(f"{path}: agents: no entry for {agent.name!r}{nearest(agent.name, patterns)}")
        if not isinstance(config := patterns[pattern], Mapping):
            raise ConfigurationError(f"{path}: agents: {agent.name}: found {config!r}, expected a dict")
        add(agent.name, "agent", {**_scene_parameters(recording, row), **points.agent_config(lidars), **config})
    for agent in recording.agents:
        if detector := points.detector_config(lidars, agent.name):
            add(f"detector_{agent.name}", "detector", {"lidar": _limits(agent.sensor), **detector})
    for role in ("broker", "command_center"):
        if scenario.get(role, {}) is not None:
            add(role, role, scenario.get(role, {}))
    for name, config in _checked_configs(scenario.get("centers", {}), f"{path}: centers"):
        add(name, "center", config)
    agents = [agent.name for agent in recording.agents]
    for agent_name, config in _peers(scenario.get("peers", {}), agents, f"{path}: peers"):
        if not isinstance(config, Mapping):
            raise ConfigurationError(f"{path}: peers: {agent_name}: found {config!r}, expected a dict")
        control = (config.get("congestion") or {}).get("type", "NoCongestionControl")
        if control != "NoCongestionControl" and scenario.get("channel") is None:
            raise ConfigurationError(
                f"{path}: peers.{agent_name}.congestion: found {control}, but the scenario has no `channel`: "
                "add channel=dict() and the map channel.toml, or leave congestion out"
            )
        if config.get("awareness") is not None:
            config = {**_vehicle_parameters(recording, agents.index(agent_name)), **config}
        add(peer_of(agent_name), "peer", {"agent": agent_name, **config})
    for name, config in driving.drivers(path, scenario):
        add(name, "driver", config)
    if scenario.get("channel") is not None:
        add("channel", "channel", scenario["channel"])
    for name, config in _checked_configs(scenario.get("adversaries", {}), f"{path}: adversaries"):
        if config.get("agent") in ([], ()):  # attacks nobody
            continue
        add(name, "adversary", config)
        if len(specs[name].agents) > 1 and scenario.get("coordinator") is not None:
            raise ConfigurationError(
                f"{path}: adversaries.{name}.agent: found {', '.join(specs[name].agents)}, expected one agent: "
                "a coordinator directs it"
            )
        if not specs[name].agents:
            raise ConfigurationError(
                f"{path}: adversaries.{name}.agent: found none, expected an agent, or a list of them"
            )
        for agent_name in specs[name].agents:
            if agent_name not in agents:
                raise ConfigurationError(
                    f"{path}: adversaries.{name}.agent: no agent {agent_name!r} in this scene"
                    f"{nearest(agent_name, agents)}"
                )
    if scenario.get("coordinator") is not None:
        adversaries = [name for name, spec in specs.items() if spec.role == "adversary"]
        add("coordinator", "coordinator", {"adversaries": adversaries, **scenario["coordinator"]})
        directed = specs["coordinator"].config["adversaries"]
        _check_names(directed, adversaries, f"{path}: coordinator.adversaries", "adversary in this scenario")
    add_surroundings(specs, recording)
    ages = {name: specs[name].config["picture_age_s"] for name in agents if "picture_age_s" in specs[name].config}
    evaluator = scenario.get("evaluator", {})
    ages_option = {"picture_ages_s": ages} if ages and "picture_age_s" not in evaluator else {}
    add("evaluator", "evaluator", {"agents": agents, **ages_option, **driving.evaluator_config(scenario), **evaluator})
    drivers = driving.described_drivers(path, scenario)
    if drivers and takes(specs["evaluator"], "drivers"):
        specs["evaluator"].config.setdefault("drivers", drivers)
    for name, config in _checked_configs(scenario.get("nodes", {}), f"{path}: nodes"):
        add(name, str(config.get("role", "")), config)
    if record:
        scans = {} if lidars.get("recorded") is None else {"points": lidars["recorded"]}
        add("recorder", "recorder", {"log": MessageLog(), **scans})
    for name, spec in specs.items():
        integrity = _part(_part(spec.config, "pipeline"), "integrity")
        _check_anchors(integrity, agents, f"{path}: {name}: pipeline.integrity")
    return specs


def _check_anchors(stage: Mapping[str, Any], agents: Sequence[str], place: str) -> None:
    """Raise ConfigurationError for an anchor of an integrity stage, or of one inside it, that no agent is."""
    _check_names(stage.get("anchors", ()), agents, f"{place}.anchors", "agent in this scene")
    for key in stage:
        _check_anchors(_part(stage, key), agents, f"{place}.{key}")


def _part(config: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    part = config.get(name)
    return part if isinstance(part, Mapping) else {}


def _check_names(names: object, known: Sequence[str], place: str, kind: str) -> None:
    """Raise ConfigurationError for a name that none of the known ones is; lists of other types are refused later."""
    for name in names if isinstance(names, (list, tuple)) else ():
        if name not in known:
            raise ConfigurationError(f"{place}: no {kind} is called {name!r}{nearest(str(name), known)}")


def _peers(patterns: Mapping[str, Any], agents: Iterable[str], place: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield (agent, configuration of its peer) of each agent that a pattern names."""
    agents = list(agents)
    for pattern in patterns:
        if not any(best_pattern([pattern], agent) for agent in agents):
            raise ConfigurationError(f"{place}: no agent {pattern!r} in this scene{nearest(pattern, agents)}")
    for agent in agents:
        if (best := best_pattern(patterns, agent)) is not None:
            yield agent, patterns[best]


def share_faults(evaluator: NodeSpec, faults: Mapping[str, Any]) -> None:
    """Let the evaluator know the faults of each agent, to compare them with its trust."""
    if takes(evaluator, "faults"):
        evaluator.config.setdefault("faults", dict(faults))


def _checked_configs(configs: Mapping[Any, Any], place: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield (name, configuration) of each node, with checked types."""
    for name, config in configs.items():
        if not isinstance(name, str):
            raise ConfigurationError(f"{place}: found the name {name!r}, expected a string")
        if not isinstance(config, Mapping):
            raise ConfigurationError(f"{place}.{name}: found {config!r}, expected a dict")
        yield name, config


def add_surroundings(specs: Mapping[str, NodeSpec], recording: Recording) -> None:
    """Add the `surroundings` parameter to attackers whose class takes it.

    Attackers are adversaries and coordinators.
    """
    attackers = {name: spec for name, spec in specs.items() if spec.role in ("adversary", "coordinator")}
    victims = list(dict.fromkeys(agent for spec in attackers.values() for agent in spec.agents))
    for spec in attackers.values():
        if takes(spec, "surroundings"):
            known_victims = victims if spec.role == "coordinator" else spec.agents
            spec.config.setdefault("surroundings", surroundings_of(recording, known_victims))


def add_input_limits(specs: Mapping[str, NodeSpec], rows: int) -> None:
    """Limit what nodes fuse that have a parameter for that and no limit; rows: of a frame"""
    _add_default(specs, "input_limit", {"type": "FairInput", "rows": rows})


def add_outside(path: Path, specs: Mapping[str, NodeSpec], parameters: Mapping[str, Mapping[str, Any]]) -> None:
    """Have meshes outside the run complete the nodes that take part in them.

    parameters: by key of a mesh, the parameter of nodes that have none of their own, from the scenario
    """
    for key, mesh in outside_meshes().items():
        partners = {name: spec for name, spec in specs.items() if takes(spec, key)}
        if key in parameters:
            _add_default(partners, key, parameters[key])
        if partners:
            mesh.prepare(path, specs, partners)


def _add_default(specs: Mapping[str, NodeSpec], parameter: str, value: Mapping[str, Any]) -> None:
    for spec in specs.values():
        if takes(spec, parameter):
            spec.config.setdefault(parameter, dict(value))


def takes(spec: NodeSpec, parameter: str) -> bool:
    """Whether the class of a node has a parameter; a user's may do without."""
    return parameter in inspect.signature(loading.node_class(Path(spec.file), spec.type)).parameters


def _scene_parameters(recording: Recording, row: int) -> dict[str, Any]:
    """The parameters of an agent's node that the scene provides. row: of the agent"""
    agent = recording.agents[row]
    mobile = agent.kind == "mobile"
    # A pole acts on nothing; but the first agent is the ego, whose mission estimate is measured.
    parameters = {"lidar": _limits(agent.sensor), "mobile": mobile, "acts": mobile or row == 0}
    due = [_due(recording, row, sensor) for sensor in range(len(agent.sensors))]
    probabilities = [sensor.detection_probability for sensor in agent.sensors]
    if len(agent.sensors) == 1 and due == [""] and probabilities == [None] and _at_frames(recording, row):
        return parameters
    return parameters | {
        "sensors": [
            {
                "name": sensor.name,
                "lidar": _limits(sensor.lidar),
                "mount_position": sensor.lidar.mount_position.tolist(),
                "mount_rotation": quaternion_from_rotation(sensor.lidar.mount_rotation).tolist(),
                "frames": frames,
                "detection_probability": sensor.detection_probability,
            }
            for sensor, frames in zip(agent.sensors, due, strict=True)
        ]
    }


def _vehicle_parameters(recording: Recording, row: int) -> dict[str, Any]:
    """What an agent's peer says of the agent itself; empty for a pole. row: of the agent"""
    agent = recording.agents[row]
    if agent.kind != "mobile":
        return {}
    itself = np.flatnonzero(recording.truth.id == agent.object_id)[:1]
    if not len(itself):
        return {"vehicle": {}}
    size, kind = recording.truth.size[itself[0]], CLASSES[recording.truth.class_id[itself[0]]]
    return {"vehicle": {"size": size.tolist(), "kind": kind}}


def _limits(lidar: LidarSensor) -> dict[str, float]:
    """Field of view and range of a sensor."""
    names = ("azimuth_min_deg", "azimuth_max_deg", "elevation_min_deg", "elevation_max_deg", "max_range_m")
    return {name: getattr(lidar, name) for name in names}


def _due(recording: Recording, row: int, sensor: int) -> str:
    """The frames with a new measurement, see `OwnSensor`; empty: all."""
    if recording.measurements is None:
        return ""
    ages = [recording.age_ns_at(frame, row, sensor) for frame in range(len(recording))]
    return "" if NO_MEASUREMENT not in ages else "".join(IDLE if age == NO_MEASUREMENT else DUE for age in ages)


def _at_frames(recording: Recording, row: int) -> bool:
    """Whether an agent's first sensor measures at the times of the frames."""
    measurements = recording.measurements
    return measurements is None or not measurements.age_ns[:, recording.column(row)].any()


def node_spec(path: Path, name: str, role: str, config: Mapping[str, Any]) -> NodeSpec:
    """A node's spec; without `file`, its file is named after its role."""
    place = f"{path}: {name}"
    if not isinstance(config, Mapping):
        raise ConfigurationError(f"{place}: found {config!r}, expected a dict")
    file_name = str(config.get("file", f"{role}.py"))
    in_session = None if "file" in config else loading.node_file(config.get("type"))
    file = in_session or bundle.find("nodes", file_name, path.parent)
    if file is None:
        known = bundle.names("nodes", path.parent)
        raise plugins.not_found(f"{place}: no node file {file_name!r}", file_name, known, NodeFileError)
    cls = loading.node_class(file, config.get("type"))
    if cls.role != role:
        raise NodeFileError(f"{place}: {cls.__name__} in {file} has the role {cls.role!r}, expected {role!r}")
    on_exit = config.get("on_exit", _DEFAULT_ON_EXIT.get(role, "fail"))
    if on_exit not in ON_EXIT:
        raise ConfigurationError(f"{place}.on_exit: found {on_exit!r}{nearest(str(on_exit), ON_EXIT)}")
    python = _interpreter(config.get("python", ""), path.parent, place)
    parameters = {key: value for key, value in config.items() if key not in CONTROLS}
    if "agent" in parameters and "agent" not in inspect.signature(cls).parameters:
        raise NodeFileError(f"{place}: {cls.__name__} has no parameter `agent`, which selects its wire")
    return NodeSpec(role, str(file), cls.__name__, parameters, on_exit, python)


def _interpreter(python: object, folder: Path, place: str) -> str:
    """The absolute path of a node's own interpreter; links stay, as they lead to its environment."""
    if not isinstance(python, str):
        raise ConfigurationError(f"{place}.python: found {python!r}, expected the path of an interpreter")
    file = (folder / Path(python).expanduser()).absolute()
    if python and not (file.is_file() and os.access(file, os.X_OK)):
        found = f"the file {file}, which cannot be executed" if file.exists() else f"no file {file}"
        raise ConfigurationError(f"{place}.python: found {found}, expected an interpreter of Python")
    return str(file) if python else ""


def surroundings_of(recording: Recording, victims: Iterable[str]) -> dict[str, Any]:
    """The parameters of `attacks.Surroundings`: buildings, sensors and routes.

    victims: the attackers' agents. Buildings out of every sensor's range are left out.
    """
    times_s = (recording.times_ns - recording.times_ns[0]) * 1e-9
    stride = max(1, round(ROUTE_STEP_S * 1e9 / recording.period_ns))
    rows = np.unique([*range(0, len(times_s), stride), len(times_s) - 1])
    agents: dict[str, Any] = {}
    for index, agent in enumerate(recording.agents):
        agents[agent.name] = {
            **_of_sensor(agent.sensor),
            "route": _route(recording, index, times_s, rows if agent.kind == "mobile" else rows[:1]),
        }
        if further := agent.sensors[1:]:
            agents[agent.name]["further"] = {sensor.name: _of_sensor(sensor.lidar) for sensor in further}
    near = _within_range(recording, rows)
    return {
        "scene": recording.name,
        "agents": agents,
        "victims": list(victims),
        "buildings": [recording.buildings[index].round(3).tolist() for index in near],
        "building_height": [float(recording.building_height[index]) for index in near],
    }


def _of_sensor(lidar: LidarSensor) -> dict[str, Any]:
    """Field of view, range and mount of a sensor."""
    return {
        "limits_deg": [
            *(lidar.azimuth_min_deg, lidar.azimuth_max_deg),
            *(lidar.elevation_min_deg, lidar.elevation_max_deg),
        ],
        "max_range_m": lidar.max_range_m,
        "mount_position": np.asarray(lidar.mount_position).tolist(),
        "mount_rotation": np.asarray(lidar.mount_rotation).tolist(),
    }


def _route(recording: Recording, agent: int, times_s: Floats, rows: Ints) -> list[list[float]]:
    rotation = quaternion_from_rotation(recording.agent_rotation[rows, agent])
    table = np.column_stack([times_s[rows], recording.agent_position[rows, agent], rotation])
    return [[round(float(value), 6) for value in row] for row in table]


def _within_range(recording: Recording, rows: Ints) -> list[int]:
    """Indices of buildings with a corner or wall centre ever in range of a sensor."""
    near: list[int] = []
    max_range_m = np.array([agent.sensor.max_range_m for agent in recording.agents])
    positions = recording.agent_position[rows, :, :2]
    for index, outline in enumerate(recording.buildings):
        points = np.concatenate([outline, 0.5 * (outline + np.roll(outline, -1, axis=0))])
        distance_m = np.linalg.norm(points - positions[..., None, :], axis=-1).min(axis=-1)
        if (distance_m <= max_range_m).any():
            near.append(index)
    return near

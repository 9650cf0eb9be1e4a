"""Resolves a scenario into all that a run needs, before any process starts."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from mast_zenoh import scenes
from mast_zenoh.config import bundle, loading, plugins, registry
from mast_zenoh.config.outside_meshes import outside_meshes
from mast_zenoh.config.resolved import DRIVER_ROLE, NodeSpec, Resolved, build_node, driver_of
from mast_zenoh.errors import ConfigurationError, NodeFileError, WiringError, nearest
from mast_zenoh.mesh.control.results import EVALUATOR
from mast_zenoh.messages import user_types
from mast_zenoh.messages.limits import LEEWAY_S, fused_rows, limits_for
from mast_zenoh.messages.packed import check_kernels
from mast_zenoh.messages.schemas import Schema
from mast_zenoh.metrics.estimates import DERIVED
from mast_zenoh.node import Node
from mast_zenoh.scenario import driving, points, reading
from mast_zenoh.scenario.cooperation import check_cooperation, uncovered
from mast_zenoh.scenario.nodes import add_input_limits, add_outside, nodes_of, share_faults
from mast_zenoh.scenario.timeline import rewrites, timeline_of
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.tracking import StoneSoupTracker
from mast_zenoh.tracking.stone_soup_tracker import INSTALL
from mast_zenoh.wiring import endpoints, maps
from mast_zenoh.wiring.model import ANY, Wire, Wiring, subject_of

#: s, limit on what a node may add to times: a century.
_MAX_RESTAMPS_S = 3e9
#: Nodes by name, each with its spec.
_Built = dict[str, tuple[NodeSpec, Node]]
#: A function that builds a Stone Soup tracker, named in a scenario as `builder="FILE.py:FUNCTION"`.
_FUNCTION = re.compile(r"(?P<file>.+\.py):(?P<name>\w+)")


def resolve(
    path: Path,
    scenario: Mapping[str, Any],
    *,
    seed: int | None = None,
    frames: int | None = None,
    record: bool = False,
    **run: Any,
) -> Resolved:
    """Resolve the scenario of a file.

    Arguments that are not None override its `run` part.
    record: add a recorder, unless the scenario's `run.record` is False

    Raises ConfigurationError (scenario), WiringError (key-expression map), SceneError (scene data).
    """
    scenario = registry.own_copy(dict(reading.checked(reading.normalise_keys(scenario, str(path)), str(path))))
    builders = load_builders(scenario, path)
    overrides = {key: value for key, value in dict(run, seed=seed, frames=frames).items() if value is not None}
    options = reading.RUN_DEFAULTS | dict(scenario.get("run", {})) | overrides
    reading.check_run(options, str(path))
    outside = {
        key: mesh.parameter(scenario[key], f"{path}: {key}")
        for key, mesh in outside_meshes().items()
        if scenario.get(key) is not None
    }
    try:
        scene_spec = reading.choose_scene(scenario.get("scene", "intersection"))
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from None
    scene = registry.build(scene_spec, scenes.Scene, f"{path}: scene")
    cache_key = json.dumps(scene_spec, sort_keys=True)
    lidars = points.described(path, scenario)
    recording = points.equipped(path, lidars, scenes.prepare(scene, options["seed"], options["frames"], cache_key))
    n_frames = len(recording) if options["frames"] is None else min(options["frames"], len(recording))
    recorded = record and options["record"]
    nodes = nodes_of(path, scenario, recording, n_frames, recorded, scene_spec)
    detections = _detections(recording) + (points.MORE_DETECTIONS if lidars else 0)
    add_input_limits(nodes, fused_rows(detections))
    add_outside(path, nodes, outside)
    wired = partial(_wired, path, scenario, nodes)
    timeline = timeline_of(
        path, scenario, nodes, recording, n_frames, wired, seed=options["seed"], mode=options["mode"]
    )
    built, sources, wiring = wired(timeline.links, timeline.on_wires)
    nodes |= timeline.links
    check_cooperation(path, built, sources, wiring, recording.period_ns)
    check_kernels(wiring.codecs, str(path))
    modelled = not lidars and not scenario.get("drivers")  # otherwise measured in points, or cast by the world
    if modelled and any(wire.message == "sweep" for wire in wiring.wires):
        recording = scenes.prepare_sweeps(recording, scene, options["seed"], options["frames"], cache_key)
        nodes[driver_of(nodes)].config["recording"] = recording
    if timeline.faults and any(wire.message == "trust" for wire in wiring.wires):
        share_faults(nodes[EVALUATOR], timeline.faults)
    return Resolved(
        name=reading.checked_name(scenario.get("name", reading.name_of_file(path.stem)), f"{path}: name"),
        seed=options["seed"],
        mode=options["mode"],
        rate=float(options["rate"]),
        frames=n_frames,
        period_ns=recording.period_ns,
        nodes=nodes,
        wiring=wiring.to_json(),
        scene=scene_spec,
        modules=modules_of(path, scenario, builders),
        steps=timeline.plan.steps,
        timeline=timeline.bands,
        network=timeline.network,
        leeway_ns=_leeway_ns([node for _, node in built.values()], recording, n_frames)
        if _uses_shipped_simulator(nodes)
        else None,
        messages=_messages(path, nodes),
        idle=(*timeline.idle, *uncovered(built, recording, n_frames)),
        max_rows=_max_rows(recording, detections, options["max_rows"]),
        plugins=plugins.used_by(
            [*registry.type_names(scenario), *registry.type_names(scene_spec)],
            {spec.type: spec.file for spec in nodes.values() if Path(spec.file).parent != bundle.ROOT / "nodes"},
        ),
        origin=recording.origin,
        recording=recording,
    )


def _wired(
    path: Path,
    scenario: Mapping[str, Any],
    nodes: Mapping[str, NodeSpec],
    links: Mapping[str, NodeSpec],
    on_wires: Iterable[tuple[str, str]] = (),
) -> tuple[_Built, maps.Sources, Wiring]:
    """The nodes and links by name, each with its spec; the sources of their wiring; and the wiring.

    on_wires: as in `Timeline`
    """
    nodes = {**nodes, **links}
    built = {name: (spec, build_node(spec, name, str(path))) for name, spec in nodes.items()}
    user_types.use(_messages(path, nodes))
    inputs = {name: node.inputs.keys() - set(node.unused) for name, (_, node) in built.items()}
    lidars = points.rewrites(points.described(path, scenario))
    sources = _sources(path, scenario, [*driving.rewrites(nodes, inputs), *lidars, *rewrites(links, nodes)])
    return built, sources, _wiring(path, built, sources, on_wires)


def modules_of(path: Path, scenario: Mapping[str, Any], builders: Iterable[Path]) -> tuple[str, ...]:
    """The scenario's own file, and the files of the classes and builders in it."""
    files = [path] if path.suffix and loading.defines_algorithms(loading.module(path)) else []
    names = list(registry.type_names(scenario))
    classes = [name.cls for name in names if isinstance(name, registry.ClassName)]
    others = [loading.class_defined_elsewhere(name, path) for name in names if not isinstance(name, registry.ClassName)]
    for cls in [*classes, *(cls for cls in others if cls is not None)]:
        file = loading.file_of_class(cls)
        ours = cls.__module__.startswith("mast_zenoh.") or plugins.plugin_of(cls) is not None
        if file is not None and not ours and not issubclass(cls, Node):
            files.append(file)
    return tuple(dict.fromkeys(map(str, [*files, *builders])))


def _messages(path: Path, nodes: Mapping[str, NodeSpec]) -> tuple[Schema, ...]:
    """The message types that nodes declare, by name.

    Raises ConfigurationError if two with the same name differ.
    """
    declared: dict[str, tuple[Schema, str]] = {}
    for spec in nodes.values():
        cls = loading.node_class(Path(spec.file), spec.type)
        place = f"{cls.__name__} in {spec.file}"
        for name, schema in cls.message_types.items():
            known, other = declared.setdefault(name, (schema, place))
            if known != schema:
                raise ConfigurationError(
                    f"{path}: message type {name!r}: {other} and {place} declare different ones: "
                    "expected one of them, in a file that both import, or another name"
                )
    return tuple(declared[name][0] for name in sorted(declared))


def _uses_shipped_simulator(nodes: Mapping[str, NodeSpec]) -> bool:
    """Whether a shipped simulator plays the scene; others may use other times."""
    shipped = [(bundle.ROOT / "nodes" / name).resolve() for name in ("simulator.py", "world.py")]
    return all(Path(spec.file).resolve() in shipped for spec in nodes.values() if spec.role == DRIVER_ROLE)


def _detections(recording: Recording) -> np.ndarray:
    """(F, A) number of detections of each agent in each frame."""
    sensors = [len(agent.sensors) for agent in recording.agents]
    counts = np.diff(recording.detection_start).reshape(-1, sum(sensors))
    return np.asarray(np.add.reduceat(counts, np.cumsum([0, *sensors[:-1]]), axis=1))


def _max_rows(recording: Recording, detections: np.ndarray, per_agent: int | None) -> dict[str, int]:
    """Limits on the rows of messages, from what the sensors of a scene detect; per_agent: the scenario's own."""
    objects = int(np.diff(recording.truth_start).max(initial=0))
    return limits_for(detections, objects, per_agent)


def _leeway_ns(nodes: Iterable[Node], recording: Recording, frames: int) -> int:
    """Tolerance for the times of messages, relative to evenly spaced frames, ns."""
    times_ns = recording.times_ns[:frames] - recording.times_ns[0]
    uneven = np.abs(times_ns - np.arange(frames) * recording.period_ns).max(initial=0)
    duration_s = float(times_ns[-1]) * 1e-9 if frames else 0.0
    return int(uneven) + round((LEEWAY_S + sum(_restamps_s(node, duration_s) for node in nodes)) * 1e9)


def _restamps_s(node: Node, duration_s: float) -> float:
    """What a node may add to times, s; it may be a user's. Raises NodeFileError for anything but a number."""
    place = f"{type(node).__module__}: {type(node).__name__}.restamps_s"
    expected = "expected a method of the run's length, s, that returns a number of seconds from 0"
    if not callable(node.restamps_s):
        raise NodeFileError(f"{place}: found {node.restamps_s!r:.80}, {expected}")
    try:
        seconds = node.restamps_s(duration_s)
    except Exception as error:
        raise NodeFileError(f"{place}: {type(error).__name__}: {error}; {expected}") from error
    if isinstance(seconds, bool) or not isinstance(seconds, (int, float)) or not 0.0 <= seconds < _MAX_RESTAMPS_S:
        raise NodeFileError(f"{place}: returned {seconds!r:.80}, {expected}")
    return seconds


def _sources(path: Path, scenario: Mapping[str, Any], more: Sequence[Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """The scenario's map and its own rewrites, followed by those in `more`."""
    options = {"map": "testbed.toml", "rewrites": [], **scenario.get("keyexpr", {})}
    for key in options:
        if key not in ("map", "rewrites"):
            raise ConfigurationError(f"{path}: keyexpr.{key}: unknown{nearest(key, ('map', 'rewrites'))}")
    if not isinstance(options["rewrites"], (list, tuple)):
        raise ConfigurationError(f"{path}: keyexpr.rewrites: found {options['rewrites']!r}, expected a list")
    sources: list[tuple[str, Mapping[str, Any]]] = []
    more = [source for source in more if source not in options["rewrites"]]
    for index, source in enumerate([options["map"], *options["rewrites"], *more]):
        if isinstance(source, Mapping):
            sources.append((f"{path}: keyexpr.rewrites[{index - 1}]", source))
        else:
            file = bundle.find("keyexpr_maps", str(source), path.parent)
            if file is None:
                hint = nearest(str(source), bundle.names("keyexpr_maps", path.parent))
                raise WiringError(f"{path}: keyexpr: {source}: no such key-expression map{hint}")
            sources.append((str(source), maps.load(file)))
    return sources


def _wiring(path: Path, built: _Built, sources: maps.Sources, on_wires: Iterable[tuple[str, str]]) -> Wiring:
    """The wiring under a map and its rewrites. on_wires: as in `Timeline`"""
    node_options = {}
    for name, (spec, node) in built.items():
        bindings = {key: names for key, value in spec.config.items() if (names := _names(value)) is not None}
        if further := _further_sensors(spec):
            bindings[maps.PART] = further
        inputs, outputs = (
            {port: message for port, message in ports.items() if port not in node.unused}
            for ports in (node.inputs, node.outputs)
        )
        node_options[name] = endpoints.NodeOptions(
            spec.role, bindings, inputs, outputs, node.takes, node.forwards, node.affects, tuple(node.fuses)
        )
    wiring = maps.resolve(sources, node_options, _shipped_ports())
    wires = {wire.key: wire for wire in wiring.wires}
    for wire in wiring.wires:
        if wire.traits.estimate in DERIVED:
            raise WiringError(
                f"{path}: {wire.key}: estimate: {wire.traits.estimate!r} is measured where messages arrive: expected "
                "another name"
            )
    for name, key in on_wires:
        wires[key] = _with_link(path, wires, key, name, node_options)
    wiring = replace(wiring, wires=tuple(wires.values()))
    subjects = {wire.subject for wire in wiring.wires if wire.message == "detections"}
    for name, (spec, _) in built.items():
        for part in _further_sensors(spec):
            if subject_of(name, part) not in subjects:
                raise WiringError(
                    f"{path}: no wire for the sensor {part!r} of {name}: expected one with the key "
                    f"agent/{{agent}}/detections/{{{maps.PART}}} in the map, as in testbed.toml"
                )
    subscribers = {name for _, _, name in wiring.flows()}
    for name, own in node_options.items():
        if (own.inputs or own.takes or own.forwards) and name not in subscribers:
            raise WiringError(
                f"{path}: {name} would receive nothing: no wire leads to its input ports ({', '.join(own.inputs)}); "
                f"name them in a map, or subscribe to every key on one port of the type {ANY!r}"
            )
    return wiring


def _with_link(
    path: Path, wires: Mapping[str, Wire], key: str, link: str, nodes: Mapping[str, endpoints.NodeOptions]
) -> Wire:
    """The wire of a key with a link before its subscribers; raises WiringError if there is none, or no port for it."""
    if key not in wires:
        raise WiringError(f"{path}: {link}: no wire {key!r}{nearest(key, wires)}")
    port = wires[key].legs[0].publisher.port
    entry = dict(role="link", node=link) | (dict(input=f"{port}_in") if port in nodes[link].inputs else {})
    return maps.insert(wires[key], entry, "", nodes, f"{path}: the fault of {key!r}")


def _names(value: object) -> str | tuple[str, ...] | None:
    """What an option that binds a node to wires names: one, or exactly the members of a list. None: no such option."""
    if isinstance(value, (list, tuple)) and all(isinstance(name, str) for name in value):
        return tuple(value)
    return value if isinstance(value, str) else None


def _further_sensors(spec: NodeSpec) -> tuple[str, ...]:
    """The names of an agent's sensors but the first; each has a wire of its own."""
    sensors = spec.config.get("sensors", ()) if spec.role == "agent" else ()
    return tuple(str(sensor["name"]) for sensor in sensors[1:])


def _shipped_ports() -> dict[tuple[str, str], set[str]]:
    """Ports of the shipped nodes by role; a user's node may lack any of them."""
    shipped = [loading.node_class(bundle.ROOT / "nodes" / name) for name in bundle.names("nodes")]
    ports: dict[tuple[str, str], set[str]] = {}
    for cls in shipped:
        ports.setdefault((cls.role, "input"), set()).update(cls.inputs)
        ports.setdefault((cls.role, "output"), set()).update(cls.outputs)
    return ports


def load_builders(scenario: Any, path: Path) -> tuple[Path, ...]:
    """Load the files of all builders in a scenario, and give their absolute paths to it.

    path: of the scenario. A file is searched in its folder, then in the current one.

    Returns the files. Raises ConfigurationError for a missing file or function.
    """
    files = []
    for parent, place in _named(scenario, ""):
        match = _FUNCTION.fullmatch(parent["builder"])
        assert match is not None
        found = [folder / match["file"] for folder in (path.parent, Path()) if (folder / match["file"]).is_file()]
        if not found:
            raise ConfigurationError(f"{path}: {place}: no file {match['file']!r} next to it or in the current folder")
        file = found[0].resolve()
        functions = {name for name, value in vars(_module(file)).items() if callable(value)}
        if match["name"] not in functions:
            raise ConfigurationError(
                f"{path}: {place}: {file} defines no function {match['name']!r}{nearest(match['name'], functions)}"
            )
        parent["builder"] = f"{file}:{match['name']}"
        files.append(file)
    return tuple(dict.fromkeys(files))


def _module(file: Path) -> ModuleType:
    try:
        return loading.module(file)
    except ConfigurationError as error:
        missing = error.__cause__.name if isinstance(error.__cause__, ModuleNotFoundError) else None
        if (missing or "").partition(".")[0] == "stonesoup":
            raise ConfigurationError(f"{error}: {INSTALL}") from None
        raise


def _named(value: Any, place: str) -> Iterator[tuple[MutableMapping[str, Any], str]]:
    """(dict, path of its `builder`) of all trackers that name a function, in nested dicts and lists."""
    if isinstance(value, MutableMapping):
        is_tracker = str(value.get("type")) in registry.known_types(StoneSoupTracker)
        if is_tracker and isinstance(builder := value.get("builder"), str) and _FUNCTION.fullmatch(builder):
            yield value, f"{place}.builder".lstrip(".")
        for key, item in value.items():
            yield from _named(item, f"{place}.{key}")
    elif isinstance(value, (list, tuple)):
        for index, item in enumerate(value):
            yield from _named(item, f"{place}[{index}]")

"""Resolves the replay of a recorded run into all that it needs, before any process starts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mast_zenoh.config import loading
from mast_zenoh.config.loading import SHIPPED, AllowedCode
from mast_zenoh.config.resolved import (
    DRIVER_ROLE,
    REALTIME,
    RECORDING,
    NodeSpec,
    ProcessStep,
    Resolved,
    build_node,
    has_topics_outside,
)
from mast_zenoh.errors import ConfigurationError, MastError
from mast_zenoh.evaluation.driven import driver_ports
from mast_zenoh.launch import liveness
from mast_zenoh.launch.measurement import recorded_wirings, scenario_of
from mast_zenoh.launch.replay.cut import Place, ReplayedMesh, cut
from mast_zenoh.launch.replay.cut import fitted as fit
from mast_zenoh.launch.replay.live import Live, live_nodes
from mast_zenoh.launch.replay.scripts import of_run, read_scripts
from mast_zenoh.mesh import player
from mast_zenoh.messages import user_types
from mast_zenoh.messages.schemas import Schema
from mast_zenoh.node import Node
from mast_zenoh.run_folder import finding, json_or_empty
from mast_zenoh.run_folder.recording.reader import file_of
from mast_zenoh.run_folder.recording.script import Script
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.wiring.insertion import never_inserted
from mast_zenoh.wiring.model import ANY, Wiring

#: Nodes whose settings change no message of the others.
_OBSERVERS = {"evaluator", "recorder"}
#: Suffix of the name of a replay.
SUFFIX = "-replay"


@dataclass(frozen=True)
class ResolvedReplay:
    """A replay that is ready to run.

    resolved: its nodes and wires;  origin: the recorded run, for run.json and metrics.json
    notices:  a sentence for each thing that is missing, or differs from the recorded run
    """

    resolved: Resolved
    origin: Mapping[str, Any]
    notices: Sequence[str]

    def record(self) -> dict[str, Any]:
        """The origin and the notices, for `launch.run`."""
        return {**self.origin, "notices": list(self.notices)}

    def lines(self) -> list[str]:
        """Which nodes are played and which are live, as text."""
        changed = self.origin["changed"]
        live = [
            f"{name} (changed: {', '.join(changed[name])})" if name in changed else name for name in self.origin["live"]
        ]
        return [f"played: {', '.join(self.origin['played'])}", f"live: {', '.join(live)}"]


def resolve(
    folder: Path,
    place: Place = "agents",
    *,
    scenario: str | None = None,
    settings: Sequence[str] = (),
    frames: int | None = None,
    repeats: int | None = 1,
    mode: str = "lockstep",
    rate: float = 1.0,
    record: bool = True,
    allowed: AllowedCode = SHIPPED,
) -> ResolvedReplay:
    """Prepare the replay of the run in a folder.

    place:    after which nodes the run is cut, see `cut`
    scenario: a scenario file with other settings of live nodes;  settings: the same, as `KEY=VALUE`. Without both,
              nodes that exchange messages with programs outside the run are played
    frames:   how many to play, None: all;  repeats: how often, None: until it is stopped
    record:   whether the replay is recorded, too;  allowed: which of the code that the folder names may run

    Raises RunFolderError for a run that cannot be replayed, ConfigurationError for invalid settings, and WiringError
    for changed nodes that do not fit the recorded wires.
    """
    file_of(folder)  # names what is missing
    run = liveness.finished_record(folder, json_or_empty(folder / "run.json"))
    recorded = scenario_of(folder, allowed)
    if not 0 < rate < float("inf"):
        raise ConfigurationError(f"rate: found {rate}, expected a number above 0")
    user_types.use(recorded.messages)
    wiring, rewired = _initial_wiring(folder)
    roles = {name: spec.role for name, spec in recorded.nodes.items() if name not in rewired}
    division = cut(wiring, roles, place)
    if not (scenario or settings):
        # What came from programs outside the run is in the recording; they need not be there again.
        outside = {name for name in division.live if has_topics_outside(recorded.nodes[name])}
        division = cut(wiring, roles, place, outside) if outside else division
    kept = division.live if record else {name for name in division.live if roles[name] != "recorder"}
    live = live_nodes(recorded, kept, scenario, settings)
    classes = {name: loading.node_class(Path(spec.file), spec.type) for name, spec in live.nodes.items()}
    messages = _messages(recorded.messages, classes)
    user_types.use(messages)
    fitted = fit(never_inserted(division.wiring, division.live - kept), classes)
    division = ReplayedMesh(division.played, frozenset(kept), fitted)
    planned = recorded.frames
    scripts = read_scripts(
        folder, division, roles, period_ns=recorded.period_ns, planned=planned, frames=frames, repeats=repeats
    )
    script = next(iter(scripts.by_node.values()))
    live_specs = {name: _repeated(spec, scripts.frames) for name, spec in live.nodes.items()}
    leeway_ns = recorded.leeway_ns
    if leeway_ns is not None:  # repetitions of uneven frames are later and later
        leeway_ns += (script.repeats - 1) * (script.span_ns - scripts.frames * recorded.period_ns)
    players = {name: _player(recorded.nodes[name], script) for name, script in scripts.by_node.items()}
    nodes = {name: players.get(name) or live_specs[name] for name in roles if name in {*players, *live.nodes}}
    steps = _steps(recorded.steps, division, mode) if repeats == 1 else ()
    for name, spec in live.nodes.items():
        build_node(spec, name)
    notices = of_run(run, recorded)
    if rewired:
        names = ", ".join(sorted(rewired))
        notices.append(
            f"{names} was inserted or removed during the recorded run: what its wires then carried is played, without "
            "measuring its effect"
        )
    notices += scripts.notices
    same = mode == "lockstep" and repeats == 1 and not notices and live.changed.keys() <= _OBSERVERS
    for name in (name for name in live.nodes if roles[name] == "evaluator"):
        if inputs := _driver_inputs(live.nodes[name], wiring, division, same):
            nodes[name] = replace(nodes[name], config={**nodes[name].config, "played_drivers": inputs})
    scene = _scene(folder)
    resolved = replace(
        recorded,
        name=recorded.name.removesuffix(SUFFIX) + SUFFIX,
        mode=mode,
        rate=rate,
        frames=script.frames,
        leeway_ns=leeway_ns,
        nodes=nodes,
        wiring=fitted.to_json(),
        modules=live.modules,
        steps=steps,
        network={},
        messages=messages,
        recording=scene,
    )
    unconnected = _unconnected(fitted, recorded, live, classes)
    left_out = [f"{step.action} {step.node}" for step in recorded.steps if step not in steps and step.node in roles]
    if unconnected:
        notices.append(f"no recorded wire leads to {', '.join(unconnected)}: these inputs get no messages")
    if left_out:
        steps_left_out = finding.names(left_out, 3)
        notices.append(f"not repeated: {steps_left_out}; what the nodes then sent, or did not send, is played")
    if scene is None:
        notices.append(f"{folder / RECORDING} cannot be read: the report shows no buildings and no camera view")
    origin = {
        "run": run.get("id"),
        "folder": str(folder.resolve()),
        "from": place,
        "frames": scripts.frames,
        "repeats": repeats,
        "played": sorted(division.played),
        "live": sorted(division.live),
        "changed": dict(live.changed),
    }
    return ResolvedReplay(resolved, origin, notices)


def _driver_inputs(
    evaluator: NodeSpec, wiring: Wiring, division: ReplayedMesh, same: bool
) -> dict[str, list[tuple[str, str]]]:
    """The messages of the played drivers, for the evaluator: see `driven.driver_ports`.

    What played nodes send is what a driver received; so is what live nodes send, if they are the `same` as recorded.

    evaluator: before it knows them; wiring: of the recorded run
    """
    before = {leg.key: leg.publisher for _, leg in wiring.legs()}
    now = {leg.key: leg.publisher for _, leg in division.wiring.legs()}
    inputs: dict[str, list[tuple[str, str]]] = {}
    for key, ends in driver_ports(wiring, evaluator.config.get("played_drivers")).items():
        publisher = now.get(key)
        played = publisher is not None and (same or publisher.node in division.played)
        for car, port in ends:
            inputs.setdefault(car, []).append((port, key if played and publisher == before.get(key) else ""))
    return inputs


def _initial_wiring(folder: Path) -> tuple[Wiring, set[str]]:
    """The wiring that a run began with, without nodes that came or went during the run; and these.

    Subscribers keep their keys when a node is inserted, so what they received is on the same keys throughout.
    """
    known = [wiring for _, wiring in recorded_wirings(folder)]
    interposers = [{name for wire in wiring.wires for name in wire.interposers} for wiring in known]
    rewired = {name for names in interposers for name in names if not all(name in each for each in interposers)}
    return never_inserted(known[0], rewired), rewired


def _player(spec: NodeSpec, script: Script) -> NodeSpec:
    """The spec of the player of a recorded node."""
    cls = player.ScenePlayer if spec.role == DRIVER_ROLE else player.Player
    own = {"file": str(spec.file)} | {name: getattr(spec, name) for name in ("type", "on_exit", "config")}
    recorded = spec.config.get("recorded") or own  # a replay can be replayed
    return NodeSpec(spec.role, str(player.__file__), cls.__name__, {"script": script, "recorded": recorded}, "fail")


def _repeated(spec: NodeSpec, frames: int) -> NodeSpec:
    """The spec of a live node, with the times of its sensors in the frames that are played and repeated."""
    sensors = spec.config.get("sensors")
    if not sensors:
        return spec
    return replace(
        spec,
        config={**spec.config, "sensors": [each | {"frames": each.get("frames", "")[:frames]} for each in sensors]},
    )


def _messages(recorded: Iterable[Schema], classes: Mapping[str, type[Node]]) -> tuple[Schema, ...]:
    """The message types of the recording and of the live nodes.

    Raises ConfigurationError if a live node declares another type with the name of a recorded one.
    """
    known = {schema.name: schema for schema in recorded}
    for name, cls in classes.items():
        for message, schema in cls.message_types.items():
            if known.setdefault(message, schema) != schema:
                raise ConfigurationError(
                    f"{name}: declares another message type {message!r} than the recorded one: expected the same, or "
                    "another name"
                )
    return tuple(known[name] for name in sorted(known))


def _steps(steps: Iterable[ProcessStep], division: ReplayedMesh, mode: str) -> tuple[ProcessStep, ...]:
    """The process steps that a replay repeats.

    Played nodes are not paused: their silence is recorded. Nothing is paused in lock-step.
    """
    return tuple(
        step
        for step in steps
        if step.node in {*division.played, *division.live}
        and not (step.action in REALTIME and (mode == "lockstep" or step.node in division.played))
    )


def _unconnected(wiring: Wiring, recorded: Resolved, live: Live, classes: Mapping[str, type[Node]]) -> list[str]:
    """New inputs of changed nodes, as node.port, that no wire of the replay leads to."""
    names = []
    for name, keys in live.changed.items():
        if {"file", "type"} & set(keys):
            known = {each.port for each in wiring.ports(name).inputs.values()}
            with suppress(MastError):  # its file is gone, or changed
                known |= loading.node_class(Path(recorded.nodes[name].file), recorded.nodes[name].type).inputs.keys()
            own = {port: message for port, message in classes[name].inputs.items() if message != ANY}
            names += [f"{name}.{port}" for port in own if port not in known]
    return names


def _scene(folder: Path) -> Recording | None:
    """The scene of a run; None if it cannot be read."""
    try:
        return Recording.load(folder / RECORDING)
    except Exception:  # NumPy has many ways to refuse a file
        return None

"""A fully resolved scenario, as stored in run folders and sent to processes.

Actions of a timeline on processes, frame by frame.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from mast_zenoh.config import loading, plugins, registry
from mast_zenoh.config.loading import SHIPPED, AllowedCode
from mast_zenoh.errors import ConfigurationError, RunFolderError
from mast_zenoh.messages import user_types
from mast_zenoh.messages.limits import Timespan
from mast_zenoh.messages.schemas import Schema
from mast_zenoh.node import Node
from mast_zenoh.run_folder import read_object
from mast_zenoh.run_folder.finding import Finding
from mast_zenoh.run_folder.recording.script import Script
from mast_zenoh.run_folder.recording.writer import MessageLog
from mast_zenoh.v2x.reference_position import LocalPlane
from mast_zenoh.wiring.model import Wiring

if TYPE_CHECKING:
    from mast_zenoh.scenes.recording import Recording


RECORDING = "scene.npz"

#: Role of the node that drives the scene.
DRIVER_ROLE = "simulator"


@dataclass(frozen=True, slots=True)
class NodeSpec:
    """One node of a run: its role, file, class and parameters.

    on_exit: what the run does when the node exits
    python:  path of an interpreter of its own; empty: that of the launcher
    """

    role: str
    file: str
    type: str
    config: dict[str, Any]
    on_exit: str
    python: str = ""

    @property
    def agents(self) -> tuple[str, ...]:
        """The agents on whose wires it is: one or several in its parameter `agent`; none without it."""
        value = self.config.get("agent")
        if isinstance(value, (list, tuple)):
            return tuple(map(str, value))
        return () if value is None else (str(value),)


def joining_files(node: str) -> tuple[str, str]:
    """The files of scenario and wiring with which a node begins that is being inserted into a running run."""
    return f"scenario.{node}.json", f"wiring.{node}.json"


def driver_of(nodes: Mapping[str, NodeSpec]) -> str:
    """The name of the node that drives the scene; "" if there is none."""
    return next((name for name, spec in nodes.items() if spec.role == DRIVER_ROLE), "")


@dataclass(frozen=True)
class Resolved:
    """A fully resolved scenario.

    modules: the user's Python files that define algorithms named in it; to be loaded before its nodes are built
    steps: actions on processes, by frame; timeline: attacks and faults as the report shows them; network: hosts
    messages: the message types that its nodes declare; the codec must know them (`user_types.use`) when nodes are built
    idle: the parts of the scenario that match nothing in this run, or begin after it; not of earlier versions
    leeway_ns: tolerance for the times of messages, see `Timespan`; None, as in earlier versions: unlimited
    plugins: by name, the classes of plugins that it uses, each with its distribution and version
    max_rows: limits on the rows of a message by type, see `row_limits`; none in earlier versions
    origin: x and y, m, of the origin of local planes, see `Recording.origin`; that of the world in earlier versions
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
    leeway_ns: int | None = None
    messages: tuple[Schema, ...] = ()
    idle: tuple[Finding, ...] = ()
    max_rows: dict[str, int] = field(default_factory=dict)
    plugins: dict[str, str] = field(default_factory=dict)
    origin: tuple[float, float] = (0.0, 0.0)
    recording: Recording | None = field(default=None, compare=False)

    @property
    def timespan(self) -> Timespan | None:
        """The frames and times that messages can have; None if unknown."""
        return None if self.leeway_ns is None else Timespan(self.frames, self.period_ns, self.leeway_ns)

    @property
    def plane(self) -> LocalPlane:
        """The plane that all stations of the run share."""
        return LocalPlane(origin=self.origin)

    @property
    def patient(self) -> bool:
        """Whether the run waits for silent nodes: in lock-step without network cuts."""
        return self.mode == "lockstep" and not self.network

    def to_json(self) -> dict[str, Any]:
        """The content of scenario.json; the wiring has its own file.

        Keys:
        name, seed, mode, rate, frames: as in run.json
        period_ns, leeway_ns: between two frames; by how much times of messages may be off
        scene, modules: as in the scenario; the user's Python files that define algorithms
        timeline: attacks, faults and links: `label`, `kind`, `type`, `at_s`, `until_s` (null: the end) and `nodes`
        steps: actions on processes: `frame`, `action` and `node`
        network: hosts and their faults
        max_rows: by type of message, the most rows
        origin: x and y, m, of the origin of local planes
        messages: message types that nodes declare
        idle: findings on parts that match nothing
        plugins: by class of a plugin, its distribution and version
        nodes: by name: `role`, `file`, `type`, `on_exit`, `config`, all of its parameters, and `python`, the
            interpreter of a node that has its own
        """
        nodes = {
            name: {
                "role": spec.role,
                "file": str(spec.file),
                "type": spec.type,
                "on_exit": spec.on_exit,
                "config": self._plain(spec.config),
                **({"python": str(spec.python)} if spec.python else {}),
            }
            for name, spec in self.nodes.items()
        }
        names = ["name", "seed", "mode", "rate", "frames", "period_ns", "leeway_ns"]
        names += ["scene", "modules", "timeline", "network", "max_rows", "origin"]
        steps = [step._asdict() for step in self.steps]
        declared = {"messages": [user_types.to_json(schema) for schema in self.messages]} if self.messages else {}
        idle = {"idle": [each.to_json() for each in self.idle]} if self.idle else {}
        return {
            **{name: getattr(self, name) for name in names},
            "modules": [str(module) for module in self.modules],
            **declared,
            **({"plugins": self.plugins} if self.plugins else {}),
            **idle,
            "steps": steps,
            "nodes": nodes,
        }

    def _plain(self, value: Any) -> Any:
        """A configuration as JSON values; recorded scene, log and scripts become file names."""
        if value is self.recording is not None:
            return RECORDING
        if isinstance(value, (MessageLog, Script)):
            return str(value.path)
        if isinstance(value, Mapping):
            return {key: self._plain(item) for key, item in value.items()}
        if isinstance(value, (list, tuple)):
            return [self._plain(item) for item in value]
        return value

    @classmethod
    def from_json(cls, data: Mapping[str, Any], wiring: dict[str, Any]) -> Resolved:
        """The scenario that `to_json` wrote."""
        nodes = {name: NodeSpec(**spec) for name, spec in data["nodes"].items()}
        steps = tuple(ProcessStep(**step) for step in data["steps"])
        lists = {name: tuple(data[name]) for name in ("modules", "timeline")}
        lists["idle"] = tuple(Finding.from_json(each) for each in data.get("idle", ()) if isinstance(each, dict))
        used = {str(name): str(text) for name, text in dict(data.get("plugins", {})).items()}
        messages = tuple(user_types.from_json(schema) for schema in data.get("messages", ()))
        x, y = map(float, data.get("origin", (0.0, 0.0)))
        lists["origin"] = LocalPlane(origin=(x, y)).origin
        return cls(
            **{**data, **lists, "nodes": nodes, "wiring": wiring, "steps": steps, "messages": messages, "plugins": used}
        )

    @classmethod
    def read(cls, run_folder: Path, allowed: AllowedCode = SHIPPED, node: str = "") -> Resolved:
        """The resolved scenario in a run folder.

        allowed: which of the Python files and interpreters that it names may run; the others are UntrustedFile
        node:    which node begins with it: one that is being inserted may begin with another one
        Raises RunFolderError for a folder whose scenario cannot be read.
        """
        inserted = bool(node) and all((run_folder / name).exists() for name in joining_files(node))
        names = joining_files(node) if inserted else ("scenario.json", "wiring.json")
        try:
            scenario, wiring = (read_object(run_folder / name) for name in names)
            Wiring.from_json(wiring)
            resolved = cls.from_json(scenario, wiring)
        except (RunFolderError, ValueError, LookupError, TypeError, AttributeError) as error:
            problem = f"{type(error).__name__}: {error!s:.300}" if not isinstance(error, RunFolderError) else str(error)
            raise RunFolderError(f"{run_folder}: scenario.json and wiring.json cannot be read: {problem}") from None
        return resolved.allowing(allowed, str(run_folder), run_folder)

    def allowing(self, allowed: AllowedCode, origin: str, folder: Path | None = None) -> Resolved:
        """A copy that runs no code but what is shipped or allowed; see `AllowedCode.files_in`."""
        specs = self.nodes.values()
        of_nodes = [*(spec.file for spec in specs), *(spec.python for spec in specs if spec.python)]
        names = dict.fromkeys([*self.modules, *of_nodes])
        files = cast("dict[str, str]", allowed.files_in(origin, folder, names))  # an UntrustedFile is shown as text
        return replace(
            self,
            modules=tuple(files[name] for name in self.modules),
            nodes={
                name: replace(spec, file=files[spec.file], python=files[spec.python] if spec.python else "")
                for name, spec in self.nodes.items()
            },
        )

    def refuse_interpreters(self, where: str) -> None:
        """Raise ConfigurationError for a node with an interpreter of its own. where: a place without, in words"""
        for name, spec in self.nodes.items():
            if spec.python:
                raise ConfigurationError(
                    f"{self.name}: {name}.python: found {str(spec.python)!r}, expected none {where}: play it as "
                    "processes of this machine (--runtime mesh), or leave `python` out"
                )

    def load_modules(self) -> None:
        """Load the user's Python files that define algorithms; raises UntrustedCode before any is loaded.

        Plugins are loaded when a class of theirs is built; an error names those that are not installed here.
        """
        plugins.expect(self.plugins)
        for file in [Path(module) for module in self.modules]:
            loading.module(file)

    def with_values(self, change: Callable[[Any], Any]) -> Resolved:
        """A copy whose nodes have changed values of parameters. change: what a value becomes"""
        specs = self.nodes.items()
        configs = {name: {key: change(value) for key, value in spec.config.items()} for name, spec in specs}
        return replace(self, nodes={name: replace(spec, config=configs[name]) for name, spec in specs})

    def in_folder(self, run_folder: Path) -> Resolved:
        """A copy for nodes that write into a run folder from another directory."""

        def moved(value: Any) -> Any:
            return MessageLog(run_folder / value.path) if isinstance(value, MessageLog) else value

        return self.with_values(moved)

    def write(self, run_folder: Path) -> None:
        """Write scenario.json, wiring.json, scene.npz and scripts, which the run's nodes need."""
        if self.recording is not None:
            self.recording.save(run_folder / RECORDING)
        for spec in self.nodes.values():
            for value in spec.config.values():
                if isinstance(value, Script):
                    value.save(run_folder)
        for name, content in (("scenario.json", self.to_json()), ("wiring.json", self.wiring)):
            (run_folder / name).write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def has_topics_outside(spec: NodeSpec) -> bool:
    """Whether a node exchanges messages with programs outside the run."""
    return loading.node_class(Path(spec.file), spec.type).outside_topics is not Node.outside_topics


def build_node(spec: NodeSpec, name: str, place: str = "scenario.json", cls: type[Node] | None = None) -> Node:
    """Build the node of a spec.

    place: the scenario's file, for error messages;  cls: its class; None: the class in the node's file
    """
    cls = cls or loading.node_class(Path(spec.file), spec.type)
    node = registry.construct(cls, spec.config, f"{place}: {name}")
    assert isinstance(node, Node)
    return node


#: kill: at once, without results; leave: requested to finish; start: for the first time, or again;
#: pause, resume: stopped and continued by signals; disconnect, connect: from and to its networks.
ACTIONS = ("kill", "leave", "start", "pause", "resume", "disconnect", "connect")

#: Actions that end a node.
LEAVING = ("kill", "leave")

#: Actions only for real time: in lock-step, the run waits for every node.
REALTIME = ("pause", "resume", "disconnect", "connect")

#: Actions that last until another one ends them, with that other action.
UNDONE_BY = {"pause": "resume", "disconnect": "connect"}


class ProcessStep(NamedTuple):
    """One action, of ACTIONS, on `node` at the boundary before frame `frame`."""

    frame: int
    action: str
    node: str

"""docs/ref-scenario.md: the keys of scenarios, studies and hosts files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from mast_ros2.mesh import Connection, Tls, connection_of_scenario

from mast_zenoh.api.catalogue import Parameter, described, parameters_of, summary, unit_of
from mast_zenoh.config import bundle, loading, registry
from mast_zenoh.config.settings import KEYS
from mast_zenoh.deploy.ssh.hostsfile import HostsFile, Router, SshAddress, SshHost
from mast_zenoh.evaluation.evaluation import Evaluation
from mast_zenoh.faults.network import ScenarioHost
from mast_zenoh.fusion.input_limit import InputLimit
from mast_zenoh.fusion.regions import ServedArea
from mast_zenoh.metrics import AttributionLimits, Consistency, CutOff, Driving, Scorer
from mast_zenoh.metrics.driving import BrakingRule
from mast_zenoh.scenario import points
from mast_zenoh.scenario.nodes import CONTROLS
from mast_zenoh.scenario.reading import RunOptions
from mast_zenoh.scenes.making.scanning import ScannedPoints
from mast_zenoh.study import definition
from mast_zenoh.study.search import plan
from reference import linked, page, parameter_table, table
from reference.docstrings import sources

_INTRODUCTION = """\
Look up here which keys a scenario, a study and a file of hosts may have. [how-to-scenarios.md](how-to-scenarios.md),
[how-to-studies.md](how-to-studies.md) and [how-to-hosts.md](how-to-hosts.md#hosts-with-ssh) show them in use. What a
`type` may be is in [ref-classes.md](ref-classes.md).

Wherever a scenario has a list of names, it means exactly its members: many, one or none."""


_NODES = """\
The configuration of every node may have these keys, and the parameters of its class. A run sets those that follow from
the scene or from other parts, so that you can leave them out though they are required: `lidar`, `mobile` and `sensors`
of agents, `surroundings` of adversaries, `adversaries` of the coordinator, names of agents, all of links (see `links`),
and of the simulator all but `take_over_s`, `hold_s`, `braking` and `limits` (see `world`)."""


_POINTS = """\
How the lidars of all agents scan, and what finds objects in their points: see
[explanation-points.md](explanation-points.md) and [tutorial-own-detector.md](tutorial-own-detector.md)."""


@dataclass(frozen=True)
class Part:
    """A heading with a text, and a table below it."""

    heading: str
    about: str
    parameters: tuple[Parameter, ...] = ()
    keys: Mapping[str, str] | None = None


def parts() -> Iterator[Part]:
    """Everything on the page."""
    yield Part("## A scenario", "What `scenario(…)` in the file of a scenario returns.", keys=KEYS)
    yield Part("### `run`", _text(RunOptions), parameters_of(RunOptions))
    yield Part("### A host of `hosts`", _text(ScenarioHost), parameters_of(ScenarioHost))
    words = described(connection_of_scenario.__doc__ or "", ["every_frame"])
    every = Parameter("every_frame", "False", "", words["every_frame"])
    yield Part("### `ros2`, with its plugin", _text(Connection), (*parameters_of(Connection), every))
    yield Part("### `tls` of `ros2`", _text(Tls), parameters_of(Tls))
    yield Part("### `points`", _POINTS, points_parameters())
    yield Part("## Nodes", _NODES, keys=CONTROLS)
    for cls in node_classes():
        yield Part(f"### `{cls.role}`: {cls.__name__}", _text(cls), parameters_of(cls, [Evaluation]))
    yield Part("## Parts of nodes", "Parameters of the evaluator, of brokers, peers and centres are made of these.")
    for cls in inner_classes():
        yield Part(f"### {cls.__name__}", _text(cls), parameters_of(cls))
    yield Part("## A study", "What `study(…)` in the file of a study returns.", keys=definition.KEYS)
    yield Part("### A run of `runs`", "The values of `runs` by label.", keys=definition.RUN_KEYS)
    yield Part(
        "### `search`", "See [how-to-studies.md](how-to-studies.md#search-for-the-worst-attack).", keys=plan.KEYS
    )
    yield Part("### An attempt of `attempts`", _text(definition.Attempt), parameters_of(definition.Attempt))
    hosts = "A TOML file for `mast deploy up --engine ssh`."
    (patience,) = (each for each in parameters_of(HostsFile) if each.name == "patience_s")
    yield Part("## A file of hosts", hosts, (patience,))
    others = {"name", *(each.name for each in parameters_of(SshAddress))}
    own = tuple(each for each in parameters_of(SshHost) if each.name not in others)
    yield Part("### `[hosts.NAME]`", f"{_text(SshHost)} It also has what `[defaults]` may have.", own)
    common = "What all hosts have, unless their own table says otherwise."
    yield Part("### `[defaults]`", common, parameters_of(SshAddress))
    yield Part("### `[router]`", _text(Router), parameters_of(Router))


def scenario_page() -> str:
    """The keys of scenarios, studies and hosts files, from the code that reads them."""
    return page("Scenarios, studies and hosts files", "the code that reads them", _INTRODUCTION, map(_section, parts()))


def points_parameters() -> tuple[Parameter, ...]:
    """The keys of `points` of a scenario: of the scans, and where objects are detected."""
    scans = (parameter for parameter in parameters_of(ScannedPoints) if parameter.name in points.SCANS)
    others = []
    for key, default in points.OTHERS.items():
        unit = unit_of(key, points.KEYS[key])
        others.append(Parameter(key, repr(default), unit, points.KEYS[key].removeprefix(f"{unit}, ")))
    return (*scans, *others)


def node_classes() -> list[Any]:
    """The classes of the shipped nodes that a scenario configures."""
    files = [bundle.find("nodes", name) for name in bundle.names("nodes")]
    return [loading.node_class(file) for file in files if file and file.stem not in ("recorder", "simulator")]


def inner_classes() -> list[type]:
    """The classes of parts of these nodes that `mast list` has not."""
    bases = [Scorer, Driving, BrakingRule, AttributionLimits, CutOff, Consistency, InputLimit, ServedArea]
    classes = [cls for base in bases for cls in registry.known_types(base).values()]
    return [cls for cls in classes if cls.__module__.startswith("mast_zenoh.")]


def _text(cls: type) -> str:
    return linked(" ".join([f"{summary(cls)}.", *sources(cls)]))


def _section(part: Part) -> str:
    keys = table(("key", "value"), ((f"`{key}`", value) for key, value in (part.keys or {}).items()))
    return "\n".join(filter(None, [f"{part.heading}\n", f"{part.about}\n", keys, parameter_table(part.parameters)]))

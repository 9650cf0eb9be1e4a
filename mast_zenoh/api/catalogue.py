"""Lists classes, scenarios and studies of each kind, with documented parameters.

A docstring describes parameters as `name: text` or `name, name: text`, on separate lines or after a full stop or a
semicolon. A class inherits the descriptions of its bases.
"""

from __future__ import annotations

import ast
import html
import inspect
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Any, overload

from mast_zenoh import attacks, driving, fusion, integrity, links, metrics, scenes, sensing, tracking, v2x
from mast_zenoh.config import bundle, loading, plugins, registry
from mast_zenoh.config.registry import short_form
from mast_zenoh.config.settings import unit_of_name
from mast_zenoh.driving.following import IntelligentDriverModel
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.faults import Fault
from mast_zenoh.faults.network import HostPartition
from mast_zenoh.fusion.pipelines import AgentPipeline, MissionEstimator, Pipeline
from mast_zenoh.messages.packed import CODECS
from mast_zenoh.messages.schemas import BUILT_IN, Schema
from mast_zenoh.metrics.measures import MEASURES
from mast_zenoh.node import Node

#: A unit at the beginning of a description: `m, how far …`, `s of scene time`.
_LEADING = re.compile(r"(?:\([^)]*\) )?(m/s²|m/s|rad|m|s|frames)(?=,| of scene time| until| without| for| to)")


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of what a scenario can name, or a column of a message.

    kind: of a column, its dtype and shape
    default: as text, "" if it is required;  unit: "" if it has none;  choices: the valid values, if they are few
    meaning: from the docstring, "" if not described there
    """

    name: str
    default: str
    unit: str
    meaning: str
    choices: tuple[str, ...] = ()
    kind: str = ""

    @property
    def words(self) -> str:
        """The meaning, and the valid values."""
        listed = f"one of {', '.join(self.choices)}" if self.choices else ""
        return "; ".join(part for part in (self.meaning, listed) if part)


def summary(cls: type) -> str:
    """The first paragraph of a class's own docstring.

    Without its full stop and without descriptions of parameters.
    """
    text = inspect.cleandoc(vars(cls).get("__doc__") or "")
    entries = _entries(text, _names(cls))
    first = text[: entries[0].start()] if entries else text
    return first.split("\n\n")[0].replace("\n", " ").strip().rstrip(".")


def parameters_of(of: Callable[..., Any], further: Iterable[Callable[..., Any]] = ()) -> tuple[Parameter, ...]:
    """The parameters of a class or function, in the order of its signature.

    further: other functions whose docstrings describe parameters that its own does not
    """
    signature = inspect.signature(of)
    meanings: dict[str, str] = {}
    for documented in (*(of.__mro__[:-1] if isinstance(of, type) else (of,)), *further):
        text = vars(documented).get("__doc__") if isinstance(documented, type) else documented.__doc__
        meanings = described(text or "", {*_names(documented), *_names(of)} - {"self"}) | meanings
    made = {each.name: each.default_factory for each in (fields(of) if is_dataclass(of) else ())}
    return tuple(
        _parameter(signature.parameters[name], meanings.get(name, ""), made.get(name, MISSING)) for name in _names(of)
    )


def _names(of: Callable[..., Any]) -> list[str]:
    return [name for name, each in inspect.signature(of).parameters.items() if each.kind is not each.VAR_KEYWORD]


def _parameter(parameter: inspect.Parameter, meaning: str, factory: Any) -> Parameter:
    """factory: makes the default of a field; MISSING: it has none"""
    choices = re.fullmatch(r"Literal\[(.*)\]", str(parameter.annotation))
    values = tuple(part.strip(" '\"") for part in choices[1].split(",")) if choices else ()
    unit = unit_of(parameter.name, meaning)
    meaning = meaning.removeprefix(f"{unit}, ").removeprefix(f"{unit}; ") if unit else meaning
    default = parameter.default if factory is MISSING else factory()
    return Parameter(parameter.name, _text(default), unit, meaning, values)


def unit_of(name: str, meaning: str) -> str:
    """The unit of a parameter, from its name's suffix or its description's beginning."""
    leading = _LEADING.match(meaning)
    return unit_of_name(name) or (leading[1] if leading else "")


def _text(default: object) -> str:
    """A default as in source code."""
    if default is inspect.Parameter.empty:
        return ""
    plain = default is None or isinstance(default, (bool, int, float, str, tuple, list, dict))
    return repr(default) if plain else f"{type(default).__name__}()"


def described(text: str, names: Iterable[str]) -> dict[str, str]:
    """Descriptions of these parameters in a docstring, by name; others are absent."""
    text = inspect.cleandoc(text)
    known = list(names)
    entries = _entries(text, known)
    meanings: dict[str, str] = {}
    ends = [*(following.start() for following in entries[1:]), len(text)]
    for match, end in zip(entries, ends[: len(entries)], strict=True):
        raw = text[match.end() : end]
        meaning = _first_part(raw, text[: match.start()])
        for name in match[2].split(", "):
            matching = [each for each in known if each.startswith(name[:-1])] if name.endswith("…") else [name]
            for each in matching:
                meanings.setdefault(each, meaning)
    return meanings


def _entries(text: str, names: Iterable[str]) -> list[re.Match[str]]:
    """Matches where a docstring begins to describe these parameters.

    Group 2 holds the names of one or several parameters.
    """
    one = "|".join([*map(re.escape, sorted(names, key=len, reverse=True)), r"\w+_…"])
    entry = re.compile(rf"(?:(?<=^)|(?<=\n)|(?<=[.;] )|(?<=[.;]\n))([ ]*)((?:{one})(?:, (?:{one}))*):\s+")
    return list(entry.finditer(text))


def _first_part(raw: str, before: str) -> str:
    """A description up to the next paragraph or sentence that is not part of it.

    Such a sentence begins on a line without more indentation.
    """
    line = before.rpartition("\n")[2]
    indent = len(line) - len(line.lstrip())
    kept: list[str] = []
    for index, part in enumerate(raw.split("\n")):
        new_sentence = part[:1].isupper() or (part.strip()[:1].isupper() and len(part) - len(part.lstrip()) <= indent)
        if index and (not part.strip() or new_sentence):
            break
        kept.append(part.strip())
    return " ".join(kept).rstrip(" .;,")


#: By kind: a heading for each base class whose subclasses `type=…` can name.
_BASES: Mapping[str, Mapping[str, type]] = {
    "attacks": {
        "attacks by an adversary": attacks.Attack,
        "coordination of several adversaries": attacks.Coordination,
        "selections: what to insert, hide and move": attacks.Selection,
        "propagations: motion of false objects": attacks.Propagation,
        "imitations: appearance of false objects": attacks.Imitation,
        "spoofers: where they are, in attacks on points": attacks.Spoofer,
    },
    "trackers": {
        "pipelines of agents": AgentPipeline,
        "trackers": tracking.Tracker,
        "assignments: assigns measurements to tracks": tracking.Assignment,
    },
    "fusion": {
        "mission estimators: combine an agent's tracks with the picture": MissionEstimator,
        "pipelines of the command centre": Pipeline,
        "clusterers: group tracks of one object": fusion.Clusterer,
        "covariance checks: how far reported covariances are believed": fusion.CovarianceCheck,
        "fusions: fuse a cluster into one state": fusion.Fusion,
        "group trackers: clusters over time": fusion.GroupTracker,
    },
    "defences": {
        "integrity stages: judge agents and objects": integrity.Integrity,
        "checks: judge detections by the points of a scan": sensing.PointCheck,
    },
    "scenes": {
        "scenes: ground truth": scenes.Scene,
        "detectors: detections from lidar visibility": sensing.Detector,
        "detectors of points: detections from the scan of a lidar": sensing.PointDetector,
        "returns: points from the scan of a lidar": sensing.Returns,
        "clutter: still objects that nobody reports": sensing.Clutter,
        "sensors of agents": scenes.Sensor,
    },
    "links": {"rules: effects of a link on messages": links.Rule},
    "faults": {
        "faults of hosts' networks, in real time": HostPartition,
        "faults of nodes and of their messages": Fault,
    },
    "metrics": {
        "optional metrics, listed in evaluator=dict(metrics=[…])": metrics.Metric,
        "assigners: match tracks to true objects": metrics.Assigner,
    },
    "drivers": {
        "drivers: command the cars of agents": driving.Driver,
        "what a car can do": driving.CarLimits,
        "car following of drivers": IntelligentDriverModel,
    },
    "rules": {"generation rules: when a peer sends which objects": v2x.GenerationRules},
    "redundancy": {"redundancy rules: leave out what others have reported": v2x.RedundancyRule},
    "congestion": {"congestion control: how often a peer may send": v2x.CongestionControl},
    "channel": {
        "radio: which transmissions arrive": v2x.RadioChannel,
        "timing: how long transmissions are on the air": v2x.OfdmTiming,
        "background: stations that are not in the scene": v2x.BackgroundStations,
    },
    "awareness": {
        "when the peer of a vehicle says where the vehicle is": v2x.CamGeneration,
        "what a vehicle knows of itself": v2x.Vehicle,
    },
}
#: Kinds that are files, by the name of the function that each file defines.
_FILES = {"scenarios": "scenario", "studies": "study"}

KINDS = (*_BASES, "codecs", "messages", *_FILES)

_WIDTH = 80  # of the text of an entry
_MAX_ASSIGNMENT = 34  # of a parameter with its default, beside its meaning


@dataclass(frozen=True, slots=True)
class Entry:
    """A class, file, profile or metric that a scenario can name.

    group: its use;  description: one line;  parameters: in the order of its signature
    cls: the class, None: it is none
    """

    name: str
    group: str
    description: str
    parameters: tuple[Parameter, ...] = ()
    cls: type | None = None

    def __str__(self) -> str:
        lines = textwrap.wrap(self.description, _WIDTH, initial_indent="  ", subsequent_indent="  ")
        written = [_as_assignment(each) for each in self.parameters]
        width = min(max((len(text) for text in written), default=0), _MAX_ASSIGNMENT)
        for text, each in zip(written, self.parameters, strict=True):
            room = " " * (width + 6)
            words = textwrap.wrap(each.words, _WIDTH - len(room)) or [""]
            first = f"    {text:{width}}  {words[0]}" if len(text) <= width else f"    {text}\n{room}{words[0]}"
            lines += [first.rstrip(), *(room + line for line in words[1:])]
        return "\n".join([self.name, *lines])


def _as_assignment(parameter: Parameter) -> str:
    """`start_s = 4.0 s`; `name, required` without a default."""
    if parameter.kind:
        return f"{parameter.name}: {parameter.kind} {parameter.unit}".rstrip()
    default = f" = {parameter.default}" if parameter.default else ""
    unit = parameter.unit if parameter.default not in ("", "None") else f"({parameter.unit})"
    required = "" if parameter.default else ", required"
    return f"{parameter.name}{default}{f' {unit}' if parameter.unit else ''}{required}"


class Listing(Sequence[Entry]):
    """The entries of one kind.

    Prints as text and displays as a table in a notebook; `listing["CoordinatedAttack"]` is one entry.
    """

    def __init__(self, kind: str, entries: Sequence[Entry]) -> None:
        self.kind = kind
        self._entries = tuple(entries)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all entries."""
        return tuple(entry.name for entry in self._entries)

    @overload
    def __getitem__(self, index: int | str) -> Entry: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Entry, ...]: ...
    def __getitem__(self, index: int | str | slice) -> Entry | tuple[Entry, ...]:
        if not isinstance(index, str):
            return self._entries[index]
        for entry in self._entries:
            if entry.name == index:
                return entry
        problem = f"{self.kind}: nothing named {index!r}"
        if self.kind in _BASES:
            raise plugins.not_found(problem, index, self.names)
        raise ConfigurationError(f"{problem}{nearest(index, self.names)}")

    def __len__(self) -> int:
        return len(self._entries)

    def groups(self) -> Iterator[tuple[str, tuple[Entry, ...]]]:
        """Yield (group, its entries)."""
        for group in dict.fromkeys(entry.group for entry in self._entries):
            yield group, tuple(entry for entry in self._entries if entry.group == group)

    def __str__(self) -> str:
        parts = []
        for group, entries in self.groups():
            parts += [f"# {group}", *map(str, entries)]
        return "\n\n".join(parts)

    __repr__ = __str__

    def _repr_html_(self) -> str:
        rows = []
        for group, entries in self.groups():
            rows.append(f"<tr><th colspan=3 style='text-align:left'>{html.escape(group)}</th></tr>")
            for entry in entries:
                listed = "<br>".join(
                    f"<code>{html.escape(_as_assignment(each))}</code> {html.escape(each.words)}"
                    for each in entry.parameters
                )
                cells = (f"<code>{html.escape(entry.name)}</code>", html.escape(entry.description), listed)
                rows.append("<tr>" + "".join(f"<td style='text-align:left'>{cell}</td>" for cell in cells) + "</tr>")
        return f"<table>{''.join(rows)}</table>"


def list_kind(kind: str) -> Listing:
    """List everything of one kind that a scenario can name; includes your own classes.

    Entries have parameters with defaults and units.

    kind: attacks, trackers, fusion, defences, scenes, links, faults, metrics, drivers, rules, redundancy, congestion,
        channel, awareness, codecs, messages, scenarios or studies

    Raises ConfigurationError for any other.
    """
    if kind not in KINDS:
        raise ConfigurationError(f"list: found {kind!r}{nearest(kind, KINDS)}; expected one of {', '.join(KINDS)}")
    if kind in _FILES:
        return Listing(kind, list(_files(kind, _FILES[kind])))
    if kind == "messages":
        return Listing(kind, list(_messages()))
    if kind == "codecs":
        group = "codecs of wires, named in a [[codec]] of a key-expression map"
        return Listing(kind, [Entry(name, group, codec.meaning) for name, codec in CODECS.items()])
    plugins.load()
    special = list(_special(kind))
    entries = [] if kind == "scenes" else special
    for group, base in _BASES[kind].items():
        entries += [
            Entry(name, group, _description(cls), parameters_of(cls, getattr(cls, "described_by", ())), cls)
            for name, cls in registry.known_types(base).items()
        ]
    return Listing(kind, entries if entries is special else entries + special)


def _description(cls: type) -> str:
    """What a class is, the short name of a scene, and the plugin that brings it."""
    plugin = plugins.plugin_of(cls)
    short = f"; {short_form(cls)}" if issubclass(cls, scenes.Scene) and vars(cls).get("short_name") else ""
    return f"{summary(cls)}{short}{f' (plugin {plugin.distribution})' if plugin else ''}"


def _special(kind: str) -> Iterator[Entry]:
    """Entries that are not classes: link profiles, built-in metrics, lidars."""
    if kind == "links":
        for name, ways in links.PROFILES.items():
            rules = ", then ".join(_rule(rule) for rule in ways["up"]) or "no rule"
            both = "up and down" if ways["up"] == ways["down"] else "up"
            yield Entry(name, "profiles of an agent's link", f"{both}: {rules}")
    if kind == "metrics":
        for measure in MEASURES.values():
            yield Entry(measure.label, "always computed, for every estimate of every agent", summary(type(measure)))
    if kind == "scenes":
        for name, model in sensing.MODELS.items():
            yield Entry(name, "lidars: models for `lidar` of a scenario's `points`", str(model))


def _messages() -> Iterator[Entry]:
    """Built-in message types, and the types that currently loaded nodes declare."""
    declared: dict[str, Schema] = {}
    for node in registry.known_types(Node).values():
        assert issubclass(node, Node)
        declared |= node.message_types
    for schema in (*BUILT_IN.values(), *declared.values()):
        group = "message types of ports" if schema.name in BUILT_IN else "message types of your own nodes"
        about = f"{schema.meaning[:1].upper()}{schema.meaning[1:].rstrip('.')} (version {schema.version})"
        columns = [
            Parameter(each.name, "", each.unit, each.meaning, kind=f"{each.dtype} ({', '.join(map(str, each.shape))})")
            for each in schema.columns
        ]
        yield Entry(schema.name, group, about, tuple(columns))


def _rule(rule: Mapping[str, Any]) -> str:
    """`Loss(probability=0.1)`."""
    arguments = ", ".join(f"{name}={value!r}" for name, value in rule.items() if name != "type")
    return f"{rule['type']}({arguments})"


def _files(kind: str, function: str) -> Iterator[Entry]:
    """The shipped files of a kind; undocumented parameters are described in `baseline`."""
    files = []
    for name in bundle.names(kind):
        path, definition = loading.function(kind, name, function)
        files.append((path, definition, ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""))
    shared = [loading.function("scenarios", name, "scenario")[1] for name in ("baseline", "uncoordinated")]
    verb = {"scenarios": "run", "studies": "study"}[kind]
    group = f"{kind}: mast {verb} NAME, or mast_zenoh.{verb}(NAME)"
    for path, definition, text in files:
        line = text.split("\n\n")[0].replace("\n", " ").rstrip(".")
        yield Entry(path.stem, group, line, parameters_of(definition, shared))

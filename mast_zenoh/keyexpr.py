"""Key-expression maps: who talks to whom on which key, and how nodes are put into wires. Pure functions.

A map (TOML, or the same as a dict) lists wires; a rewrite inserts nodes into them:

    [[wire]]
    key = "agent/{agent}/detections"      # at most one placeholder, named after a role
    message = "detections"
    from = "simulator.detections"         # role.port
    to = ["agent.detections"]

    [[insert]]
    wire = "agent/{agent}/detections"
    role = "adversary"                    # every node of the role whose option `agent` is the wire's agent
    input = "detections"
    output = "detections_out"

`{agent}` stands for each node of the role `agent` in turn. An endpoint `role.port` means: the node that the
placeholder names, if it is of that role; else the nodes of the role whose option of the placeholder's name has its
value (`adversary` with `agent="infra_1"`); else, if none has such an option, all nodes of the role.

A chain on a wire K turns `publisher -> K -> subscribers` into `publisher -> K/@tap/0 -> node -> K/@tap/1 -> node -> K`:
the subscribers' key stays as it is, and wildcards do not match the tap legs' verbatim chunk.

With `to`, a rewrite stands before the subscribers of one role alone, and the others hear K as before:

    [[insert]]
    wire = "cc/picture"
    role = "link"
    input = "picture"
    output = "picture_out"
    to = "agent"                          # each link before the agent that its option `agent` names

That makes a branch, `K -> node -> K/@tap/{subscriber}/0 -> node -> K/@tap/{subscriber}/1 -> subscriber`, on which nodes
stand in the order of the rewrites; only the key of that one subscriber is another. A branch begins where the trunk
ends: who sits on the trunk is before all branches.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from mast_zenoh.errors import WiringError, nearest
from mast_zenoh.messages import SCHEMAS
from mast_zenoh.wiring import ANY, Branch, Endpoint, Leg, Wire, Wiring

_CHUNK = re.compile(r"[A-Za-z0-9_.\-]+")
_PLACEHOLDER = re.compile(r"\{([a-z_]+)\}")
_ENDPOINT = re.compile(r"([a-z_]+)\.([a-z_]+)")
TAP = "@tap"
_WIRE_KEYS = ("key", "message", "from", "to")
_INSERT_KEYS = ("wire", "role", "input", "output")

#: Rewrites of earlier versions, and those that do the same now.
RENAMED = {
    "uncoordinated.toml": ("on_detections.toml",),
    "coordinated.toml": ("on_tracks.toml", "coordination.toml"),
    "passthrough.toml": ("on_detections.toml", "on_tracks.toml"),
}

#: Roles that a map may name even where a scenario has no such node.
ROLES = (
    *("simulator", "agent", "broker", "command_center", "adversary", "coordinator", "link"),
    *("evaluator", "recorder", "visualizer"),
)


@dataclass(frozen=True, slots=True)
class NodeOptions:
    """What the wiring needs to know of a node: its role, and those options that bind it to a wire."""

    role: str
    options: Mapping[str, str]
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]


def load(path: Path) -> dict[str, Any]:
    """A map or rewrite file as a dict; raises WiringError where it is missing or no TOML."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        if path.name in RENAMED:
            successors = " and ".join(repr(name) for name in RENAMED[path.name])
            raise WiringError(
                f"{path.name}: rewrites are named after the wires that they take: name {successors} instead"
            ) from None
        beside = [other.name for other in path.parent.glob("*.toml")] if path.parent.is_dir() else []
        raise WiringError(f"{path}: no such key-expression map{nearest(path.name, beside)}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise WiringError(f"{path}: not TOML: {error}") from None


def resolve(
    sources: Sequence[tuple[str, Mapping[str, Any]]],
    nodes: Mapping[str, NodeOptions],
    optional: Mapping[str, Collection[str]] = MappingProxyType({}),
) -> Wiring:
    """The wiring of `nodes` under a map followed by rewrites, each given as (its file's name, its content).

    optional: by role, ports that a node of that role may do without: wires pass it by. (A user's adversary need not
    take the pose that ours takes.)

    A node with an input port of the type `ANY` hears every key without being named in a map.

    Raises WiringError, naming the file and the entry, for unknown keys, roles, ports or messages, invalid key
    expressions, a wire with more than one publisher, a node twice on one wire, a rewrite of no wire, and one before a
    role that does not hear the wire.
    """
    for name in nodes:
        if not _CHUNK.fullmatch(name):
            raise WiringError(f"node {name!r}: a node's name is one chunk of a key expression: letters, digits, _ . -")
    wires: dict[str, Wire] = {}
    templates: dict[str, list[str]] = {}
    hearing: dict[str, set[str]] = {}  # the roles that a template names as subscribers
    for file, content in sources:
        _known(content, {"wire", "insert"}, file)
        for index, entry in enumerate(content.get("wire", ())):
            place = f"{file}: wire {index + 1}"
            _known(entry, _WIRE_KEYS, place, required=_WIRE_KEYS)
            if entry["key"] in templates:
                raise WiringError(f"{place}: the wire {entry['key']!r} has a publisher already")
            templates[entry["key"]] = []
            hearing[entry["key"]] = {str(reference).partition(".")[0] for reference in _listed(entry["to"])}
            for wire in _instances(entry, nodes, optional, place):
                if wire.key in wires:
                    raise WiringError(f"{place}: the key {wire.key!r} has a publisher already")
                wires[wire.key] = wire
                templates[entry["key"]].append(wire.key)
    for file, content in sources:
        for index, entry in enumerate(content.get("insert", ())):
            place = f"{file}: insert {index + 1}"
            _known(entry, {*_INSERT_KEYS, "to"}, place, required=_INSERT_KEYS)
            if entry["wire"] not in templates:
                raise WiringError(f"{place}: no wire {entry['wire']!r}{nearest(entry['wire'], templates)}")
            to = entry.get("to")
            if to is not None and to not in list(hearing[entry["wire"]]):
                hint = nearest(str(to), hearing[entry["wire"]])
                raise WiringError(f"{place}: to: no role {to!r} hears the wire {entry['wire']!r}{hint}")
            for key in templates[entry["wire"]]:
                wires[key] = _insert(wires[key], entry, nodes, place)
    overhearers = [
        Endpoint(name, port) for name, node in nodes.items() for port, message in node.inputs.items() if message == ANY
    ]
    for end in overhearers:
        if len(nodes[end.node].inputs) > 1 or nodes[end.node].outputs:
            raise WiringError(f"node {end.node!r}: who hears every key on one port ({end.port!r}) has no other port")
    return Wiring(tuple(wires.values()), tuple(overhearers))


def _instances(
    entry: Mapping[str, Any],
    nodes: Mapping[str, NodeOptions],
    optional: Mapping[str, Collection[str]],
    place: str,
) -> Iterator[Wire]:
    """The wires that one entry stands for: one for each value of its placeholder."""
    template, message = str(entry["key"]), str(entry["message"])
    if message not in SCHEMAS:
        raise WiringError(f"{place}: no message type {message!r}{nearest(message, SCHEMAS)}")
    placeholders = _PLACEHOLDER.findall(template)
    if len(placeholders) > 1:
        raise WiringError(f"{place}: {template!r} has {len(placeholders)} placeholders, at most one is allowed")
    placeholder = placeholders[0] if placeholders else ""
    subjects = [name for name, node in nodes.items() if node.role == placeholder] if placeholder else [""]
    for subject in subjects:
        key = template.replace(f"{{{placeholder}}}", subject)
        for chunk in key.split("/"):
            if not _CHUNK.fullmatch(chunk):
                raise WiringError(f"{place}: {key!r} is not a valid key expression: chunk {chunk!r}")
        publishers = _endpoints(entry["from"], placeholder, subject, nodes, place, message, True, optional)
        if not publishers:
            continue
        if len(publishers) > 1:
            names = ", ".join(end.node for end in publishers)
            raise WiringError(f"{place}: the key {key!r} has {len(publishers)} publishers ({names}), expected one")
        subscribers = [
            end
            for reference in _listed(entry["to"])
            for end in _endpoints(reference, placeholder, subject, nodes, place, message, False, optional)
        ]
        if any(end.node == publishers[0].node for end in subscribers):
            raise WiringError(f"{place}: {publishers[0].node} would hear itself on {key!r}")
        yield Wire(key, subject, message, (Leg(key, publishers[0], tuple(subscribers)),))


def _listed(to: object) -> list[object]:
    return list(to) if isinstance(to, (list, tuple)) else [to]


def _insert(wire: Wire, entry: Mapping[str, Any], nodes: Mapping[str, NodeOptions], place: str) -> Wire:
    """The wire with the nodes of one rewrite inserted before its subscribers, or before those of the role `to`."""
    placeholder = "".join(_PLACEHOLDER.findall(entry["wire"]))
    into = _endpoints(f"{entry['role']}.{entry['input']}", placeholder, wire.subject, nodes, place, wire.message, False)
    out = _endpoints(f"{entry['role']}.{entry['output']}", placeholder, wire.subject, nodes, place, wire.message, True)
    for entrance, exit_ in zip(into, out, strict=True):
        subscriber = _subscriber(wire, entrance.node, entry["to"], nodes, place) if "to" in entry else None
        if "to" in entry and subscriber is None:
            continue
        on_wire = {wire.legs[0].publisher.node, *wire.interposers, *(end.node for end in wire.subscribers)}
        if entrance.node in on_wire:
            raise WiringError(f"{place}: {entrance.node} is on the wire {wire.key!r} already: that would be a loop")
        if subscriber is not None:
            wire = _on_branch(wire, entrance, exit_, subscriber)
        else:
            *before, last = wire.legs
            tap = f"{wire.key}/{TAP}/{len(before)}"
            legs = (*before, Leg(tap, last.publisher, (entrance,)), Leg(wire.key, exit_, last.subscribers))
            wire = replace(wire, legs=legs)
    return wire


def _subscriber(wire: Wire, node: str, role: str, nodes: Mapping[str, NodeOptions], place: str) -> Endpoint | None:
    """The subscriber of `role` that a node is to stand before: the one that its option of the role's name names,

    else the only one. None: it stands before none of this wire.
    """
    ends = [end for end in wire.subscribers if nodes[end.node].role == role]
    named = nodes[node].options.get(role)
    if named is not None:
        ends = [end for end in ends if end.node == named]
    if len(ends) > 1:
        names = ", ".join(end.node for end in ends)
        raise WiringError(
            f"{place}: {wire.key!r} is for {names}: an option `{role}` must say before which {node} stands"
        )
    return ends[0] if ends else None


def _on_branch(wire: Wire, entrance: Endpoint, exit_: Endpoint, subscriber: Endpoint) -> Wire:
    """The wire with a node at the end of the branch to `subscriber`, which begins with it if there is none."""
    branches = {branch.subscriber: branch for branch in wire.branches}
    branch = branches.get(subscriber)
    legs = branch.legs if branch else ()
    last = Leg(f"{wire.key}/{TAP}/{subscriber.node}/{len(legs)}", exit_, (subscriber,))
    if branch:
        legs = (*legs[:-1], replace(legs[-1], subscribers=(entrance,)), last)
        branches[subscriber] = replace(branch, legs=legs)
        return replace(wire, branches=tuple(branches.values()))
    *before, end = wire.legs
    heard_by = tuple(entrance if other == subscriber else other for other in end.subscribers)
    branches[subscriber] = Branch(entrance, subscriber, (last,))
    return replace(wire, legs=(*before, replace(end, subscribers=heard_by)), branches=tuple(branches.values()))


def _endpoints(
    reference: object,
    placeholder: str,
    subject: str,
    nodes: Mapping[str, NodeOptions],
    place: str,
    message: str,
    output: bool,
    optional: Mapping[str, Collection[str]] = MappingProxyType({}),
) -> list[Endpoint]:
    """The ports that `role.port` means for one subject."""
    match = _ENDPOINT.fullmatch(str(reference))
    if not match:
        raise WiringError(f"{place}: {reference!r} is not an endpoint, expected role.port")
    role, port = match.groups()
    roles = {*ROLES, *(node.role for node in nodes.values())}
    if role not in roles:
        raise WiringError(f"{place}: no role {role!r}{nearest(role, roles)}")
    members = {name: node for name, node in nodes.items() if node.role == role}
    if role == placeholder:
        members = {subject: members[subject]}
    elif placeholder and any(placeholder in node.options for node in members.values()):
        members = {name: node for name, node in members.items() if node.options.get(placeholder) == subject}
    found = []
    for name, node in members.items():
        ports = node.outputs if output else node.inputs
        side = "output" if output else "input"
        if port not in ports and port in optional.get(role, ()):
            continue
        if port not in ports:
            raise WiringError(f"{place}: {name} has no {side} port {port!r}{nearest(port, ports)}")
        if ports[port] != message:
            raise WiringError(f"{place}: {name}.{port} carries {ports[port]!r} messages, the wire {message!r}")
        found.append(Endpoint(name, port))
    return found


def _known(entry: Mapping[str, Any], known: Collection[str], place: str, *, required: Collection[str] = ()) -> None:
    if not isinstance(entry, Mapping):
        raise WiringError(f"{place}: found {type(entry).__name__}, expected a table")
    for key in entry:
        if key not in known:
            raise WiringError(f"{place}: unknown key {key!r}{nearest(key, known)}")
    if missing := sorted(set(required) - entry.keys()):
        raise WiringError(f"{place}: missing {', '.join(missing)}")

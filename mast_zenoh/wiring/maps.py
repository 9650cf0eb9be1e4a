"""Key-expression maps: which nodes exchange messages on which key, and which are inserted there. Pure functions.

A map (TOML, or the same as a dict) lists wires. A rewrite changes them: it inserts nodes, or adds subscribers.

    [[wire]]
    key = "agent/{agent}/detections"      # a placeholder is named after a role
    message = "detections"
    from = "simulator.detections"         # role.port
    to = ["agent.detections"]
    direction = "sensor"                  # optional, as other properties of a wire: see `Traits`

    [[insert]]
    wire = "agent/{agent}/detections"     # or one agent's wire: "agent/ego/detections"
    role = "adversary"                    # every node of the role whose option `agent` is the wire's agent
    input = "detections"                  # optional, as `output`: by default the publisher's port, and that with `_out`
    output = "detections_out"
    node = "adversary_1"                  # optional: only this node
    optional = true                       # optional: ignore the entry if there is no such wire or subscriber

    [[listen]]
    wire = "agent/*/pose"                 # every agent's; "agent/ego/pose": one; "agent/{agent}/pose": its own agent's
    role = "adversary"
    input = "poses"
    leg = "source"                        # optional: what the publisher sends, before any interposer
    node = "adversary_1"                  # optional: only this node
    optional = true                       # optional: without nodes that lack the port, and if there is such a wire

    [[publish]]
    wire = "agent/{agent}/detections"
    role = "detector"                     # instead of the wire's own publisher, where there is such a node
    output = "detections"

    [[codec]]
    wire = "agent/{agent}/tracks"         # or one agent's wire
    codec = "cpm"                         # its messages travel as Collective Perception Messages, on all legs

`{agent}` stands for each node of the role `agent` in turn. An endpoint `role.port` means the node that the
placeholder names, if it has that role; else the nodes of the role whose option with the placeholder's name has its
value (`adversary` with `agent="infra_1"`); else, if none has such an option, all nodes of the role.
`other role.port` means the nodes of the role that do not belong to the value: `other peer.heard` on a wire with
`{agent}` leads to the peers of all other agents, and `role = "other link"` of an insert means the links of all other
agents.
`{sensor}`, after `{agent}`, stands for each sensor of the agent but the first: `agent/infra_1/detections/radar`.

A chain on a wire K turns `publisher -> K -> subscribers` into `publisher -> K/@tap/0 -> node -> K/@tap/1 -> node -> K`:
the subscribers' key does not change, and wildcards do not match the verbatim chunk of the tap legs.

With `to`, a rewrite affects the subscribers of one role only, and the others receive K as before:

    [[insert]]
    wire = "cc/picture"
    role = "link"
    input = "picture"
    output = "picture_out"
    to = "agent"                          # each link before the agent that its option `agent` names

That makes a branch, `K -> node -> K/@tap/{subscriber}/0 -> node -> K/@tap/{subscriber}/1 -> subscriber`, with nodes in
the order of the rewrites; only the key of that one subscriber changes. A branch begins where the trunk ends: nodes on
the trunk come before all branches.

All wires are resolved first, then their publishers, then the inserts in order, then the listeners. A listener receives
K, after the trunk's interposers and before the branches, unless it asks for the source."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from mast_zenoh.errors import WiringError, nearest
from mast_zenoh.messages.packed import CODECS
from mast_zenoh.messages.schemas import SCHEMAS
from mast_zenoh.wiring.endpoints import OTHER, ROLES, NodeOptions, check_forwarding, members, ports
from mast_zenoh.wiring.insertion import extended
from mast_zenoh.wiring.model import (
    ANY,
    DIRECTIONS,
    TAP,
    Branch,
    Endpoint,
    Leg,
    Listener,
    NodeFlow,
    Traits,
    Wire,
    Wiring,
    agent_of,
    part_of,
    subject_of,
)

_CHUNK = re.compile(r"[A-Za-z0-9_.\-]+")
_PLACEHOLDER = re.compile(r"\{([a-z_]+)\}")
_ENDPOINT = re.compile(r"(other )?([a-z_]+)\.([a-z_]+)")

#: The keys of an entry of each kind: required, optional.
KEYS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "wire": (("key", "message", "from", "to"), tuple(each.name for each in fields(Traits))),
    "insert": (("wire", "role"), ("input", "output", "to", "node", "optional")),
    "listen": (("wire", "role", "input"), ("leg", "node", "optional")),
    "publish": (("wire", "role", "output"), ()),
    "codec": (("wire", "codec"), ()),
}

#: Columns of messages about objects that can be scored and fused.
_OBJECTS = {"id", "position", "velocity", "covariance"}

#: The second placeholder of a key.
PART = "sensor"

#: (name of a file, content) of a map and its rewrites.
Sources = Sequence[tuple[str, Mapping[str, Any]]]


def load(path: Path) -> dict[str, Any]:
    """Read a map or rewrite file; raises WiringError if missing or not TOML."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        beside = [other.name for other in path.parent.glob("*.toml")] if path.parent.is_dir() else []
        raise WiringError(f"{path}: no such key-expression map{nearest(path.name, beside)}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise WiringError(f"{path}: not TOML: {error}") from None
    except OSError as error:
        raise WiringError(f"{path}: {error.strerror}, expected a key-expression map") from None


def resolve(
    sources: Sources,
    nodes: Mapping[str, NodeOptions],
    optional: Mapping[tuple[str, str], Collection[str]] = MappingProxyType({}),
) -> Wiring:
    """The wiring of `nodes` under a map followed by rewrites.

    sources: (name of the file, its content) of the map and of each rewrite
    optional: ports by role and side (input or output) that a node of that role may lack: wires skip it. (A user's
    adversary need not take the pose that the shipped one takes.)

    A node with an input port of the type `ANY` receives every key without being named in a map.

    Raises WiringError, naming the file and the entry, for unknown keys, roles, nodes, ports or messages, invalid key
    expressions, a wire with several publishers, a node twice on one wire, a rewrite that matches no wire, or is for a
    role that does not subscribe to the wire, a node that would receive its own messages, or those of a wire twice, a
    port that would publish two wires of one subject, and traits that contradict others.
    """
    for name in nodes:
        if not _CHUNK.fullmatch(name):
            raise WiringError(f"node {name!r}: a node's name is one chunk of a key expression: letters, digits, _ . -")
    for file, content in sources:
        _check_keys(content, KEYS, file)
    wires: dict[str, Wire] = {}
    places: dict[str, str] = {}  # of the entries, by key
    templates: dict[str, list[str]] = {}
    subscribing: dict[str, set[str]] = {}  # the roles that a template names as subscribers
    for place, entry in _entries(sources, "wire"):
        if entry["key"] in templates:
            raise WiringError(f"{place}: the wire {entry['key']!r} already has a publisher")
        templates[entry["key"]] = []
        subscribing[entry["key"]] = {
            str(reference).partition(".")[0].removeprefix(OTHER) for reference in _listed(entry["to"])
        }
        for wire in _instances(entry, nodes, optional, place):
            if wire.key in wires:
                raise WiringError(f"{place}: the key {wire.key!r} already has a publisher")
            wires[wire.key], places[wire.key] = wire, place
            templates[entry["key"]].append(wire.key)
    for place, entry in _entries(sources, "publish"):
        template = _template_of(entry["wire"], templates, place)
        keys = templates[template] if entry["wire"] == template else [entry["wire"]]
        _check_affected(entry, _placeholder(template), [wires[key] for key in keys], nodes, place)
        for key in keys:
            wires[key] = _published(wires[key], entry, nodes, place)
    for place, entry in _entries(sources, "insert"):
        if entry.get("optional") and not _refers(entry["wire"], templates):
            continue
        template = _template_of(entry["wire"], templates, place)
        keys = templates[template] if entry["wire"] == template else [entry["wire"]]
        if "to" in entry and entry["to"] not in list(subscribing[template]):
            if entry.get("optional"):
                continue
            hint = nearest(str(entry["to"]), subscribing[template])
            raise WiringError(f"{place}: to: no role {entry['to']!r} subscribes to the wire {template!r}{hint}")
        if entry["wire"] != template:
            _check_affected(entry, _placeholder(template), [wires[key] for key in keys], nodes, place)
        for key in keys:
            wires[key] = insert(wires[key], entry, _placeholder(template), nodes, place)
    for place, entry in _entries(sources, "listen"):
        if entry.get("optional") and not _refers(entry["wire"], templates, every=True):
            continue
        template = _template_of(entry["wire"], templates, place, every=True)
        keys = [entry["wire"]] if entry["wire"] in wires else templates[template]
        if not entry.get("optional"):
            _check_affected(entry, _placeholder(entry["wire"]), [wires[key] for key in keys], nodes, place)
        for key in keys:
            wires[key] = _listen(wires[key], entry, nodes, place)
    for place, entry in _entries(sources, "codec"):
        template = _template_of(entry["wire"], templates, place)
        for key in templates[template] if entry["wire"] == template else [entry["wire"]]:
            wires[key] = replace(wires[key], codec=_codec(entry["codec"], wires[key], place))
    flows = {name: NodeFlow(node.role, node.affects, node.fuses) for name, node in nodes.items()}
    wiring = Wiring(tuple(wires.values()), _overhearers(nodes), flows)
    _check_outputs(wiring, places)
    _check_traits(wiring, places)
    return wiring


def _check_outputs(wiring: Wiring, places: Mapping[str, str]) -> None:
    """Raise WiringError for a port that would publish two wires of one subject: its node could not tell them apart.

    places: of the entries, by key
    """
    keys: dict[tuple[str, str, str], str] = {}
    for wire, leg in wiring.legs():
        node, port = leg.publisher.node, leg.publisher.port
        other = keys.setdefault((node, port, wire.subject), leg.key)
        if other != leg.key:
            raise WiringError(
                f"{places[wire.key]}: {node}.{port} would publish on {other!r} and on {leg.key!r}: expected a port for "
                "each, or two nodes"
            )


def _check_traits(wiring: Wiring, places: Mapping[str, str]) -> None:
    """Raise WiringError for traits that other wires contradict. places: of the entries, by key"""
    publishers = {wire.key: wire.legs[0].publisher.node for wire in wiring.wires}
    estimates: dict[tuple[str, str], str] = {}
    for wire in wiring.wires:
        traits, publisher = wire.traits, publishers[wire.key]
        if traits.of and (traits.of == wire.key or publishers.get(traits.of) != publisher):
            own = [key for key, node in publishers.items() if node == publisher and key != wire.key]
            hint = nearest(traits.of, own)
            raise WiringError(
                f"{places[wire.key]}: of: found {traits.of!r}, expected another wire of {publisher}{hint}"
            )
        other = estimates.setdefault((wire.subject, traits.estimate), wire.key) if traits.estimate else wire.key
        if other != wire.key:
            raise WiringError(
                f"{places[wire.key]}: estimate: {traits.estimate!r} is already that of {other!r}: expected another name"
            )


def _instances(
    entry: Mapping[str, Any],
    nodes: Mapping[str, NodeOptions],
    optional: Mapping[tuple[str, str], Collection[str]],
    place: str,
) -> Iterator[Wire]:
    """The wires of one entry: one for each value of its placeholder."""
    template, message = entry["key"], entry["message"]
    if message not in SCHEMAS:
        raise WiringError(f"{place}: no message type {message!r}{nearest(message, SCHEMAS)}")
    if message == "clock" and not str(entry["from"]).startswith("simulator."):
        raise WiringError(f"{place}: from: found {entry['from']!r}, expected the simulator: a run has one clock")
    placeholder, traits = _placeholder(template), _traits(entry, place)
    for subject in _subjects(template, nodes, place):

        def endpoints(reference: object, output: bool = False, subject: str = subject) -> list[Endpoint]:
            match = _ENDPOINT.fullmatch(str(reference))
            if not match:
                raise WiringError(
                    f"{place}: {reference!r} is not an endpoint, expected role.port, or other role.port, of small "
                    "letters and _"
                )
            other, role, port = match.groups()
            referenced = members(f"{other or ''}{role}", nodes, place, placeholder=placeholder, subject=subject)
            lacking = optional.get((role, "output" if output else "input"), ())
            return ports(referenced, port, message, place, output=output, optional=lacking)

        def filled(text: str, subject: str = subject) -> str:
            return text.replace(f"{{{placeholder}}}", agent_of(subject)).replace(f"{{{PART}}}", part_of(subject))

        key = filled(template)
        for chunk in key.split("/"):
            if not _CHUNK.fullmatch(chunk):
                raise WiringError(f"{place}: {key!r} is not a valid key expression: chunk {chunk!r}")
        publishers = endpoints(entry["from"], output=True)
        if not publishers:
            continue
        if len(publishers) > 1:
            names = ", ".join(end.node for end in publishers)
            raise WiringError(f"{place}: the key {key!r} has {len(publishers)} publishers ({names}), expected one")
        subscribers = [end for reference in _listed(entry["to"]) for end in endpoints(reference)]
        if any(end.node == publishers[0].node for end in subscribers):
            raise WiringError(f"{place}: {publishers[0].node} would receive its own messages on {key!r}")
        for node, count in Counter(end.node for end in subscribers).items():
            if count > 1:
                on = ", ".join(repr(end.port) for end in subscribers if end.node == node)
                raise WiringError(f"{place}: to: {node} would receive {key!r} on {on}: expected one port")
        of_subject = replace(traits, of=filled(traits.of))
        yield Wire(key, subject, message, (Leg(key, publishers[0], tuple(subscribers)),), traits=of_subject)


def _traits(entry: Mapping[str, Any], place: str) -> Traits:
    """The traits in the entry of a wire."""
    traits = Traits.from_json(entry)
    for each in fields(Traits):
        value, kind = getattr(traits, each.name), type(each.default)
        if type(value) is not kind:
            raise WiringError(
                f"{place}: {each.name}: found {value!r}, expected {'true or false' if kind is bool else 'a string'}"
            )
    if traits.direction not in DIRECTIONS:
        raise WiringError(f"{place}: direction: found {traits.direction!r}{nearest(traits.direction, DIRECTIONS)}")
    columns = {column.name for column in SCHEMAS[entry["message"]].columns}
    for name, wanted in (("estimate", traits.estimate), ("fuse", traits.fuse)):
        if wanted and not columns >= _OBJECTS:
            raise WiringError(
                f"{place}: {name}: found messages of type {entry['message']!r}, expected objects, such as tracks"
            )
    if traits.estimate and not _CHUNK.fullmatch(traits.estimate):
        raise WiringError(f"{place}: estimate: found {traits.estimate!r}, expected letters, digits, _ . and -")
    return traits


def _subjects(template: str, nodes: Mapping[str, NodeOptions], place: str) -> list[str]:
    """The subjects of a template's wires; without a placeholder, one empty subject."""
    placeholders = _PLACEHOLDER.findall(template)
    if not placeholders:
        return [""]
    if placeholders[1:] not in ([], [PART]):
        raise WiringError(f"{place}: {template!r} has {len(placeholders)} placeholders, expected a role, then {PART!r}")
    roles = {*ROLES, *(node.role for node in nodes.values())}
    if placeholders[0] not in roles:
        raise WiringError(f"{place}: {template!r}: no role {placeholders[0]!r}{nearest(placeholders[0], roles)}")
    of_role = [name for name, node in nodes.items() if node.role == placeholders[0]]
    if len(placeholders) == 1:
        return of_role
    return [subject_of(name, part) for name in of_role for part in nodes[name].names(PART)]


def _template_of(wire: object, templates: Mapping[str, list[str]], place: str, *, every: bool = False) -> str:
    """The template that a rewrite's `wire` refers to.

    wire: the template, one of its keys or, if `every`, the template with `*`
    """
    if template := _refers(wire, templates, every=every):
        return template
    known = {*templates, *(key for keys in templates.values() for key in keys)}
    raise WiringError(f"{place}: no wire {wire!r}{nearest(str(wire), known)}")


def _refers(wire: object, templates: Mapping[str, list[str]], *, every: bool = False) -> str:
    """The template, as in `_template_of`; empty: there is none."""
    return next(
        (
            template
            for template, keys in templates.items()
            if wire in (template, *keys) or (every and wire == _PLACEHOLDER.sub("*", template))
        ),
        "",
    )


def _published(wire: Wire, entry: Mapping[str, Any], nodes: Mapping[str, NodeOptions], place: str) -> Wire:
    """The wire with the publisher of a `[[publish]]`; as it is if no node of the role belongs to it."""
    placeholder = _placeholder(entry["wire"])
    publishing = members(entry["role"], nodes, place, placeholder=placeholder, subject=wire.subject)
    ends = ports(publishing, entry["output"], wire.message, place, output=True)
    if not ends:
        return wire
    if len(ends) > 1 or ends[0].node in {end.node for end in wire.subscribers}:
        names = ", ".join(end.node for end in ends)
        raise WiringError(f"{place}: {wire.key!r}: found {names}, expected one publisher that does not subscribe to it")
    return replace(wire, legs=(replace(wire.legs[0], publisher=ends[0]), *wire.legs[1:]))


def _listen(wire: Wire, entry: Mapping[str, Any], nodes: Mapping[str, NodeOptions], place: str) -> Wire:
    """The wire with the listeners of one entry added."""
    if entry.get("leg", "source") != "source":
        raise WiringError(f"{place}: leg: found {entry['leg']!r}, expected 'source', or no `leg`")
    placeholder, node = _placeholder(entry["wire"]), entry.get("node")
    listening = members(entry["role"], nodes, place, placeholder=placeholder, subject=wire.subject, node=node)
    lacking = (entry["input"],) if entry.get("optional") else ()
    ends = ports(listening, entry["input"], wire.message, place, optional=lacking)
    return listen(wire, [Listener(end, "leg" in entry) for end in ends], place, every="*" in entry["wire"])


def _codec(name: str, wire: Wire, place: str) -> str:
    """The codec of a wire; raises WiringError for one that cannot carry its messages."""
    if name not in CODECS:
        raise WiringError(f"{place}: codec: no codec {name!r}{nearest(name, CODECS)}")
    codec = CODECS[name]
    if wire.message not in codec.messages:
        raise WiringError(f"{place}: codec: {name} carries {', '.join(codec.messages)}, the wire {wire.message!r}")
    if codec.itself and not wire.traits.itself:
        others = [other for other, each in CODECS.items() if wire.message in each.messages and not each.itself]
        raise WiringError(
            f"{place}: codec: found {name} on {wire.key!r}, expected `itself = true` on that wire, as {name} is for "
            f"{codec.meaning}; or {', '.join(others)}, or no codec"
        )
    return name


def _check_affected(
    entry: Mapping[str, Any], placeholder: str, wires: Sequence[Wire], nodes: Mapping[str, NodeOptions], place: str
) -> None:
    """Raise WiringError if the entry's role has nodes, but none is on these wires."""
    role, node = entry["role"], entry.get("node")
    candidates = members(role, nodes, place, node=node)
    for wire in wires:
        if members(role, nodes, place, placeholder=placeholder, subject=wire.subject, node=node):
            return
    if wires and candidates:
        names = ", ".join(
            f"{name} ({', '.join(options.names(placeholder)) or None})" for name, options in candidates.items()
        )
        raise WiringError(
            f"{place}: no {role} belongs to {entry['wire']!r}: expected one with {placeholder}={wires[0].subject!r}, "
            f"found {names}"
        )


def _overhearers(nodes: Mapping[str, NodeOptions]) -> tuple[Endpoint, ...]:
    """The input ports that receive every key."""
    ends = tuple(
        Endpoint(name, port) for name, node in nodes.items() for port, message in node.inputs.items() if message == ANY
    )
    for end in ends:
        if len(nodes[end.node].inputs) > 1 or nodes[end.node].outputs:
            name, port = end.node, end.port
            raise WiringError(f"node {name!r}: a node that subscribes to every key ({port!r}) has no other port")
    return ends


def _placeholder(template: str) -> str:
    """The role in the first braces of a template; "" if it has none."""
    return next(iter(_PLACEHOLDER.findall(template)), "")


def _listed(to: object) -> list[object]:
    return list(to) if isinstance(to, (list, tuple)) else [to]


def _entries(sources: Sources, kind: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield (place, entry) of one kind; raises WiringError for invalid entries."""
    required, optional = KEYS[kind]
    for file, content in sources:
        entries = content.get(kind, ())
        if isinstance(entries, Mapping):
            raise WiringError(f"{file}: {kind}: found a table, expected [[{kind}]] with two brackets")
        for index, entry in enumerate(entries):
            place = f"{file}: {kind} {index + 1}"
            _check_keys(entry, (*required, *optional), place, required=required)
            for key in ("key", "message", "from", "wire", "role", "input", "output", "leg", "node", "codec"):
                if not isinstance(entry.get(key, ""), str):
                    raise WiringError(f"{place}: {key}: found {entry[key]!r}, expected a string")
            yield place, entry


def _check_keys(
    entry: Mapping[str, Any], known: Collection[str], place: str, *, required: Collection[str] = ()
) -> None:
    if not isinstance(entry, Mapping):
        raise WiringError(f"{place}: found {type(entry).__name__}, expected a table")
    for key in entry:
        if key not in known:
            raise WiringError(f"{place}: unknown key {key!r}{nearest(key, known)}")
    if missing := sorted(set(required) - entry.keys()):
        raise WiringError(f"{place}: missing key{'s' * (len(missing) > 1)} {', '.join(map(repr, missing))}")


def insert(
    wire: Wire, entry: Mapping[str, Any], placeholder: str, nodes: Mapping[str, NodeOptions], place: str
) -> Wire:
    """The wire with the nodes of an `[[insert]]`.

    They come before all subscribers, or before the one of the role `to`. A node that subscribes to the wire on the same
    port receives it as an interposer instead.
    Raises WiringError for a node without the ports, a node that is on the wire already, an ambiguous `to`, and one to
    which the wire does not lead, unless the entry is `optional`.
    """
    inserted = members(
        entry["role"], nodes, place, placeholder=placeholder, subject=wire.subject, node=entry.get("node")
    )
    port = entry.get("input", wire.legs[0].publisher.port)
    output = entry.get("output", f"{port}_out")
    into = ports(inserted, port, wire.message, place, forwards=True)
    out = ports(inserted, output, wire.message, place, output=True, forwards=True)
    for name, node in inserted.items():
        check_forwarding(name, node.inputs, node.outputs, port, output, place)
    for entrance, exit_ in zip(into, out, strict=True):
        subscriber = _subscriber(wire, entrance.node, entry["to"], nodes, place) if "to" in entry else None
        if "to" in entry and subscriber is None:
            if entry.get("optional"):
                continue
            raise _not_a_subscriber(wire, entrance.node, entry["to"], nodes, place)
        wire = _without_subscriber(wire, entrance)
        on_wire = {wire.legs[0].publisher.node, *wire.interposers, *(end.node for end in wire.subscribers)}
        if entrance.node in on_wire:
            raise WiringError(f"{place}: {entrance.node} is already on the wire {wire.key!r}: that would be a loop")
        if subscriber is not None:
            wire = _on_branch(wire, entrance, exit_, subscriber)
        else:
            wire = replace(wire, legs=extended(wire, wire.legs, f"{wire.key}/{TAP}", entrance, exit_))
    return wire


def listen(wire: Wire, listeners: list[Listener], place: str, *, every: bool) -> Wire:
    """The wire with more listeners.

    A node receives a wire once, and never what it publishes or forwards itself.
    every: the entry refers to every wire of its kind: a node that cannot listen to this one is skipped. Otherwise
           WiringError is raised, unless the node already receives the wire as the entry asks.
    """
    for listener in listeners:
        node = listener.end.node
        received = {known.end.node: known for known in (*map(Listener, wire.subscribers), *wire.listeners)}
        if node in (wire.legs[0].publisher.node, *wire.interposers):
            if not every:
                raise WiringError(
                    f"{place}: {node} publishes or forwards {wire.key!r}: it would receive its own messages"
                )
        elif node not in received:
            wire = replace(wire, listeners=(*wire.listeners, listener))
        elif not every and received[node] != listener:
            where = f"its port {received[node].end.port!r}{' at the source' if received[node].source else ''}"
            raise WiringError(
                f"{place}: {node} already receives {wire.key!r} on {where}: a node can receive a wire only once"
            )
    return wire


def _without_subscriber(wire: Wire, end: Endpoint) -> Wire:
    """The wire without a subscriber that no branch leads to."""
    *before, last = wire.legs
    if end not in last.subscribers or any(end in (branch.entrance, branch.subscriber) for branch in wire.branches):
        return wire
    kept = tuple(other for other in last.subscribers if other != end)
    return replace(wire, legs=(*before, replace(last, subscribers=kept)))


def _subscriber(wire: Wire, node: str, role: str, nodes: Mapping[str, NodeOptions], place: str) -> Endpoint | None:
    """The subscriber of `role` before which a node is inserted; None if there is none.

    It is the one that the node's option with the role's name names, else the only one.
    """
    ends = [end for end in wire.subscribers if nodes[end.node].role == role]
    if role in nodes[node].options:
        ends = [end for end in ends if end.node in nodes[node].names(role)]
    if len(ends) > 1:
        names = ", ".join(end.node for end in ends)
        raise WiringError(
            f"{place}: {wire.key!r} leads to {names}: the option `{role}` of {node} must name one of them"
        )
    return ends[0] if ends else None


def _not_a_subscriber(wire: Wire, node: str, role: str, nodes: Mapping[str, NodeOptions], place: str) -> WiringError:
    """The error about a wire that does not lead to the subscriber before which a node is to come."""
    wanted = ", ".join(nodes[node].names(role)) or f"any {role}"
    found = ", ".join(end.node for end in wire.subscribers) or "nobody"
    hint = f" (agents.{wanted}.acts=true gives it the picture)" if wire.message == "picture" else ""
    return WiringError(f"{place}: {node} is to come before {wanted}, but {wire.key!r} leads to {found}{hint}")


def _on_branch(wire: Wire, entrance: Endpoint, exit_: Endpoint, subscriber: Endpoint) -> Wire:
    """The wire with a node at the end of a branch, which is created if needed."""
    branches = {branch.subscriber: branch for branch in wire.branches}
    branch = branches.get(subscriber)
    legs = branch.legs if branch else ()
    last = Leg(f"{wire.key}/{TAP}/{subscriber.node}/{len(legs)}", exit_, (subscriber,))
    if branch:
        legs = (*legs[:-1], replace(legs[-1], subscribers=(entrance,)), last)
        branches[subscriber] = replace(branch, legs=legs)
        return replace(wire, branches=tuple(branches.values()))
    *before, end = wire.legs
    subscribers = tuple(entrance if other == subscriber else other for other in end.subscribers)
    branches[subscriber] = Branch(entrance, subscriber, (last,))
    return replace(wire, legs=(*before, replace(end, subscribers=subscribers)), branches=tuple(branches.values()))

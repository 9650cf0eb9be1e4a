"""Requests to insert a node into a wire of a running run, or to remove it: their client, and the launcher's server.

`mast intercept` and `mast release` check the request against the run folder and build the node once. So the launcher
never executes a user's file: it only starts the node's process. The request is a query on @control/intercept, sealed
with a secret in the run folder: the launcher starts processes only for users who may read that folder.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import socket
from collections.abc import Mapping, Sequence
from dataclasses import replace
from inspect import signature
from itertools import count
from pathlib import Path
from typing import Any

import msgpack
import zenoh

from mast_zenoh.attacks import Attack
from mast_zenoh.config import bundle, loading, registry
from mast_zenoh.config.loading import SHIPPED, AllowedCode
from mast_zenoh.config.resolved import RECORDING, NodeSpec, Resolved, build_node
from mast_zenoh.config.settings import nested
from mast_zenoh.errors import (
    ConfigurationError,
    MessageError,
    NodeFileError,
    NotRunning,
    UntrustedCode,
    WiringError,
    nearest,
)
from mast_zenoh.launch import liveness
from mast_zenoh.launch.launcher_protocol import Interceptions, LauncherActions
from mast_zenoh.mesh.control import codec, control_prefix
from mast_zenoh.mesh.control import interception as control
from mast_zenoh.mesh.control.files import decode_refusal
from mast_zenoh.mesh.control.interception import answer_of, place_json
from mast_zenoh.mesh.control.key_marks import check_control_mark, control_mark
from mast_zenoh.mesh.session import direct, open_client
from mast_zenoh.node import Node
from mast_zenoh.run_folder import check_plain, read_json
from mast_zenoh.scenario.nodes import add_surroundings, node_spec
from mast_zenoh.scenario.resolution import modules_of
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.wiring import maps
from mast_zenoh.wiring.endpoints import check_forwarding
from mast_zenoh.wiring.insertion import InsertionPoint, insert
from mast_zenoh.wiring.model import ANY, Endpoint, Leg, Wire, Wiring, agent_of, takes

SECRET_FILE = "control.key"


def seal(request: dict[str, Any], secret: bytes) -> bytes:
    """Encode and sign a request; a random number makes it unique."""
    body: bytes = msgpack.packb(request | {"number": secrets.token_hex(8)})
    return bytes(msgpack.packb([body, hmac.digest(secret, body, hashlib.sha256)]))


def unseal(payload: bytes, secret: bytes) -> dict[str, Any]:
    """Decode a request; raises MessageError if it was not sealed with the secret."""
    body, digest = control.sealed_parts(payload)
    if hmac.compare_digest(digest, hmac.digest(secret, body, hashlib.sha256)):
        return codec.decode(dict[str, Any], body, "intercept")
    raise MessageError("a request that was not sealed with this run's secret")


class InterceptionServer:
    """Passes requests to change a run's wiring to `interceptions`, and refuses malformed ones."""

    def __init__(
        self, folder: Path, base: str, session: zenoh.Session, interceptions: Interceptions, actions: LauncherActions
    ) -> None:
        self._interceptions = interceptions
        self._actions = actions
        self._secret = secrets.token_bytes(32)
        self._secret_file = folder / SECRET_FILE
        self._secret_file.touch(mode=0o600)
        self._secret_file.write_bytes(self._secret)
        self._declared: list[Any] = [
            session.declare_queryable(f"{base}/@control/intercept", direct(self._on_query)),
            session.liveliness().declare_subscriber(f"{base}/alive/*", direct(self._note_presence), history=True),
        ]

    def close(self) -> None:
        """End the service."""
        for entity in self._declared:
            entity.undeclare()
        self._secret_file.unlink(missing_ok=True)

    def _on_query(self, query: zenoh.Query) -> None:
        """Receive a request, in Zenoh's thread."""
        try:
            check_control_mark(query.key_expr, query.attachment)
            request = unseal(query.payload.to_bytes() if query.payload else b"", self._secret)
            change = control.request_of(request)  # and checks the number
            self._interceptions.add(query, request["number"], change)
        except MessageError as error:
            self._actions.refuse(query, error)

    def _note_presence(self, token: zenoh.Sample) -> None:
        name = str(token.key_expr).rpartition("/")[2]
        self._interceptions.note_presence(name, token.kind == zenoh.SampleKind.PUT)


#: The shipped node that carries out attacks.
_ADVERSARY = "adversary.py"
_TIMEOUT_S = 180.0
_CONNECT_TIMEOUT_S = 2.0


def intercept(
    run: Path,
    wire: str,
    file: str,
    *,
    name: str | None = None,
    before: str = "",
    input: str | None = None,
    output: str | None = None,
    settings: Sequence[str] = (),
    allowed: AllowedCode = SHIPPED,
) -> dict[str, Any]:
    """Put a node on a wire of a run; return action, node, wires, frame, took_ms, before.

    run:   the run folder
    file:  of the node; or an attack, by name, FILE.py or FILE.py:CLASS, which the shipped adversary carries out
    name:  name of the new node; None: the file's name with a number
    before: the only subscriber before which it comes, which has a node of its own on the wire since launch; "": all
    input, output: its ports on the wire; None: the ports that carry the wire's messages
    settings: its parameters, `key=value`; a dotted key sets an item of a dict
    allowed: which of the code that the run folder names may run here

    Raises NotRunning, WiringError (the wire), NodeFileError (the node's file or ports), ConfigurationError (its
    parameters or name), StartError (it did not start), RunError (nothing was changed).
    """
    record = _running(run, allowed)
    resolved = Resolved.read(run, allowed)
    ports = dict(input=input, output=output)
    node, spec, place = plan(resolved, wire, file, name=name, before=before, settings=settings, **ports)
    add_surroundings({node: spec}, Recording.load(run / RECORDING))
    fields = {name: getattr(spec, name) for name in ("file", "type", "role", "config", "on_exit")}
    modules = [module for module in modules_of(Path(), spec.config, ()) if module not in resolved.modules]
    request = {"do": "intercept", "name": node, "spec": fields, "place": place_json(place), "modules": modules}
    return _ask(run, record, request)


def release(
    run: Path, *, name: str | None = None, wire: str | None = None, allowed: AllowedCode = SHIPPED
) -> dict[str, Any]:
    """Take a node off its wires: the named one, or the only one on a wire.

    Returns as `intercept` does. Raises NotRunning, WiringError (no such node or wire), RunError (nothing was changed).
    """
    if (name is None) == (wire is None):
        raise ConfigurationError("release: expected either a name or a wire")
    return _ask(run, _running(run, allowed), {"do": "release", "name": name, "wire": wire})


def plan(
    resolved: Resolved,
    wire: str,
    file: str,
    *,
    name: str | None = None,
    before: str = "",
    input: str | None = None,
    output: str | None = None,
    settings: Sequence[str] = (),
) -> tuple[str, NodeSpec, InsertionPoint]:
    """(name, spec, place) of a node to put on a wire; checked, and built once.

    For parameters and errors see `intercept`.
    """
    wiring = Wiring.from_json(resolved.wiring)
    wires = {candidate.key: candidate for candidate in wiring.wires}
    if wire not in wires:
        raise WiringError(f"no wire {wire!r}{nearest(wire, wires)}")
    unread: UntrustedCode | None = None
    try:
        resolved.load_modules()
    except UntrustedCode as error:  # the new node may not need what is not trusted
        unread = error
    path, config = node_of(file, nested(settings))
    target = wires[wire]
    cls = loading.node_class(path, config.get("type"))
    declared = {schema.name: schema for schema in resolved.messages}
    for message, schema in cls.message_types.items():
        if declared.get(message, schema) != schema:
            raise NodeFileError(f"{path}: {cls.__name__}: the run already has a different message type {message!r}")
    if name is None:
        name = next(free for i in count(1) if (free := f"{path.stem}_{i}") not in resolved.nodes)
    elif name in resolved.nodes:
        raise ConfigurationError(f"node {name!r} already exists: give another --name")
    if "agent" in signature(cls).parameters and agent_of(target.subject) in resolved.nodes:
        config.setdefault("agent", agent_of(target.subject))
    if "python" in config:
        raise ConfigurationError(f"{name}.python: found {config['python']!r}, expected none in a node that is inserted")
    spec = replace(node_spec(path, name, cls.role, config | {"file": str(path)}), on_exit="continue")
    try:
        build_node(spec, name, str(path))
    except ConfigurationError as error:
        if unread is None:
            raise
        raise ConfigurationError(f"{error}; {unread}") from None
    subject = str(spec.config.get("agent", agent_of(target.subject)))
    published, where = target.legs[0].publisher.port, (f"{path}: {cls.__name__}", f"the wire {target.key!r}")
    ports = ports_of(cls, target.message, published, input, output, *where)
    place = replace(_place(cls, name, target, subject, resolved, ports), before=before)
    insert(wiring, name, place)
    return name, spec, place


def node_of(text: str, config: dict[str, Any]) -> tuple[Path, dict[str, Any]]:
    """(file, parameters) of the node that `--with` names; of an attack, those of the shipped adversary."""
    file, _, name = text.partition(":")
    path = bundle.find("nodes", file, Path.cwd())
    shipped = registry.known_types(Attack, None if path else text)
    attack = text if text in shipped else ""
    if not attack:
        if path is None:
            known = [*bundle.names("nodes", Path.cwd()), *shipped]
            raise NodeFileError(f"no node file or attack {file!r}{nearest(file, known)}")
        loaded = loading.module(path)
        attacks = [cls.__name__ for cls in loading.concrete([loaded], Attack)]
        if name not in attacks and (not attacks or loading.concrete([loaded], Node)):
            return path, {"type": name} | config if name else config
        attack = loading.class_name(f"{path}:{name}" if name else str(path), Attack)
    adversary = bundle.find("nodes", _ADVERSARY)
    if adversary is None:
        raise NodeFileError(f"{_ADVERSARY}: not found: expected it among the shipped nodes")
    chosen = config.get("attack", {})
    if not isinstance(chosen, Mapping) or chosen.get("type", attack) != attack:
        raise ConfigurationError(f"attack: found {chosen!r}, expected its parameters: --with names {attack}")
    return adversary, config | {"attack": {"type": attack, **chosen}}


def _place(
    cls: type[Node], name: str, target: Wire, subject: str, resolved: Resolved, ports: tuple[str, str]
) -> InsertionPoint:
    """The node's ports on the wire, its other inputs, and the wires that it publishes itself.

    An input port is connected to the only other wire of its message type that has no subject or the node's subject
    (such as the clock, or its agent's pose), unless it is of a type that the node forwards. Inputs that the testbed's
    map has for its role are connected in any case. The node publishes the wires that the testbed's map has for its role
    (such as an adversary's report).
    """
    wires, (input_port, output_port) = Wiring.from_json(resolved.wiring).wires, ports
    other_inputs: dict[str, str] = {}
    usual = _usual_inputs(cls)
    for port, message in cls.inputs.items():
        forwarded = message in cls.outputs.values() and port not in usual
        if port == input_port or forwarded or port in cls.listening:
            continue
        keys = [w.key for w in wires if w.message == message and w.subject in ("", subject)]
        if len(keys) == 1 and keys[0] != target.key:
            other_inputs[keys[0]] = port
    existing = {wire.key for wire in wires}
    own = (wire for wire in _own_wires(cls, name, resolved) if wire.key not in existing)
    published_wires = tuple(wire for wire in own if wire.legs[0].publisher.port != output_port)
    return InsertionPoint(target.key, input_port, output_port, other_inputs, published_wires)


def ports_of(
    node: type[Node], message: str, published: str, input: str | None, output: str | None, place: str, wire: str
) -> tuple[str, str]:
    """The ports by which a node is on a wire: the requested ones, or the only ones, or further ones if it forwards it.

    message: type of what the wire carries;  published: the publisher's port;  wire: in words, for errors
    """
    if takes(node.forwards, message) and message not in node.outputs.values():
        input = input or (f"{published}_in" if published in node.inputs else published)
        output = output or f"{input}_out"
        check_forwarding(node.__name__, node.inputs, node.outputs, input, output, place)
        return input, output
    sides = (("input", input), ("output", output))
    input, output = (_port_of(node, message, requested, place, side, wire) for side, requested in sides)
    return input, output


def _port_of(node: type[Node], message: str, requested: str | None, place: str, side: str, wire: str) -> str:
    """The port of a node for messages of a type: the requested one, or the only one.

    side: "input" or "output";  wire: what carries the messages, for errors
    """
    ports = node.outputs
    if side == "input":
        ports = {port: kind for port, kind in node.inputs.items() if port not in node.listening or port == requested}
    if ANY in ports.values():
        raise NodeFileError(f"{place} subscribes to every key: it cannot be put on a wire")
    matching = [port for port, carried in ports.items() if carried == message]
    if requested is not None:
        if requested not in ports:
            raise NodeFileError(f"{place}: no {side} port {requested!r}{nearest(requested, ports)}")
        if requested not in matching:
            raise NodeFileError(f"{place}: {side} {requested!r} carries {ports[requested]!r} messages, not {message!r}")
        return requested
    of_type = message if side == "input" else f"{message}_out"
    if of_type in matching:
        return of_type
    if len(matching) != 1:
        candidates = f"the {side}s {', '.join(matching)}: choose one with --{side}" if matching else f"no {side}"
        raise NodeFileError(f"{place}: {candidates} for {message!r} messages, which {wire} carries")
    return matching[0]


def _usual_inputs(cls: type[Node]) -> set[str]:
    """The input ports that the testbed's map has for nodes of this role."""
    entries = maps.load(bundle.ROOT / "keyexpr_maps" / "testbed.toml")["wire"]
    ends = [reference.partition(".") for entry in entries for reference in entry["to"]]
    return {port for role, _, port in ends if role == cls.role}


def _own_wires(cls: type[Node], name: str, resolved: Resolved) -> list[Wire]:
    """The wires that the testbed's map has for a node of this role."""
    wires = []
    for entry in maps.load(bundle.ROOT / "keyexpr_maps" / "testbed.toml")["wire"]:
        role, _, port = str(entry["from"]).partition(".")
        if role != cls.role or cls.outputs.get(port) != entry["message"] or f"{{{role}}}" not in entry["key"]:
            continue
        ends = []
        for reference in entry["to"]:
            to_role, _, to_port = reference.partition(".")
            for other, spec in resolved.nodes.items():
                if spec.role == to_role and to_port in loading.node_class(Path(spec.file), spec.type).inputs:
                    ends.append(Endpoint(other, to_port))
        key = entry["key"].replace(f"{{{role}}}", name)
        wires.append(Wire(key, name, entry["message"], (Leg(key, Endpoint(name, port), tuple(ends)),)))
    return wires


def _running(run: Path, allowed: AllowedCode) -> dict[str, Any]:
    """Read run.json of a run; raises NotRunning unless it is running on a mesh."""
    if not run.is_dir():
        raise NotRunning(f"{run}: no such folder: the run is not up yet, or its folder is another one")
    if not (run / "run.json").exists():
        raise NotRunning(f"{run}: found no run.json: the run is not up yet, or this is not the folder of a run")
    record: dict[str, Any] = liveness.current_record(read_json(run / "run.json"))
    if record.get("status") != "running":
        raise NotRunning(f"{run}: the run is over: {record.get('status')}")
    if record.get("runtime") != "mesh":
        raise NotRunning(f"{run}: the run is in one process: expected a run on a mesh")
    if record.get("security", "open") != "open":
        level = record["security"]
        raise NotRunning(
            f"{run}: security level {level}: only the nodes that it was started with have certificates and rights: "
            "add the node to the scenario, or start the run without --secure"
        )
    if not record.get("endpoint") or not (run / SECRET_FILE).is_file():
        raise NotRunning(f"{run}: the run has not started its nodes yet, or was killed")
    liveness.check_from_here(run, record, allowed, f"the router {record.get('endpoint')}")
    return record


def _ask(run: Path, record: Mapping[str, Any], request: dict[str, Any]) -> dict[str, Any]:
    """Send a request, return the answer; raises the launcher's error, and NotRunning."""
    sealed = seal(request, check_plain(run / SECRET_FILE).read_bytes())
    endpoint = record["endpoint"]
    if not _reachable(endpoint):
        raise NotRunning(f"{run}: nothing answers at {endpoint}: the run was killed")
    with open_client(endpoint) as session:
        options: Any = {"payload": sealed, "attachment": control_mark("intercept"), "timeout": _TIMEOUT_S}
        for reply in session.get(f"{control_prefix(record['id'])}/intercept", **options):
            if reply.ok is not None:
                return answer_of(reply.ok.payload.to_bytes())
            if reply.err is not None:
                timeout = NotRunning(f"{run}: the launcher did not answer in time")
                raise decode_refusal(reply.err.payload.to_bytes()) or timeout
    raise NotRunning(f"{run}: the launcher does not answer")


def _reachable(endpoint: str) -> bool:
    """Whether a TCP endpoint accepts connections; a Zenoh client would retry for ever."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if protocol != "tcp" or not port.isdigit():
        return True
    try:
        socket.create_connection((host.strip("[]"), int(port)), _CONNECT_TIMEOUT_S).close()
    except OSError:
        return False
    return True

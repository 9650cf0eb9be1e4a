"""Finds the nodes and ports that entries of a key-expression map refer to."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from mast_zenoh.errors import WiringError, nearest
from mast_zenoh.wiring.model import Endpoint, agent_of, takes

#: Roles that a map may name even where a scenario has no such node.
ROLES = (
    *("simulator", "agent", "broker", "command_center", "center", "peer", "channel", "driver", "detector"),
    *("adversary", "coordinator", "link", "evaluator", "recorder", "visualizer"),
)


#: Before a role: its nodes that do not belong to the subject.
OTHER = "other "


@dataclass(frozen=True, slots=True)
class NodeOptions:
    """The properties of a node that the wiring depends on.

    options: options that bind it to a wire, or to several; inputs, outputs: message type by port
    takes, forwards: message types of further ports that a map may give it, see `Node`
    affects, fuses: see `NodeFlow`
    """

    role: str
    options: Mapping[str, str | tuple[str, ...]]
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    takes: Collection[str] = ()
    forwards: Collection[str] = ()
    affects: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    fuses: tuple[str, ...] = ()

    @property
    def of_one_wire(self) -> bool:
        """Whether it is a link that a fault puts on a single wire: no map puts it on others."""
        return self.options.get("agent") == ""

    def names(self, option: str) -> tuple[str, ...]:
        """The subjects that an option names; none without the option."""
        value = self.options.get(option, ())
        return (value,) if isinstance(value, str) else value


def members(
    role: str,
    nodes: Mapping[str, NodeOptions],
    place: str,
    *,
    placeholder: str = "",
    subject: str = "",
    node: str | None = None,
) -> dict[str, NodeOptions]:
    """The nodes of a role that belong to one subject of a placeholder.

    Without a placeholder, all nodes of the role.

    A node belongs to a subject if it is the subject, or if its option with the placeholder's name names it (an option
    may name several subjects). If no node of the role has that option, all of them belong to every subject. `other
    role` means the nodes of the role that do not belong to it. The link of a single wire belongs to none.

    node: keep only the node of this name

    Raises WiringError for an unknown role, and for a name that no node of the role has.
    """
    if role.startswith(OTHER):
        role = role.removeprefix(OTHER)
        own = members(role, nodes, place, placeholder=placeholder, subject=subject)
        every = members(role, nodes, place, node=node)
        return {name: other for name, other in every.items() if name not in own and not other.of_one_wire}
    subject = agent_of(subject)
    roles = {*ROLES, *(other.role for other in nodes.values())}
    if role not in roles:
        raise WiringError(f"{place}: no role {role!r}{nearest(role, roles)}")
    of_role = {name: other for name, other in nodes.items() if other.role == role}
    if node is not None and node not in of_role:
        raise WiringError(f"{place}: node: no {role} is called {node!r}{nearest(node, of_role)}")
    if role == placeholder:
        of_role = {subject: of_role[subject]}
    elif placeholder and any(placeholder in other.options for other in of_role.values()):
        of_role = {name: other for name, other in of_role.items() if subject in other.names(placeholder)}
    elif placeholder:
        of_role = {name: other for name, other in of_role.items() if not other.of_one_wire}
    return {name: other for name, other in of_role.items() if node in (None, name)}


def ports(
    nodes: Mapping[str, NodeOptions],
    port: str,
    message: str,
    place: str,
    *,
    output: bool = False,
    forwards: bool = False,
    optional: Collection[str] = (),
) -> list[Endpoint]:
    """The port of each node; an `optional` port is skipped if a node lacks it.

    output: an output port;  forwards: of a node that sends on what it takes, which may be a further one

    Raises WiringError where a node has no such port, or one for another message type.
    """
    ends = []
    for name, node in nodes.items():
        known = node.outputs if output else node.inputs
        side = "output" if output else "input"
        if port not in known:
            if port in optional:
                continue
            further = node.forwards if forwards else () if output else node.takes
            if not takes(further, message):
                raise WiringError(f"{place}: {name} has no {side} port {port!r}{nearest(port, known)}")
        elif known[port] != message:
            raise WiringError(f"{place}: {name}.{port} carries {known[port]!r} messages, the wire {message!r}")
        ends.append(Endpoint(name, port))
    return ends


def check_forwarding(
    node: str, inputs: Collection[str], outputs: Collection[str], port: str, output: str, place: str
) -> None:
    """Raise WiringError if a node on a wire does not send on by `output` what arrives on `port`.

    inputs, outputs: its own ports
    """
    if port in inputs and output not in outputs:
        raise WiringError(
            f"{place}: {node} keeps what arrives on its port {port!r}: expected another input, such as '{port}_in'"
        )
    if port not in inputs and output != f"{port}_out":
        raise WiringError(
            f"{place}: output: found {output!r}, expected '{port}_out', as {node} sends on what arrives on {port!r}"
        )

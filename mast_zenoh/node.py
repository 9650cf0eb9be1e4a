"""Base class of nodes: named ports and handlers, no I/O.

    class Echo(Node):
        role = "adversary"
        inputs = {"detections": "detections"}
        outputs = {"detections_out": "detections"}

        def on_detections(self, message, context):
            context.relay("detections_out", message)

A node reacts to messages and publishes through its context. It never uses Zenoh, a socket, a clock or a global random
generator: the runtime (`mast_zenoh.mesh`) owns them, so the same node runs in one process, on a mesh of processes
and on many hosts. The messages it publishes for a frame must depend on the set of messages of that frame, never on
their order; use `mast_zenoh.gather.Gather` to collect them.
"""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from typing import Any, ClassVar, Protocol

import numpy as np

from mast_zenoh.errors import nearest
from mast_zenoh.messages.limits import RowChoice
from mast_zenoh.messages.schemas import BUILT_IN, Body, Schema
from mast_zenoh.outside import Outside, OutsideTopics
from mast_zenoh.wiring.model import ANY, Input, Wiring
from mast_zenoh.wiring.received import Overheard, Received, Unopened

#: The names for files of nodes and for the runtime.
__all__ = [
    "Context",
    "Node",
    "Outside",
    "OutsideTopics",
    "Overheard",
    "Received",
    "Source",
    "Unopened",
    "check_handlers",
    "handler_of",
]


class Context(Protocol):
    """A node's interface to the runtime: what its handlers get is its `mesh.host.Host`.

    frame, time_ns: of the newest clock; -1 and 0 before the first
    subscriptions: its inputs, by key
    wiring:        the current wiring of the run: every wire with its legs; for nodes that observe wires
    """

    name: str
    seed: int
    frame: int
    time_ns: int
    log: logging.Logger
    subscriptions: Mapping[str, Input]
    wiring: Wiring

    @property
    def outside(self) -> Outside:
        """The link to programs outside the run, of a node that has topics there (`Node.outside_topics`)."""
        ...

    @property
    def now_ns(self) -> int:
        """Time since the scene's start, ns; `time_ns` in lock-step, finer in real time; the same within a handler."""
        ...

    @property
    def elapsed_ns(self) -> int:
        """How long the handler has been running, ns; 0 in lock-step."""
        ...

    def publish(
        self,
        port: str,
        body: Body,
        *,
        subject: str | None = None,
        frame: int | None = None,
        time_ns: int | None = None,
        known: int | None = None,
    ) -> None:
        """Publish columns on an output port; about the current frame by default.

        subject: the wire, for a port with several (the simulator's `pose` has one per agent)
        known: number of objects that the node knows, of which it sends some; for standard messages. None: it sends all

        Messages to a port without a wire are discarded.
        """
        ...

    def relay(
        self,
        port: str,
        received: Received,
        body: Body | None = None,
        *,
        payload: bytes | None = None,
        time_ns: int | None = None,
        after_s: float = 0.0,
    ) -> None:
        """Forward a message with its original header, and its original or a new body.

        payload: send exactly these bytes instead, valid or not; excludes `body` and `time_ns`
        time_ns: replaces the time in its header, ns, 0 or more
        after_s: delay, s: in simulated time in lock-step, where events within a frame's interval belong to that
                 frame; on the wall clock in real time. Only for nodes that subscribe to the clock.

        Relaying a message twice sends it twice, with the same number. Raises ConfigurationError if it cannot be sent.
        """
        ...

    def ignore(self, keys: Collection[str]) -> None:
        """Stop receiving these keys on the port for every key; replaces earlier calls."""
        ...

    def failed(self, part: str, error: BaseException) -> None:
        """Count the failure of a part of a handler that continues.

        The run fails as if the handler had raised `error`.

        part: its name, reported instead of the handler's
        """
        ...

    def reject(self, reason: str) -> None:
        """Count the current message as rejected: valid but not usable, such as too old.

        reason: begins with its kind, one word before a colon
        """
        ...

    def append(self, table: str, columns: Mapping[str, Any]) -> None:
        """Append rows to one of the node's tables, as often as you like, also in `finish`.

        table:   its name, at most 64 letters, digits, dots, hyphens and underscores; at most 100 tables
        columns: by name, equally long: arrays or lists of numbers, or of text

        The first rows decide names, order and types of the columns. The rows leave the node in parts of 65,536 rows
        (16 MiB), and become row groups of the table's file, `results/<node>/<table>.parquet`, at any end of the run;
        those of the evaluator's own tables are at the top of the run folder. So a node of a long run need not keep
        them. A table of this name that `finish` returns holds the last rows.

        Raises ConfigurationError for an invalid table, or for columns that differ from those before.
        """
        ...

    def connected(self, port: str, subject: str | None = None) -> bool:
        """Whether a wire is connected to an output port."""
        ...

    def rng(self, *purpose: str | int) -> np.random.Generator:
        """The random stream `streams.stream(seed, name, *purpose)` of this node."""
        ...


class Node:
    """Base of all nodes.

    A subclass names its role and ports, and has a handler `on_<port>` for each input; for messages on further ports,
    `on_<type>` or `on_message`.

    Parameters of `__init__` come from the scenario, converted by their annotations (`mast_zenoh.config.registry`).
    """

    role: ClassVar[str] = ""
    #: input ports and output ports: name to message type. A subclass may give its own `Schema` as the type: this
    #: declares it, and the port then has its name.
    inputs: ClassVar[Mapping[str, Any]] = {}
    outputs: ClassVar[Mapping[str, Any]] = {}
    #: types of messages that it takes on any other input port that a key-expression map names, as `inputs` has none for
    #: them: `on_<type>` handles them, or `on_message`, which handles those of types that are also names of `inputs`;
    #: ANY: of all types. `Received.port` tells them apart.
    takes: ClassVar[Collection[str]] = ()
    #: types of messages for which a map may insert it into a wire on a further port `x`: it sends them on by `x_out`
    forwards: ClassVar[Collection[str]] = ()
    #: what messages can affect: by input port, the output ports, each with the number of frames after which; "": for
    #: further ports. An absent port affects all outputs in the same frame. What a subclass adds may affect all, and
    #: depend on all. See `wiring.influence`.
    affects: ClassVar[Mapping[str, Mapping[str, int]]] = {}
    #: output ports of messages that combine what several agents say
    fuses: ClassVar[Collection[str]] = ()
    #: the message types that its ports declare, by name
    message_types: ClassVar[Mapping[str, Schema]] = {}
    #: input ports that only a `[[listen]]` of a scenario connects: `mast intercept` leaves them out
    listening: ClassVar[Collection[str]] = ()
    #: input ports whose messages are relayed undecoded, including malformed ones, which their receivers reject.
    #: Accessing a malformed body raises MessageError (see `Unopened`). ANY: all besides `inputs`
    unopened: ClassVar[Collection[str]] = ()
    #: ports that the node, as configured, has no use for: no wire leads to or from them. `__init__` may set them.
    unused: Collection[str] = ()
    #: whether its handlers are so fast that, in real time, the receiving thread calls them directly
    prompt: ClassVar[bool] = False

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        types: dict[str, Schema] = dict(cls.message_types)
        for side in ("inputs", "outputs"):
            ports = dict(getattr(cls, side))
            for port, message in ports.items():
                if isinstance(message, Schema):
                    _declare(types, message, f"{cls.__name__}.{side}[{port!r}]")
                    ports[port] = message.name
            setattr(cls, side, ports)
        cls.message_types = types
        if "affects" not in vars(cls) and cls.affects:
            bases = [base for base in cls.__mro__[1:] if issubclass(base, Node)]
            added = dict.fromkeys(cls.outputs.keys() - {port for base in bases for port in base.outputs}, 0)
            own = cls.inputs.keys() - {port for base in bases for port in base.inputs}
            cls.affects = {port: {**known, **added} for port, known in cls.affects.items()}
            cls.affects |= dict.fromkeys(own, dict.fromkeys(cls.outputs, 0))

    def restamps_s(self, duration_s: float) -> float:
        """Largest error, s, that the node may add to header times in a run of that length.

        Receivers reject messages whose time is off by more than the sum over all nodes plus `limits.LEEWAY_S`.
        """
        return 0.0

    def outside_topics(self, context: Context) -> OutsideTopics | None:
        """The topics on which the node, as configured, receives messages from outside the run; None: it has no link.

        Called before `start`, when `context` has no link yet. The link is open from `start` to `finish`.
        """
        return None

    def arrived(self, context: Context) -> None:
        """Called in real time when messages from outside have arrived; `Outside.take` has them."""

    def choice(self, port: str, subject: str, step: int) -> RowChoice | None:
        """Which rows of a message on an input port are used; None: up to its limit, those with the highest scores.

        subject: of the message's wire; step: frame in which it was sent

        The result may depend on earlier frames alone, as the clock of the frame may not have arrived yet.
        """
        return None

    def start(self, context: Context) -> None:
        """Called once, before the first frame."""

    def joined(self, node: str, role: str, context: Context) -> None:
        """Called when another node has joined; at the start, for nodes already present."""

    def left(self, node: str, role: str, context: Context) -> None:
        """Called when another node has left."""

    def rewired(self, context: Context) -> None:
        """Called when `context.wiring` has changed: a node was inserted or removed."""

    def finish(self, context: Context) -> dict[str, Any]:
        """Called once, after the last frame, when publishing is over; returns results.

        `tables` of the results are the node's tables, columns by name; `Context.append` has already taken others. It
        may take as long as it makes progress (docs/explanation-architecture.md#how-a-run-ends).
        """
        return {}


class Source(Node, ABC):
    """A node that drives the scene: the runtime requests each frame when it is due, or ahead of it without inputs.

    It publishes in `advance` alone.
    """

    period_ns: int = 100_000_000

    @abstractmethod
    def advance(self, context: Context) -> bool:
        """Publish the next frame; False when there is none."""


def _declare(types: dict[str, Schema], schema: Schema, place: str) -> None:
    """Add a message type to a node's types.

    Raises TypeError if a different type has its name.
    """
    if schema.name in BUILT_IN:
        if BUILT_IN[schema.name] != schema:
            raise TypeError(f"{place}: message type {schema.name!r} comes with mast: expected another name")
    elif types.setdefault(schema.name, schema) != schema:
        raise TypeError(f"{place}: another message type of this node is called {schema.name!r}: expected one of them")


def handler_of(node: type[Node], port: str, message: str) -> str:
    """Name of the handler of an input port, for messages of a type; raises TypeError if there is none."""
    if port in node.inputs:
        names: tuple[str, ...] = (f"on_{port}",)
    elif message in node.inputs:  # `on_<type>` is for its own port of that name
        names = ("on_message",)
    else:
        names = (f"on_{message}", "on_message")
    for name in names:
        if callable(getattr(node, name, None)):
            return name
    raise TypeError(f"{node.__name__} has no {' or '.join(names)} for its input port {port!r}")


def check_handlers(node: type[Node]) -> None:
    """Raise TypeError if an input port, or a type that the node takes or forwards, has no handler.

    And for a port in `affects` or `fuses` that it does not have.
    """
    missing = [f"on_{port}" for port in node.inputs if not callable(getattr(node, f"on_{port}", None))]
    if missing:
        raise TypeError(f"{node.__name__} has no {', '.join(missing)} for its input ports")
    for message in (*node.takes, *node.forwards):
        handler_of(node, "", "message" if message == ANY else message)
    for port, reached in node.affects.items():
        if port not in ("", *node.inputs):
            raise TypeError(f"{node.__name__}.affects: no input port {port!r}{nearest(port, node.inputs)}")
        for output, frames in reached.items():
            if output not in node.outputs:
                raise TypeError(f"{node.__name__}.affects: no output port {output!r}{nearest(output, node.outputs)}")
            if frames < 0:
                raise TypeError(f"{node.__name__}.affects[{port!r}]: found {frames} frames, expected 0 or more")
    for output in node.fuses:
        if output not in node.outputs:
            raise TypeError(f"{node.__name__}.fuses: no output port {output!r}{nearest(output, node.outputs)}")

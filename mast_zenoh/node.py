"""What a node is: named ports and handlers, no I/O.

    class Echo(Node):
        role = "adversary"
        inputs = {"detections": "detections"}
        outputs = {"detections_out": "detections"}

        def on_detections(self, message, context):
            context.relay("detections_out", message)

A node acts only on messages, and publishes only through its context. It never sees Zenoh, a socket, a clock or a
global random generator: the runtime (`mast_zenoh.runtime`) owns them, so the same node runs in one process, on a
mesh of processes, and on many hosts. What it publishes for a frame must depend on the set of messages of that frame,
never on their order: `mast_zenoh.gather.Gather` is there for that.
"""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from typing import Any, ClassVar, Protocol

import numpy as np

from mast_zenoh.messages.schemas import Body
from mast_zenoh.wiring.model import Input, Wiring
from mast_zenoh.wiring.received import Overheard, Received, Unopened

#: All that the file of a node imports, and the runtime that hosts it.
__all__ = ["Context", "Node", "Overheard", "Received", "Source", "Unopened", "handler_names"]


class Context(Protocol):
    """What a node may do. `frame` and `time_ns` are those of the newest clock it has got; -1 and 0 before the first.

    now_ns: what time it is, ns since the scene began: `time_ns` in lock-step; in real time it goes on between clocks
    hears:  what it hears, by key
    wiring: every wire of the run with its legs, as it is now; for nodes that measure what happens on them
    """

    name: str
    seed: int
    frame: int
    time_ns: int
    log: logging.Logger
    hears: Mapping[str, Input]
    wiring: Wiring

    @property
    def now_ns(self) -> int:
        """See the class."""
        ...

    def publish(
        self, port: str, body: Body, *, subject: str | None = None, frame: int | None = None, time_ns: int | None = None
    ) -> None:
        """Publish columns on an output port; about the current frame unless said.

        subject: which wire, where the port has several (the simulator's `pose` has one per agent)

        A port that no wire is connected to swallows the message.
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
        """Pass a message on with its header as it was, and its body as it was or changed.

        payload: send exactly these bytes instead, sound or not; excludes `body` and `time_ns`
        time_ns: the time in its header, ns, 0 or more
        after_s: it leaves that much later, s: in simulated time in lock-step, where what happens within a frame's
                 interval is in that frame; on the wall clock in real time. Only for nodes that hear the clock.

        Passing it on again sends it twice, with the same number. Raises ConfigurationError for what cannot be sent.
        """
        ...

    def ignore(self, keys: Collection[str]) -> None:
        """For a node that hears every key: have nothing of these keys handed on, until it ignores others instead."""
        ...

    def failed(self, part: str, error: BaseException) -> None:
        """Count the failure of a part of a handler, which goes on: the run fails as if the handler had raised `error`.

        part: its name, in place of the handler's
        """
        ...

    def reject(self, reason: str) -> None:
        """Count the message that is being handled as rejected: sound, but of no use here, such as one that is too old.

        reason: its first word, before a colon, says of what kind
        """
        ...

    def connected(self, port: str, subject: str | None = None) -> bool:
        """Whether a wire is connected to an output port."""
        ...

    def rng(self, *purpose: str | int) -> np.random.Generator:
        """The random stream of (this run's seed, this node, purpose): `streams.stream(seed, name, *purpose)`."""
        ...


class Node:
    """Base of all nodes. A subclass names its role and ports, and has a handler `on_<port>` for each input.

    Parameters of `__init__` come from the scenario, built by their annotations (`mast_zenoh.config.registry`).
    """

    role: ClassVar[str] = ""
    #: input ports and output ports: name to message type
    inputs: ClassVar[Mapping[str, str]] = {}
    outputs: ClassVar[Mapping[str, str]] = {}
    #: input ports whose messages it passes on without looking at them, malformed ones as well: whoever they are for
    #: will refuse those. Looking at one is possible, and raises MessageError if it is malformed (see `Unopened`).
    unopened: ClassVar[Collection[str]] = ()
    #: whether its handlers do so little that in real time it is called by the thread that brings a message, at once
    prompt: ClassVar[bool] = False

    def restamps_s(self, duration_s: float) -> float:
        """s, by how much it may put the time in a header wrong in a run of that length.

        Receivers reject what is off by more than all nodes of a run say, and `timespan.LEEWAY_S`.
        """
        return 0.0

    def start(self, context: Context) -> None:
        """Called once, before the first frame."""

    def joined(self, node: str, role: str, context: Context) -> None:
        """Another node has come up (called before the first frame for those that are there already)."""

    def left(self, node: str, role: str, context: Context) -> None:
        """Another node has gone."""

    def rewired(self, context: Context) -> None:
        """A node has been put on a wire of the running mesh, or taken off one: `context.wiring` is the new wiring."""

    def finish(self, context: Context) -> dict[str, Any]:
        """Called once, after the last frame; what it returns is collected by the launcher. It can publish no more."""
        return {}


class Source(Node, ABC):
    """A node that drives the scene: the runtime asks it for the next frame when it is time."""

    period_ns: int = 100_000_000

    @abstractmethod
    def advance(self, context: Context) -> bool:
        """Publish the next frame; False when there is none."""


def handler_names(node: type[Node]) -> dict[str, str]:
    """The handler's name of every input port; raises TypeError where a port has none."""
    names = {port: f"on_{port}" for port in node.inputs}
    missing = [name for name in names.values() if not callable(getattr(node, name, None))]
    if missing:
        raise TypeError(f"{node.__name__} has no {', '.join(missing)} for its input ports")
    return names

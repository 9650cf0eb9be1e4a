"""The handlers of a node's input ports."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mast_zenoh.node import Node, handler_of
from mast_zenoh.wiring.model import ANY, Input

Handler = Callable[[Any, Any], None]


class Handlers:
    """The handlers of a node, by input port; those of ports that a map gives it are found when it has one.

    of: the handlers;  names: of them;  unopened: ports of messages that are not decoded
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.of: dict[str, Handler] = {}
        self.names: dict[str, str] = {}
        self.unopened: set[str] = set()
        for port, message in node.inputs.items():
            self.add(Input(port, "", message, ""))

    def add(self, port_input: Input) -> None:
        """Find the handler of an input port for messages of its type; raises TypeError if there is none."""
        node, port = self._node, port_input.port
        if port not in self.of:
            self.names[port] = handler_of(type(node), port, port_input.message)
            self.of[port] = getattr(node, self.names[port])
            if port in node.unopened or (ANY in node.unopened and port not in node.inputs):
                self.unopened.add(port)

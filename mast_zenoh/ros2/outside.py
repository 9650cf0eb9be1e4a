"""What a node can exchange with nodes of ROS 2 outside the run: topics, and the interface of its link to them.

The runtime opens a link (`mast_zenoh.runtime.mesh.ros2_link`); a node gets it as `Context.outside`. Needs no rosbags.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.ros2.connection import Connection

#: Publishers of a topic that are told apart.
MOST_PUBLISHERS = 16


class OutsideTopic(NamedTuple):
    """A topic of ROS 2 on which a node receives messages from outside the run.

    transient_local: whether what was sent earlier arrives, too, as on /tf_static
    depth: messages that wait for the node, at most: the newest;  most_bytes: of one of them
    """

    name: str
    type_name: str
    transient_local: bool = False
    depth: int = 8
    most_bytes: int = 1 << 21


@dataclass(frozen=True, slots=True)
class OutsideTopics:
    """What a node receives from outside the run. connection: where"""

    connection: Connection
    received: tuple[OutsideTopic, ...]


class Arrival(NamedTuple):
    """A message from outside: a valid one of its topic's type, with values of any kind. gid: of its publisher"""

    topic: str
    message: Any
    gid: bytes


class Outside(Protocol):
    """A node's link to programs outside the run: nodes of ROS 2, see docs/ros2_nodes.md.

    waits: whether the run waits for answers, as in lock-step
    ended: whether the run is being stopped, so that nothing is waited for any more
    clock_arrivals_ns: wall-clock times at which the clocks of the newest frames arrived, ns, by frame
    refused: number of messages that were dropped before the node got them, by reason
    """

    waits: bool

    @property
    def ended(self) -> bool: ...

    @property
    def clock_arrivals_ns(self) -> Mapping[int, int]: ...

    @property
    def refused(self) -> Mapping[str, int]: ...

    def announce(self, topic: str, type_name: str) -> None:
        """Make a topic known on which the node sends messages of this type."""
        ...

    def send(self, topic: str, message: Any) -> None:
        """Send a message on an announced topic; dropped if its receivers take nothing for 1 s."""
        ...

    def take(self) -> list[Arrival]:
        """What has arrived since the last call: topic by topic, each in order."""
        ...

    def wait(self, limit_s: float, done: Callable[[], bool], needed: Sequence[str] = ()) -> bool:
        """Wait until `done()`, which is called after each arrival; False after `limit_s`, s, or if the run ends.

        needed: topics without whose publishers waiting is useless: False as soon as one has none
        """
        ...

    def present(self, topic: str) -> bool:
        """Whether a program outside publishes on a topic: it says so, or a message has come lately."""
        ...

    def heard(self, topic: str) -> bool:
        """Whether a program outside subscribes to an announced topic."""
        ...

    def absence(self, topic: str) -> str:
        """Why nothing can arrive on a topic now, as a clause; "": a program outside publishes on it."""
        ...


def required(module: str) -> Any:
    """A module that needs the extra ros2; raises ConfigurationError if that is not installed."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("mast_zenoh"):
            raise
        problem = f"{error.name} is not installed, which messages of ROS 2 need"
        raise ConfigurationError(f"{problem}: pip install 'mast-zenoh[ros2]'") from None


def topic_prefix(node: str) -> str:
    """Where the topics of a node of the run are by default, such as /mast/infra_1."""
    return f"/mast/{ros2_name(node)}"


def ros2_name(name: str) -> str:
    """A node's name as ROS 2 allows it: letters, digits and _, no digit first."""
    return re.sub(r"^(?=[0-9])", "_", re.sub(r"\W", "_", name, flags=re.ASCII))

"""What a scenario says of ROS 2: the part `ros2`, the parameter of that name, and the bridge."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from mast_ros2.connection import connection_of_scenario
from mast_ros2.names import ros2_name
from mast_zenoh.config.outside_meshes import OutsideMesh
from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.errors import ConfigurationError

_CLOCK = "/clock"


class Ros2Mesh(OutsideMesh):
    """A router of rmw_zenoh, see `connection_of_scenario`."""

    key = "ros2"
    no_bridge = "ros2: no bridge: a single process has no mesh to observe; `mast ros2 RUN` plays the finished run"

    @staticmethod
    def parameter(config: Any, place: str) -> Mapping[str, Any]:
        """The connection of nodes that name none."""
        return connection_of_scenario(config, place).to_json()

    @staticmethod
    def prepare(path: Path, nodes: Mapping[str, NodeSpec], partners: Mapping[str, NodeSpec]) -> None:
        """Check that ROS 2 can tell the names of all nodes apart, and have one node send the clock.

        The first that can: of two, one may be behind, and the clock goes back.
        """
        from mast_zenoh.scenario.nodes import takes  # which the processes of nodes do not need

        names: dict[str, str] = {}
        for name in nodes:
            if (other := names.setdefault(ros2_name(name), name)) != name:
                raise ConfigurationError(
                    f"{path}: {name} and {other}: both are {ros2_name(name)} in ROS 2, which allows letters, digits "
                    "and _: rename one"
                )
        topic = _CLOCK
        for spec in partners.values():
            if takes(spec, "clock"):
                topic = "" if spec.config.setdefault("clock", topic) else topic

    @staticmethod
    def bridge(config: Any) -> AbstractContextManager[Callable[[Any], None]]:
        """A process that publishes a run, if the scenario has `ros2`."""
        from mast_ros2.commands import bridge_process

        return bridge_process(config)

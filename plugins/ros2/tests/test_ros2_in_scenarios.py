"""A scenario with nodes of ROS 2 gives them the router, one clock, and names that ROS 2 can tell apart."""

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
from mast_ros2 import Ros2Mesh
from mast_ros2.mesh import Connection
from tiny_world import tiny

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.errors import ConfigurationError

AGENT = {"type": "Ros2Agent", "file": "ros2_agent.py"}
CENTER = {"type": "Ros2CommandCenter", "file": "ros2_command_center.py"}


def resolved(agents: Mapping[str, Any] = MappingProxyType({"infra_1": AGENT, "infra_2": AGENT}), **parts: Any) -> Any:
    """Configurations of the nodes of the tiny world with these nodes of ROS 2, by name."""

    def edit(content: dict[str, Any]) -> None:
        content["agents"] |= {name: {**content["agents"]["*"], **config} for name, config in agents.items()}
        content |= parts

    return {name: spec.config for name, spec in tiny(edit=edit, frames=2).nodes.items()}


def test_the_router_of_the_scenario_is_that_of_nodes_without_their_own() -> None:
    own = {**AGENT, "ros2": {"router": "tcp/10.0.0.1:7447"}}
    nodes = resolved({"infra_1": AGENT, "infra_2": own}, ros2={"router": "tcp/10.0.0.2:7447", "domain": 3})
    assert (nodes["infra_1"]["ros2"]["router"], nodes["infra_1"]["ros2"]["domain"]) == ("tcp/10.0.0.2:7447", 3)
    assert nodes["infra_2"]["ros2"] == {"router": "tcp/10.0.0.1:7447"}
    assert "ros2" not in nodes["ego"]


def test_whether_every_frame_is_sent_is_said_of_the_bridge_and_not_of_a_node() -> None:
    router = {"router": "tcp/10.0.0.2:7447"}
    nodes = resolved({"infra_1": AGENT}, ros2={**router, "every_frame": True})
    assert nodes["infra_1"]["ros2"] == {**router, "domain": 0}
    with pytest.raises(ConfigurationError, match=r"ros2: 'every_frames': unknown key.*every_frame"):
        resolved(ros2={"every_frames": True})
    with pytest.raises(ConfigurationError, match=r"ros2.every_frame: found 'yes', expected True or False"):
        resolved(ros2={"every_frame": "yes"})
    with pytest.raises(ConfigurationError, match=r"'every_frame': unknown key"):
        Connection.of({"every_frame": True}, "ros2")


def test_the_plugin_is_among_those_that_the_run_uses() -> None:
    def edit(content: dict[str, Any]) -> None:
        content["agents"]["infra_1"] = content["agents"]["*"] | AGENT

    assert tiny(edit=edit, frames=2).plugins == {"Ros2Agent": f"mast-zenoh-ros2 {version('mast-zenoh-ros2')}"}
    assert tiny(frames=2).plugins == {}


def test_one_node_sends_the_clock() -> None:
    nodes = resolved(command_center=CENTER)
    clocks = [nodes[name]["clock"] for name in ("infra_1", "infra_2", "command_center")]
    assert sorted(clocks) == ["", "", "/clock"]
    assert "clock" not in nodes["ego"]


def test_a_chosen_clock_is_kept() -> None:
    nodes = resolved(command_center={**CENTER, "clock": "/sim/clock"})
    assert nodes["command_center"]["clock"] == "/sim/clock"


def test_names_that_are_one_in_ros_2_are_refused() -> None:
    file = str(Path(__file__).parents[1] / "mast_ros2/nodes/ros2_agent.py")
    specs = {name: NodeSpec("agent", file, "Ros2Agent", {}, "fail") for name in ("a-b", "a_b")}
    with pytest.raises(ConfigurationError, match=r"here.py: a_b and a-b: both are a_b in ROS 2.*rename one"):
        Ros2Mesh.prepare(Path("here.py"), specs, specs)
    specs = {"a-b": specs["a-b"], "ab": specs["a_b"]}
    Ros2Mesh.prepare(Path("here.py"), specs, specs)

"""The tiny world with a node of ROS 2 in one place."""

from typing import Any

from tiny_world import tiny

from mast_zenoh.config.resolved import Resolved


def with_ros2(place: str, router: str, *, frames: int = 12, record: bool = False, **options: Any) -> Resolved:
    """The tiny world whose agent infra_1, command centre, or adversary of infra_1 is a node of ROS 2.

    place: agent, center or adversary;  options: of the node
    """
    ros2 = options.pop("ros2", {"router": router})
    mode = options.pop("mode", "lockstep")

    def edit(content: dict[str, Any]) -> None:
        if place == "agent":
            own = {"type": "Ros2Agent", "file": "ros2_agent.py", "ros2": ros2, **options}
            content["agents"]["infra_1"] = {**content["agents"]["*"], **own}
        elif place == "center":
            own = {"type": "Ros2CommandCenter", "file": "ros2_command_center.py", "ros2": ros2, **options}
            content["command_center"] = own
        else:
            own = {"type": "Ros2Adversary", "file": "ros2_adversary.py", "agent": "infra_1", "ros2": ros2, **options}
            content["adversaries"] = {"thief": own}
            content["keyexpr"] = {"map": "testbed.toml", "rewrites": ["on_tracks.toml"]}
        content["run"] = {**content.get("run", {}), "mode": mode}

    return tiny(edit=edit, frames=frames, record=record)

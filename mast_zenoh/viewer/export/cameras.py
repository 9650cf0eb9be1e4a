"""The cameras of the agents of a run, and where these and the agents are."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mast_zenoh.arrays.geometry import quaternion_from_rotation
from mast_zenoh.arrays.states import Floats
from mast_zenoh.sensing import Camera
from mast_zenoh.viewer.frame import FrameSource, Pose

#: Components in the axes of an image (x right, y down, z ahead) of a vector in ours (x ahead, y left, z up).
AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


#: Name of the world frame.
WORLD = "world"


def transforms_of(agent: str, pose: Pose, camera: Camera) -> Iterator[tuple[str, str, Floats, Floats]]:
    """(parent, child, position (3,) m, quaternion (4,) x y z w) of an agent and of its camera's optical frame."""
    mount = camera.mount_position, camera.mount_rotation @ AXES.T
    for parent, child, place in ((WORLD, agent, pose), (agent, f"{agent}/camera", mount)):
        yield parent, child, place[0], np.roll(quaternion_from_rotation(place[1]), -1)


def cameras(run: FrameSource) -> dict[str, Camera]:
    """The camera of each agent; the default one if the scene is not known."""
    known = {agent.name: agent.camera for agent in run.scene.agents} if run.scene is not None else {}
    return {agent: known.get(agent, Camera()) for agent in run.agents}

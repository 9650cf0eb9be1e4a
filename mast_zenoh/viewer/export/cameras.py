"""The cameras of the agents of a run."""

from __future__ import annotations

import numpy as np

from mast_zenoh.sensing import Camera
from mast_zenoh.viewer.frames import RunFrames

#: Components in the axes of an image (x right, y down, z ahead) of a vector in ours (x ahead, y left, z up).
AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def cameras(run: RunFrames) -> dict[str, Camera]:
    """The camera of each agent; the default one if the scene is not known."""
    known = {agent.name: agent.camera for agent in run.scene.agents} if run.scene is not None else {}
    return {agent: known.get(agent, Camera()) for agent in run.agents}

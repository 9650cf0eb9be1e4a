"""A pinhole camera model: calibration and projection only, no images."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mast_zenoh.arrays.geometry import to_local, to_world
from mast_zenoh.arrays.states import Floats


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera that looks along the x axis of its own frame (y left, z up).

    mount_position: (3,) m, of the camera in the agent's frame
    mount_rotation: (3, 3), active, camera to agent
    width, height:  px
    focal:          px; 400 px at 800 px width is a field of view of 90 degrees
    """

    mount_position: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.6]))
    mount_rotation: Floats = field(default_factory=lambda: np.eye(3))
    width: int = 800
    height: int = 600
    focal: float = 400.0

    def project(self, points_world: Floats, agent_position: Floats, agent_rotation: Floats) -> tuple[Floats, Floats]:
        """Pixels (n, 2) and depth (n,) m of world points (n, 3) for an agent's pose.

        agent_position: (3,) m; agent_rotation: (3, 3)

        Pixels count u to the right and v down from the upper left corner. A point behind the camera has a depth <= 0
        and NaN pixels; a point outside the image has pixels outside [0, width) x [0, height).
        """
        position = to_world(self.mount_position[None], agent_position, agent_rotation)[0]
        local = to_local(np.asarray(points_world, np.float64), position, agent_rotation @ self.mount_rotation)
        depth = local[:, 0]
        scale = self.focal / np.where(depth > 0.0, depth, np.nan)
        pixels = np.stack([self.width / 2 - scale * local[:, 1], self.height / 2 - scale * local[:, 2]], axis=1)
        return pixels, depth

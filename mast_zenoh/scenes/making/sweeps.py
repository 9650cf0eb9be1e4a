"""Free space around the sensors of a recording, in every frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import sensor_pose
from mast_zenoh.sensing.raycast import SweepRays, Walls


def with_sweeps(recording: Recording) -> Recording:
    """The recording with `sweeps`; unchanged for a scene without buildings.

    Without buildings nobody knows what stands beside the road, and so not what is free.
    """
    if not recording.buildings:
        return recording
    return replace(recording, sweeps=tuple(_sweeps(recording, agent) for agent in range(len(recording.agents))))


def _sweeps(recording: Recording, agent: int) -> NDArray[np.float32]:
    """(F, bands, sectors) float32, m, of one agent."""
    described = recording.agents[agent]
    rays = SweepRays.of(described.sensor)
    walls = Walls.of_buildings(recording.buildings, recording.building_height)
    sweeps = np.empty((len(recording), rays.bands, rays.sectors), np.float32)
    background, last_pose = np.zeros(0), b""
    for frame in range(len(recording)):
        position, rotation = sensor_pose(
            recording.agent_position[frame, agent],
            recording.agent_rotation[frame, agent],
            described.sensor.mount_position,
            described.sensor.mount_rotation,
        )
        pose = position.tobytes() + rotation.tobytes()
        if pose != last_pose:  # that of a pole never changes
            background, last_pose = rays.background(position, rotation, walls), pose
        truth = recording.truth_at(frame)
        own = np.flatnonzero((truth.id == described.object_id) & (truth.id >= 0))
        boxes = truth.position, truth.size, truth.yaw
        sweeps[frame] = rays.sweep(background, position, rotation, boxes, int(own[0]) if len(own) else -1)
    return sweeps

"""Agents of a scenario: their paths and their lidars."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.making.assembly import AgentPath
from mast_zenoh.scenes.opv2v.labels import AgentPose
from mast_zenoh.scenes.opv2v.layout import AgentFolder
from mast_zenoh.scenes.opv2v.variants import Variant
from mast_zenoh.scenes.opv2v.vehicles import OwnCar
from mast_zenoh.scenes.recording import SceneAgent
from mast_zenoh.sensing import Camera

_MAX_MOUNT_ERROR_M = 0.5  # between a lidar's place on its car in two frames
_MAX_POLE_STEP_M = 1.0  # of a pole, which does not move
_CAMERA_BELOW_LIDAR_M = 0.2


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of A agents in F frames: position (F, A, 3) m of the body, lidar (F, A, 3) m, rotation (F, A, 3, 3)."""

    position: Floats
    lidar: Floats
    rotation: Floats

    @classmethod
    def of(cls, poses: Sequence[Sequence[AgentPose]]) -> Poses:
        """The poses of the agents for each frame."""
        return cls(*(np.array([[getattr(each, name) for each in now] for now in poses]) for name in _POSE))


_POSE = ("position", "lidar", "rotation")


def agent_path(
    agents: Sequence[AgentFolder],
    column: int,
    playing: Sequence[int],
    poses: Poses,
    cars: Mapping[int, OwnCar],
    variant: Variant,
    frames: Sequence[int],
) -> AgentPath:
    """The path of an agent and its sensors, without what it sees.

    column: of the agent; playing: columns of the agents that play, the ego first; cars: by column; frames: numbers

    Raises SceneError for a pole that moves and for a lidar that moves on its car.
    """
    folder, position, rotation = agents[column].folder, poses.position[:, column], poses.rotation[:, column]
    same_kind = [k for k in playing if agents[k].is_pole == agents[column].is_pole]
    if agents[column].is_pole:
        step = np.linalg.norm(position - position[0], axis=1).max()
        if step > _MAX_POLE_STEP_M:
            raise SceneError(f"{folder}: the pole moves {step:.2f} m, expected at most {_MAX_POLE_STEP_M:g} m")
        name = f"infra_{same_kind.index(column) + 1}"
        return AgentPath(
            SceneAgent(name, "static", -1, variant.pole, Camera(mount_position=np.zeros(3))), position, rotation
        )
    mounts = np.einsum("fji,fj->fi", rotation, poses.lidar[:, column] - position)
    mount = np.median(mounts, axis=0)
    apart = np.linalg.norm(mounts - mount, axis=1)
    if apart.max() > _MAX_MOUNT_ERROR_M:
        file = agents[column].file(frames[int(apart.argmax())])
        raise SceneError(
            f"{file}: lidar_pose is {apart.max():.2f} m from where the lidar is on the car in other frames, "
            f"expected at most {_MAX_MOUNT_ERROR_M:g} m"
        )
    order = same_kind.index(column)
    camera = Camera(mount_position=mount - [0.0, 0.0, _CAMERA_BELOW_LIDAR_M])
    sensor = replace(variant.car, mount_position=mount)
    agent = SceneAgent("ego" if order == 0 else f"mobile_{order}", "mobile", cars[column].object_id, sensor, camera)
    return AgentPath(agent, position, rotation)

"""An agent's pipeline: detections to tracks, then fusion with the picture.

Tracking, the first stage, does not use any message of another node.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.states import Detections, Floats, ObjectStates, concatenate
from mast_zenoh.fusion.base import Clusterer, Fusion
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.sensing import LidarSensor, sensor_pose, to_world
from mast_zenoh.tracking.base import Tracker
from mast_zenoh.tracking.view import SensorView

_NO_OFFSET = np.zeros(3)
_NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])
_NO_OFFSET.setflags(write=False)
_NO_TURN.setflags(write=False)
_NOWHERE = SensorView(_NO_OFFSET, np.eye(3), -np.pi, np.pi, -np.pi / 2, np.pi / 2, 0.0)


class MissionEstimator(ABC):
    """Makes the mission-critical estimate from own tracks and the newest picture."""

    def look(self, view: SweptView) -> None:  # noqa: B027 (a hook: most estimators need no view)
        """Set what the agent's own sensor covers, for the next estimate.

        Called only where agents get the sweeps of their sensors (keyexpr_maps/views.toml).
        """

    @abstractmethod
    def estimate(self, own: ObjectStates, picture: ObjectStates) -> ObjectStates:
        """Objects at the common time of both inputs, world frame.

        Ids are unique: 2 i for object i of the picture, 2 i + 1 for object i that only the agent has.
        """


class OwnAndPicture(MissionEstimator):
    """Clusters and fuses own tracks with the picture's objects.

    clustering: groups tracks and objects of the same object; fusion: fuses each cluster

    The picture already contains this agent's tracks in an unknown proportion: fuse by covariance intersection, which is
    consistent for any correlation (Julier and Uhlmann, ACC 1997).
    """

    def __init__(self, *, clustering: Clusterer, fusion: Fusion) -> None:
        self.clustering = clustering
        self.fusion = fusion

    def estimate(self, own: ObjectStates, picture: ObjectStates) -> ObjectStates:
        """The objects of both, world frame; see `MissionEstimator.estimate`."""
        both = concatenate([picture.with_(id=2 * picture.id), own.with_(id=2 * own.id + 1)])
        if len(picture) == 0 or len(own) == 0:
            return both
        labels = self.clustering.cluster(both, np.repeat([0, 1], [len(picture), len(own)]))
        fused = self.fusion.fuse(both, labels)
        # The picture's rows come first, so the first member of a cluster is from the picture if there is one.
        return fused.with_(id=both.id[np.unique(labels, return_index=True)[1]])


class PictureFirst(MissionEstimator):
    """Takes the picture, and own tracks only where it has no object nearby.

    radius: m, in the bird's-eye view, within which one of the agent's own tracks is left out
    """

    def __init__(self, *, radius: float = 2.0) -> None:
        self.radius = radius

    def estimate(self, own: ObjectStates, picture: ObjectStates) -> ObjectStates:
        """The objects of both, world frame; see `MissionEstimator.estimate`."""
        near, _, _, _ = neighbours(own.position, picture.position, np.full(len(own), self.radius))
        seen = np.zeros(len(own), bool)
        seen[near] = True
        remaining = own.select(~seen)
        ids = np.concatenate([2 * picture.id, 2 * remaining.id + 1])
        return concatenate([picture, remaining]).with_(id=ids)


@dataclass(frozen=True, slots=True)
class Pose:
    """Pose of an agent.

    position: (3,) m; quaternion: (4,) active, w x y z, agent to world
    """

    position: Floats
    quaternion: Floats


class AgentPipeline:
    """The stages of an agent, from detections to tracks.

    tracker: turns detections into tracks;  mission: makes the mission-critical estimate of them and the picture
    frame: "world": detections are transformed to the world frame before tracking, which removes the agent's own motion.
           "body": detections are tracked in the agent's moving frame, as in the original MAST; only to show the effect.
    """

    def __init__(
        self, *, tracker: Tracker, mission: MissionEstimator, frame: Literal["world", "body"] = "world"
    ) -> None:
        self.tracker = tracker
        self.mission = mission
        self.frame = frame
        self._view: tuple[list[bytes], SensorView] = ([], _NOWHERE)

    def track(
        self, time_ns: int, detections: Detections, pose: Pose, mount: Pose, lidar: LidarSensor
    ) -> tuple[ObjectStates, Floats, Floats]:
        """Safety-critical tracks, from own sensors alone, and their frame of reference.

        Returns tracks, origin (3,) m and active quaternion (4,).

        detections: sensor frame; pose: of the agent in the world; mount: of the sensor in the agent's frame
        """
        base = pose if self.frame == "world" else Pose(_NO_OFFSET, _NO_TURN)
        view = self._view_from(base, mount, lidar)
        tracks = self.tracker.step(time_ns, to_world(detections, view.position, view.rotation), view)
        reference = Pose(_NO_OFFSET, _NO_TURN) if self.frame == "world" else pose
        return tracks, reference.position, reference.quaternion

    def view(self, pose: Pose, mount: Pose, lidar: LidarSensor) -> SensorView:
        """The field of view of the sensor, world frame."""
        return self._view_from(pose, mount, lidar)

    def _view_from(self, base: Pose, mount: Pose, lidar: LidarSensor) -> SensorView:
        """The sensor's field of view; cached, because most agents are stationary."""
        parts = base.position, base.quaternion, mount.position, mount.quaternion
        key = [part.tobytes() for part in parts]
        if key != self._view[0]:
            agent, sensor = (rotation_from_quaternion(pose.quaternion) for pose in (base, mount))
            self._view = (key, view_of(lidar, *sensor_pose(base.position, agent, mount.position, sensor)))
        return self._view[1]


def view_of(lidar: LidarSensor, position: Floats, rotation: Floats) -> SensorView:
    """The field of view of a lidar at `position` (3,) with `rotation` (3, 3)."""
    return SensorView(
        position=position,
        rotation=rotation,
        azimuth_min=np.deg2rad(lidar.azimuth_min_deg),
        azimuth_max=np.deg2rad(lidar.azimuth_max_deg),
        elevation_min=np.deg2rad(lidar.elevation_min_deg),
        elevation_max=np.deg2rad(lidar.elevation_max_deg),
        max_range=lidar.max_range_m,
    )

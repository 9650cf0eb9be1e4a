"""An agent's pipeline: detections to tracks, which use no message of another node, and their mission estimate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mast_zenoh.arrays.geometry import NO_OFFSET, NO_TURN, rotation_from_quaternion
from mast_zenoh.arrays.states import Detections, Floats, ObjectStates
from mast_zenoh.fusion.pipelines.mission import MissionEstimator
from mast_zenoh.sensing import LidarSensor, sensor_pose, to_world
from mast_zenoh.tracking.base import Tracker
from mast_zenoh.tracking.view import SensorView

#: For each frame: a new measurement is due, or none is.
DUE, IDLE = "1", "0"


@dataclass(frozen=True, eq=False)
class OwnSensor:
    """One of several sensors of an agent, or one that measures at times of its own.

    name:           of the sensor
    lidar:          its field of view and range
    mount_position: (x, y, z) m, of the sensor in the agent's frame; its messages have the mount at their time
    mount_rotation: (w, x, y, z) active quaternion, sensor to agent
    frames:         for each frame of the run DUE or IDLE, repeated after the last; empty: a measurement is due in every
                    frame
    detection_probability: of an object in full view; None: that of the tracker

    Raises ValueError for other frames, and a probability outside (0, 1).
    """

    name: str
    lidar: LidarSensor
    mount_position: tuple[float, float, float]
    mount_rotation: tuple[float, float, float, float]
    frames: str = ""
    detection_probability: float | None = None

    def __post_init__(self) -> None:
        if self.frames.strip(DUE + IDLE):
            raise ValueError(f"frames: found {self.frames[:20]!r}, expected {DUE} or {IDLE} for each frame")
        if self.detection_probability is not None and not 0.0 < self.detection_probability < 1.0:
            raise ValueError(f"detection_probability: found {self.detection_probability}, expected between 0 and 1")

    def due(self, frame: int) -> bool:
        """Whether it sends a measurement in a frame."""
        return not self.frames or self.frames[frame % len(self.frames)] == DUE


_NO_VIEW: tuple[list[bytes], None] = ([], None)


@dataclass(frozen=True, slots=True)
class Pose:
    """Pose of an agent.

    position: (3,) m; quaternion: (4,) active, w x y z, agent to world
    """

    position: Floats
    quaternion: Floats


@dataclass(kw_only=True, eq=False)
class AgentPipeline:
    """The stages of an agent, from detections to tracks.

    tracker: turns detections into tracks;  mission: makes the mission-critical estimate of them and the picture
    frame: "world": detections are transformed to the world frame before tracking, which removes the agent's own motion.
           "body": detections are tracked in the agent's moving frame, as in the original MAST; only to show the effect.
    """

    tracker: Tracker
    mission: MissionEstimator
    frame: Literal["world", "body"] = "world"

    def __post_init__(self) -> None:
        self._views: dict[LidarSensor, tuple[list[bytes], SensorView]] = {}

    def track(
        self,
        time_ns: int,
        detections: Detections,
        pose: Pose,
        mount: Pose,
        lidar: LidarSensor,
        detection_probability: float | None = None,
    ) -> tuple[ObjectStates, Floats, Floats]:
        """Safety-critical tracks, from own sensors alone, and their frame of reference.

        Returns tracks, origin (3,) m and active quaternion (4,).

        time_ns: of the measurement; detections: sensor frame; pose: of the agent in the world
        mount: of the sensor in the agent's frame; lidar, detection_probability: of the sensor; None: the tracker's
        """
        base = pose if self.frame == "world" else Pose(NO_OFFSET, NO_TURN)
        view = self.view(base, mount, lidar)
        if detection_probability is not None:
            view = replace(view, detection_probability=detection_probability)
        tracks = self.tracker.step(time_ns, to_world(detections, view.position, view.rotation), view)
        return tracks, *self.reference(pose)

    def reference(self, pose: Pose) -> tuple[Floats, Floats]:
        """Origin (3,) m and active quaternion (4,) of the tracks' frame of reference. pose: of the agent"""
        reference = Pose(NO_OFFSET, NO_TURN) if self.frame == "world" else pose
        return reference.position, reference.quaternion

    def view(self, base: Pose, mount: Pose, lidar: LidarSensor) -> SensorView:
        """The field of view of a sensor for a pose of the agent; cached, because most agents are stationary."""
        parts = base.position, base.quaternion, mount.position, mount.quaternion
        key = [part.tobytes() for part in parts]
        if key != self._views.get(lidar, _NO_VIEW)[0]:
            agent, sensor = (rotation_from_quaternion(pose.quaternion) for pose in (base, mount))
            self._views[lidar] = (key, frame_at(lidar, *sensor_pose(base.position, agent, mount.position, sensor)))
        return self._views[lidar][1]


def frame_at(lidar: LidarSensor, position: Floats, rotation: Floats) -> SensorView:
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

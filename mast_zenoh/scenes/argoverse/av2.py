"""Recorded scenes: logs of the Argoverse 2 sensor data set."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.geometry import heading
from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.scenes.argoverse.files import Annotations, find_log, read_annotations, read_poses
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.making.assembly import AgentPath, assemble
from mast_zenoh.scenes.making.boxes import Boxes
from mast_zenoh.scenes.making.recorded_traffic import agent_counts, nearest_vehicles
from mast_zenoh.scenes.making.virtual_agents import poles
from mast_zenoh.scenes.recording import Recording, SceneAgent
from mast_zenoh.sensing import Camera, DetectionModel, Detector, LidarSensor

#: The recording car. The origin of its frame is the rear axle; the ego's box encloses the body.
_EGO_ID = 0
_EGO_SIZE = np.array([4.877, 2.0, 1.473])
_AXLE_HEIGHT_M = 0.33
_EGO_CENTRE = np.array([1.42, 0.0, _EGO_SIZE[2] / 2 - _AXLE_HEIGHT_M])
#: Its two roof lidars, 32 channels each, modelled as one.
_EGO_LIDAR = LidarSensor(
    mount_position=np.array([1.35, 0.0, 1.64]), elevation_min_deg=-25.0, elevation_max_deg=15.0, max_range_m=200.0
)
_EGO_CAMERA = Camera(mount_position=np.array([1.6, 0.0, 1.4]))

_DETECTOR = DetectionModel()


class AV2Log(Scene):
    """An Argoverse 2 sensor log: a real car in real traffic, to which virtual agents are added.

    path:             the folder of a log, with annotations*.feather and city_SE3_egovehicle.feather
    n_infrastructure: virtual poles along the ego's path, 15 m above the ground there, looking 30 degrees down, 0 to 16;
                      None: 4
    n_mobile:         recorded vehicles that get a lidar on the roof, besides the ego, the ones nearest to it that are
                      annotated in every frame of the log; None: 0
    detector:         the model that generates detections from lidar visibility

    The world's origin is on the ground below the ego's first position. The ego's visibility is the number of lidar
    returns in the data set; that of the other agents comes from ray casting against the other boxes (the data has no
    buildings). Traffic signs, cones and similar objects are left out (`files.LEFT_OUT`).
    """

    def __init__(
        self,
        *,
        path: str,
        n_infrastructure: int | None = None,
        n_mobile: int | None = None,
        detector: Detector = _DETECTOR,
    ) -> None:
        self.path = Path(path)
        self.n_infrastructure, self.n_mobile = agent_counts("AV2Log", n_infrastructure, n_mobile)
        self.detector = detector

    def inputs(self) -> Sequence[Path]:
        """The log's folder."""
        return (self.path,)

    def record(self, seed: int, frames: int | None) -> Recording:
        file, pose_file = find_log(self.path)
        annotations = read_annotations(file)
        city, rotation = read_poses(pose_file, annotations.times_ns)
        axle = city - city[0] + [0.0, 0.0, _AXLE_HEIGHT_M]
        boxes = _boxes(annotations, axle, rotation)
        ego = AgentPath(
            SceneAgent("ego", "mobile", _EGO_ID, _EGO_LIDAR, _EGO_CAMERA),
            axle,
            rotation,
            points=np.concatenate([np.zeros(len(axle), np.int32), annotations.points.astype(np.int32)]),
            ground=axle[:, 2] - _AXLE_HEIGHT_M,
        )
        others = nearest_vehicles(boxes, _EGO_ID, len(axle), self.n_mobile, self.path)
        roadside = poles(boxes, axle[:, :2], heading(rotation), self.n_infrastructure)
        name = file.parent.name
        paths = [ego, *others, *roadside]
        return assemble(name, annotations.times_ns, boxes, paths, self.detector, seed=seed, frames=frames)


def _boxes(annotations: Annotations, axle: Floats, rotation: Floats) -> Boxes:
    """The ego's boxes, then those of the traffic, in the world frame."""
    frame = annotations.frame
    ego = Boxes.throughout(_EGO_ID, axle + rotation @ _EGO_CENTRE, _EGO_SIZE, heading(rotation), CLASS_INDEX["car"])
    position = np.einsum("nij,nj->ni", rotation[frame], annotations.position) + axle[frame]
    traffic = Boxes(
        frame=frame,
        id=annotations.track,
        position=position,
        size=annotations.size,
        yaw=heading(rotation[frame] @ annotations.rotation),
        class_id=annotations.class_id,
        velocity=np.full_like(position, np.nan),
    )
    return Boxes.concatenate([ego, traffic])

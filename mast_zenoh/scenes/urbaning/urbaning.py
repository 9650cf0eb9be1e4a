"""Recorded scenes: sequences of UrbanIng-V2X, with two cars and the lidars of a crossing's poles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.geometry import heading
from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.making.assembly import AgentPath, assemble
from mast_zenoh.scenes.making.boxes import Boxes
from mast_zenoh.scenes.making.labels import Labels
from mast_zenoh.scenes.making.virtual_agents import standing
from mast_zenoh.scenes.recording import Recording, SceneAgent
from mast_zenoh.scenes.selection import check_counts
from mast_zenoh.scenes.urbaning.files import (
    TIMESYNC,
    Files,
    find_sequence,
    read_av_size,
    read_av_tracks,
    read_pole_lidar,
    read_states,
    read_timesync,
    read_vehicle_lidar,
)
from mast_zenoh.scenes.urbaning.tracks import Track, add_tracks, read_tracks
from mast_zenoh.sensing import Camera, DetectionModel, Detector, LidarSensor

#: Models of the lidars, whose channels and angles are not in the files.
_CAR_LIDAR = LidarSensor(elevation_min_deg=-25.0, elevation_max_deg=15.0)
_POLE_LIDAR = LidarSensor(mount_position=np.zeros(3), elevation_min_deg=-45.0, elevation_max_deg=45.0, channels=128)
#: l w h of a car with neither a label nor an entry in av_vehicle_data.json.
_CAR_SIZE = np.array([4.8, 1.9, 1.7])
_MAX_LABEL_ERROR_M = 2.0  # between the label of a car and its own state
_DETECTOR = DetectionModel()


class UrbanIngV2X(Scene):
    """A sequence of UrbanIng-V2X: one or two cars and the lidars of poles at a crossing.

    path:             the folder of the data set, or dataset/<sequence> in it
    n_infrastructure: number of pole lidars to use, the first ones by name; None: all
    n_mobile:         number of cars besides the ego to use, the first ones; None: all
    sequence:         name of the sequence; None: the only one
    detector:         the model that generates detections from lidar visibility

    The ego is the first vehicle; each lidar on a pole is an agent. The world is the crossing's global frame, shifted
    so that its origin is on the ground below the ego's first position. All agents see by ray casting against the other
    boxes: the labels do not tell who saw an object, and buildings are not read. See docs/scenes_urbaning.md.
    """

    def __init__(
        self,
        *,
        path: str,
        n_infrastructure: int | None = None,
        n_mobile: int | None = None,
        sequence: str | None = None,
        detector: Detector = _DETECTOR,
    ) -> None:
        self.path = Path(path)
        self.n_infrastructure = n_infrastructure
        self.n_mobile = n_mobile
        self.sequence = sequence
        self.detector = detector

    def inputs(self) -> Sequence[Path]:
        """The sequence's folder and the files about it; `path`, if there is none."""
        try:
            files = find_sequence(self.path, self.sequence)
        except (SceneError, ConfigurationError):
            return (self.path,)
        return (files.folder, files.labels, files.av_tracks, files.av_data)

    def record(self, seed: int, frames: int | None) -> Recording:
        files = find_sequence(self.path, self.sequence)
        timesync = read_timesync(files.folder / TIMESYNC)
        vehicles, lidars = self._agents(list(timesync.states), timesync.lidars)
        poses = {name: read_states(files.folder, name, timesync) for name in timesync.states}
        own_tracks = read_av_tracks(files, list(poses))
        boxes, objects = _boxes(files, read_tracks(files.labels, timesync.times_ms), poses, own_tracks)
        row = np.flatnonzero((boxes.id == objects[vehicles[0]]) & (boxes.frame == 0))[0]
        origin = boxes.position[row] - [0.0, 0.0, boxes.size[row, 2] / 2]
        boxes = replace(boxes, position=boxes.position - origin)
        calibration = files.folder / "calibration.json"
        paths = []
        for k, name in enumerate(vehicles):
            position, rotation = poses[name]
            own = objects[name]
            height = float(boxes.size[np.flatnonzero(boxes.id == own)[0], 2])
            mount = read_vehicle_lidar(calibration, name)
            paths.append(_car("ego" if k == 0 else f"mobile_{k}", own, position - origin, rotation, height, mount))
        for k, name in enumerate(lidars, start=1):
            position, rotation = read_pole_lidar(calibration, name)
            paths.append(standing(f"infra_{k}", _POLE_LIDAR, position - origin, rotation, len(timesync.times_ms)))
        times = np.array(timesync.times_ms, np.int64) * 1_000_000
        return assemble(files.folder.name, times, boxes, paths, self.detector, seed=seed, frames=frames)

    def _agents(self, vehicles: list[str], lidars: list[str]) -> tuple[list[str], list[str]]:
        """The vehicles and the pole lidars that play."""
        kinds = "cars besides the ego", "lidars on poles"
        check_counts(self.path, (self.n_mobile, len(vehicles) - 1), (self.n_infrastructure, len(lidars)), kinds)
        kept = len(vehicles) if self.n_mobile is None else 1 + self.n_mobile
        return vehicles[:kept], lidars[: self.n_infrastructure]


def _boxes(
    files: Files, tracks: dict[str, Track], poses: dict[str, tuple[Floats, Floats]], own_tracks: dict[str, str]
) -> tuple[Boxes, dict[str, int]]:
    """All boxes in the global frame, and the object ids of the vehicles with a lidar.

    Such a vehicle has a box in every frame, from its own state, in place of its labels.
    """
    labels = Labels(files.labels)
    add_tracks({name: track for name, track in tracks.items() if name not in own_tracks.values()}, labels)
    boxes, ids = labels.boxes(own_tracks.values())
    unused = max(ids.values(), default=0) + 1
    parts, objects = [boxes], {}
    for k, (vehicle, (position, rotation)) in enumerate(poses.items()):
        name = own_tracks.get(vehicle)
        track = None if name is None else tracks.get(name)
        if track is not None:
            _check_label(vehicle, track, position)
        objects[vehicle] = unused + k if name is None else ids[name]
        size = track.size[0] if track is not None and len(track.size) else read_av_size(files, vehicle)
        class_id = CLASS_INDEX["car"] if track is None else track.class_id
        size = _CAR_SIZE if size is None else size
        parts.append(Boxes.throughout(objects[vehicle], position, size, heading(rotation), class_id))
    return Boxes.concatenate(parts), objects


def _check_label(vehicle: str, track: Track, position: Floats) -> None:
    """Raise SceneError if the label of a vehicle is elsewhere than its state. position: (F, 3) m"""
    if not len(track.frame):
        return
    error = np.linalg.norm(track.position - position[track.frame], axis=1)
    row = int(error.argmax())
    if error[row] > _MAX_LABEL_ERROR_M:
        place = track.element["positions"].elements()[row]
        place.fail(
            f"a position within {_MAX_LABEL_ERROR_M:g} m of {vehicle} in its state, "
            f"{np.round(position[track.frame[row]], 2).tolist()}"
        )


def _car(
    name: str, own: int, position: Floats, rotation: Floats, height: float, mount: tuple[Floats, Floats]
) -> AgentPath:
    """A car; its origin is the middle of its underside.

    position, rotation: of its body, whose origin is the middle of its box; mount: pose of the lidar in it
    """
    underside = np.array([0.0, 0.0, -height / 2])
    sensor = replace(_CAR_LIDAR, mount_position=mount[0] - underside, mount_rotation=mount[1])
    camera = Camera(mount_position=mount[0] - underside)
    return AgentPath(SceneAgent(name, "mobile", own, sensor, camera), position + rotation @ underside, rotation)

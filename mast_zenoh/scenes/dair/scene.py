"""Recorded scenes of a car and a pole: V2X-Seq-SPD and DAIR-V2X-C."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.dair.cooperative import Poses, read_truth, with_car
from mast_zenoh.scenes.dair.layout import (
    INFRASTRUCTURE,
    VEHICLE,
    Layout,
    Pair,
    clocks,
    frame_number,
    open_layout,
    read_pairs,
    split_path,
)
from mast_zenoh.scenes.dair.timing import check_differences, check_limit, check_times
from mast_zenoh.scenes.making.assembly import AgentPath, assemble
from mast_zenoh.scenes.making.visibility import listed_returns
from mast_zenoh.scenes.recording import Recording, SceneAgent
from mast_zenoh.sensing import Camera, DetectionModel, Detector, LidarSensor

_ORIGIN = np.zeros(3)
_CAR_LIDAR = LidarSensor(
    mount_position=_ORIGIN, elevation_min_deg=-25.0, elevation_max_deg=15.0, channels=40, max_range_m=200.0
)
_POLE_LIDAR = LidarSensor(
    mount_position=_ORIGIN,
    azimuth_min_deg=-50.0,
    azimuth_max_deg=50.0,
    elevation_min_deg=-30.0,
    elevation_max_deg=10.0,
    channels=300,
    max_range_m=200.0,
)
_CAMERA = Camera(mount_position=_ORIGIN)
_DETECTOR = DetectionModel()
_NO_LIMIT = 10**40


class DAIRScene(Scene):
    """A sequence of V2X-Seq-SPD or DAIR-V2X-C: a car and a pole, with cooperative labels.

    path:                  the folder of the data set, or a folder that holds a single one; the name of a sequence may
                           follow, as in V2X-Seq-SPD/0003
    sequence:              name of the sequence (DAIR-V2X-C: the car's batch_id); None: the only one
    n_infrastructure:      0: without the pole; None: 1
    n_mobile:              cars besides the ego; None: 0, the only value
    detector:              the model that generates detections from lidar visibility
    first_frame:           number of the car's frame with which to begin; None: the first
    last_frame:            number of the car's last frame; None: the last
    max_time_difference_s: limit on the time between a frame of the car and the pole's frame that belongs to it
    max_gap_s:             limit on the time between two frames of the car
    match_radius_m:        the labels of a side that do not refer to a cooperative label match one within this distance
    link_radius_m:         give labels without track ids the id of the nearest box in the frame before, within this
                           distance of where it leads; None: refuse labels without track ids

    The truth are the cooperative labels. Frames are those of the car; the pole measures at the times of its own clock,
    and its poses and visibility come from the frame that is paired with the car's, see docs/scenes_dair.md. An agent's
    frame is that of its lidar: x forward, y left, z up; positions are middles of boxes, and rotations are active.
    """

    def __init__(
        self,
        *,
        path: str,
        sequence: str | int | None = None,
        n_infrastructure: int | None = None,
        n_mobile: int | None = None,
        detector: Detector = _DETECTOR,
        first_frame: int | None = None,
        last_frame: int | None = None,
        max_time_difference_s: float = 0.2,
        max_gap_s: float = 0.15,
        match_radius_m: float = 2.0,
        link_radius_m: float | None = None,
    ) -> None:
        for name, value, highest in (("n_infrastructure", n_infrastructure, 1), ("n_mobile", n_mobile, 0)):
            if value is not None and not 0 <= value <= highest:
                raise ConfigurationError(
                    f"DAIRScene: {name} is {value}, expected {'0' if highest == 0 else '0 or 1'}: "
                    "the data has one car and one pole"
                )
        self.path, named = split_path(Path(path))
        self.sequence = named if sequence is None else str(sequence)
        if named not in (None, self.sequence):
            raise ConfigurationError(f"{path}: sequence is {self.sequence!r}, expected {named!r} as in the path")
        self.n_infrastructure = 1 if n_infrastructure is None else n_infrastructure
        self.detector = detector
        self.first_frame = first_frame
        self.last_frame = last_frame
        self.max_time_difference_s = check_limit("DAIRScene", "max_time_difference_s", max_time_difference_s)
        self.max_gap_s = check_limit("DAIRScene", "max_gap_s", max_gap_s)
        self.match_radius_m = check_limit("DAIRScene", "match_radius_m", match_radius_m)
        self.link_radius_m = None if link_radius_m is None else check_limit("DAIRScene", "link_radius_m", link_radius_m)

    def inputs(self) -> Sequence[Path]:
        """The data set's folder."""
        return (self.path,)

    def time_differences_s(self) -> Floats:
        """(F,) s that each frame of the pole is later than the car's frame it is paired with.

        Raises SceneError and ConfigurationError as `record` does.
        """
        return clocks(self._pairs(open_layout(self.path)))[1]

    def record(self, seed: int, frames: int | None) -> Recording:
        layout = open_layout(self.path)
        pairs = self._pairs(layout)
        times, _ = clocks(pairs)
        car, pole = _poses(layout, pairs)
        truth = read_truth(layout, pairs, car, pole, times, self.match_radius_m, self.link_radius_m)
        truth, object_id = with_car(truth, car)
        paths = [
            AgentPath(SceneAgent("ego", "mobile", object_id, _CAR_LIDAR, _CAMERA), car.position, car.rotation),
            AgentPath(
                SceneAgent("infra_1", "static", -1, _POLE_LIDAR, _CAMERA),
                pole.position,
                pole.rotation,
                velocity=np.zeros_like(pole.position),
                measured_ns=np.array([pair.infrastructure_time_ns for pair in pairs], np.int64),
            ),
        ]
        seen = [
            replace(
                path, points=listed_returns(truth.boxes, path, truth.seen[:, column], ~truth.known[:, column], frames)
            )
            for column, path in enumerate(paths[: 1 + self.n_infrastructure])
        ]
        name = f"{layout.root.name} {self.sequence or ''}".strip()
        return assemble(name, times, truth.boxes, seen, self.detector, seed=seed, frames=frames)

    def _pairs(self, layout: Layout) -> list[Pair]:
        """The pairs of the requested frames, with times checked."""
        first = -1 if self.first_frame is None else self.first_frame
        last = _NO_LIMIT if self.last_frame is None else self.last_frame
        pairs = read_pairs(layout, self.sequence)
        chosen = [pair for pair in pairs if first <= frame_number(pair.vehicle) <= last]
        if not chosen:
            raise ConfigurationError(
                f"{layout.root}: first_frame {self.first_frame} to last_frame {self.last_frame}: found no frame, "
                f"expected some of {pairs[0].vehicle} to {pairs[-1].vehicle}"
            )
        names = [pair.vehicle for pair in chosen]
        times, difference = clocks(chosen)
        check_times(layout.clocks(VEHICLE), names, times, self.max_gap_s)
        check_differences(layout.clocks(INFRASTRUCTURE), names, "infra_1", difference, self.max_time_difference_s)
        return chosen


def _poses(layout: Layout, pairs: list[Pair]) -> tuple[Poses, Poses]:
    """Poses of the lidars of the car and of the pole."""
    car = [layout.vehicle_pose(pair) for pair in pairs]
    pole = [layout.infrastructure_pose(pair, rotation) for pair, (_, rotation) in zip(pairs, car, strict=True)]
    of_car, of_pole = (
        Poses(np.array([position for position, _ in poses]), np.array([rotation for _, rotation in poses]))
        for poses in (car, pole)
    )
    return of_car, of_pole

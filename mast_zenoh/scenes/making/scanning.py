"""Scans a scene with its lidars, frame by frame: their points, and how many of these each object returned.

Where a data set recorded the points of a lidar, they are taken from there; receivers cannot tell the difference.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import (
    heading,
    quaternion_from_rotation,
    rotation_from_yaw,
    to_local,
    to_world,
    wrap_angle,
)
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.scenes.agents import best_pattern
from mast_zenoh.scenes.making.observe import World
from mast_zenoh.scenes.recording import NO_MEASUREMENT, Recording, SceneAgent
from mast_zenoh.sensing import Walls, sensor_pose
from mast_zenoh.sensing.beams import MODELS, Beams
from mast_zenoh.sensing.clutter import Clutter
from mast_zenoh.sensing.free_space import swept
from mast_zenoh.sensing.point_detector import PointDetector, detected
from mast_zenoh.sensing.points import Points
from mast_zenoh.sensing.returns import REFLECTIVITY, Returns
from mast_zenoh.sensing.scan import Moving, cast
from mast_zenoh.sensing.shapes import Parts
from mast_zenoh.streams import stream

#: m, radius around an agent that clutter stays out of, as around its pole.
_POLE_M = 0.5
#: m: objects this near to a lidar stand on its ground; clutter is at most this far from all that moves.
_NEAR_M = 50.0


@dataclass(kw_only=True, eq=False)
class ScannedPoints:
    """How the lidars of a scene scan it.

    lidar:   a model, see `mast list scenes`, or models by agent or pattern ("infra_*"); None: the agents' own, or
             the points that the scene's data recorded
    returns: what a lidar measures of what its beams meet
    clutter: still objects beside the roads, which are not in the scene's truth; None: none
    moving:  whether lidars and objects move during a scan
    detector: finds objects in the points where they are made; None: a node or an agent does
    """

    lidar: str | dict[str, str] | None = None
    returns: Returns = field(default_factory=Returns)
    clutter: Clutter | None = field(default_factory=Clutter)
    moving: bool = True
    detector: PointDetector | None = None

    def __post_init__(self) -> None:
        models = () if self.lidar is None else (self.lidar,) if isinstance(self.lidar, str) else self.lidar.values()
        for model in models:
            if model not in MODELS:
                raise ValueError(f"lidar: found {model!r}{nearest(str(model), MODELS)}")

    def model_of(self, agent: str) -> str | None:
        """The model of an agent's lidar; None: its own."""
        if not isinstance(self.lidar, dict):
            return self.lidar
        pattern = best_pattern(self.lidar, agent)
        return None if pattern is None else self.lidar[pattern]

    def equipped(self, recording: Recording) -> Recording:
        """The recording, with agents that have these lidars.

        Raises ConfigurationError for a pattern that no agent matches, and an agent whose first sensor is no lidar that
        measures in every frame, at its time.
        """
        names = recording.agent_names
        for pattern in self.lidar if isinstance(self.lidar, dict) else ():
            if not any(best_pattern([pattern], name) for name in names):
                raise ConfigurationError(f"lidar: no agent {pattern!r} in this scene{nearest(pattern, names)}")
        agents = []
        for row, agent in enumerate(recording.agents):
            first = agent.sensors[0]
            timed = [recording.age_ns_at(frame, row) for frame in range(len(recording))]
            if first.kind != "lidar" or any(timed) or NO_MEASUREMENT in timed:
                raise ConfigurationError(
                    f"{agent.name}: found the sensor {first.name!r}, expected first a lidar without rate_hz and "
                    "phase_s: its points are those of the frame"
                )
            model = self.model_of(agent.name)
            if model is not None:
                lidar = MODELS[model].sensor(first.lidar.mount_position, first.lidar.mount_rotation)
                sensors = (replace(first, lidar=lidar), *agent.sensors[1:])
                agent = replace(agent, sensor=lidar, sensors=sensors)
            agents.append(agent)
        return replace(recording, agents=tuple(agents))


class Scanner:
    """Scans a scene with the lidars of all agents.

    recording: the scene as it is prepared: its agents, their lidars, buildings, and where objects move
    points:    how its lidars scan;  seed: of the run
    swept:     whether free space is published, too, where objects are detected here
    """

    def __init__(self, recording: Recording, points: ScannedPoints, seed: int, swept: bool = False) -> None:
        self._agents, self._points, self._seed, self._swept = recording.agents, points, seed, swept
        self._detectors = [copy.deepcopy(points.detector) for _ in recording.agents]
        self._period_s = recording.period_ns * 1e-9
        self._beams = [self._beams_of(agent) for agent in recording.agents]
        self._recorded = recording.scans
        clutter = points.clutter or Clutter(hedges=0, kerbs=0, signs=0, poles=0)
        occupied, radius = _occupied(recording)
        extent = np.stack([occupied.min(axis=0) - _NEAR_M, occupied.max(axis=0) + _NEAR_M])
        random, ground_m = stream(seed, "clutter"), _ground_m(recording.truth)
        self._still = clutter.place(occupied, radius, recording.buildings, extent, random, ground_m)
        self._walls = Walls.of_buildings(recording.buildings, recording.building_height).joined(self._still.kerbs)
        self._headings: tuple[Mapping[int, float], Floats] = {}, np.zeros(0)  # of the last frame: objects, lidars

    def _beams_of(self, agent: SceneAgent) -> Beams:
        model, period_s = self._points.model_of(agent.name), self._period_s if self._points.moving else 0.0
        return Beams.of_sensor(agent.sensor, period_s) if model is None else MODELS[model].beams(period_s)

    def _recorded_scan(self, frame: int, row: int) -> Points | None:
        """The recorded scan of an agent's lidar in a frame; None: that lidar is simulated."""
        scans, is_other = self._recorded, self._points.model_of(self._agents[row].name) is not None
        return None if scans is None or is_other or not scans.recorded[row] else scans.at(frame, row)

    def publish(
        self,
        frame: int,
        truth: ObjectStates,
        scene: Recording | World,
        row: int,
        publish: Callable[..., None],
    ) -> NDArray[np.int32]:
        """Publish the points of each agent in a frame, and the detections in them here; frames are in order.

        truth: n objects, world frame
        scene: has the agents' poses and velocities;  row: of the frame, there
        publish: of a node's context

        Returns how many points (n, A) each object returned to each agent.
        """
        agents = scene.agent_position[row], scene.agent_rotation[row], scene.agent_velocity[row]
        scans, returned = self._scans(frame, truth, *agents), []
        for agent, detector, (columns, of_objects) in zip(self._agents, self._detectors, scans, strict=True):
            publish("points", columns, subject=agent.name)
            if detector is not None:
                publish("detections", detected(detector, columns), subject=agent.name)
                if self._swept:
                    publish("sweep", swept(columns, agent.sensor), subject=agent.name)
            returned.append(np.bincount(of_objects, minlength=len(truth)))
        return np.stack(returned, axis=1).astype(np.int32)

    def _scans(
        self, frame: int, truth: ObjectStates, position: Floats, rotation: Floats, velocity: Floats
    ) -> Iterator[tuple[dict[str, NDArray[Any]], Ints]]:
        """Yield the columns of the `points` message of each agent, and the rows of objects that points are of."""
        poses = [
            sensor_pose(position[row], rotation[row], agent.sensor.mount_position, agent.sensor.mount_rotation)
            for row, agent in enumerate(self._agents)
        ]
        facing = np.array([heading(lidar[1]) for lidar in poses])
        before, facing_before = self._headings
        turn = np.array([wrap_angle(yaw - before.get(id_, yaw)) for id_, yaw in zip(truth.id, truth.yaw, strict=True)])
        lidar_turn = wrap_angle(facing - facing_before) if len(facing_before) else np.zeros(len(facing))
        self._headings = dict(zip(truth.id.tolist(), truth.yaw.tolist(), strict=True)), facing
        still, none = self._still, np.zeros(len(self._still.yaw))
        everything = Moving(
            np.concatenate([truth.position, still.position]),
            np.concatenate([truth.velocity, np.zeros_like(still.position)]),
            np.concatenate([truth.yaw, still.yaw]),
            np.concatenate([turn / self._period_s, none]),
        )
        classes = np.concatenate([truth.class_id, none]).astype(np.int64)
        parts = Parts.of(classes, np.concatenate([truth.size, still.size]))
        reflectivity = np.concatenate([REFLECTIVITY[truth.class_id], still.reflectivity])
        for row, (agent, (at, active)) in enumerate(zip(self._agents, poses, strict=True)):
            level = rotation_from_yaw(-float(facing[row])) @ active
            frames = {
                "mount_position": agent.sensor.mount_position,
                "mount_rotation": quaternion_from_rotation(agent.sensor.mount_rotation),
                "level_rotation": quaternion_from_rotation(level),
            }
            if (points := self._recorded_scan(frame, row)) is not None:
                others = np.append(np.where(truth.id == agent.object_id, -1, np.arange(len(truth))), -1)
                of_objects = others[_object_of(to_world(points.position.astype(np.float64), at, active), truth)]
                yield points.columns() | frames, of_objects[of_objects >= 0]
                continue
            moves = agent.kind == "mobile"
            lidar = Moving(
                at[None],
                velocity[row][None] * moves,
                facing[row][None],
                np.atleast_1d(lidar_turn[row] / self._period_s) * moves,
            )
            own = np.flatnonzero((truth.id == agent.object_id) & (truth.id >= 0))
            beams = self._beams[row]
            row_of_own = int(own[0]) if len(own) else -1
            scan = cast(beams, lidar, level, everything, parts, _ground_m(truth, at), self._walls, row_of_own)
            random = stream(self._seed, "points", agent.name, frame)
            points, source = self._points.returns.measure(scan, beams, lidar, level, reflectivity, random)
            yield points.columns() | frames, source[(source >= 0) & (source < len(truth))]


def _object_of(points: Floats, truth: ObjectStates) -> Ints:
    """(n,) row of the object whose box a point (n, 3) m is in, the last of several; -1: none. All in the world frame"""
    rows = np.full(len(points), -1)
    for row in range(len(truth)):
        offset = np.abs(to_local(points, truth.position[row], rotation_from_yaw(float(truth.yaw[row]))))
        rows[(offset <= truth.size[row] / 2.0).all(axis=1)] = row
    return rows


def _ground_m(truth: ObjectStates, at: Floats | None = None) -> float:
    """m, z of the ground on which objects stand; 0: no objects. at: (3,) m, counts only those near this place"""
    bottom = truth.position[:, 2] - truth.size[:, 2] / 2.0
    if at is not None:
        bottom = bottom[np.linalg.norm(truth.position[:, :2] - at[:2], axis=1) < _NEAR_M]
    return float(np.median(bottom)) if len(bottom) else 0.0


def _occupied(recording: Recording) -> tuple[Floats, Floats]:
    """(k, 2) m, where objects and agents are in any frame, and the radius (k,) m that each takes up."""
    truth, agents = recording.truth, recording.agent_position[:, :, :2].reshape(-1, 2)
    radius = np.hypot(truth.size[:, 0], truth.size[:, 1]) / 2.0
    return np.concatenate([truth.position[:, :2], agents]), np.concatenate([radius, np.full(len(agents), _POLE_M)])

"""Makes a recording from boxes and the paths of the agents: the last step of every reader of a data set.

Agents added to recorded traffic: cars with a lidar on the roof, and poles beside a route.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import rotation_from_yaw, rotation_from_yaw_pitch
from mast_zenoh.arrays.states import CLASS_INDEX, CLASSES, Detections, Floats, Ints
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.making.observe import World, detect, lidar_visibility, make_recording
from mast_zenoh.scenes.making.sensor_types import Rig, SensorsByAgent, SensorSchedule, equip
from mast_zenoh.scenes.recording import Recording, SceneAgent, check_times, truth_states
from mast_zenoh.sensing import Camera, Detector, LidarSensor


@dataclass(frozen=True, eq=False)
class SceneBoxes:
    """N boxes in the world frame, in any order.

    frame:    (N,) int64, row of the scene's frames
    id:       (N,) int64, 0 or more, the same in all frames of an object
    position: (N, 3) m, middle of the box
    size:     (N, 3) m, length, width, height
    yaw:      (N,) rad
    class_id: (N,) uint8, index into CLASSES
    velocity: (N, 3) m/s; rows of NaN, or all of them without any, are computed from the positions
    """

    frame: Ints
    id: Ints
    position: Floats
    size: Floats
    yaw: Floats
    class_id: NDArray[np.uint8]
    velocity: Floats = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        if not len(self.velocity):
            object.__setattr__(self, "velocity", np.full((len(self.id), 3), np.nan))

    def __len__(self) -> int:
        return len(self.id)

    def select(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> SceneBoxes:
        """The boxes of the given rows, in that order."""
        return SceneBoxes(*(getattr(self, column.name)[rows] for column in fields(self)))

    def rows_of(self, number: int) -> NDArray[np.intp]:
        """The rows of one object, in the order of the frames."""
        rows = np.flatnonzero(self.id == number)
        return rows[np.argsort(self.frame[rows], kind="stable")]

    def rows_by_frame(self, frames: int) -> list[NDArray[np.intp]]:
        """For each frame the rows of its boxes, by id."""
        order = np.lexsort((self.id, self.frame))
        return np.split(order, np.searchsorted(self.frame[order], np.arange(1, frames)))

    @classmethod
    def throughout(cls, number: int, position: Floats, size: Floats, yaw: Floats, class_id: int) -> SceneBoxes:
        """Boxes of one object in all F frames.

        number: its id; position: (F, 3) m, middle; size: (3,) m l w h; yaw: (F,) rad
        """
        frames = len(position)
        return cls(
            frame=np.arange(frames),
            id=np.full(frames, number, np.int64),
            position=position,
            size=np.tile(size, (frames, 1)),
            yaw=yaw,
            class_id=np.full(frames, class_id, np.uint8),
        )

    @classmethod
    def concatenate(cls, parts: Sequence[SceneBoxes]) -> SceneBoxes:
        """All boxes of the parts, in order."""
        return cls(*(np.concatenate([getattr(part, column.name) for part in parts]) for column in fields(cls)))

    def validate(self, name: str, frames: int) -> None:
        """Raise SceneError for the first box that cannot be.

        name: of the scene, for the message; frames: how many it has
        """
        n = len(self.id)
        for column, width in (("position", 3), ("size", 3), ("velocity", 3), ("frame", 0), ("yaw", 0), ("class_id", 0)):
            shape, expected = getattr(self, column).shape, (n, width) if width else (n,)
            if shape != expected:
                raise SceneError(f"{name}: {column} of the boxes has shape {shape}, expected {expected}")
        for column, invalid, expectation in (
            ("frame", (self.frame < 0) | (self.frame >= frames), f"0 to {frames - 1}"),
            ("id", self.id < 0, "0 or more"),
            ("position", ~np.isfinite(self.position).all(axis=1), "finite numbers"),
            ("size", ~(np.isfinite(self.size) & (self.size > 0)).all(axis=1), "finite numbers above 0"),
            ("yaw", ~np.isfinite(self.yaw), "a finite number"),
            ("velocity", np.isinf(self.velocity).any(axis=1), "finite numbers, or NaN"),
            ("class_id", self.class_id >= len(CLASSES), f"0 to {len(CLASSES) - 1}"),
        ):
            if invalid.any():
                row = int(np.flatnonzero(invalid)[0])
                place = f"frame {self.frame[row]}, object {self.id[row]}"
                raise SceneError(f"{name}: {place}: {column} is {getattr(self, column)[row]}, expected {expectation}")
        order = np.lexsort((self.id, self.frame))
        repeated = np.flatnonzero((np.diff(self.frame[order]) == 0) & (np.diff(self.id[order]) == 0))
        if len(repeated):
            row = order[repeated[0]]
            raise SceneError(
                f"{name}: frame {self.frame[row]}, object {self.id[row]}: found two boxes, expected one at most"
            )


_STANDING_MPS = 0.5  # the direction of a lower speed is mostly noise


def fill_velocity(ids: Ints, position: Floats, velocity: Floats, times_ns: Ints) -> Floats:
    """Fill NaN rows of `velocity` (N, 3) m/s by differentiating `position` (N, 3) m.

    ids (N,) and times_ns (N,) ns, ascending for each id. Central differences, one-sided at the ends of a track; zero
    for an object in a single frame.
    """
    filled = velocity.copy()
    missing = np.logical_or.reduce(np.isnan(velocity), axis=1)
    order = np.argsort(ids, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(ids[order])) + 1):
        if missing[rows].any():
            derivative = (
                np.gradient(position[rows], (times_ns[rows] - times_ns[rows[0]]) / 1e9, axis=0)
                if len(rows) > 1
                else np.zeros((1, 3))
            )
            filled[rows[missing[rows]]] = derivative[missing[rows]]
    return filled


def direction_of_motion(ids: Ints, velocity: Floats) -> Floats:
    """(N,) rad, direction of velocities (N, 3) m/s, ascending in time for each id (N,).

    While an object stands, its last direction, or its first before it moves; 0 for one that never does.
    """
    moving = np.hypot(velocity[:, 0], velocity[:, 1]) > _STANDING_MPS
    direction = np.where(moving, np.arctan2(velocity[:, 1], velocity[:, 0]), 0.0)
    order = np.argsort(ids, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(ids[order])) + 1):
        known = np.flatnonzero(moving[rows])
        if len(known):
            last = np.searchsorted(known, np.arange(len(rows)), side="right") - 1
            direction[rows] = direction[rows[known[np.maximum(last, 0)]]]
    return direction


_GROUND_RADIUS_M = 25.0  # the ground's height is estimated from the boxes within this distance,
_MIN_GROUND_BOXES = 20  # and from at least this many
_PERIOD_NS = 100_000_000  # of a scene with a single frame
_MAX_SHEAR = 1e-3  # of a rotation matrix, per element of its product with its transpose


#: Its former name, which scenes of users import.
Boxes = SceneBoxes


@dataclass(frozen=True, eq=False)
class AgentPath:
    """An agent, its path, and what it sees.

    agent:    name, kind, object and sensors
    position: (F, 3) m, world frame; rotation: (F, 3, 3) active, agent to world
    velocity: (F, 3) m/s, world frame; None: that of its object, otherwise computed from the positions
    points:   (N,) lidar returns of each box, in the order of the boxes; None: by ray casting
    ground:   (F,) m, z of the ground below the agent; None: the bottom of its own box, otherwise of boxes around it
    measured_ns: (F,) ns, when its sensor measured what the data has in each frame, on the clock of the frames' times;
              None: at the frames' times
    """

    agent: SceneAgent
    position: Floats
    rotation: Floats
    velocity: Floats | None = None
    points: NDArray[np.int32] | None = None
    ground: Floats | None = None
    measured_ns: Ints | None = None


#: Detections of a recording: its columns `detections`, `detection_start` and `detection_truth_id`.
DetectionColumns = tuple[Detections, Ints, Ints]


def assemble(
    name: str,
    times_ns: Ints,
    boxes: SceneBoxes,
    paths: Sequence[AgentPath],
    detected: Detector | DetectionColumns,
    *,
    seed: int,
    frames: int | None = None,
    buildings: tuple[Floats, ...] = (),
    building_height: Floats | None = None,
    sensors: SensorsByAgent | None = None,
) -> Recording:
    """The recording of a scene.

    times_ns: (F,) ns, ascending; of all frames of the boxes and paths
    paths:    the ego's first
    detected: the model that generates detections, or detections of the first `frames` frames
    frames:   how many frames to keep, the first ones; None: all. Velocities are computed from all.
    buildings, building_height: as in `Recording`
    sensors: of agents, by name or pattern; the others have those of their paths; detections of a model only

    Raises SceneError for boxes or paths that cannot be, and ConfigurationError for more frames than there are.
    """
    total = len(times_ns)
    kept = total if frames is None else frames
    if not 1 <= kept <= total:
        raise ConfigurationError(f"{name}: {kept} frames requested, the scene has {total}")
    check_times(name, times_ns)
    boxes.validate(name, total)
    order = np.lexsort((boxes.id, boxes.frame))
    order = order[boxes.frame[order] < kept]
    _check(name, times_ns, boxes, paths)
    world = _world(name, times_ns, boxes, kept, order)
    agents, rigs = tuple(path.agent for path in paths), _rigs(times_ns, paths, kept)
    if sensors:
        agents, rigs = equip(name, agents, sensors, world.times_ns, world.period_ns)
    world = replace(
        world,
        agents=agents,
        rigs=rigs,
        agent_position=np.stack([path.position[:kept] for path in paths], axis=1),
        agent_rotation=np.stack([path.rotation[:kept] for path in paths], axis=1),
        agent_velocity=np.stack([_velocity(path, world, times_ns) for path in paths], axis=1),
        buildings=buildings,
        building_height=np.zeros(0) if building_height is None else building_height,
    )
    cast = [column for column, path in enumerate(paths) if path.points is None]
    points = lidar_visibility(world, cast) if cast else np.zeros((len(order), len(paths)), np.int32)
    for column, path in enumerate(paths):
        if path.points is not None:
            points[:, column] = path.points[order]
    if not isinstance(detected, Detector):
        return make_recording(world, points, *detected)
    ground = np.stack([_ground(path, boxes, kept) for path in paths], axis=1)
    recorded = [column for column, path in enumerate(paths) if path.points is not None]
    return make_recording(world, points, *detect(world, points, detected, seed, ground, recorded))


def _rigs(times_ns: Ints, paths: Sequence[AgentPath], kept: int) -> tuple[Rig, ...]:
    """What the sensors of the paths do: those with times of their own have measured at these."""
    start, rigs = times_ns[0], []
    for path in paths:
        of_frames = None if path.measured_ns is None else path.measured_ns - start
        if of_frames is None:
            rigs += [Rig()] * len(path.agent.sensors)
            continue
        schedule = SensorSchedule.recorded(times_ns - start, of_frames, np.arange(len(times_ns)))
        rigs.append(Rig(schedule.before(kept)))
    return tuple(rigs)


def _world(name: str, times_ns: Ints, boxes: SceneBoxes, kept: int, order: NDArray[np.intp]) -> World:
    """The kept frames without agents. order: rows of the boxes that are kept, by frame and id."""
    by_time = np.argsort(boxes.frame, kind="stable")
    velocity = np.empty_like(boxes.velocity)
    velocity[by_time] = fill_velocity(
        boxes.id[by_time], boxes.position[by_time], boxes.velocity[by_time], times_ns[boxes.frame[by_time]]
    )
    names = ("id", "position", "size", "yaw", "class_id")
    columns = {column: getattr(boxes, column)[order] for column in names} | {"velocity": velocity[order]}
    return World(
        name=name,
        agents=(),
        period_ns=int(np.median(np.diff(times_ns))) if len(times_ns) > 1 else _PERIOD_NS,
        times_ns=times_ns[:kept] - times_ns[0],
        truth=truth_states(columns),
        truth_start=np.searchsorted(boxes.frame[order], np.arange(kept + 1)).astype(np.int64),
        agent_position=np.zeros((kept, 0, 3)),
        agent_rotation=np.zeros((kept, 0, 3, 3)),
        agent_velocity=np.zeros((kept, 0, 3)),
    )


def _check(name: str, times_ns: Ints, boxes: SceneBoxes, paths: Sequence[AgentPath]) -> None:
    """Raise SceneError for agents that do not fit the boxes, or poses that are none."""
    frames = len(times_ns)
    if not paths:
        raise SceneError(f"{name}: found no agents, expected the ego at least")
    for path in paths:
        place = f"{name}: agent {path.agent.name}"
        expected = {"position": (frames, 3), "rotation": (frames, 3, 3), "velocity": (frames, 3)}
        expected |= {"points": (len(boxes),), "ground": (frames,)}
        for column, shape in expected.items():
            values = getattr(path, column)
            if values is not None and values.shape != shape:
                raise SceneError(f"{place}: {column} has shape {values.shape}, expected {shape}")
            if values is not None and not np.isfinite(values).all():
                raise SceneError(f"{place}: {column} contains a number that is not finite")
        shear = np.abs(path.rotation @ np.swapaxes(path.rotation, 1, 2) - np.eye(3)).max(axis=(1, 2))
        invalid = (shear > _MAX_SHEAR) | (np.linalg.det(path.rotation) < 0)
        if invalid.any():
            frame = int(np.flatnonzero(invalid)[0])
            found = np.round(path.rotation[frame], 3).tolist()
            raise SceneError(
                f"{place}: frame {frame}: rotation is {found}, expected an orthonormal right-handed matrix"
            )
        if path.points is not None and len(boxes) and path.points.min() < 0:
            raise SceneError(f"{place}: points has a number below 0, expected counts of lidar returns")
        if path.agent.object_id >= 0:
            missing = np.setdiff1d(np.arange(frames), boxes.frame[boxes.id == path.agent.object_id])
            if len(missing):
                raise SceneError(
                    f"{place}: frame {missing[0]} has no box of its object {path.agent.object_id}, "
                    "expected one in every frame"
                )


def _velocity(path: AgentPath, world: World, times_ns: Ints) -> Floats:
    """(F, 3) m/s of an agent in the frames of the world."""
    frames = len(world.times_ns)
    if path.velocity is not None:
        return path.velocity[:frames]
    if path.agent.object_id >= 0:
        own: Floats = world.truth.velocity[world.truth.id == path.agent.object_id]
        return own
    unknown = np.full_like(path.position, np.nan)
    return fill_velocity(np.zeros(len(times_ns), np.int64), path.position, unknown, times_ns)[:frames]


def _ground(path: AgentPath, boxes: SceneBoxes, frames: int) -> Floats:
    """(frames,) m, z of the ground below an agent."""
    if path.ground is not None:
        return path.ground[:frames]
    if path.agent.object_id >= 0:
        own = boxes.rows_of(path.agent.object_id)[:frames]
        bottom: Floats = boxes.position[own, 2] - boxes.size[own, 2] / 2
        return bottom
    still = bool((path.position == path.position[0]).all())
    levels = [ground_level(boxes, position[:2]) for position in path.position[: 1 if still else frames]]
    return np.resize(levels, frames)


def ground_level(boxes: SceneBoxes, position: Floats) -> float:
    """Height m of the ground at `position` (2,): the median bottom of the boxes nearby, in all frames.

    If there are too few, the nearest boxes are used; without any, 0.
    """
    if not len(boxes):
        return 0.0
    distance = np.hypot(*(boxes.position[:, :2] - position).T)
    radius = max(_GROUND_RADIUS_M, np.sort(distance)[:_MIN_GROUND_BOXES][-1])
    near = distance <= radius
    return float(np.median(boxes.position[near, 2] - boxes.size[near, 2] / 2))


MAX_POLES = 16
POLE_HEIGHT_M = 15.0
POLE_PITCH_DEG = 30.0
_MIN_LIDAR_HEIGHT_M = 1.8  # above the underside of a vehicle,
_ABOVE_ROOF_M = 0.2  # or above its roof, whichever is higher
_POLE_OFFSET_M = 16.0  # from the route
_ROUTE_EXTENSION_M = 20.0  # by which the route is extended at both ends
#: Classes of objects that can be vehicles with a lidar.
VEHICLE_CLASSES = [CLASS_INDEX[name] for name in ("car", "truck", "bus")]


def roof_sensors(height: float) -> tuple[LidarSensor, Camera]:
    """The lidar and the camera of a vehicle of a height m."""
    mount = np.array([0.0, 0.0, max(_MIN_LIDAR_HEIGHT_M, height + _ABOVE_ROOF_M)])
    return LidarSensor(mount_position=mount), Camera(mount_position=mount - [0.0, 0.0, _ABOVE_ROOF_M])


def vehicle(name: str, boxes: SceneBoxes, object_id: int) -> AgentPath:
    """A car of the traffic as an agent; its origin is the middle of its underside.

    object_id: with a box in every frame
    """
    own = boxes.rows_of(object_id)
    height = boxes.size[own, 2]
    lidar, camera = roof_sensors(float(height.max()))
    return AgentPath(
        SceneAgent(name, "mobile", object_id, lidar, camera),
        boxes.position[own] - np.stack([np.zeros(len(own)), np.zeros(len(own)), height / 2], axis=1),
        np.stack([rotation_from_yaw(float(yaw)) for yaw in boxes.yaw[own]]),
    )


def vehicles_throughout(boxes: SceneBoxes, frames: int) -> Ints:
    """Ids of the cars, trucks and buses that have a box in each of the frames, ascending."""
    ids, count = np.unique(boxes.id[np.isin(boxes.class_id, VEHICLE_CLASSES)], return_counts=True)
    throughout: Ints = ids[count == frames]
    return throughout


def poles(boxes: SceneBoxes, route: Floats, yaw: Floats, count: int) -> list[AgentPath]:
    """Poles 15 m above the ground on both sides of a route; they look 30 degrees down to its middle.

    route: (F, 2) m, and yaw: (F,) rad along it. The k-th pole does not depend on the number of poles.
    """
    extension = np.stack([np.cos(yaw), np.sin(yaw)], axis=1) * _ROUTE_EXTENSION_M
    path = np.concatenate([[route[0] - extension[0]], route, [route[-1] + extension[-1]]])
    step = np.hypot(*np.diff(path, axis=0).T)
    distance = np.concatenate([[0.0], np.cumsum(step)])

    def at(fraction: float) -> Floats:
        return np.array([np.interp(fraction * distance[-1], distance, path[:, k]) for k in (0, 1)])

    placed = []
    for k in range(count):
        fraction = 0.1 + 0.8 * _van_der_corput(k)
        direction = at(fraction + 0.02) - at(fraction - 0.02)
        offset = np.array([-direction[1], direction[0]]) / np.hypot(*direction) * _POLE_OFFSET_M
        position = at(fraction) + (offset if k % 2 == 0 else -offset)
        facing = at(0.5) - position
        placed.append(pole(f"infra_{k + 1}", boxes, position, np.arctan2(facing[1], facing[0]), len(route)))
    return placed


def pole(name: str, boxes: SceneBoxes, position: Floats, yaw: float, frames: int) -> AgentPath:
    """A pole at `position` (2,) m, 15 m above the ground; its lidar looks 30 degrees down.

    yaw: rad, where it looks
    """
    ground = ground_level(boxes, position)
    rotation = rotation_from_yaw_pitch(float(yaw), np.radians(POLE_PITCH_DEG))
    place = np.array([*position, ground + POLE_HEIGHT_M])
    path = standing(name, LidarSensor.infrastructure(), place, rotation, frames)
    return replace(path, ground=np.full(frames, ground))


def standing(name: str, sensor: LidarSensor, position: Floats, rotation: Floats, frames: int) -> AgentPath:
    """An agent that never moves, whose origin is its sensor. position: (3,) m; rotation: (3, 3)"""
    return AgentPath(
        SceneAgent(name, "static", -1, sensor, Camera(mount_position=np.zeros(3))),
        np.tile(position, (frames, 1)),
        np.tile(rotation, (frames, 1, 1)),
        velocity=np.zeros((frames, 3)),
    )


def _van_der_corput(k: int) -> float:
    """The k-th term of 0, 1, 1/2, 1/4, 3/4, …: a sequence that fills 0 to 1 evenly."""
    if k < 2:
        return float(k)
    level = 1 << ((k - 1).bit_length() - 1)
    return (2 * (k - 1 - level) + 1) / (2 * level)

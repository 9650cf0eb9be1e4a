"""Simulates what the agents of a scene see and detect."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import quaternion_from_rotation, rotation_from_quaternion, wrap_angle
from mast_zenoh.arrays.states import Detections, Floats, Ints, ObjectStates
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.making.sensor_types import Rig
from mast_zenoh.scenes.recording import NO_MEASUREMENT, Measurements, Recording, SceneAgent
from mast_zenoh.sensing import Detector, LidarSensor, Walls, lidar_points, sensor_pose
from mast_zenoh.sensing.raycast import SweepRays
from mast_zenoh.streams import stream


def objects_between(
    objects: ObjectStates, neighbours: ObjectStates | None, span_s: float, share: float
) -> ObjectStates:
    """The n objects of a frame, at a time between it and a neighbouring frame.

    neighbours: the objects of that frame; None: there is none. span_s: s from the frame to its neighbour, negative to
    an earlier one; share: 0 to 1, of the way to the neighbour.

    Positions follow a cubic Hermite spline, which keeps positions and velocities of both frames. An object without a
    neighbour moves at constant velocity. Velocities stay those of the frame.
    """
    position, yaw = objects.position + objects.velocity * (share * span_s), objects.yaw.copy()
    if neighbours is not None and len(neighbours):
        order = np.argsort(neighbours.id, kind="stable")
        row = order[np.minimum(np.searchsorted(neighbours.id[order], objects.id), len(order) - 1)]
        known = neighbours.id[row] == objects.id
        row = row[known]
        ends = objects.position[known], neighbours.position[row]
        speeds = objects.velocity[known], neighbours.velocity[row]
        position[known] = hermite(ends, speeds, span_s, share)
        yaw[known] += share * wrap_angle(neighbours.yaw[row] - yaw[known])
    return objects.with_(position=position, yaw=wrap_angle(yaw))


def hermite(ends: tuple[Floats, Floats], speeds: tuple[Floats, Floats], span_s: float, share: float) -> Floats:
    """Positions (..., 3) m at a `share` of a cubic spline of `span_s` s between `ends` with velocities `speeds`."""
    t, u = share, 1.0 - share
    along = (1.0 + 2.0 * t) * u * u * ends[0] + t * t * (3.0 - 2.0 * t) * ends[1]
    return np.asarray(along + span_s * (t * u * u * speeds[0] - t * t * u * speeds[1]))


def rotation_between(first: Floats, second: Floats, share: float) -> Floats:
    """The rotation (3, 3) at a share of the way between two that are close to each other."""
    start, end = quaternion_from_rotation(first), quaternion_from_rotation(second)
    end = end if start @ end >= 0.0 else -end
    return np.asarray(rotation_from_quaternion((1.0 - share) * start + share * end))


@dataclass(frozen=True, eq=False)
class World:
    """A scene without visibility and detections; the fields are the same as in `Recording`.

    The rows of each frame are in the order of their ids.
    rigs: of each of the S sensors; empty: each measures in every frame, at its time
    """

    name: str
    agents: tuple[SceneAgent, ...]
    period_ns: int
    times_ns: Ints
    truth: ObjectStates
    truth_start: Ints
    agent_position: Floats
    agent_rotation: Floats
    agent_velocity: Floats
    buildings: tuple[Floats, ...] = ()
    building_height: Floats = field(default_factory=lambda: np.zeros(0))
    rigs: tuple[Rig, ...] = ()

    def rows(self, frame: int) -> slice:
        """The truth rows of a frame."""
        return slice(int(self.truth_start[frame]), int(self.truth_start[frame + 1]))

    def sensors(self) -> Iterator[tuple[int, int, Rig]]:
        """(row of its agent, row among the agent's sensors, rig) of each of the S sensors."""
        rigs = iter(self.rigs)
        for agent, described in enumerate(self.agents):
            for sensor in range(len(described.sensors)):
                yield agent, sensor, next(rigs, Rig())

    def moment(self, agent: int, rig: Rig, frame: int) -> MeasuredWorld | None:
        """What the sensor of a rig measures that is new in a frame; None: nothing is."""
        schedule = rig.schedule
        if schedule is None:
            truth = self.truth.select(self.rows(frame))
            return MeasuredWorld(frame, 0, truth, self.agent_position[frame, agent], self.agent_rotation[frame, agent])
        source = int(schedule.source[frame])
        if source < 0:
            return None
        age_ns = int(self.times_ns[frame] - schedule.time_ns[frame])
        since_ns = int(schedule.time_ns[frame] - self.times_ns[source])
        truth, other = self.truth.select(self.rows(source)), source + (1 if since_ns > 0 else -1)
        position, rotation = self.agent_position[source, agent], self.agent_rotation[source, agent]
        if since_ns == 0:
            return MeasuredWorld(source, age_ns, truth, position, rotation)
        known = 0 <= other < len(self.times_ns)
        span_ns = int(self.times_ns[other] - self.times_ns[source]) if known else since_ns
        span_s, share = span_ns * 1e-9, since_ns / span_ns
        neighbours = self.truth.select(self.rows(other)) if known else None
        truth = objects_between(truth, neighbours, span_s, share)
        if known and self.agents[agent].kind == "mobile":  # the pose of a pole is the one recorded with its measurement
            ends = position, self.agent_position[other, agent]
            speeds = self.agent_velocity[source, agent], self.agent_velocity[other, agent]
            position = hermite(ends, speeds, span_s, share)
            rotation = rotation_between(rotation, self.agent_rotation[other, agent], share)
        return MeasuredWorld(source, age_ns, truth, position, rotation)


@dataclass(frozen=True, eq=False)
class MeasuredWorld:
    """The world when a sensor measured.

    source: frame that it was recorded with; age_ns: ns, before the time of the frame in which it is new
    truth: objects of that frame at the time of the measurement
    position: (3,) m, rotation: (3, 3) active: of the agent at that time
    """

    source: int
    age_ns: int
    truth: ObjectStates
    position: Floats
    rotation: Floats


def lidar_visibility(
    world: World, columns: Sequence[int] | None = None, walls: Walls | None = None
) -> NDArray[np.int32]:
    """Lidar returns (N, A) of each truth row at each agent's first sensor, by ray casting.

    columns: the agents to compute; None: all; walls: of the world's buildings; None: they are computed
    """
    points = np.zeros((len(world.truth), len(world.agents)), np.int32)
    walls = Walls.of_buildings(world.buildings, world.building_height) if walls is None else walls
    for frame in range(len(world.times_ns)):
        for column in range(len(world.agents)) if columns is None else columns:
            moment = world.moment(column, Rig(), frame)
            assert moment is not None
            points[world.rows(frame), column] = _returns(world, column, world.agents[column].sensor, moment, walls)
    return points


def _returns(world: World, agent: int, lidar: LidarSensor, moment: MeasuredWorld, walls: Walls) -> NDArray[np.int32]:
    """(n,) lidar returns of the objects of a moment at a sensor of an agent."""
    truth = moment.truth
    own = np.flatnonzero((truth.id == world.agents[agent].object_id) & (truth.id >= 0))
    pose = sensor_pose(moment.position, moment.rotation, lidar.mount_position, lidar.mount_rotation)
    boxes = truth.position, truth.size, truth.yaw
    return lidar_points(lidar, *pose, *boxes, walls, int(own[0]) if len(own) else -1)


def detect(
    world: World,
    points: NDArray[np.int32],
    detector: Detector,
    seed: int,
    ground: Floats | None = None,
    recorded: Sequence[int] = (),
) -> tuple[Detections, Ints, Ints]:
    """Detect objects in every frame.

    The result is `detections`, `detection_start` and `detection_truth_id`.
    Each (sensor, frame) has its own random stream, so adding an agent does not affect the others.
    points: (N, A) lidar returns at the agents' first sensors, in all frames
    ground: (F, A) m, z of the ground at each agent; None: 0.
    recorded: agents whose lidar returns the data gives: they count for measurements between frames, too
    """
    detection = FrameDetection(world, detector, seed)
    batches: list[Detections] = []
    ids: list[Ints] = []
    for frame in range(len(world.times_ns)):
        for detections, truth_id in detection.of(world, frame, points, ground, recorded):
            batches.append(detections)
            ids.append(truth_id)
    return Detections.joined(batches), np.cumsum([0, *map(len, ids)]), np.concatenate(ids)


class FrameDetection:
    """Detects objects frame by frame; errors of a sensor that last go on from one frame to the next.

    world: its agents, sensors and buildings; detector: of sensors without one of their own; seed: of the run
    """

    def __init__(self, world: World, detector: Detector, seed: int) -> None:
        self.walls = Walls.of_buildings(world.buildings, world.building_height)
        self._seed = seed
        self._sensors = [
            (agent, sensor, rig, (rig.detector or detector).begin(world.agents[agent].name, described.name, period_s))
            for agent, sensor, rig in world.sensors()
            for described in [world.agents[agent].sensors[sensor]]
            for period_s in [_period_s(world, rig)]
        ]

    def of(
        self,
        world: World,
        frame: int,
        points: NDArray[np.int32],
        ground: Floats | None = None,
        recorded: Sequence[int] = (),
        number: int | None = None,
    ) -> Iterator[tuple[Detections, Ints]]:
        """Yield the detections of each sensor in a frame, and the truth ids (n,) of these, -1 for clutter.

        world: with at least this frame; number: of the frame in the run, None: `frame`; the others as for `detect`
        """
        number = frame if number is None else number
        for agent, sensor, rig, own_detector in self._sensors:
            moment = world.moment(agent, rig, frame)
            if moment is None:
                yield Detections.empty(), np.zeros(0, np.int64)
                continue
            described = world.agents[agent]
            lidar = described.sensors[sensor].lidar
            at_frame = moment.age_ns == 0 and moment.source == frame
            if sensor == 0 and (at_frame or agent in recorded):
                returns = points[world.rows(moment.source), agent]
            else:
                returns = _returns(world, agent, lidar, moment, self.walls)
            found, ids = own_detector.detect(
                moment.truth,
                returns,
                lidar,
                *sensor_pose(moment.position, moment.rotation, lidar.mount_position, lidar.mount_rotation),
                0.0 if ground is None else float(ground[frame, agent]),
                stream(
                    self._seed,
                    "detector",
                    described.name,
                    number,
                    *([described.sensors[sensor].name] if sensor else []),
                ),
            )
            if problem := _problem(found, ids):
                where = f"{type(own_detector).__name__}, {described.sensors[sensor].name} of {described.name}"
                raise SceneError(f"{where}, frame {number}: {problem}")
            yield found, ids


def _problem(found: Detections, ids: Ints) -> str:
    """What is wrong with the detections of a sensor and their ids (n,); empty: nothing."""
    if len(found) != len(ids):
        return f"{len(found)} detections and {len(ids)} ids of objects, expected equal numbers"
    if len(found) and not 0.0 <= found.score.min() <= found.score.max() <= 1.0:
        return f"score {found.score.min():g} to {found.score.max():g}, expected 0 to 1"
    return ""


def _period_s(world: World, rig: Rig) -> float:
    """s, between two measurements of a sensor, usually."""
    measured = world.times_ns if rig.schedule is None else rig.schedule.time_ns[rig.schedule.source >= 0]
    if rig.schedule is None or len(measured) < 2:
        return world.period_ns * 1e-9
    return float(np.median(np.diff(measured))) * 1e-9


def _measurements(world: World) -> Measurements | None:
    """When the sensors measured; None: all in every frame, at its time."""
    sensors = list(world.sensors())
    if all(rig.schedule is None for _, _, rig in sensors):
        return None
    frames = range(len(world.times_ns))
    moments = [[world.moment(agent, rig, frame) for agent, _, rig in sensors] for frame in frames]
    agents = np.array([agent for agent, _, _ in sensors])
    age = np.array([[NO_MEASUREMENT if each is None else each.age_ns for each in row] for row in moments], np.int64)
    position, rotation = world.agent_position[:, agents].copy(), world.agent_rotation[:, agents].copy()
    for frame, row in enumerate(moments):
        for column, moment in enumerate(row):
            if moment is not None:
                position[frame, column], rotation[frame, column] = moment.position, moment.rotation
    return Measurements(age, position, rotation)


def most_seen(world: World, points: NDArray[np.int32], walls: Walls | None = None) -> NDArray[np.int32]:
    """Lidar returns (N, A) at the agents: the most that one of their sensors has at the times of the frames."""
    walls = Walls.of_buildings(world.buildings, world.building_height) if walls is None else walls
    for agent, sensor, _ in world.sensors():
        for frame in range(len(world.times_ns)) if sensor else ():
            moment = world.moment(agent, Rig(), frame)
            assert moment is not None
            lidar, rows = world.agents[agent].sensors[sensor].lidar, world.rows(frame)
            points[rows, agent] = np.maximum(points[rows, agent], _returns(world, agent, lidar, moment, walls))
    return points


def make_recording(
    world: World, points: NDArray[np.int32], detections: Detections, detection_start: Ints, detection_truth_id: Ints
) -> Recording:
    """The finished, validated recording. points: (N, A) lidar returns at the agents' first sensors"""
    recording = Recording(
        name=world.name,
        agents=world.agents,
        period_ns=world.period_ns,
        times_ns=world.times_ns,
        truth=world.truth,
        truth_start=world.truth_start,
        points=most_seen(world, points),
        agent_position=world.agent_position,
        agent_rotation=world.agent_rotation,
        agent_velocity=world.agent_velocity,
        detections=detections,
        detection_start=detection_start,
        detection_truth_id=detection_truth_id,
        buildings=world.buildings,
        building_height=world.building_height,
        measurements=_measurements(world),
    )
    recording.validate()
    return recording


def with_sweeps(recording: Recording) -> Recording:
    """The recording with `sweeps`; unchanged for a scene without buildings.

    Without buildings nobody knows what stands beside the road, and so not what is free.
    """
    if not recording.buildings:
        return recording
    return replace(recording, sweeps=tuple(_sweeps(recording, agent) for agent in range(len(recording.agents))))


def _sweeps(recording: Recording, agent: int) -> NDArray[np.float32]:
    """(F, bands, sectors) float32, m, of one agent."""
    walls = Walls.of_buildings(recording.buildings, recording.building_height)
    caster = SweepCaster(recording.agents[agent], walls)
    poses = recording.agent_position[:, agent], recording.agent_rotation[:, agent]
    return np.stack([caster.sweep(recording.truth_at(k), *pose) for k, pose in enumerate(zip(*poses, strict=True))])


class SweepCaster:
    """How far an agent's first sensor sees in each direction, frame by frame."""

    def __init__(self, agent: SceneAgent, walls: Walls) -> None:
        self._agent, self._walls = agent, walls
        self._rays = SweepRays.of(agent.sensor)
        self._background, self._last_pose = np.zeros(0), b""

    def sweep(self, truth: ObjectStates, position: Floats, rotation: Floats) -> NDArray[np.float32]:
        """(bands, sectors) m that each direction is free. position (3,) m, rotation (3, 3): of the agent"""
        agent = self._agent
        mount = agent.sensor.mount_position, agent.sensor.mount_rotation
        position, rotation = sensor_pose(position, rotation, *mount)
        pose = position.tobytes() + rotation.tobytes()
        if pose != self._last_pose:  # that of a pole never changes
            self._background, self._last_pose = self._rays.background(position, rotation, self._walls), pose
        own = np.flatnonzero((truth.id == agent.object_id) & (truth.id >= 0))
        boxes = truth.position, truth.size, truth.yaw
        free = self._rays.sweep(self._background, position, rotation, boxes, int(own[0]) if len(own) else -1)
        return np.asarray(free, np.float32)

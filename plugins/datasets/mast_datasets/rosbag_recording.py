"""Makes a recording of a ROS 2 bag from its poses, objects and detections: frames, boxes, and when sensors measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mast_datasets.rosbag import AgentEntry, BagMap, Body, FramePose, RosBag, TopicSource
from mast_datasets.rosbag_points import read_scans
from mast_datasets.rosbag_reading import (
    DetectionReader,
    ObjectReader,
    PoseReader,
    PosesAt,
    PoseTrack,
    ScanReader,
    SensorMeasurements,
    TopicReader,
    TrueObject,
)
from mast_datasets.rosbag_storage import Bag
from mast_datasets.traffic import MAX_BOXES
from mast_zenoh.arrays.geometry import heading, to_local, to_world, wrap_angle
from mast_zenoh.arrays.states import CLASS_INDEX, Detections, Floats, Ints
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.making.assembly import AgentPath, SceneBoxes, assemble
from mast_zenoh.scenes.making.sensor_types import SensorSchedule
from mast_zenoh.scenes.recorded_scans import RecordedScans
from mast_zenoh.scenes.recording import NO_MEASUREMENT, Measurements, Recording, SceneAgent
from mast_zenoh.sensing import Camera, LidarSensor, Points, sensor_pose, to_sensor

_MAX_FRAMES = 200_000
_LEVEL = 1e-3  # cosine of the tilt of a sensor that looks straight down or up: yaws about its axis say nothing
_CAMERA = Camera(mount_position=np.zeros(3))


class _DetectionRows(NamedTuple):
    """Detections of one sensor in all frames: each with its frame (n,) and truth id (n,)."""

    frame: Ints
    detections: Detections
    truth_id: Ints


class BagScene:
    """What was read of a bag, on the frames of a scene.

    notes: what is left out, and what is not of the bag, in sentences

    Raises SceneError and ConfigurationError, as `Scene.record` does.
    """

    def __init__(
        self, scene: RosBag, path: Path, bag_map: BagMap, readers: Mapping[TopicSource, TopicReader[Any]]
    ) -> None:
        self._path, self._detector, self._map = path, scene.detector, bag_map
        self._tracks: dict[TopicSource, PoseTrack] = {}
        self._measured: dict[TopicSource, SensorMeasurements] = {}
        self._lists: dict[TopicSource, list[TrueObject]] = {}
        self._scans: dict[TopicSource, Ints] = {}  # ns, of each message
        notes: dict[str, None] = {}  # one of a topic that several agents are on
        for source, reader in readers.items():
            if isinstance(reader, PoseReader):
                self._tracks[source] = reader.track(bag_map.max_gap_ns)
            elif isinstance(reader, DetectionReader):
                self._measured[source] = reader.measured()
            elif isinstance(reader, ObjectReader):
                self._lists[source] = reader.objects()
            elif isinstance(reader, ScanReader):
                self._scans[source] = reader.times_ns()
            remarks = sorted(reader.remarks.items())
            notes |= {f"{source.topic}: {remark}: {n} in {reader.count} messages": None for remark, n in remarks}
        self.notes = list(notes)
        agents: dict[str, AgentEntry] = bag_map.agents
        ego, *others = agents
        moving = [ego, *(name for name in others if not agents[name].fixed)]
        playing = scene.playing(moving, [name for name in others if agents[name].fixed], "agents that never move")
        self._agents = {name: agent for name, agent in agents.items() if any(name in names for names in playing)}
        self._times_ns = self._frames(scene.start_s, scene.duration_s)

    def recording(self, seed: int, frames: int | None) -> Recording:
        """The recording of the first `frames` frames; None: of all. seed: of generated detections"""
        boxes, own_ids = self._boxes()
        paths = [self._agent_path(name, agent, own_ids.get(name, -1)) for name, agent in self._agents.items()]
        generated = assemble(self._path.name, self._times_ns, boxes, paths, self._detector, seed=seed, frames=frames)
        return replace(self._with_detections(generated), notes=tuple(self.notes))

    @property
    def has_points(self) -> bool:
        """Whether agents that play have a topic of points."""
        return any(agent.sensors[0].points is not None for agent in self._agents.values())

    def with_points(self, recording: Recording, bag: Bag) -> Recording:
        """The recording with the scan of each frame that is nearest to its time, within half a period.

        Points are where they were seen from the lidar in the frame: the motion of the agent since then is removed.
        """
        count, agents = len(recording), list(self._agents.values())
        times, scans = self._times_ns[:count], {}
        for row, agent in enumerate(agents):
            entry = agent.sensors[0].points
            if entry is None:
                continue
            of_topic = self._scans[entry]
            order = np.argsort(of_topic, kind="stable")
            nearest = order[_nearest(of_topic[order], times)]
            poses = self._poses(agent, of_topic[nearest])
            there = (2 * np.abs(of_topic[nearest] - times) <= self._map.period_ns) & poses.known
            found = read_scans(bag, entry, set(nearest[there].tolist()))
            lidar = recording.agents[row].sensor
            of_agent = []
            for frame in range(count):
                points = found.get(int(nearest[frame]), Points.empty()) if there[frame] else Points.empty()
                then = poses.position[frame], poses.rotation[frame]
                now = recording.agent_position[frame, row], recording.agent_rotation[frame, row]
                if not (np.array_equal(then[0], now[0]) and np.array_equal(then[1], now[1])):
                    mount = lidar.mount_position, lidar.mount_rotation
                    seen = to_world(points.position.astype(np.float64), *sensor_pose(*then, *mount))
                    points = replace(points, position=to_local(seen, *sensor_pose(*now, *mount)).astype(np.float32))
                of_agent.append(points)
            scans[row] = of_agent
            if absent := int((~there).sum()):
                name = recording.sensor_names[recording.column(row)]
                self.notes.append(f"{name}: no points in {absent} of {count} frames: no scan within half a period")
        kept = RecordedScans.of(f"{self._path}: points", count, len(agents), scans)
        return replace(recording, scans=kept, notes=tuple(self.notes))

    def _frames(self, start_s: float, duration_s: float | None) -> Ints:
        """(F,) ns, the times of the frames of a part of the time in which all agents of the map have a pose."""
        agents = self._map.agents.items()
        moving = {name: self._tracks[agent.pose].times_ns for name, agent in agents if not agent.fixed}
        times = moving or self._times_of_data()
        begins, ends = ({name: int(each[end]) for name, each in times.items()} for end in (0, -1))
        latest, earliest = max(begins, key=begins.__getitem__), min(ends, key=ends.__getitem__)
        first, last = (begins[latest], ends[earliest]) if moving else (min(begins.values()), max(ends.values()))
        if first > last:
            raise SceneError(
                f"{self._path}: the poses of {earliest} end {(first - last) / 1e9:.3f} s before those of {latest} "
                "begin, expected a time at which all agents have one; `offset_s` and `time` of the map align clocks"
            )
        for what, who, gap_ns, when in (
            ("begin", latest, first - min(begins.values()), "after"),
            ("end", earliest, max(ends.values()) - last, "before"),
        ):
            if gap_ns > self._map.period_ns:
                self.notes.append(f"frames {what} with the poses of {who}, {gap_ns / 1e9:.3f} s {when} those of others")
        if start_s > (last - first) / 1e9:
            raise ConfigurationError(f"{self._path}: start_s is {start_s:g}, expected 0 to {(last - first) / 1e9:g}")
        begin = first + round(start_s * 1e9)
        if duration_s is not None and duration_s <= (last - begin) / 1e9:
            last = begin + round(duration_s * 1e9)
        count = (last - begin) // self._map.period_ns + 1
        if count > _MAX_FRAMES:
            raise SceneError(
                f"{self._path}: found {count} frames from {begin} to {last} ns, expected at most {_MAX_FRAMES}; "
                "choose a part by start_s and duration_s, or other times by `time` of the map"
            )
        return begin + np.arange(count, dtype=np.int64) * self._map.period_ns

    def _times_of_data(self) -> dict[str, Ints]:
        """Times of measurements and of the truth, for a scene in which no agent moves."""
        objects = [each.poses for listed in self._lists.values() for each in listed]
        times = [each.times_ns for each in (*objects, *self._tracks.values())]
        times += [each.times_ns for each in self._measured.values()]
        if not times:
            raise ConfigurationError(f"{self._path}: the map has no topics, expected one, for the times of frames")
        return {str(row): each for row, each in enumerate(times)}

    def _poses(self, agent: AgentEntry, times_ns: Ints) -> PosesAt:
        """Poses of an agent at times (n,)."""
        if not agent.fixed:
            return self._tracks[agent.pose].at(times_ns, self._map.max_gap_ns)
        count, entry = len(times_ns), agent.pose
        pose = FramePose(position=entry.position, yaw_deg=entry.yaw_deg, pitch_deg=entry.pitch_deg)
        return PosesAt(np.tile(pose.origin, (count, 1)), np.tile(pose.rotation, (count, 1, 1)), np.ones(count, bool))

    def _agent_path(self, name: str, agent: AgentEntry, object_id: int) -> AgentPath:
        poses = self._poses(agent, self._times_ns)
        if not poses.known.all():
            time, times = int(self._times_ns[poses.known.argmin()]), self._tracks[agent.pose].times_ns
            after = int(np.searchsorted(times, time))
            gap_s, at_s = (times[after] - times[after - 1]) / 1e9, (time - self._times_ns[0]) / 1e9
            raise SceneError(
                f"{self._path}: agent {name}: {agent.pose.topic}: found no pose for {gap_s:.3f} s, {at_s:.3f} s "
                f"after the first frame, expected one every {self._map.max_gap_s:g} s (max_gap_s of the map); "
                "start_s and duration_s choose a part"
            )
        sensors = tuple(entry.sensor for entry in agent.sensors)
        kind = "static" if agent.fixed else "mobile"
        described = SceneAgent(name, kind, object_id, sensors[0].lidar, _CAMERA, sensors)
        velocity = np.zeros_like(poses.position) if agent.fixed else None
        return AgentPath(described, poses.position, poses.rotation, velocity)

    def _boxes(self) -> tuple[SceneBoxes, dict[str, int]]:
        """The boxes of all objects in the frames, and by agent the id of its own object."""
        gap_ns, parts, own_ids = self._map.max_gap_ns, [_boxes_of(0, _NO_BODY, _NOWHERE)], {}
        for number, (name, agent) in enumerate(self._map.agents.items(), start=1):
            if agent.body is not None:  # agents that do not play are objects, too
                own_ids[name] = number
                parts.append(self._part(name, number, agent.body, self._poses(agent, self._times_ns)))
        number = len(self._map.agents)
        for name, entry in self._map.truth.items():
            if entry.body is not None:
                number += 1
                parts.append(self._part(name, number, entry.body, self._tracks[entry].at(self._times_ns, gap_ns)))
                continue
            for each in self._lists[entry]:
                number += 1
                parts.append(self._boxes_of_list(number, each))
        total = sum(map(len, parts))
        if total > MAX_BOXES:
            raise SceneError(f"{self._path}: found {total} boxes in all frames, expected at most {MAX_BOXES}")
        return SceneBoxes.concatenate(parts), own_ids

    def _part(self, name: str, number: int, body: Body, poses: PosesAt) -> SceneBoxes:
        """The boxes of an object with a body; frames without one are noted."""
        if absent := int((~poses.known).sum()):
            frames = len(poses.known)
            self.notes.append(f"{name}: not there in {absent} of {frames} frames, which have no pose of it")
        return _boxes_of(number, body, poses)

    def _boxes_of_list(self, number: int, tracked: TrueObject) -> SceneBoxes:
        """The boxes of an object of a list in the frames in which its pose is known."""
        times = tracked.poses.times_ns
        first = int(np.searchsorted(self._times_ns, times[0]))
        within = self._times_ns[first : np.searchsorted(self._times_ns, times[-1], side="right")]
        poses = tracked.poses.at(within, self._map.max_gap_ns)
        row = np.searchsorted(times, within, side="right") - 1
        boxes = SceneBoxes.throughout(number, poses.position, np.ones(3), heading(poses.rotation), 0)
        boxes = replace(boxes, frame=first + boxes.frame, size=tracked.size[row], class_id=tracked.class_id[row])
        return boxes.select(poses.known)

    def _with_detections(self, recording: Recording) -> Recording:
        """A recording whose sensors with a topic have the detections and the times of the bag, in its frames."""
        frames, start = len(recording), int(self._times_ns[0])
        shape = frames, len(recording.sensor_names)
        age, position, rotation = np.zeros(shape, np.int64), np.empty((*shape, 3)), np.empty((*shape, 3, 3))
        rows: list[_DetectionRows] = []
        generated: list[str] = []
        for agent_row, agent in enumerate(self._agents.values()):
            for sensor_row, entry in enumerate(agent.sensors):
                column = len(rows)
                position[:, column] = recording.agent_position[:, agent_row]
                rotation[:, column] = recording.agent_rotation[:, agent_row]
                name = recording.sensor_names[column]
                if not entry.topic:
                    rows.append(_rows_of(recording, agent_row, sensor_row))
                    generated.append(name)
                    continue
                measured = self._measured[entry]
                poses = self._poses(agent, measured.times_ns)
                usable = np.flatnonzero(poses.known)
                schedule = SensorSchedule.recorded(self._times_ns - start, measured.times_ns[usable] - start, usable)
                self._note_measurements(name, measured, usable, schedule)
                new = np.flatnonzero(schedule.source[:frames] >= 0)
                source = schedule.source[new]
                age[:, column] = NO_MEASUREMENT
                age[new, column] = self._times_ns[new] - measured.times_ns[source]
                position[new, column], rotation[new, column] = poses.position[source], poses.rotation[source]
                rows.append(_measured_rows(measured, source, new, poses, entry.sensor.lidar))
        if generated:
            detector = type(self._detector).__name__
            self.notes.append(f"{', '.join(generated)}: no detections in the bag, those of {detector} instead")
        if len(generated) == len(rows):
            return recording
        detections, starts, truth_id = _joined(rows, frames)
        own = Measurements(age, position, rotation)
        complete = replace(
            recording, detections=detections, detection_start=starts, detection_truth_id=truth_id, measurements=own
        )
        complete.validate()
        return complete

    def _note_measurements(
        self, name: str, measured: SensorMeasurements, usable: Ints, schedule: SensorSchedule
    ) -> None:
        """Say how many measurements are new in no frame, of all frames of the scene."""
        times, frames = measured.times_ns[usable], self._times_ns
        within = int(np.count_nonzero((times >= frames[0]) & (times <= frames[-1])))
        used, total = int(np.count_nonzero(schedule.source >= 0)), len(measured.times_ns)
        for number, why in (
            (total - within, "outside the frames, or without a pose of the agent"),
            (within - used, "with a newer one in the same frame; a higher rate_hz of the map keeps more"),
        ):
            if number:
                self.notes.append(f"{name}: {number} of {total} measurements left out: {why}")


def _nearest(sorted_ns: Ints, times_ns: Ints) -> Ints:
    """(n,) the row of the time in (K,) that is nearest to each of (n,)."""
    after = np.clip(np.searchsorted(sorted_ns, times_ns), 0, len(sorted_ns) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(times_ns - sorted_ns[before] <= np.abs(sorted_ns[after] - times_ns), before, after)


_NO_BODY = Body(size=(1.0, 1.0, 1.0), kind="unknown")
_NOWHERE = PosesAt(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, bool))


def _boxes_of(number: int, body: Body, poses: PosesAt) -> SceneBoxes:
    """The boxes of an object in the frames in which its pose is known."""
    position = poses.position + poses.rotation @ np.array(body.centre)
    size, yaw = np.array(body.size), heading(poses.rotation)
    return SceneBoxes.throughout(number, position, size, yaw, CLASS_INDEX[body.kind]).select(poses.known)


def _rows_of(recording: Recording, agent: int, sensor: int) -> _DetectionRows:
    """The detections of a sensor in a recording."""
    column, sensors = recording.column(agent, sensor), len(recording.sensor_names)
    of_all = np.repeat(np.arange(len(recording) * sensors), np.diff(recording.detection_start))
    rows = np.flatnonzero(of_all % sensors == column)
    return _DetectionRows(
        of_all[rows] // sensors, recording.detections.select(rows), recording.detection_truth_id[rows]
    )


def _measured_rows(
    measured: SensorMeasurements, source: Ints, frame: Ints, poses: PosesAt, lidar: LidarSensor
) -> _DetectionRows:
    """Recorded detections in the frame of their sensor when it measured.

    source: (n,) rows of the measurements; frame: (n,) in which each is new; poses: of the agent at all measurements
    """
    parts = []
    for row in source.tolist():
        detections = measured.detections.select(measured.rows[row])
        pose = sensor_pose(poses.position[row], poses.rotation[row], lidar.mount_position, lidar.mount_rotation)
        if measured.fixed is None:
            parts.append(replace(detections, yaw=_about_vertical(detections.yaw, pose[1])))
            continue
        origin, turn = measured.fixed.origin, measured.fixed.rotation
        in_world = replace(
            detections,
            position=to_world(detections.position, origin, turn),
            yaw=detections.yaw + heading(turn),
            covariance=turn @ detections.covariance @ turn.T,
        )
        parts.append(to_sensor(in_world, *pose))
    frames = np.repeat(frame, [len(part) for part in parts])
    return _DetectionRows(frames, Detections.joined([Detections.empty(), *parts]), np.full(len(frames), -1, np.int64))


def _about_vertical(yaw: Floats, rotation: Floats) -> Floats:
    """Yaws (n,) about the world's vertical, less the sensor's heading, of yaws about the z axis of a tilted sensor.

    rotation: (3, 3) of the sensor. Boxes stand upright in the world: so their directions ahead have no part along it.
    """
    ahead = np.stack([np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))], axis=1)
    if abs(rotation[2, 2]) > _LEVEL:
        ahead[:, 2] = -ahead[:, :2] @ rotation[2, :2] / rotation[2, 2]
    x, y, _ = (ahead @ rotation.T).T
    return wrap_angle(np.arctan2(y, x) - heading(rotation))


def _joined(sensors: list[_DetectionRows], frames: int) -> tuple[Detections, Ints, Ints]:
    """The columns of a recording of the detections of all sensors, in their order."""
    group = np.concatenate([each.frame * len(sensors) + column for column, each in enumerate(sensors)])
    order = np.argsort(group, kind="stable")
    start = np.searchsorted(group[order], np.arange(frames * len(sensors) + 1)).astype(np.int64)
    detections = Detections.joined([Detections.empty(), *[each.detections for each in sensors]]).select(order)
    return detections, start, np.concatenate([each.truth_id for each in sensors])[order]

"""An agent: tracks the detections of its own sensors, and extends its view with the picture.

It has two estimators. The safety-critical one (`tracks`) uses only the agent's own detections and pose; no message
from outside reaches it. The mission-critical one (`mission`) also uses the latest picture that arrived in an earlier
frame: this frame's may arrive before or after it, and the result must not depend on that.
"""

from __future__ import annotations

from collections import deque
from typing import Any, Literal, NamedTuple

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import (
    NO_OFFSET,
    NO_TURN,
    heading,
    quaternion_from_rotation,
    rotation_from_quaternion,
    states_to_local,
    states_to_world,
)
from mast_zenoh.arrays.states import Detections, Floats, ObjectStates
from mast_zenoh.fusion.pipelines import AgentPipeline, OwnSensor, Pose
from mast_zenoh.gather import Gather, LatestBefore
from mast_zenoh.integrity.views import UNKNOWN_SPACE, SweptView, view_columns
from mast_zenoh.mesh.hosting import main
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.sensing import LidarSensor, sensor_pose, to_world
from mast_zenoh.sensing.free_space import swept
from mast_zenoh.sensing.point_detector import PointDetector, detected_or_nothing
from mast_zenoh.tracking.kalman import predicted
from mast_zenoh.v2x.tracks import orientation_of, rotation_of
from mast_zenoh.wiring.model import part_of

#: Frame of reference of states in the world frame.
WORLD = {"origin": NO_OFFSET, "rotation": NO_TURN}


class Measurement(NamedTuple):
    """What a sensor detected at a time, or that nothing arrived from it.

    time_ns: of the measurement; sensor: row of the agent's sensors; mount: of the sensor at that time
    """

    time_ns: int
    sensor: int
    detections: Detections
    mount: Pose


class Perceived(NamedTuple):
    """What an agent perceived in a frame.

    pose: of the agent in the world; mount: of its first sensor
    free: how far that one sees in each direction; None: unknown
    """

    frame: int
    time_ns: int
    pose: Pose
    mount: Pose
    measured: list[Measurement]
    free: Floats | None

    def detections(self) -> Detections:
        """What all sensors have detected, in the world."""
        parts = (to_world(each.detections, *sensor_in_world(self.pose, each.mount)) for each in self.measured)
        return Detections.joined([Detections.empty(), *parts])


class Agent(Node):
    """Tracks objects from its own sensors, and estimates the mission picture.

    pipeline: its stages; lidar: its first sensor; mobile: whether it moves; status_every: frames between two statuses
    acts: whether it acts on a mission estimate; without one, it gets no picture
    picture_age_s: the greatest age of a picture that is used
    unsupported_std_m: m, the greatest standard deviation of the horizontal position of an object in a picture that no
        agent supports; above, it is not used, because the picture itself is about to lose it
    sensors: all of its sensors, if they are several, or measure at times of their own; empty: `lidar`, in every frame
    tracks_from: frame of reference of its published tracks: "world", or "agent": relative to where it is, as V2X
        messages are; with the axes of the world, or those of a vehicle to 0.1 deg, if it is mobile
    detector: finds objects in the points of its only sensor, a lidar; None: it receives detections
    late_frames: frames by which detections may be late: those of a slow detector
    measurement_times: False: treats measurements as made at the time of their frame; only to show the effect
    """

    role = "agent"
    inputs = {
        "clock": "clock",
        "pose": "pose",
        "detections": "detections",
        "points": "points",
        "sweep": "sweep",
        "picture": "picture",
    }
    outputs = {"tracks": "tracks", "view": "view", "mission": "tracks", "status": "status"}
    affects = {
        "detections": {"tracks": 0, "mission": 0, "status": 0},
        "points": {"tracks": 0, "mission": 0, "status": 0},
        "sweep": {"view": 0, "mission": 0},
        "picture": {"mission": 0},
    }

    def __init__(
        self,
        pipeline: AgentPipeline,
        lidar: LidarSensor,
        mobile: bool = False,
        acts: bool = True,
        status_every: int = 10,
        picture_age_s: float = 0.5,
        unsupported_std_m: float = 0.5,
        sensors: tuple[OwnSensor, ...] = (),
        measurement_times: bool = True,
        tracks_from: Literal["world", "agent"] = "world",
        detector: PointDetector | None = None,
        late_frames: int = 0,
    ) -> None:
        check("1 or more", status_every=status_every)
        check("0 or more", picture_age_s=picture_age_s, late_frames=late_frames)
        check("more than 0", unsupported_std_m=unsupported_std_m)
        if detector is not None and len(sensors) > 1:
            raise ValueError(f"detector: found {len(sensors)} sensors, expected one: the lidar that returns its points")
        self.pipeline = pipeline
        self.detector = detector
        self.sensors = sensors
        self.measurement_times = measurement_times
        self.tracks_from = tracks_from
        self.lidars = [lidar, *(sensor.lidar for sensor in sensors[1:])]
        self.members = ["detections", *(f"detections/{sensor.name}" for sensor in sensors[1:])]
        self.mobile = mobile
        sensed = ("points",) if detector is None else ("detections", "sweep")
        self.unused = (*sensed, *(() if acts else ("picture", "mission")))
        self.status_every = status_every
        self.picture_age_ns = round(picture_age_s * 1e9)
        self.unsupported_variance = unsupported_std_m**2
        self.sensed: Gather[str, Received | None] = Gather({"clock", "pose", *self.members})
        self.pictures: LatestBefore[tuple[int, ObjectStates]] = LatestBefore()
        self.last: Pose | None = None
        self.mount = _mount(sensors[0]) if sensors else None  # of the first sensor; otherwise the latest
        self.tracks = ObjectStates.empty()  # of the tracker's last step, at its time:
        self.tracks_ns = 0
        self.newest_ns = 0  # time of the last frame
        self.now_ns = -1  # time of the newest frame
        #: greatest times up to each frame before it: a new measurement was made after the first of them
        self.past_ns = deque([-1] * (late_frames + 1), maxlen=late_frames + 1)
        self.poses: deque[tuple[int, Pose]] = deque(maxlen=late_frames + 1)  # of the latest frames, with their times

    def start(self, context: Context) -> None:
        """Wait for a sweep in each frame, if the sensor sends one, or the agent measures it in points for its view."""
        is_sent = any(source.port == "sweep" for source in context.subscriptions.values())
        if is_sent or (self.detector is not None and context.connected("view")):
            self.sensed.expected.add("sweep")

    def on_clock(self, received: Received, context: Context) -> None:
        """Process frames whose pose or detections are missing with whatever has arrived."""
        for frame, items in self.sensed.expired(received.frame):
            self.perceive(frame, items, context)
        self.past_ns.append(max(self.past_ns[-1], self.now_ns))
        self.now_ns = received.time_ns
        for row, member in enumerate(self.members):
            if not self.due(row, received.frame):
                self.sensed.add(received.frame, member, None)  # nothing to wait for
        self.sense("clock", received, context)

    def on_pose(self, received: Received, context: Context) -> None:
        """The agent's pose."""
        self.sense("pose", received, context)

    def on_detections(self, received: Received, context: Context) -> None:
        """The detections of one of its sensors, with the time of the measurement."""
        part = part_of(received.subject)
        member = f"detections/{part}" if part else "detections"
        if reason := self.refusal(self.members.index(member), received, context):
            context.reject(reason)
            if received.frame == context.frame:
                self.sense(member, None, context)  # the other sensors' data wait for nothing else
        else:
            self.sense(member, received, context)

    def on_points(self, received: Received, context: Context) -> None:
        """The points of its lidar: what it detects in them counts as its detections; nothing if its detector fails.

        Free space is measured in them, too, if others get its view.
        """
        assert self.detector is not None  # otherwise no wire leads here
        if "sweep" in self.sensed.expected:
            free = received.message._replace(body=swept(received.body, self.lidars[0]))
            self.sense("sweep", received._replace(message=free), context)
        columns = detected_or_nothing(self.detector, received.body, context.failed)
        self.on_detections(received._replace(message=received.message._replace(body=columns)), context)

    def on_sweep(self, received: Received, context: Context) -> None:
        """How far its sensor sees in each direction."""
        self.sense("sweep", received, context)

    def on_picture(self, received: Received, context: Context) -> None:
        """Store the picture for the frames after its arrival, however late, without objects about to be lost."""
        objects = ObjectStates.from_columns(received.body)
        supported = received.body["support"] > 0
        if np.count_nonzero(supported) < len(supported):
            variance = objects.covariance[:, 0, 0] + objects.covariance[:, 1, 1]
            objects = objects.select(supported | (variance <= self.unsupported_variance))
        self.pictures.add(context.frame, (received.time_ns, objects), received.frame)

    def sense(self, port: str, received: Received | None, context: Context) -> None:
        """Process a frame once its clock, its pose and all data of its sensors have arrived.

        received: None: of no use, and not to be waited for
        """
        frame = received.frame if received else context.frame
        items = self.sensed.add(frame, port, received)
        if items is not None:
            self.perceive(frame, items, context)

    def perceive(self, frame: int, items: dict[str, Received | None], context: Context) -> None:
        """Publish both estimates of one frame; always one message each, even if empty."""
        items = {port: received for port, received in items.items() if received is not None}
        if not items:
            return  # a refused message without the clock of its frame
        time_ns = items.get("clock", next(iter(items.values()))).time_ns
        if time_ns < self.newest_ns:
            least = f"{self.newest_ns}, the time of the previous frame"
            context.reject(f"old: frame {frame}: time_ns is {time_ns}, expected at least {least}")
            return
        pose = self.last
        if "pose" in items:
            pose = Pose(items["pose"].body["position"], items["pose"].body["rotation"])
        measured, mount = self.measured(frame, time_ns, items)
        if pose is None or mount is None:
            return  # its pose or its sensor's mount has never arrived
        self.last, self.mount, self.newest_ns = pose, mount, time_ns
        self.poses.append((time_ns, pose))
        measured = [self.from_here(each, pose) for each in measured] if self.poses.maxlen != 1 else measured
        free = items["sweep"].body["free"] if "sweep" in items else None
        self.estimate(Perceived(frame, time_ns, pose, mount, measured, free), context)

    def estimate(self, perceived: Perceived, context: Context) -> None:
        """Track what was perceived in a frame, and publish both estimates."""
        tracks = self.track(perceived)
        self.publish_tracks(perceived, tracks, context)
        self.publish_mission(perceived, tracks, context)

    def track(self, perceived: Perceived) -> ObjectStates:
        """The tracks at the time of a frame, in the pipeline's frame of reference."""
        for each in sorted(perceived.measured, key=lambda each: (each.time_ns, each.sensor)):
            probability = self.sensors[each.sensor].detection_probability if self.sensors else None
            of_sensor = self.lidars[each.sensor], *(() if probability is None else (probability,))
            self.tracks, _, _ = self.pipeline.track(
                each.time_ns, each.detections, perceived.pose, each.mount, *of_sensor
            )
            self.tracks_ns = each.time_ns
        return predicted(self.tracks, (perceived.time_ns - self.tracks_ns) * 1e-9)

    def publish_tracks(self, perceived: Perceived, tracks: ObjectStates, context: Context) -> None:
        """Publish the tracks of a frame, and its view.

        tracks: at the time of the frame, in the pipeline's frame of reference
        """
        frame, time_ns, pose, mount, _, free = perceived
        origin, rotation = self.pipeline.reference(pose)
        reference, published = {"origin": origin, "rotation": rotation}, tracks
        if self.tracks_from == "agent":
            turn = NO_TURN
            if self.mobile:
                turn = rotation_of(orientation_of(float(heading(rotation_from_quaternion(pose.quaternion)))))
            published = states_to_local(states_to_world(tracks, origin, rotation), pose.position, turn)
            reference = {"origin": pose.position, "rotation": turn}
        context.publish("tracks", published.columns() | reference, frame=frame, time_ns=time_ns)
        if context.connected("view"):
            view = self.pipeline.view(pose, mount, self.lidars[0])
            swept = UNKNOWN_SPACE if free is None else free
            context.publish("view", view_columns(view, swept), frame=frame, time_ns=time_ns)

    def publish_mission(self, perceived: Perceived, tracks: ObjectStates, context: Context) -> None:
        """Publish the mission estimate of a frame, and its status. tracks: see `publish_tracks`"""
        frame, time_ns, pose, mount, measured, free = perceived
        if context.connected("mission"):
            if free is not None:
                self.pipeline.mission.look(SweptView(self.pipeline.view(pose, mount, self.lidars[0]), free))
            own = states_to_world(tracks, *self.pipeline.reference(pose))
            mission = self.pipeline.mission.estimate(time_ns, own, self.picture_at(frame, time_ns))
            context.publish("mission", mission.columns() | WORLD, frame=frame, time_ns=time_ns)
        if frame % self.status_every == 0:
            status = {
                "mobile": np.array([self.mobile], np.uint8),
                "detections": np.array([sum(len(each.detections) for each in measured)]),
                "tracks": np.array([len(tracks)]),
            }
            context.publish("status", status, frame=frame, time_ns=time_ns)

    def measured(self, frame: int, time_ns: int, items: dict[str, Received]) -> tuple[list[Measurement], Pose | None]:
        """The measurements that are due in a frame, and the mount of the first sensor; None: not known yet.

        From a sensor whose message is missing, nothing was detected at the frame's time.
        """
        measurements, first = [], self.mount
        for row, member in enumerate(self.members):
            if not self.due(row, frame):
                continue
            received, mount = items.get(member), _mount(self.sensors[row]) if self.sensors else first
            detections, measured_ns = Detections.empty(), time_ns
            if received is not None:
                body = received.body
                detections = Detections.from_columns(body)
                if self.measurement_times or not self.sensors:
                    mount = Pose(body["mount_position"], body["mount_rotation"])
                    measured_ns = received.time_ns if self.measurement_times else time_ns
                first = first if self.sensors else mount
            if mount is not None:
                measurements.append(Measurement(measured_ns, row, detections, mount))
        return measurements, first

    def from_here(self, late: Measurement, pose: Pose) -> Measurement:
        """A measurement of an earlier frame, with its sensor's mount as seen from where the agent is now."""
        before = next((known for time_ns, known in self.poses if time_ns == late.time_ns), pose)
        if before is pose:
            return late
        position, rotation = sensor_in_world(before, late.mount)
        here = rotation_from_quaternion(pose.quaternion)
        mount = Pose(here.T @ (position - pose.position), quaternion_from_rotation(here.T @ rotation))
        return late._replace(mount=mount)

    def due(self, row: int, frame: int) -> bool:
        """Whether a sensor sends a measurement in a frame. row: of the sensor"""
        return not self.sensors or self.sensors[row].due(frame)

    def refusal(self, row: int, received: Received, context: Context) -> str:
        """The reason why detections cannot be used, or "". row: of the sensor

        A measurement that is new in a frame was made after the frame before it, and not after the frame.
        """
        frame, time_ns, before, now = received.frame, received.time_ns, self.past_ns[0], self.now_ns
        if frame > context.frame:
            return f"early: frame {frame} has not begun"
        if not self.due(row, frame):
            return f"unexpected: frame {frame}: its sensor has no measurement in this frame"
        if frame == context.frame and time_ns != now and not before < time_ns < now:
            return f"measured: frame {frame}: time_ns is {time_ns}, expected {before + 1} to {now}"
        return ""

    def finish(self, context: Context) -> dict[str, Any]:
        """How far its detections were from what its tracker expected, if that tells."""
        innovations = self.pipeline.tracker.innovations
        return {} if innovations is None else {"innovations": innovations.summary()}

    def picture_at(self, frame: int, time_ns: int) -> ObjectStates:
        """The objects of the latest picture of an earlier frame, predicted to `time_ns`.

        Earlier by its frame of arrival. Empty if it is too old. Tells the mission estimator its time.
        """
        latest = self.pictures.get(frame)
        picture_ns, states = (time_ns + 1, ObjectStates.empty()) if latest is None else latest[1]
        age_ns = time_ns - picture_ns
        if not 0 <= age_ns <= self.picture_age_ns:
            return ObjectStates.empty()
        self.pipeline.mission.date_picture(picture_ns)
        return predicted(states, age_ns * 1e-9)


def sensor_in_world(pose: Pose, mount: Pose) -> tuple[Floats, Floats]:
    """Position (3,) and rotation (3, 3) of a sensor. pose: of its agent"""
    agent, sensor = (rotation_from_quaternion(each.quaternion) for each in (pose, mount))
    return sensor_pose(pose.position, agent, mount.position, sensor)


def _mount(sensor: OwnSensor) -> Pose:
    """The mount of a sensor, while its agent stands."""
    return Pose(np.array(sensor.mount_position), np.array(sensor.mount_rotation))


if __name__ == "__main__":
    main(Agent)

"""An agent: tracks its own sensor's detections, and extends its view with the picture.

It has two estimators. The safety-critical one (`tracks`) uses only the agent's own detections and pose; no message
from outside reaches it. The mission-critical one (`mission`) also uses the latest picture that arrived in an earlier
frame: this frame's may arrive before or after it, and the result must not depend on that.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mast_zenoh.arrays.geometry import states_to_world
from mast_zenoh.arrays.states import Detections, ObjectStates
from mast_zenoh.gather import Gather, LatestBefore
from mast_zenoh.integrity.views import UNKNOWN_SPACE, SweptView, view_columns
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.pipelines import AgentPipeline, Pose
from mast_zenoh.runtime.mesh.main import main
from mast_zenoh.sensing import LidarSensor
from mast_zenoh.tracking.prediction import predicted

#: Frame of reference of states in the world frame.
WORLD = {"origin": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}
for _part in WORLD.values():
    _part.setflags(write=False)


class Agent(Node):
    """Tracks objects from its own sensor, and estimates the mission picture.

    pipeline: its stages; lidar: its sensor; mobile: whether it moves; status_every: frames between two statuses
    picture_age_s: the greatest age of a picture that is used
    """

    role = "agent"
    inputs = {
        "clock": "clock",
        "pose": "pose",
        "detections": "detections",
        "sweep": "sweep",
        "picture": "picture",
    }
    outputs = {"tracks": "tracks", "view": "view", "mission": "tracks", "status": "status"}

    def __init__(
        self,
        pipeline: AgentPipeline,
        lidar: LidarSensor,
        mobile: bool = False,
        status_every: int = 10,
        picture_age_s: float = 0.5,
    ) -> None:
        if status_every < 1:
            raise ValueError(f"status_every: found {status_every}, expected 1 or more")
        if picture_age_s < 0.0:
            raise ValueError(f"picture_age_s: found {picture_age_s}, expected 0 or more")
        self.pipeline = pipeline
        self.lidar = lidar
        self.mobile = mobile
        self.status_every = status_every
        self.picture_age_ns = round(picture_age_s * 1e9)
        self.sensed: Gather[str, Received] = Gather({"clock", "pose", "detections"})
        self.pictures: LatestBefore[tuple[int, ObjectStates]] = LatestBefore()
        self.last: tuple[Pose, Pose] | None = None  # latest pose and mount
        self.newest_ns = 0  # time of the tracker's last step

    def start(self, context: Context) -> None:
        """Wait for the sensor's sweep in each frame, if there is one."""
        if any(source.port == "sweep" for source in context.subscriptions.values()):
            self.sensed.expected.add("sweep")

    def on_clock(self, received: Received, context: Context) -> None:
        """Process frames whose pose or detections are missing with whatever has arrived."""
        for frame, items in self.sensed.expired(received.frame):
            self.perceive(frame, items, context)
        self.sense("clock", received, context)

    def on_pose(self, received: Received, context: Context) -> None:
        """The agent's pose."""
        self.sense("pose", received, context)

    def on_detections(self, received: Received, context: Context) -> None:
        """The detections of its sensor."""
        self.sense("detections", received, context)

    def on_sweep(self, received: Received, context: Context) -> None:
        """How far its sensor sees in each direction."""
        self.sense("sweep", received, context)

    def on_picture(self, received: Received, context: Context) -> None:
        """Store the common picture for the frames after its arrival, however late."""
        picture = (received.time_ns, ObjectStates.from_columns(received.body))
        self.pictures.add(context.frame, picture, received.frame)

    def sense(self, port: str, received: Received, context: Context) -> None:
        """Process a frame once its clock, its pose and all data of its sensor have arrived."""
        items = self.sensed.add(received.frame, port, received)
        if items is not None:
            self.perceive(received.frame, items, context)

    def perceive(self, frame: int, items: dict[str, Received], context: Context) -> None:
        """Publish both estimates of one frame; always one message each, even if empty."""
        time_ns = items.get("clock", next(iter(items.values()))).time_ns
        if time_ns < self.newest_ns:
            least = f"{self.newest_ns}, the time of the previous frame"
            context.reject(f"old: frame {frame}: time_ns is {time_ns}, expected at least {least}")
            return
        detections = Detections.empty()
        if "detections" in items:
            body = items["detections"].body
            detections = Detections.from_columns(body)
            mount = Pose(body["mount_position"], body["mount_rotation"])
        elif self.last:
            mount = self.last[1]
        if "pose" in items:
            pose = Pose(items["pose"].body["position"], items["pose"].body["rotation"])
        elif self.last:
            pose = self.last[0]
        if self.last is None and not {"pose", "detections"} <= items.keys():
            return  # its pose or its sensor's mount has never arrived
        self.last = (pose, mount)
        self.newest_ns = time_ns
        tracks, origin, rotation = self.pipeline.track(time_ns, detections, pose, mount, self.lidar)
        reference = {"origin": origin, "rotation": rotation}
        context.publish("tracks", tracks.columns() | reference, frame=frame, time_ns=time_ns)
        free = items["sweep"].body["free"] if "sweep" in items else UNKNOWN_SPACE
        if context.connected("view"):
            view = self.pipeline.view(pose, mount, self.lidar)
            context.publish("view", view_columns(view, free), frame=frame, time_ns=time_ns)
        if context.connected("mission"):
            if "sweep" in items:
                self.pipeline.mission.look(SweptView(self.pipeline.view(pose, mount, self.lidar), free))
            own = states_to_world(tracks, origin, rotation)
            mission = self.pipeline.mission.estimate(time_ns, own, self.picture_at(frame, time_ns))
            context.publish("mission", mission.columns() | WORLD, frame=frame, time_ns=time_ns)
        if frame % self.status_every == 0:
            status = {
                "mobile": np.array([self.mobile], np.uint8),
                "detections": np.array([len(detections)]),
                "tracks": np.array([len(tracks)]),
            }
            context.publish("status", status, frame=frame, time_ns=time_ns)

    def finish(self, context: Context) -> dict[str, Any]:
        """How far its detections were from what its tracker expected, if that tells."""
        innovations = self.pipeline.tracker.innovations
        return {} if innovations is None else {"innovations": innovations.summary()}

    def picture_at(self, frame: int, time_ns: int) -> ObjectStates:
        """The latest picture of an earlier frame, predicted to `time_ns`.

        Earlier by its frame of arrival. Empty if it is too old.
        """
        latest = self.pictures.get(frame)
        if latest is None:
            return ObjectStates.empty()
        picture_ns, states = latest[1]
        age_ns = time_ns - picture_ns
        return predicted(states, age_ns * 1e-9) if 0 <= age_ns <= self.picture_age_ns else ObjectStates.empty()


if __name__ == "__main__":
    main(Agent)

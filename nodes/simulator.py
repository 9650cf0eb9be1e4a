"""The simulator: replays a prepared scene to sensors and evaluator, by frame.

It drives the run: the runtime requests the next frame when the mesh is quiet (lock-step) or
when the frame is due (real time). It sends the truth only to the evaluator.
"""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.geometry import quaternion_from_rotation
from mast_zenoh.mesh.hosting import main
from mast_zenoh.messages.schemas import text
from mast_zenoh.node import Context, Source
from mast_zenoh.scenes.making.scanning import ScannedPoints, Scanner
from mast_zenoh.scenes.recording import NO_MEASUREMENT, Recording
from mast_zenoh.wiring.model import subject_of


class Simulator(Source):
    """Replays a scene.

    recording: the prepared scene (its own file); frames: number of frames to play, None for all
    points:    how the agents' first sensors scan; None: they detect as the prepared scene says
    """

    role = "simulator"
    outputs = {name: name for name in ("clock", "truth", "pose", "points", "detections", "sweep")}

    def __init__(self, recording: Recording, frames: int | None = None, points: ScannedPoints | None = None) -> None:
        self.recording, self.points = recording, points
        self.scanner: Scanner | None = None
        self.period_ns = recording.period_ns
        self.frames = len(recording.times_ns) if frames is None else min(frames, len(recording.times_ns))
        self.next_frame = 0
        agents = recording.agents
        self.names = text([agent.name for agent in agents])
        self.objects = np.array([agent.object_id for agent in agents], np.int64)
        self.rotations = quaternion_from_rotation(recording.agent_rotation)
        self.rotations.setflags(write=False)

    def start(self, context: Context) -> None:
        """Place what stands beside the roads, if lidars scan it."""
        if self.points is not None:
            self.scanner = Scanner(self.recording, self.points, context.seed, context.connected("sweep"))

    def advance(self, context: Context) -> bool:
        """Publish the next frame: clock, truth, and each agent's pose and sensor data."""
        frame = self.next_frame
        if frame >= self.frames:
            return False
        self.next_frame += 1
        scene = self.recording
        context.publish("clock", {}, frame=frame, time_ns=int(scene.times_ns[frame] - scene.times_ns[0]))
        for index, agent in enumerate(scene.agents):
            context.publish(
                "pose",
                {
                    "position": scene.agent_position[frame, index],
                    "rotation": self.rotations[frame, index],
                    "velocity": scene.agent_velocity[frame, index],
                },
                subject=agent.name,
            )
            self.publish_detections(frame, index, context)
            if self.scanner is None and context.connected("sweep", agent.name):
                context.publish("sweep", {"free": scene.sweep_at(frame, index)}, subject=agent.name)
        truth, returned = scene.truth_at(frame), scene.points_at(frame)
        if self.scanner is not None:
            returned = self.scanner.publish(frame, truth, scene, frame, context.publish)
        context.publish(
            "truth",
            {
                **{name: getattr(truth, name) for name in ("id", "position", "velocity", "size", "yaw", "class_id")},
                "points": returned,
                "agents": self.names,
                "agent_position": scene.agent_position[frame],
                "agent_object": self.objects,
            },
        )
        return True

    def publish_detections(self, frame: int, index: int, context: Context) -> None:
        """Publish the new measurements of an agent's sensors, with their times; a sensor without one sends nothing.

        index: row of the agent
        """
        scene = self.recording
        agent = scene.agents[index]
        for row, sensor in enumerate(agent.sensors):
            if self.scanner is not None and row == 0:
                continue
            age_ns = scene.age_ns_at(frame, index, row)
            if age_ns == NO_MEASUREMENT:
                continue
            position, rotation = scene.mount_at(frame, index, row)
            mount = {"mount_position": position, "mount_rotation": quaternion_from_rotation(rotation)}
            context.publish(
                "detections",
                scene.detections_at(frame, index, row).columns() | mount,
                subject=subject_of(agent.name, sensor.name if row else ""),
                time_ns=int(scene.times_ns[frame] - scene.times_ns[0]) - age_ns,
            )


if __name__ == "__main__":
    main(Simulator)

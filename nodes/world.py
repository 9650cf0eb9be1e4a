"""The world: a simulator whose scene follows from commands. Drivers drive some cars; all others react to them.

In every frame it publishes what nodes/simulator.py does, with the same sensors, and a route for each driver. A command
of a frame acts in the next one. Without commands it publishes the prepared scene, bit by bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import quaternion_from_rotation
from mast_zenoh.driving import Actuation, CarLimits, Command
from mast_zenoh.driving.motion import HOLD_S, TAKE_OVER_S
from mast_zenoh.mesh.hosting import main
from mast_zenoh.messages.schemas import text
from mast_zenoh.node import Context, Received, Source
from mast_zenoh.scenes import Recording, Scene
from mast_zenoh.scenes.base import SteppedWorld, check_cars
from mast_zenoh.scenes.making.observe import FrameDetection, SweepCaster, World, lidar_visibility, most_seen
from mast_zenoh.scenes.making.scanning import ScannedPoints, Scanner
from mast_zenoh.wiring.model import subject_of


class WorldSimulator(Source):
    """Steps a scene, frame by frame.

    recording: the prepared scene, in which nobody drives: its length and its agents
    scene:     the scene itself, which is stepped
    frames:    number of frames to play
    drivers:   by car, the name of its driver's node
    take_over_s: s, until which the cars drive as in the prepared scene, while the trackers begin
    hold_s:    s, for which a car without commands goes on as it was told; then it brakes
    braking:   m/s², of a car without commands
    limits:    what the cars can do; None: CarLimits()
    points:    as in nodes/simulator.py

    Raises ConfigurationError, at its start, for a scene that cannot be stepped, and for a name that is no car of it.
    """

    role = "simulator"
    inputs = {"command": "command"}
    affects = {"command": {}}  # it changes the world, not what is said of it
    outputs = {name: name for name in ("clock", "truth", "pose", "points", "detections", "sweep", "route")}

    def __init__(
        self,
        recording: Recording,
        scene: Scene,
        frames: int,
        drivers: Mapping[str, str],
        take_over_s: float = TAKE_OVER_S,
        hold_s: float = HOLD_S,
        braking: float = 3.0,
        limits: CarLimits | None = None,
        points: ScannedPoints | None = None,
    ) -> None:
        check("0 or more, finite", take_over_s=take_over_s, hold_s=hold_s)
        check("more than 0, finite", braking=braking)
        self.recording, self.scene, self.drivers, self.points = recording, scene, drivers, points
        self.scanner: Scanner | None = None
        self.period_ns = recording.period_ns
        self.frames = min(frames, len(recording))
        self.take_over = round(take_over_s * 1e9 / self.period_ns)
        hold_frames, limits = round(hold_s * 1e9 / self.period_ns), limits or CarLimits()
        self.cars = {car: Actuation(limits, hold_frames, braking) for car in drivers}
        self.next_frame = 0
        self.world: SteppedWorld
        self.detection: FrameDetection
        self.sweeps: list[SweepCaster] = []
        self.uncommanded: set[str] = set()  # cars of which it was told that they had no command

    def start(self, context: Context) -> None:
        """Begin the scene."""
        self.world = self.scene.world(context.seed, len(self.recording))
        check_cars(self.drivers, self.world.cars)
        present = self.world.now()
        self.detection = FrameDetection(present, self.world.detector, context.seed)
        if self.points is not None:
            self.scanner = Scanner(self.recording, self.points, context.seed, context.connected("sweep"))
        if present.buildings:  # without them nobody knows what is free
            self.sweeps = [SweepCaster(agent, self.detection.walls) for agent in present.agents]

    def on_command(self, received: Received, context: Context) -> None:
        """What a driver wants of its car."""
        if received.subject not in self.cars:
            context.reject(f"unknown: {received.subject} is not one of the driven cars")
            return
        command = Command(*(float(received.body[name][0]) for name in Command._fields))
        if reason := self.cars[received.subject].receive(received.frame, context.frame, command):
            context.reject(reason)

    def advance(self, context: Context) -> bool:
        """Step to the next frame and publish it: clock, routes, truth, and each agent's pose and sensor data."""
        frame = self.next_frame
        if frame >= self.frames:
            return False
        self.next_frame += 1
        if frame > 0:
            self.world.step(self.commands(frame, context) if frame > self.take_over else {})
        context.publish("clock", {}, frame=frame, time_ns=frame * self.period_ns)
        present = self.world.now()
        for car, driver in self.drivers.items():
            route = self.world.route(car)
            stop = np.array([route.stop_m] if np.isfinite(route.stop_m) else [])
            body = {"position": route.position, "speed": route.speed, "stop": stop, "size": self.world.size(car)}
            context.publish("route", body, subject=driver)
        self.publish_agents(present, frame, context)
        return True

    def commands(self, frame: int, context: Context) -> dict[str, Command]:
        """What each car does until a frame; tells once of a car that has no command."""
        commands = {}
        for car, actuation in self.cars.items():
            commands[car] = actuation.act(frame)
            missing = actuation.counts["held"] + actuation.counts["braked"]
            if missing and car not in self.uncommanded:
                self.uncommanded.add(car)
                context.log.warning("frame %d: no new command for %s (more will only be counted)", frame, car)
        return commands

    def publish_agents(self, present: World, frame: int, context: Context) -> None:
        """Publish what the agents sense in the present frame, and the truth."""
        points = lidar_visibility(present, walls=self.detection.walls)
        detected = iter(self.detection.of(present, 0, points, number=frame))
        rotations = quaternion_from_rotation(present.agent_rotation[0])
        for row, agent in enumerate(present.agents):
            position, velocity = present.agent_position[0, row], present.agent_velocity[0, row]
            pose = {"position": position, "rotation": rotations[row], "velocity": velocity}
            context.publish("pose", pose, subject=agent.name)
            for number, sensor in enumerate(agent.sensors):
                detections, _ = next(detected)
                if self.scanner is not None and number == 0:
                    continue
                mount = {
                    "mount_position": sensor.lidar.mount_position,
                    "mount_rotation": quaternion_from_rotation(sensor.lidar.mount_rotation),
                }
                part = sensor.name if number else ""
                context.publish("detections", detections.columns() | mount, subject=subject_of(agent.name, part))
            if self.scanner is None and context.connected("sweep", agent.name):
                free = np.zeros((0, 0))
                if self.sweeps:
                    free = self.sweeps[row].sweep(present.truth, position, present.agent_rotation[0, row])
                context.publish("sweep", {"free": free.astype(np.float64)}, subject=agent.name)
        if self.scanner is None:
            returned = most_seen(present, points, self.detection.walls)
        else:
            returned = self.scanner.publish(frame, present.truth, present, 0, context.publish)
        columns = ("id", "position", "velocity", "size", "yaw", "class_id")
        context.publish(
            "truth",
            {
                **{name: getattr(present.truth, name) for name in columns},
                "points": returned,
                "agents": text([agent.name for agent in present.agents]),
                "agent_position": present.agent_position[0],
                "agent_object": np.array([agent.object_id for agent in present.agents], np.int64),
            },
        )

    def finish(self, context: Context) -> dict[str, Any]:
        """For each car, the number of frames in which it was commanded, held on or braked, and of refused commands."""
        self.world.close()
        return {"commands": {car: dict(actuation.counts) for car, actuation in self.cars.items()}}


if __name__ == "__main__":
    main(WorldSimulator)

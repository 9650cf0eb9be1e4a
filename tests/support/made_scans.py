"""Scans of a few cars, a wall and the ground, with 2 cm of noise: for attacks on points and what checks them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_yaw
from mast_zenoh.arrays.states import CLASS_INDEX, Detections, Floats
from mast_zenoh.sensing.beams import MODELS
from mast_zenoh.sensing.points import Points
from mast_zenoh.sensing.raycast import Walls
from mast_zenoh.sensing.scan import Moving, cast
from mast_zenoh.sensing.sectors import LidarMotion
from mast_zenoh.sensing.shapes import Parts

HEIGHT_M = 1.8
CAR = (4.5, 1.8, 1.5)


@dataclass
class Street:
    """Cars (n, 4) x, y, yaw, speed at time 0, world frame, a lidar on the x axis at height 1.8 m, and a wall."""

    cars: Floats
    model: str = "OS1-128"
    speed: float = 0.0
    turn: float = 0.0
    wall_x: float | None = None
    noise_m: float = 0.02

    def lidar(self, time_s: float) -> tuple[Floats, Floats]:
        return np.array([self.speed * time_s, 0.0, HEIGHT_M]), rotation_from_yaw(self.turn * time_s)

    def at(self, time_s: float) -> tuple[Moving, Floats]:
        cars = self.cars
        velocity = cars[:, 3:] * np.stack([np.cos(cars[:, 2]), np.sin(cars[:, 2]), np.zeros(len(cars))], axis=1)
        position = np.column_stack([cars[:, :2], np.full(len(cars), CAR[2] / 2)]) + velocity * time_s
        return Moving(position, velocity, cars[:, 2], np.zeros(len(cars))), np.tile(CAR, (len(cars), 1))

    def points(self, time_s: float = 0.0, seed: int = 0) -> Points:
        beams = MODELS[self.model].beams()
        position, rotation = self.lidar(time_s)
        velocity = np.array([self.speed, 0.0, 0.0])
        lidar = Moving(position[None], velocity[None], np.array([self.turn * time_s]), np.array([self.turn]))
        objects, size = self.at(time_s)
        walls = None
        if self.wall_x is not None:
            x = self.wall_x
            walls = Walls.of_buildings(
                (np.array([(x, -40), (x, 40), (x + 9, 40), (x + 9, -40)], float),), np.array([8.0])
            )
        parts = Parts.of(np.full(len(size), CLASS_INDEX["car"]), size)
        scan = cast(beams, lidar, np.eye(3), objects, parts, walls=walls)
        firing, channel = np.nonzero(np.isfinite(scan.range_m))
        range_m = scan.range_m[firing, channel]
        range_m = range_m + self.noise_m * np.random.default_rng(seed).standard_normal(len(range_m))
        time = beams.time_s[firing].astype(np.float32)
        fired = beams.directions()[firing, channel] * range_m[:, None]
        deskewed = LidarMotion(rotation, velocity, self.turn).deskewed(fired, time)
        return Points(deskewed, np.full(len(time), 0.3, np.float32), time, channel.astype(np.uint8))

    def detections(self, time_s: float, seed: int, found_m: float = 50.0) -> Detections:
        """The cars that at least 10 points are on within a range, with errors of a detector: 0.3 m, 5 deg, 10 %."""
        objects, size = self.at(time_s)
        draw = np.random.default_rng(seed)
        position, rotation = self.lidar(time_s)
        local, yaw = (objects.position - position) @ rotation, objects.yaw - self.turn * time_s
        points = self.points(time_s, seed).position
        c, s = np.cos(yaw), np.sin(yaw)
        x, y, z = np.moveaxis(points[:, None] - local, 2, 0)
        inside = (np.abs(c * x + s * y) < CAR[0] / 2 + 0.2) & (np.abs(c * y - s * x) < CAR[1] / 2 + 0.2)
        seen = np.count_nonzero(inside & (np.abs(z) < CAR[2] / 2), axis=0) >= 10
        noise = draw.normal(0.0, 0.3, (len(size), 3)) * (1.0, 1.0, 0.3)
        yaw = yaw + draw.normal(0.0, np.radians(5.0), len(yaw))
        detections = boxes(local + noise, size * draw.normal(1.0, 0.1, size.shape), yaw)
        return detections.select(seen & (np.hypot(*local[:, :2].T) < found_m))


def boxes(position: Floats, size: Floats | None = None, yaw: Floats | None = None) -> Detections:
    """Cars (n, 3) m."""
    n = len(position)
    return Detections(
        np.asarray(position, float),
        np.tile(CAR, (n, 1)) if size is None else size,
        np.zeros(n) if yaw is None else yaw,
        np.ones(n),
        np.full(n, CLASS_INDEX["car"], np.uint8),
        np.zeros((n, 3, 3)),
    )

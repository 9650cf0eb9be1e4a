"""A generated junction that is stepped: drivers command some of its cars, and all others react to them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.driving.motion import Command, RouteAhead, drive
from mast_zenoh.scenes.base import SteppedWorld
from mast_zenoh.scenes.generated.traffic import Motion, Traffic
from mast_zenoh.scenes.making.observe import World
from mast_zenoh.sensing import Detector

#: m, how far ahead of a car its route is told.
HORIZON_M = 80
#: m, on either side of a place, over which the curvature of a lane is measured.
_CURVATURE_M = 0.5


class DrivenTraffic(Traffic):
    """Traffic in which some movers do what they are commanded; they may leave the middle of their lane.

    commands: by row of the mover, for the next step; a mover without one drives itself
    """

    commands: Mapping[int, Command] = {}
    _offset: Floats
    _turn: Floats

    def release(self) -> None:
        """Let movers leave the middle of their lanes from now on; all are there."""
        self._offset, self._turn = np.zeros_like(self.s), np.zeros_like(self.s)

    def motion(self) -> tuple[Floats, Floats, Floats, Ints]:
        points, yaw, speed, path = super().motion()
        away = np.flatnonzero((self._offset != 0.0) | (self._turn != 0.0))
        points[away] += self._offset[away, None] * np.stack([-np.sin(yaw[away]), np.cos(yaw[away])], axis=1)
        yaw[away] += self._turn[away]
        return points, yaw, speed, path

    def move(self, acceleration: Floats, dt: float) -> None:
        acceleration = acceleration.copy()
        for row, command in self.commands.items():
            acceleration[row] = command.acceleration
        super().move(acceleration, dt)

    def _progress(self, distance: Floats) -> Floats:
        if not self.commands:
            return distance
        rows = np.array(list(self.commands))
        curvature = np.array([command.curvature for command in self.commands.values()])
        driven = drive(self._offset[rows], self._turn[rows], distance[rows], curvature, self._lane_curvature(rows))
        progress = distance.copy()
        progress[rows], self._offset[rows], self._turn[rows] = driven
        return progress

    def _lane_curvature(self, rows: Ints) -> Floats:
        """Curvature (k,) 1/m of the paths of some movers where these are."""
        path, table = self.route[rows, 0], self.network.table
        begin = np.clip(self.s[rows] - _CURVATURE_M, 0.0, table.length[path] - 2.0 * _CURVATURE_M)
        turned = table.pose(path, begin + 2.0 * _CURVATURE_M)[1] - table.pose(path, begin)[1]
        return np.asarray(wrap_angle(turned) / (2.0 * _CURVATURE_M))

    def route_ahead(self, row: int) -> RouteAhead:
        """What the map and the lights tell the driver of a mover."""
        table, paths = self.network.table, self.route[row]
        length = table.length[paths]
        start = np.concatenate([[0.0], np.cumsum(length)])
        along = self.s[row] + np.arange(HORIZON_M + 1)
        along = along[along < start[-1]]
        part = np.searchsorted(start, along, side="right") - 1
        path, at = paths[part], along - start[part]
        to_line = float(length[0] - self.s[row] - self.movers.size[row, 0] / 2)
        return RouteAhead(
            table.pose(path, at)[0],
            np.minimum(table.limit_at(path, at), self.movers.speed[row]),
            to_line if self.must_stop[row] else np.inf,
        )


class JunctionWorld(SteppedWorld):
    """A generated junction, stepped from the first frame of the scene on.

    traffic: in that frame; cars: row of the mover of each agent that is a motor vehicle, by name
    snapshot: the world of the one frame of a motion; step_s: s, of a step of the traffic, steps: of a frame
    """

    def __init__(
        self,
        traffic: DrivenTraffic,
        cars: Mapping[str, int],
        snapshot: Callable[[Motion], World],
        detector: Detector,
        *,
        steps: int,
        step_s: float,
    ) -> None:
        self.cars, self.detector = tuple(cars), detector
        self._rows = cars
        self._traffic, self._snapshot = traffic, snapshot
        self._steps, self._step_s = steps, step_s
        traffic.release()
        self._chosen = traffic.decide()

    def now(self) -> World:
        position, yaw, speed, path = self._traffic.motion()
        return self._snapshot(Motion(position[None], yaw[None], speed[None], path[None]))

    def route(self, car: str) -> RouteAhead:
        return self._traffic.route_ahead(self._rows[car])

    def size(self, car: str) -> Floats:
        return self._traffic.movers.size[self._rows[car], :2]

    def step(self, commands: Mapping[str, Command]) -> None:
        self._traffic.commands = {self._rows[car]: command for car, command in commands.items()}
        for _ in range(self._steps):
            self._traffic.move(self._chosen, self._step_s)
            self._chosen = self._traffic.decide()

"""What the driver of a car would do if it knew the truth: another driver of its class, which is given the truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints, ObjectStates, canonical_order
from mast_zenoh.config import registry
from mast_zenoh.driving import CarLimits, Command, Driver, RouteAhead, Situation
from mast_zenoh.gather import Gather

#: Frames for which the truth waits for the route of its frame, and the reverse: the messages of a key may arrive at a
#: listen-only node after those of another key about many later frames.
_PATIENCE = 200


class TrueFrame(NamedTuple):
    """What is there in a frame. time_ns: ns; objects: world frame; own: id of the car among them"""

    time_ns: int
    objects: ObjectStates
    own: int


class DriverOnTruth:
    """Drives in the place of a car's driver, with the truth in place of its estimate; nothing obeys it.

    It is asked once a frame, in the order of frames, so that a driver with a state has the same history.

    braking: m/s^2, by frame, that it commands; negative: it accelerates
    problem: why it has no answer about some frames; "": none
    """

    def __init__(self, driver: Mapping[str, Any], limits: Mapping[str, Any] | None = None) -> None:
        self.braking: dict[int, float] = {}
        self.problem = ""
        self._gather: Gather[str, Any] = Gather({"truth", "route"}, _PATIENCE)
        self._newest = -1
        self._driver: Driver | None = None
        try:
            self._limits = CarLimits() if limits is None else registry.build(limits, CarLimits, "limits")
            self._driver = registry.build(driver, Driver, "driver")
        except Exception as error:  # code of a user
            self._fail(error)

    def add(self, frame: int, part: Literal["truth", "route"], item: TrueFrame | RouteAhead) -> None:
        """Add the truth of a frame, or the car's lane ahead; it is asked when both are there."""
        for _ in self._gather.expired(frame):
            pass
        parts = self._gather.add(frame, part, item)
        if parts is not None and frame > self._newest and self._driver is not None:
            self._newest = frame
            self._ask(self._driver, frame, parts["truth"], parts["route"])

    def in_frames(self, frames: Ints) -> Floats:
        """(f,) m/s^2, its braking in each of some frames; NaN: it has no answer."""
        return np.array([self.braking.get(frame, np.nan) for frame in frames.tolist()])

    def _ask(self, driver: Driver, frame: int, truth: TrueFrame, route: RouteAhead) -> None:
        objects, own = truth.objects, np.flatnonzero(truth.objects.id == truth.own)
        if len(own) != 1:
            return
        others = objects.select(objects.id != truth.own)
        car = objects.select(own)
        try:
            command = driver.drive(
                Situation(
                    time_ns=truth.time_ns,
                    position=car.position[0],
                    velocity=car.velocity[0],
                    heading=float(car.yaw[0]),
                    size=car.size[0, :2],
                    route=RouteAhead(route.position.copy(), route.speed.copy(), route.stop_m),
                    objects=others.select(canonical_order(others)),
                    limits=self._limits,
                )
            )
            if not isinstance(command, Command) or not np.isfinite(command.acceleration):
                raise TypeError(f"found {command!r}, expected a Command")
            self.braking[frame] = -float(command.acceleration)
        except Exception as error:  # code of a user
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        self.problem = self.problem or f"{type(error).__name__}: {error}"

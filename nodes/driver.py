"""A driver: sees what its agent knows, and commands its agent's car.

It publishes one command in every frame, from the pose and the route of that frame and from the newest estimate of an
earlier one, as an agent uses the picture: the result does not depend on the order of arrival.

With a veto, the agent's own sensors overrule the mission estimate, which others contribute to: see
mast_zenoh/driving/driver.py.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import heading, rotation_from_quaternion, tracks_in_world
from mast_zenoh.arrays.states import Bools, ObjectStates, canonical_order
from mast_zenoh.driving import CarLimits, Command, Driver, RouteAhead, Situation
from mast_zenoh.driving.driver import ESTIMATE_AGE_S, Refutations, overruled
from mast_zenoh.gather import Gather, LatestBefore, plausible
from mast_zenoh.integrity.base import ClusterBoxes
from mast_zenoh.integrity.views import SweptView, check_view, view_of
from mast_zenoh.integrity.visibility import clear_in_view
from mast_zenoh.mesh.hosting import main
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.tracking.kalman import predicted

#: By which objects a driver can drive: what is there, its agent's own tracks, or its agent's mission estimate.
ESTIMATES = ("truth", "safety", "mission")
#: Points of a route that are used: as many metres.
MAX_POINTS = 1000


class DriverNode(Node):
    """Drives the car of its agent.

    agent:    whose car it is
    driver:   how it drives
    estimate: one of ESTIMATES
    estimate_age_s: s, the greatest age of an estimate that is used; without one it brakes
    braking:  m/s², without an estimate
    limits:   what the car can do, as it believes; None: CarLimits(), or in a scenario those of the world
    veto:     whether the agent's own sensors overrule its mission estimate: it drives by its own tracks, and by what
        else is in the mission estimate unless they see through its place
    """

    role = "driver"
    inputs = {
        "clock": "clock",
        "pose": "pose",
        "route": "route",
        "truth": "truth",
        "safety": "tracks",
        "mission": "tracks",
        "view": "view",
    }
    outputs = {"command": "command"}

    def __init__(
        self,
        agent: str,
        driver: Driver,
        estimate: Literal["truth", "safety", "mission"] = "mission",
        estimate_age_s: float = ESTIMATE_AGE_S,
        braking: float = 3.0,
        limits: CarLimits | None = None,
        veto: bool = False,
    ) -> None:
        check("0 or more, finite", estimate_age_s=estimate_age_s)
        check("more than 0, finite", braking=braking)
        if veto and estimate != "mission":
            raise ValueError(
                f"veto: found True with the estimate {estimate!r}, expected 'mission': it overrules that one"
            )
        self.agent, self.driver, self.estimate = agent, driver, estimate
        self.veto = veto
        used = {estimate, "safety", "view"} if veto else {estimate}
        self.unused = tuple(name for name in (*ESTIMATES, "view") if name not in used)
        self.age_ns, self.braking = round(estimate_age_s * 1e9), braking
        self.limits = limits or CarLimits()
        self.sensed: Gather[str, Received] = Gather({"clock", "pose", "route"})
        self.estimates: dict[str, LatestBefore[tuple[int, ObjectStates]]] = {name: LatestBefore() for name in ESTIMATES}
        self.views: LatestBefore[tuple[int, SweptView]] = LatestBefore()
        self.refutations = Refutations()
        self.counts = {"commands": 0, "blind": 0, "absurd": 0}

    def on_clock(self, received: Received, context: Context) -> None:
        """A frame begins; one without a pose or a route gets no command."""
        for _ in self.sensed.expired(received.frame):
            pass
        self.sense("clock", received, context)

    def on_pose(self, received: Received, context: Context) -> None:
        """Where the car is."""
        self.sense("pose", received, context)

    def on_route(self, received: Received, context: Context) -> None:
        """Its lane ahead."""
        points = len(received.body["position"])
        if 2 <= points <= MAX_POINTS:
            self.sense("route", received, context)
        else:
            context.reject(f"points: route of {points} points, expected 2 to {MAX_POINTS}")

    def on_truth(self, received: Received, context: Context) -> None:
        """What is there."""
        columns = {name: received.body[name] for name in ("id", "velocity", "size", "yaw", "class_id")}
        self.remember("truth", received, ObjectStates.of(received.body["position"], **columns), context)

    def on_safety(self, received: Received, context: Context) -> None:
        """The agent's own tracks, as the agent sends them."""
        self.remember("safety", received, tracks_in_world(received.body), context)

    def on_mission(self, received: Received, context: Context) -> None:
        """The agent's mission estimate."""
        self.remember("mission", received, tracks_in_world(received.body), context)

    def on_view(self, received: Received, context: Context) -> None:
        """What the agent's own sensor sees, as the agent sends it."""
        try:
            check_view(received.body)
        except ValueError as error:
            context.reject(f"view: {error}")
            return
        self.views.add(context.frame, (received.time_ns, view_of(received.body)), received.frame)

    def remember(self, estimate: str, received: Received, objects: ObjectStates, context: Context) -> None:
        """Store an estimate for the frames after its arrival, without objects of absurd values, which are counted."""
        objects = plausible(objects, self.counts)
        self.estimates[estimate].add(
            context.frame, (received.time_ns, objects.select(canonical_order(objects))), received.frame
        )

    def sense(self, port: str, received: Received, context: Context) -> None:
        """Command the car once the clock, the pose and the route of a frame have arrived."""
        items = self.sensed.add(received.frame, port, received)
        if items is None or received.frame != context.frame:
            return
        time_ns, pose, route = items["clock"].time_ns, items["pose"].body, items["route"].body
        objects = self.objects_at(received.frame, time_ns)
        if objects is None:
            self.counts["blind"] += 1
            command = self.limits.nearest(-self.braking, 0.0)
        else:
            stop = float(route["stop"].min(initial=np.inf))
            situation = Situation(
                time_ns=time_ns,
                position=pose["position"],
                velocity=pose["velocity"],
                heading=float(heading(rotation_from_quaternion(pose["rotation"]))),
                size=route["size"],
                route=RouteAhead(route["position"], route["speed"], stop),
                objects=objects,
                limits=self.limits,
            )
            command = self.driver.drive(situation)
            if not isinstance(command, Command):
                found = type(command).__name__
                raise TypeError(f"{type(self.driver).__name__}.drive returned {found}, expected a Command")
        self.counts["commands"] += 1
        body = {name: np.array([value]) for name, value in command._asdict().items()}
        context.publish("command", body, frame=received.frame, time_ns=time_ns)

    def objects_at(self, frame: int, time_ns: int) -> ObjectStates | None:
        """The objects to drive by at `time_ns`; None: what is known of them is too old."""
        objects = self.estimate_at(self.estimate, frame, time_ns)
        if objects is None or not self.veto:
            return objects
        own = self.estimate_at("safety", frame, time_ns)
        if own is None:
            return None
        free = self.refutations.update(time_ns, objects.id, self.free(objects, frame, time_ns))
        return overruled(own, objects, free)

    def estimate_at(self, name: str, frame: int, time_ns: int) -> ObjectStates | None:
        """The newest estimate of an earlier frame, predicted to `time_ns`; None: it is too old."""
        latest = self.estimates[name].get(frame)
        if latest is None:
            return None
        estimate_ns, objects = latest[1]
        age_ns = time_ns - estimate_ns
        return predicted(objects, age_ns * 1e-9) if 0 <= age_ns <= self.age_ns else None

    def free(self, objects: ObjectStates, frame: int, time_ns: int) -> Bools:
        """(n,) whether the newest view of an earlier frame sees through the place where each object was at its time."""
        latest = self.views.get(frame)
        age_ns = self.age_ns + 1 if latest is None else time_ns - latest[1][0]
        if latest is None or not 0 <= age_ns <= self.age_ns:
            return np.zeros(len(objects), np.bool_)
        boxes = ClusterBoxes(objects.position, objects.velocity, objects.size, objects.yaw)
        return clear_in_view(boxes, replace(latest[1][1], age_s=age_ns * 1e-9))

    def finish(self, context: Context) -> dict[str, Any]:
        """The number of commands, of those without an estimate: "blind", and of dropped objects: "absurd"."""
        return dict(self.counts)


if __name__ == "__main__":
    main(DriverNode)

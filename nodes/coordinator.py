"""The coordinator: combines the adversaries' observations into one plan.

Observations of one frame may have different times (a clock that is wrong, a link that restamps): objects, agents and
views are brought forward to the latest of them.
"""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.states import ObjectStates, concatenate, propagate
from mast_zenoh.attacks import Coordination, Surroundings, Targets
from mast_zenoh.attacks.campaign import shortfall
from mast_zenoh.attacks.knowledge import CentreMessages
from mast_zenoh.attacks.surroundings import UNKNOWN
from mast_zenoh.gather import Gather
from mast_zenoh.mesh.hosting import main
from mast_zenoh.messages.schemas import Body
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.tracking.view import SensorView


class Coordinator(Node):
    """Directs several adversaries by a common plan.

    coordination: how targets are chosen and moved; adversaries: names of the adversaries that it directs
    surroundings: the attackers' prior knowledge of the scene
    """

    role = "coordinator"
    inputs = {"clock": "clock", "observations": "observation", "overheard_picture": "picture", "trust": "trust"}
    listening = ("overheard_picture", "trust")
    outputs = {"directive": "directive"}

    def __init__(
        self, coordination: Coordination, adversaries: tuple[str, ...], surroundings: Surroundings = UNKNOWN
    ) -> None:
        self.coordination = coordination
        self.surroundings = surroundings
        self.adversaries = frozenset(adversaries)
        self.observed: Gather[str, Received] = Gather()  # follows the adversaries that are up
        self.overheard = CentreMessages()
        self.heard: dict[str, int] = {}  # frames of arrival of what the coordination has heard, by type

    def start(self, context: Context) -> None:
        """Initialise the random streams."""
        self.coordination.inform(self.surroundings)
        self.coordination.bind(context.seed, context.name)

    def finish(self, context: Context) -> dict[str, int]:
        """The number of chosen targets; logs a warning if fewer were found than wanted."""
        counts = self.coordination.counts()
        if self.adversaries and (missing := shortfall(counts)):
            context.log.warning("%s", missing)
        return counts

    def left(self, node: str, role: str, context: Context) -> None:
        """Stop waiting for an adversary that has left."""
        self.observed.expected.discard(node)

    def joined(self, node: str, role: str, context: Context) -> None:
        """Direct one of its adversaries from now on, when it joins or rejoins."""
        if node in self.adversaries:
            self.observed.expected.add(node)

    def on_clock(self, received: Received, context: Context) -> None:
        """Make a plan for incomplete frames with whatever has arrived."""
        for frame, items in self.observed.expired(received.frame):
            self.direct(frame, items, context)

    def on_observations(self, received: Received, context: Context) -> None:
        """Store the observation of one adversary."""
        if received.subject not in self.observed.expected:
            return  # of an adversary that it does not direct
        items = self.observed.add(received.frame, received.subject, received)
        if items is not None:
            self.direct(received.frame, items, context)

    def on_trust(self, received: Received, context: Context) -> None:
        """The command centre's trust or picture, which is known from the next frame on."""
        self.overheard.add(context.frame, received)

    on_overheard_picture = on_trust

    def direct(self, frame: int, items: dict[str, Received], context: Context) -> None:
        """Send one plan to the adversaries that reported, for the frames that follow."""
        self.overheard.tell(self.coordination, self.heard, context.frame)
        names = sorted(items)
        bodies = [items[name].body for name in names]
        time_ns = max(items[name].time_ns for name in names)
        late_s = [(time_ns - items[name].time_ns) * 1e-9 for name in names]
        states_seen = [propagate(ObjectStates.from_columns(body), s) for body, s in zip(bodies, late_s, strict=True)]
        velocity = np.array([body["agent_velocity"] for body in bodies])
        moved = velocity * np.array(late_s)[:, None]
        self.coordination.look(tuple(map(view_of, bodies, moved)))
        if type(self.coordination).locate is not Coordination.locate:  # the class overrides it
            rotations = rotation_from_quaternion(np.array([body["agent_rotation"] for body in bodies]))
            self.coordination.locate(rotations, velocity)
        plans = self.coordination.step(
            frame,
            time_ns,
            concatenate(states_seen),
            np.repeat(np.arange(len(states_seen)), [len(states) for states in states_seen]),
            np.array([body["agent_position"] for body in bodies]) + moved,
        )
        for name, targets in zip(names, plans, strict=True):
            context.publish("directive", directive(targets), subject=name, frame=frame, time_ns=time_ns)


def view_of(body: Body, moved: np.ndarray) -> SensorView:
    """The view in an observation; moved: (3,) m, by which its agent has moved since."""
    limits = *body["azimuth"].tolist(), *body["elevation"].tolist(), float(body["max_range"][0])
    return SensorView(body["sensor_position"] + moved, body["sensor_rotation"], *limits)


def directive(targets: Targets) -> dict[str, np.ndarray]:
    """Targets as columns of a directive."""
    columns = {"move_offset": targets.move_offset}
    for prefix, states in (("add_", targets.add), ("remove_", targets.remove), ("move_", targets.move)):
        for name in ("id", "position", "velocity", "size", "yaw", "class_id"):
            columns[prefix + name] = getattr(states, name)
    return columns


if __name__ == "__main__":
    main(Coordinator)

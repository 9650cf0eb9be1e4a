"""What an adversary keeps of one compromised agent."""

from __future__ import annotations

from collections import deque

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.attacks.base import Attack
from mast_zenoh.attacks.surroundings import Surroundings
from mast_zenoh.attacks.targets import Changes
from mast_zenoh.messages.schemas import Body
from mast_zenoh.tracking.view import SensorView
from mast_zenoh.wiring.received import Received
from mast_zenoh.wiring.subjects import agent_of

POSES_KEPT = 16  #: frames by which a message may be late and still be attacked


class Victim:
    """One compromised agent, or one of its sensors: its poses, and the messages that wait for them.

    name: of the agent, or agent/sensor; attack: on its messages
    """

    def __init__(self, name: str, attack: Attack) -> None:
        self.name = name
        self.agent = agent_of(name)
        self.attack = attack
        self.poses: dict[int, Body] = {}
        self.last_view: tuple[bytes, SensorView] | None = None  # latest pose, and the view from it
        self.waiting: dict[str, deque[Received]] = {"detections": deque(), "tracks": deque(), "picture": deque()}
        self.views: deque[Received] = deque()  # claimed views that wait for the lies of their frame
        self.attacked: deque[int] = deque(maxlen=POSES_KEPT)  # frames whose lies are known
        self.heard = {"picture": -1, "trust": -1}  # frames of arrival of what its attack has heard
        self.reports: list[tuple[Received, Changes]] = []  # that have not been published

    def store_pose(self, frame: int, pose: Body) -> None:
        """Store the true pose of a frame; the first one counts."""
        self.poses.setdefault(frame, pose)
        if len(self.poses) > POSES_KEPT:
            del self.poses[min(self.poses)]

    def view(self, surroundings: Surroundings, pose: Body) -> SensorView:
        """The view of its sensor; cached, because most agents are static."""
        key = pose["position"].tobytes() + pose["rotation"].tobytes()
        if self.last_view is None or self.last_view[0] != key:
            rotation = rotation_from_quaternion(pose["rotation"])
            self.last_view = (key, surroundings.view(self.name, pose["position"], rotation))
        return self.last_view[1]

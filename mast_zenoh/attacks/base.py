"""Base class of attacks: alter the messages of a victim, in the world frame."""

from __future__ import annotations

from abc import ABC, abstractmethod

from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.attacks.knowledge import Trust
from mast_zenoh.attacks.surroundings import Surroundings
from mast_zenoh.attacks.targets import Tampering, Targets
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.tracking.view import SensorView


class Attack(ABC):
    """Base class of attacks: tampers with the messages of a victim."""

    def bind(self, seed: int, name: str) -> None:  # noqa: B027 (a hook: attacks without random numbers need no streams)
        """Set the seed and the node's name, which identify the random streams."""

    def inform(self, surroundings: Surroundings) -> None:  # noqa: B027 (a hook)
        """Set the attacker's prior knowledge of the scene; called before `bind`."""

    def look(self, view: SensorView, *, fused: bool) -> None:  # noqa: B027 (a hook)
        """Set the victim's field of view for the next step.

        fused: whether the objects are those of several agents
        """

    def hear_picture(self, frame: int, time_ns: int, objects: ObjectStates) -> None:  # noqa: B027 (a hook)
        """Take note of a picture that arrived in an earlier frame: n fused objects, world frame.

        For adversaries that listen to the picture (`keyexpr_maps/knowledge_picture.toml`).
        """

    def hear_trust(self, frame: int, time_ns: int, trust: Trust) -> None:  # noqa: B027 (a hook)
        """Take note of the command centre's trust, which arrived in an earlier frame.

        For adversaries that listen to it (`keyexpr_maps/knowledge_trust.toml`).
        """

    def counts(self) -> dict[str, int]:
        """Numbers of selected targets (`Campaign.counts`); {} for attacks without any."""
        return {}

    @abstractmethod
    def step(
        self,
        frame: int,
        time_ns: int,
        objects: ObjectStates,
        agent_position: Floats,
        directive: Targets | None = None,
    ) -> Tampering:
        """Tamper with the objects of one message.

        frame:          index of the message's frame
        time_ns:        ns, its time since the start of the scene
        objects:        the victim's objects, world frame: tracks, or detections (velocity zero, ids below 0)
        agent_position: (3,) m, the victim, world frame
        directive:      the coordinator's newest targets from an earlier frame, if any

        The result does not depend on the order of the objects.
        """

    def forge_view(self, frame: int, time_ns: int, swept: SweptView) -> SweptView:
        """The view that the victim is to claim, by default the true one.

        Called after `step` for the same frame. swept: the true view
        """
        return swept

    def forge_pose(self, frame: int, time_ns: int, position: Floats) -> Floats:
        """The position (3,) m that the victim is to believe, by default the true one (3,) m.

        Called before `step` for the same frame, or after it.
        """
        return position


class PassThrough(Attack):
    """Relays every message unchanged."""

    def step(
        self,
        frame: int,
        time_ns: int,
        objects: ObjectStates,
        agent_position: Floats,
        directive: Targets | None = None,
    ) -> Tampering:
        return Tampering.nothing(len(objects))

"""Faults of sensors: temporary rules for the detections of an agent."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from mast_zenoh.faults.base import SENSOR, Fault, Rule, check_after


@dataclass(frozen=True, kw_only=True)
class SensorFault(Fault):
    """A fault of the detections of agents, exact in lock-step, on the wall clock in real time.

    until: s of scene time at which it ends; None: at the end of the run

    An agent stands for its first sensor. The agent's claimed view is unchanged. Targets may also be keys of wires:
    agent/infra_1/detections, agent/infra_1/detections/radar.
    """

    until: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_after(self.at, self.until)

    @property
    def over(self) -> float | None:
        return self.until

    def ways(self, role: str) -> Sequence[str]:
        return (SENSOR,) if role == "agent" else ()

    def rules(self, lockstep: bool) -> Sequence[Rule]:
        return (self.as_rule(),)

    @abstractmethod
    def as_rule(self) -> Rule:
        """The link rule: dict(type=…), see docs/links.md."""


@dataclass(frozen=True, kw_only=True)
class BlindSector(SensorFault):
    """Loses all detections in a sector, which the agent still claims to see.

    azimuth_min_deg: deg, at which the sector begins, in the sensor's frame
    azimuth_max_deg: deg, at which it ends, counter-clockwise from there
    """

    azimuth_min_deg: float
    azimuth_max_deg: float

    def as_rule(self) -> Rule:
        limits = {"azimuth_min_deg": self.azimuth_min_deg, "azimuth_max_deg": self.azimuth_max_deg}
        return {"type": "BlindSector", **limits}


@dataclass(frozen=True, kw_only=True)
class GhostDetections(SensorFault):
    """Detects objects that are not there, again and again at the same places.

    places: m, (x, y, z) of each: x ahead and y left of the sensor, or in the world; z is always that in the world
    frame:  "sensor": the ghosts move with the sensor; "world": they stay
    probability: that a ghost is detected in a frame
    size:    m, length, width and height
    yaw_rad: rad, heading: less the sensor's, or in the world
    kind:    class
    """

    places: tuple[tuple[float, float, float], ...]
    frame: str = "world"
    probability: float = 0.9
    size: tuple[float, float, float] = (4.5, 1.8, 1.5)
    yaw_rad: float = 0.0
    kind: str = "car"

    def as_rule(self) -> Rule:
        names = ("places", "frame", "probability", "size", "yaw_rad", "kind")
        return {"type": "GhostDetections", **{name: getattr(self, name) for name in names}}

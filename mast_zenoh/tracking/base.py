"""Base class of trackers."""

from __future__ import annotations

from abc import ABC, abstractmethod

from mast_zenoh.arrays.states import Detections, Ints, ObjectStates
from mast_zenoh.tracking.innovations import Innovations
from mast_zenoh.tracking.view import SensorView


class Tracker(ABC):
    """Turns measurements at successive times into tracks with persistent ids.

    One tracker serves one agent, or the centre: `step` takes the detections of one sensor, `step_states` full states,
    such as fused ones. Both may be called on the same tracker, even for the same time.
    """

    #: how far measurements were from what the tracker expected, since the last `reset`; None: it does not tell
    innovations: Innovations | None = None

    @abstractmethod
    def step(self, time_ns: int, detections: Detections, view: SensorView | None = None) -> ObjectStates:
        """The confirmed tracks at `time_ns`, sorted by id.

        time_ns:    ns, not earlier than in the previous call (ValueError)
        detections: n detections in the tracker's frame of reference, a fixed one (the world frame)
        view:       of the sensor that measured, see `SensorView`; without it, every object counts as in view

        Ids are unique and never reused. The result does not depend on the order of the detections.
        """

    @abstractmethod
    def step_states(self, time_ns: int, measured: ObjectStates) -> ObjectStates:
        """As `step`, for n measured full states with positive definite covariances."""

    @property
    @abstractmethod
    def matched(self) -> Ints:
        """Input row (n,) that updated each track of the last result; -1: coasting."""

    @abstractmethod
    def reset(self) -> None:
        """Return to the initial state."""

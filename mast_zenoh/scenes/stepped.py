"""Base class of stepped worlds: scenes whose truth follows from commands."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING

from mast_zenoh.arrays.states import Floats
from mast_zenoh.driving.motion import Command, RouteAhead
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.sensing import Detector

if TYPE_CHECKING:
    from mast_zenoh.scenes.making.observe import World


class SteppedWorld(ABC):
    """A scene that is computed frame by frame, because it depends on what drivers do.

    Without commands it is, bit by bit, the scene that `Scene.record` prepares for the same seed. A command changes what
    depends on it, and nothing else: all random numbers come from streams of their own.

    detector: of sensors without one of their own; cars: names of the agents that can be driven
    """

    detector: Detector
    cars: Collection[str]

    @abstractmethod
    def now(self) -> World:
        """The world of the present frame alone, as its frame 0; its agents, sensors and buildings never change."""

    @abstractmethod
    def route(self, car: str) -> RouteAhead:
        """What a car's map and the lights tell its driver in the present frame."""

    @abstractmethod
    def size(self, car: str) -> Floats:
        """(2,) m, length and width of a car."""

    @abstractmethod
    def step(self, commands: Mapping[str, Command]) -> None:
        """Go on to the next frame. commands: by car; all others drive as in the prepared scene, and react"""

    def close(self) -> None:  # noqa: B027
        """End what the world has started, such as a simulator's process; it is not stepped again."""


def check_cars(names: Iterable[str], cars: Iterable[str]) -> None:
    """Raise ConfigurationError for the first of some names that is not one of the cars of a world."""
    for name in names:
        if name not in cars:
            raise ConfigurationError(f"drivers: {name!r} is not a car of this scene{nearest(name, cars)}")

"""Base classes of scenes: recorded ones, and stepped worlds, whose truth follows from commands."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from mast_zenoh.arrays.states import Floats
from mast_zenoh.driving.motion import Command, RouteAhead
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import Detector

if TYPE_CHECKING:
    from mast_zenoh.scenes.making.observe import World


class Scene(ABC):
    """A source of ground truth, which prepares a `Recording`.

    A subclass takes its parameters as keywords.

    short_name:     what comes before the colon in short, as in `av2:PATH`; "": none; no two scenes have the same one
    short_argument: the parameter that comes after it; one with a default is a whole number and may be left out
    files:          variants of the files in a folder of this type: all patterns match, but none that begins with "!"
    """

    short_name: ClassVar[str] = ""
    short_argument: ClassVar[str] = "path"
    files: ClassVar[tuple[tuple[str, ...], ...]] = ()

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether a file or folder looks like a scene of this type."""

        def matches(pattern: str) -> bool:
            return any(path.glob(pattern.removeprefix("!"))) != pattern.startswith("!")

        return path.is_dir() and any(all(map(matches, variant)) for variant in cls.files)

    @classmethod
    def named(cls, argument: str) -> type[Scene]:
        """The type that the short name means with this argument; another one for other files of the same program."""
        return cls

    @abstractmethod
    def record(self, seed: int, frames: int | None) -> Recording:
        """Record the scene's first `frames` frames (None: all, or its default number).

        The result depends on (self, seed) alone. Raises SceneError with file, place and reason when data is missing,
        truncated or inconsistent, and ConfigurationError for an invalid parameter.
        """

    def world(self, seed: int, frames: int | None) -> SteppedWorld:
        """The scene of `record` as a world that drivers change, in its first frame.

        Raises ConfigurationError for a scene that cannot be stepped: only `record` is required of a scene.
        """
        raise ConfigurationError(
            f"scene: {type(self).__name__} cannot be stepped, so its cars cannot be driven: expected Intersection, "
            "StraightRoad, SumoTraffic, or a scene of yours that defines `world`; or leave out `drivers`"
        )

    def inputs(self) -> Sequence[Path]:
        """Files and folders that the recording depends on; the disk cache tracks them."""
        return ()


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

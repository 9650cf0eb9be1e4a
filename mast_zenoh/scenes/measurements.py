"""When the sensors of a recording measured, and where their agents were then."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.errors import SceneError

#: In place of the age of a measurement, in frames without a new one.
NO_MEASUREMENT = -1


@dataclass(frozen=True, eq=False)
class Measurements:
    """The new measurements of S sensors in F frames.

    age_ns:   (F, S) int64, ns, time of the frame minus that of the measurement; NO_MEASUREMENT: none is new
    position: (F, S, 3) m, of the sensor's agent when it measured, world frame
    rotation: (F, S, 3, 3) active, agent to world, at that time
    """

    age_ns: Ints
    position: Floats
    rotation: Floats

    def select(self, frames: slice, sensors: slice | Ints) -> Measurements:
        """Those of some frames and sensors."""
        part = frames, sensors
        return Measurements(self.age_ns[part], self.position[part], self.rotation[part])

    def arrays(self) -> dict[str, NDArray[np.int64] | Floats]:
        """All arrays by name."""
        return {"age_ns": self.age_ns, "position": self.position, "rotation": self.rotation}

    def problems(self, times_ns: Ints, names: list[str]) -> Iterator[str]:
        """What is wrong with them, each in a sentence.

        times_ns: (F,) of the frames; names: (S,) of the sensors
        """
        frames, sensors = len(times_ns), len(names)
        for name, shape in (("age_ns", ()), ("position", (3,)), ("rotation", (3, 3))):
            values = getattr(self, name)
            if values.shape != (frames, sensors, *shape):
                yield f"measurements.{name} has shape {values.shape}, expected {(frames, sensors, *shape)}"
                return
            if not np.isfinite(values).all():
                yield f"measurements.{name} has a number that is not finite"
        latest = np.concatenate([[0], np.diff(times_ns) - 1])
        invalid = np.argwhere((self.age_ns < NO_MEASUREMENT) | (self.age_ns > latest[:, None]))
        if len(invalid):
            frame, sensor = invalid[0].tolist()
            yield (
                f"measurements.age_ns: {names[sensor]} in frame {frame}: found {self.age_ns[frame, sensor]} ns, "
                f"expected {NO_MEASUREMENT} (none), or 0 to {latest[frame]}: after the frame before it"
            )

    def check(self, place: str, times_ns: Ints, names: list[str]) -> None:
        """Raise SceneError for the first problem. place: of the recording, for the message"""
        for problem in self.problems(times_ns, names):
            raise SceneError(f"{place}: {problem}")

"""When the sensors of a scene measure, and in which frames their measurements are new."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Ints
from mast_zenoh.errors import ConfigurationError

_NONE = -1
#: Longest time between two measurements, in frames.
_LONGEST_FRAMES = 1e6


@dataclass(frozen=True, eq=False)
class Schedule:
    """The measurements of one sensor that are new in each of F frames.

    A measurement at a time after the frame before and up to a frame's is new in that frame. Of several, the newest is.

    source:  (F,) frame that a measurement was recorded with: the nearest one, often the frame itself; -1: none is new
    time_ns: (F,) ns, of the measurement, on the clock of the frames; arbitrary where none is new
    """

    source: Ints
    time_ns: Ints

    @classmethod
    def recorded(cls, times_ns: Ints, measured_ns: Ints, source: Ints | None = None) -> Schedule:
        """The schedule of measurements at `measured_ns` (K,) ns.

        times_ns: (F,) of the frames, ascending; source: (K,) frame of each; None: the frame in which it is new

        Measurements before the first frame or after the last one are never new.
        """
        frame = np.searchsorted(times_ns, measured_ns, side="left")
        kept = np.flatnonzero((measured_ns >= times_ns[0]) & (frame < len(times_ns)))
        kept = kept[np.argsort(measured_ns[kept], kind="stable")]  # of several in a frame, the last one stays
        new, time_ns = np.full(len(times_ns), _NONE, np.int64), np.zeros(len(times_ns), np.int64)
        new[frame[kept]] = frame[kept] if source is None else source[kept]
        time_ns[frame[kept]] = measured_ns[kept]
        return cls(new, time_ns)

    @classmethod
    def regular(cls, times_ns: Ints, period_ns: int, phase_ns: int) -> Schedule:
        """Measurements `phase_ns` after the first frame, and every `period_ns` from then on."""
        first = int(times_ns[0]) + phase_ns
        return cls.recorded(times_ns, np.arange(first, int(times_ns[-1]) + 1, period_ns, dtype=np.int64))

    def before(self, frames: int) -> Schedule:
        """That of the first frames, without measurements that were recorded with a later one."""
        source = self.source[:frames]
        return Schedule(np.where(source < frames, source, _NONE), self.time_ns[:frames])


def regular_times(place: str, frame_ns: int, rate_hz: float, phase_s: float) -> tuple[int, int]:
    """Period and phase, ns, of a sensor with `rate_hz` measurements per second.

    place: of the sensor, for messages; frame_ns: between two frames
    Raises ConfigurationError for a rate that is not positive or above that of the frames, and for a phase outside one
    period.
    """
    if not 0.0 < rate_hz < float("inf"):
        raise ConfigurationError(f"{place}: rate_hz is {rate_hz!r}, expected a number above 0")
    frames = 1e9 / rate_hz / frame_ns
    if not frames < _LONGEST_FRAMES:
        raise ConfigurationError(
            f"{place}: rate_hz is {rate_hz:g}, expected at least {1e9 / frame_ns / _LONGEST_FRAMES:g}"
        )
    # Frames at 30 Hz are 33,333,333 ns apart: a sensor at 15 Hz measures in every second one, not 1 ns after it.
    whole = abs(frames - round(frames)) < 1e-6
    period_ns = round(frames) * frame_ns if whole else round(1e9 / rate_hz)
    if period_ns < frame_ns:
        raise ConfigurationError(
            f"{place}: rate_hz is {rate_hz:g}, expected at most {1e9 / frame_ns:g}, the rate of the frames: a sensor "
            "has at most one new measurement in a frame; raise the rate of the scene's frames, or lower the sensor's"
        )
    phase_ns = round(phase_s * 1e9) if 0.0 <= phase_s < 1e9 else -1
    if not 0 <= phase_ns < period_ns:
        raise ConfigurationError(
            f"{place}: phase_s is {phase_s:g}, expected 0 to less than {1 / rate_hz:g}, the time between measurements"
        )
    return period_ns, phase_ns

"""Types of sensors, when they measure, and the sensors of the agents of a scene."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import ClassVar, NamedTuple

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_yaw_pitch
from mast_zenoh.arrays.states import Ints
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.scenes.agents import SceneAgent, SceneSensor, best_pattern
from mast_zenoh.sensing import DetectionModel, Detector, LidarSensor

_NONE = -1
#: Longest time between two measurements, in frames.
_LONGEST_FRAMES = 1e6


@dataclass(frozen=True, eq=False)
class SensorSchedule:
    """The measurements of one sensor that are new in each of F frames.

    A measurement at a time after the frame before and up to a frame's is new in that frame. Of several, the newest is.

    source:  (F,) frame that a measurement was recorded with: the nearest one, often the frame itself; -1: none is new
    time_ns: (F,) ns, of the measurement, on the clock of the frames; arbitrary where none is new
    """

    source: Ints
    time_ns: Ints

    @classmethod
    def recorded(cls, times_ns: Ints, measured_ns: Ints, source: Ints | None = None) -> SensorSchedule:
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
    def regular(cls, times_ns: Ints, period_ns: int, phase_ns: int) -> SensorSchedule:
        """Measurements `phase_ns` after the first frame, and every `period_ns` from then on."""
        first = int(times_ns[0]) + phase_ns
        return cls.recorded(times_ns, np.arange(first, int(times_ns[-1]) + 1, period_ns, dtype=np.int64))

    def before(self, frames: int) -> SensorSchedule:
        """That of the first frames, without measurements that were recorded with a later one."""
        source = self.source[:frames]
        return SensorSchedule(np.where(source < frames, source, _NONE), self.time_ns[:frames])


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


@dataclass(kw_only=True, eq=False)
class Sensor(ABC):
    """Base of the types of sensors.

    name:          in the key of its wire, unless it is the first sensor of its agent; None: that of its kind
    rate_hz:       measurements per second; None: one in every frame, at the frame's time
    phase_s:       s from the first frame to the first measurement, less than the time between two
    position:      (x, y, z) m, in the agent's frame; None: that of the agent's own lidar
    yaw_deg, pitch_deg: deg, counter-clockwise and down, where it looks in the agent's frame; None: as that lidar, or 0
                   if the other one is given
    azimuth_deg, elevation_deg: deg, (from, to) of its field of view; range_m: m; None: those of its type
    detector:      the model that generates its detections; None: that of its type
    detection_probability: of an object in full view, which trackers assume; None: that of its type

    What it sees is decided by casting rays, whatever its kind.
    """

    kind: ClassVar[str]
    assumed_probability: ClassVar[float | None] = None

    name: str | None = None
    rate_hz: float | None = None
    phase_s: float = 0.0
    position: tuple[float, float, float] | None = None
    yaw_deg: float | None = None
    pitch_deg: float | None = None
    azimuth_deg: tuple[float, float] | None = None
    elevation_deg: tuple[float, float] | None = None
    range_m: float | None = None
    detector: Detector | None = None
    detection_probability: float | None = None

    def __post_init__(self) -> None:
        if self.rate_hz is None and self.phase_s != 0.0:
            raise ValueError(f"phase_s: found {self.phase_s}, expected 0 for a sensor without rate_hz")
        self.detector = self.usual_detector() if self.detector is None else self.detector
        if self.detection_probability is None:
            self.detection_probability = self.assumed_probability

    @abstractmethod
    def geometry(self, own: LidarSensor) -> LidarSensor:
        """Field of view, range and rays of the type. own: the agent's own lidar, for its mount"""

    def usual_detector(self) -> Detector | None:
        """The detector of the type; None: that of the scene."""
        return None

    def fitted(self, own: LidarSensor) -> SceneSensor:
        """This sensor on an agent. own: the agent's own lidar

        Raises ValueError for a field of view or a mount that cannot be.
        """
        lidar = self.geometry(own)
        changes: dict[str, object] = {}
        if self.position is not None:
            changes["mount_position"] = np.array(self.position)
        if self.yaw_deg is not None or self.pitch_deg is not None:
            turn = np.radians(self.yaw_deg or 0.0), np.radians(self.pitch_deg or 0.0)
            changes["mount_rotation"] = rotation_from_yaw_pitch(float(turn[0]), float(turn[1]))
        for name, limits in (("azimuth", self.azimuth_deg), ("elevation", self.elevation_deg)):
            if limits is not None:
                changes |= {f"{name}_min_deg": limits[0], f"{name}_max_deg": limits[1]}
        if self.range_m is not None:
            changes["max_range_m"] = self.range_m
        name = self.kind if self.name is None else self.name
        return SceneSensor(name, self.kind, replace(lidar, **changes), self.detection_probability)  # type: ignore[arg-type]  # by name


#: Sensors by agent: a name or a pattern ("infra_*") to the sensors of each of these agents.
SensorsByAgent = Mapping[str, tuple[Sensor, ...]]


class Lidar(Sensor):
    """A lidar: by default the agent's own, with the detector of the scene."""

    kind = "lidar"

    def geometry(self, own: LidarSensor) -> LidarSensor:
        return own


class Radar(Sensor):
    """A radar: 90 degrees wide and 30 high, 120 m; far and coarse, with few false detections.

    The numbers are typical, and not fitted to a product.
    """

    kind = "radar"
    assumed_probability = 0.7

    def geometry(self, own: LidarSensor) -> LidarSensor:
        return LidarSensor(own.mount_position, own.mount_rotation, -45.0, 45.0, 1.0, -15.0, 15.0, 16, 120.0)

    def usual_detector(self) -> Detector:
        return DetectionModel(
            min_points=1,
            points_scale=2.0,
            position_noise_m=0.5,
            vertical_noise_m=1.0,
            size_noise_m=0.5,
            yaw_noise_deg=10.0,
            few_points=2.0,
            clutter_rate=1.0,
            clutter_range_m=120.0,
        )


class ObjectCamera(Sensor):
    """A camera with a detector of 3D boxes: 90 degrees wide, 80 m; its errors grow quickly with range.

    The numbers are typical, and not fitted to a product.
    """

    kind = "camera"
    assumed_probability = 0.85

    def geometry(self, own: LidarSensor) -> LidarSensor:
        return LidarSensor(own.mount_position, own.mount_rotation, -45.0, 45.0, 0.5, -30.0, 15.0, 64, 80.0)

    def usual_detector(self) -> Detector:
        return DetectionModel(
            points_scale=15.0, position_noise_m=0.5, range_scale_m=25.0, yaw_noise_deg=6.0, clutter_rate=1.0
        )


class Rig(NamedTuple):
    """What a sensor does: when it measures, and the detector of its detections.

    schedule: None: it measures in every frame, at its time; detector: None: that of the scene
    """

    schedule: SensorSchedule | None = None
    detector: Detector | None = None


def equip(
    place: str, agents: Sequence[SceneAgent], sensors: SensorsByAgent, times_ns: Ints, period_ns: int
) -> tuple[tuple[SceneAgent, ...], tuple[Rig, ...]]:
    """The agents with their sensors, and what each of the sensors does, agent by agent.

    place: of the scene, for messages; sensors: others keep their own lidar; times_ns: (F,); period_ns: of the frames

    The most specific pattern counts: a plain name, else the longest. Raises ConfigurationError for a pattern that no
    agent matches, two sensors of an agent with one name, and a sensor that cannot be.
    """
    names = [agent.name for agent in agents]
    for pattern in sensors:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise ConfigurationError(f"{place}: sensors: no agent {pattern!r} in this scene{nearest(pattern, names)}")
    equipped, rigs = [], []
    for agent in agents:
        matching = best_pattern(sensors, agent.name)
        if matching is None:
            equipped.append(agent)
            rigs.append(Rig())
            continue
        chosen, where = sensors[matching], f"{place}: sensors[{matching!r}]"
        if not chosen:
            raise ConfigurationError(f"{where}: found no sensor, expected at least one")
        fitted = []
        for row, sensor in enumerate(chosen):
            schedule = None
            if sensor.rate_hz is not None:
                times = regular_times(f"{where}[{row}]", period_ns, sensor.rate_hz, sensor.phase_s)
                if times != (period_ns, 0):
                    schedule = SensorSchedule.regular(times_ns, *times)
            try:
                fitted.append(sensor.fitted(agent.sensor))
            except ValueError as error:
                raise ConfigurationError(f"{where}[{row}]: {error}") from None
            rigs.append(Rig(schedule, sensor.detector))
        if len({each.name for each in fitted}) < len(fitted):
            found = ", ".join(each.name for each in fitted)
            raise ConfigurationError(
                f"{where}: found sensors named {found}, expected different names: give each a name"
            )
        equipped.append(replace(agent, sensor=fitted[0].lidar, sensors=tuple(fitted)))
    return tuple(equipped), tuple(rigs)

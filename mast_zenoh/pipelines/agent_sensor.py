"""A sensor as its agent knows it."""

from __future__ import annotations

from dataclasses import dataclass

from mast_zenoh.sensing import LidarSensor

#: For each frame: a new measurement is due, or none is.
DUE, IDLE = "1", "0"


@dataclass(frozen=True, eq=False)
class AgentSensor:
    """One of several sensors of an agent, or one that measures at times of its own.

    name:           of the sensor
    lidar:          its field of view and range
    mount_position: (x, y, z) m, of the sensor in the agent's frame; its messages have the mount at their time
    mount_rotation: (w, x, y, z) active quaternion, sensor to agent
    frames:         for each frame of the run DUE or IDLE, repeated after the last; empty: a measurement is due in every
                    frame
    detection_probability: of an object in full view; None: that of the tracker

    Raises ValueError for other frames, and a probability outside (0, 1).
    """

    name: str
    lidar: LidarSensor
    mount_position: tuple[float, float, float]
    mount_rotation: tuple[float, float, float, float]
    frames: str = ""
    detection_probability: float | None = None

    def __post_init__(self) -> None:
        if self.frames.strip(DUE + IDLE):
            raise ValueError(f"frames: found {self.frames[:20]!r}, expected {DUE} or {IDLE} for each frame")
        if self.detection_probability is not None and not 0.0 < self.detection_probability < 1.0:
            raise ValueError(f"detection_probability: found {self.detection_probability}, expected between 0 and 1")

    def due(self, frame: int) -> bool:
        """Whether it sends a measurement in a frame."""
        return not self.frames or self.frames[frame % len(self.frames)] == DUE

"""Cooperative awareness: what a vehicle knows of itself, and when it says so (ETSI TS 103 900 v2.1.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import CLASS_INDEX, Floats, ObjectStates


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """What a vehicle knows of itself besides its pose.

    size: m, length, width, height;  kind: name of its class
    position_std_m, height_std_m, velocity_std_mps: standard deviations of its own positioning, of each component
    """

    size: tuple[float, float, float] = (4.5, 1.8, 1.5)
    kind: str = "car"
    position_std_m: float = 0.25
    height_std_m: float = 1.0
    velocity_std_mps: float = 0.1

    def __post_init__(self) -> None:
        check("more than 0, finite", **{f"size[{i}]": side for i, side in enumerate(self.size)})
        check("more than 0, finite", position_std_m=self.position_std_m, height_std_m=self.height_std_m)
        check("more than 0, finite", velocity_std_mps=self.velocity_std_mps)
        if self.kind not in CLASS_INDEX:
            raise ValueError(f"kind: found {self.kind!r}, expected one of {', '.join(CLASS_INDEX)}")

    def state(self, place: Floats, velocity: Floats, yaw: float) -> ObjectStates:
        """Its own state, one row, id 0, world frame.

        place: (3,) m, on the ground below its centre; velocity: (3,) m/s; yaw: rad
        """
        centre = place + np.array([0.0, 0.0, 0.5 * self.size[2]])
        std = [*(2 * [self.position_std_m]), self.height_std_m, *(3 * [0.1]), *(3 * [self.velocity_std_mps])]
        return ObjectStates.of(
            centre[None],
            velocity=velocity[None],
            size=np.array([self.size], np.float64),
            yaw=np.array([yaw]),
            covariance=np.diag(np.square(std))[None],
            class_id=np.array([CLASS_INDEX[self.kind]], np.uint8),
        )


class CamDecision(NamedTuple):
    """Whether a CAM is generated now, and whether it has the low-frequency container."""

    generated: bool
    low_frequency: bool


class _Sent(NamedTuple):
    """What the last CAM said: time, ns; position (3,) m; speed, m/s; heading, rad."""

    time_ns: int
    position: Floats
    speed: float
    yaw: float


@dataclass(kw_only=True, eq=False)
class CamGeneration:
    """Decides at each frame whether a station generates a CAM (TS 103 900 v2.1.1, clause 6.1.3).

    A CAM is sent at once if the station has moved or turned or changed its speed since the last one. Further ones
    follow at the interval after which that happened, `repeats` times, then every `most_s`.

    least_s, most_s: s, limits of the time between two CAMs (T_GenCamMin, T_GenCamMax)
    heading_deg, moved_m, speed_mps: changes of °, m and m/s that call for a CAM
    repeats: number of CAMs at the interval of the last change (N_GenCam)
    low_frequency_s: s, between two low-frequency containers
    tolerance_s: s, by which a frame may be early and still count as due; times of frames are rounded
    """

    least_s: float = 0.1
    most_s: float = 1.0
    heading_deg: float = 4.0
    moved_m: float = 4.0
    speed_mps: float = 0.5
    repeats: int = 3
    low_frequency_s: float = 0.5
    tolerance_s: float = 0.001

    def __post_init__(self) -> None:
        check("more than 0 and at most 60 s", least_s=self.least_s, most_s=self.most_s)
        check("more than 0, finite", low_frequency_s=self.low_frequency_s)
        check("0 or more, finite", heading_deg=self.heading_deg, moved_m=self.moved_m, speed_mps=self.speed_mps)
        check("0 or more, finite", tolerance_s=self.tolerance_s)
        check("1 or more", repeats=self.repeats)
        if self.least_s > self.most_s:
            raise ValueError(f"least_s: found {self.least_s}, expected at most `most_s`, which is {self.most_s}")
        self._sent: _Sent | None = None
        self._low_frequency_ns: int | None = None
        self._period_s = self.most_s
        self._repeated = 0

    def generate(self, time_ns: int, position: Floats, velocity: Floats, yaw: float) -> CamDecision:
        """Whether to send a CAM now.

        position: (3,) m; velocity: (3,) m/s; yaw: rad, of the station, world frame
        """
        now = _Sent(time_ns, position, float(np.linalg.norm(velocity)), yaw)
        if not self._is_due(now):
            return CamDecision(False, False)
        self._sent = now
        low_frequency = self._passed(time_ns, self._low_frequency_ns, self.low_frequency_s)
        if low_frequency:
            self._low_frequency_ns = time_ns
        return CamDecision(True, low_frequency)

    def _is_due(self, now: _Sent) -> bool:
        """Whether to send a CAM; updates the period."""
        if self._sent is None:
            return True
        last_ns = self._sent.time_ns
        if not self._passed(now.time_ns, last_ns, self.least_s):
            return False
        if self._changed(self._sent, now):
            self._period_s = min((now.time_ns - last_ns) / 1e9, self.most_s)
            self._repeated = 0
            return True
        if not self._passed(now.time_ns, last_ns, self._period_s):
            return False
        self._repeated += 1
        if self._repeated >= self.repeats:
            self._period_s = self.most_s
        return True

    def _changed(self, last: _Sent, now: _Sent) -> bool:
        turned = abs(float(wrap_angle(np.array(now.yaw - last.yaw))))
        return (
            turned > np.radians(self.heading_deg)
            or float(np.linalg.norm(now.position - last.position)) > self.moved_m
            or abs(now.speed - last.speed) > self.speed_mps
        )

    def _passed(self, now_ns: int, last_ns: int | None, period_s: float) -> bool:
        return last_ns is None or now_ns - last_ns >= round((period_s - self.tolerance_s) * 1e9)

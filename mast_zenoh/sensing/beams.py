"""The beams of lidars: their directions and times, of common models."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.geometry import unit_vectors
from mast_zenoh.arrays.states import Floats
from mast_zenoh.sensing.sensors import LidarSensor


@dataclass(frozen=True, eq=False)
class Beams:
    """The beams of one turn of a lidar, or of one pass over its sector: c channels fire at each of m azimuths.

    azimuth:     (m,) rad, ascending, counter-clockwise from x
    elevation:   (c,) rad, ascending
    offset:      (c,) rad, added to the azimuth of a channel
    time_s:      (m,) s, of each azimuth, from the time of the scan, which is when the lidar looks along x
    min_range_m, max_range_m: of a return
    """

    azimuth: Floats
    elevation: Floats
    offset: Floats
    time_s: Floats
    min_range_m: float
    max_range_m: float

    @classmethod
    def of_sensor(cls, lidar: LidarSensor, period_s: float = 0.1) -> Beams:
        """The beams of a lidar whose turns take `period_s`, such as the paper's; 0: all at once."""
        azimuth, elevation = lidar.azimuths, lidar.elevations
        time = azimuth * (period_s / (2.0 * np.pi))
        return cls(azimuth, elevation, np.zeros(len(elevation)), time, 0.0, lidar.max_range_m)

    @property
    def step(self) -> float:
        """rad, between two azimuths."""
        return float(self.azimuth[1] - self.azimuth[0]) if len(self.azimuth) > 1 else 2.0 * np.pi

    @property
    def turn(self) -> int:
        """How many azimuths a full turn has, or would have."""
        return max(round(2.0 * np.pi / self.step), len(self.azimuth))

    @property
    def longest_s(self) -> float:
        """s, between the time of the scan and its first or last beam."""
        return float(np.abs(self.time_s).max(initial=0.0))

    def directions(self) -> Floats:
        """(m, c, 3) unit vectors in the frame of the lidar."""
        return unit_vectors(self.azimuth[:, None] + self.offset, self.elevation)


@dataclass(frozen=True)
class LidarModel:
    """A lidar as its data sheet describes it.

    elevation_deg: deg, of the channels, ascending;  offset_deg: deg, of their azimuths; (): none
    azimuths: their number, in a sector of `sector_deg` degrees;  range_m: m, shortest and longest
    source: the data sheet
    """

    elevation_deg: tuple[float, ...]
    azimuths: int
    range_m: tuple[float, float]
    source: str
    offset_deg: tuple[float, ...] = ()
    sector_deg: float = 360.0

    def __str__(self) -> str:
        low, high = self.elevation_deg[0], self.elevation_deg[-1]
        channels = f"{len(self.elevation_deg)} channels from {low:g}° to {high:g}°"
        return f"{channels}, {self.azimuths} azimuths in {self.sector_deg:g}°, {self.range_m[1]:g} m ({self.source})"

    def beams(self, period_s: float = 0.1) -> Beams:
        """The beams of a turn that takes `period_s`; 0: all at once."""
        step = np.radians(self.sector_deg) / self.azimuths
        azimuth = step * (np.arange(self.azimuths) + 0.5) - np.radians(self.sector_deg) / 2.0
        elevation = np.radians(self.elevation_deg)
        offset = np.radians(self.offset_deg) if self.offset_deg else np.zeros(len(elevation))
        return Beams(azimuth, elevation, offset, azimuth * (period_s / (2.0 * np.pi)), *self.range_m)

    def sensor(self, mount_position: Floats, mount_rotation: Floats) -> LidarSensor:
        """Its limits of azimuth, elevation and range on a mount: (3,) m and (3, 3) active, lidar to agent.

        The limits hold for all models; the channels of some are not evenly spaced, as those of a `LidarSensor` are.
        """
        half = self.sector_deg / 2.0
        return LidarSensor(
            mount_position=mount_position,
            mount_rotation=mount_rotation,
            azimuth_min_deg=-half,
            azimuth_max_deg=half,
            azimuth_step_deg=self.sector_deg / self.azimuths,
            elevation_min_deg=self.elevation_deg[0],
            elevation_max_deg=self.elevation_deg[-1],
            channels=len(self.elevation_deg),
            max_range_m=self.range_m[1],
        )


def _even(low: float, high: float, count: int) -> tuple[float, ...]:
    return tuple(np.linspace(low, high, count).tolist())


#: deg, of the channels of the VLP-32C: elevations and azimuths.
_VLP_32C_ELEVATION, _VLP_32C_OFFSET = zip(
    (-25.0, 1.4), (-15.639, -1.4), (-11.31, 1.4), (-8.843, -1.4), (-7.254, 1.4), (-6.148, -1.4), (-5.333, 4.2),
    (-4.667, 1.4), (-4.0, -1.4), (-3.667, -4.2), (-3.333, 4.2), (-3.0, 1.4), (-2.667, -1.4), (-2.333, -4.2),
    (-2.0, 4.2), (-1.667, 1.4), (-1.333, -1.4), (-1.0, -4.2), (-0.667, 4.2), (-0.333, 1.4), (0.0, -1.4),
    (0.333, -4.2), (0.667, 4.2), (1.0, 1.4), (1.333, -1.4), (1.667, -4.2), (2.333, 1.4), (3.333, -1.4),
    (4.667, 1.4), (7.0, -1.4), (10.333, 1.4), (15.0, -1.4), strict=True,
)  # fmt: skip

#: Common lidars at 10 turns a second, by name.
MODELS = {
    "VLP-16": LidarModel(_even(-15.0, 15.0, 16), 1800, (0.5, 100.0), "Velodyne 63-9229"),
    "VLP-32C": LidarModel(_VLP_32C_ELEVATION, 1800, (0.5, 200.0), "Velodyne 63-9325", _VLP_32C_OFFSET),
    "HDL-32E": LidarModel(_even(-30.67, 10.67, 32), 1800, (0.9, 100.0), "Velodyne 97-0038"),
    "HDL-64E": LidarModel(
        (*_even(-24.33, -8.83, 32), *_even(-8.33, 2.0, 32)), 2083, (0.9, 120.0), "Velodyne 63-HDL64ES3"
    ),
    "XT32": LidarModel(_even(-16.0, 15.0, 32), 2000, (0.05, 120.0), "Hesai PandarXT-32"),
    "AT128": LidarModel(_even(-12.5, 12.9, 128), 1200, (0.5, 200.0), "Hesai AT128", sector_deg=120.0),
    "OS1-128": LidarModel(_even(-22.5, 22.5, 128), 1024, (0.3, 120.0), "Ouster OS1"),
}

"""Returns: what a lidar reports of a scan, with noise, losses, rain and dust.

The power that comes back decides. It is relative to that of a surface of 10 % reflectivity at `dark_range_m`, the limit
that data sheets state, and falls with the square of the range and with extinction (Kilic et al. 2021, LISA,
arXiv:2107.07004, section 3.1). Surfaces are rough: Oren and Nayar 1994, qualitative model, lit from where it is seen.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from statistics import NormalDist
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import rotation_from_yaw
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.sensing.beams import Beams
from mast_zenoh.sensing.points import Points, Singles
from mast_zenoh.sensing.scan import Moving, Scan, ScanPose, firing_axes, firings

#: What returned a point that is no surface, beside `scan.GROUND` and `scan.WALL`.
RAIN, DUST = -4, -5
#: Share of light of 900 nm that surfaces reflect, by class (`states.CLASSES`). Road users: assumed means, as paint and
#: clothes have 5 % to 85 %. "unknown", which may be vegetation: between concrete (24 %) and trees (30 to 60 %), both in
#: Wehr and Lohr 1999, table 1.
REFLECTIVITY: Floats = np.array([0.3, 0.3, 0.4, 0.4, 0.25, 0.3, 0.35])

#: A draw is 64 bits: a row of the table of noise, one of that of power, a place, and a power.
_BITS, _PLACE_BITS = 12, 20
_LEVELS, _PLACES = 1 << _BITS, 1 << _PLACE_BITS
#: m, between two echoes that a pulse of 5 ns tells apart, and the depth of dust that it lights at a time.
_PULSE_M = 0.75
#: m, range from which the receiver sees all of a beam; of nearer echoes less, by the square (assumed).
_OVERLAP_M = 3.0
#: Of water: the light that goes straight back from a drop's surface, refractive index 1.328 (Kilic et al. 2021).
_WATER = (0.328 / 2.328) ** 2
#: sr, extinction by backscatter of mineral dust: Tesche et al. 2009, Tellus B 61.
_DUST_SR = 55.0
#: Reflectivity for which data sheets state the range.
_DARK = 0.1


class Echoes(NamedTuple):
    """What comes back on beams (m, c).

    range_m: float32 m, inf: nothing;  source: int32, as of a `Scan`
    power:   float32, relative to a dark surface that faces the lidar at its limit
    """

    range_m: Singles
    source: NDArray[np.int32]
    power: Singles


class Receiver(NamedTuple):
    """How echoes are measured.

    noise, least: (4096,) float32, by draw: m of error, and the power that is needed
    unit: m^2, by which the power times the square of the range is an intensity;  nearest_m, farthest_m: m, of returns
    """

    noise: Singles
    least: Singles
    unit: float
    nearest_m: float
    farthest_m: float


class Firings(NamedTuple):
    """Where beams start and go, in the lidar's frame at the time of the scan; float32.

    origin: (m, 3) m;  axes: (m, 3, 3) ahead, left and up of each azimuth by column;  channels: (3, c) along them
    time_s: (m,)
    """

    origin: Singles
    axes: Singles
    channels: Singles
    time_s: Singles


@kernel
def surface_echoes(
    range_m: Floats, source: NDArray[np.int32], cosine: Floats, shades: Singles, lit: float, grazing: float
) -> Echoes:
    """The echoes of the surfaces of a scan, whose arrays are the first three.

    shades: (k,) power at 1 m of a surface by its source, the last by negative ones
    lit, grazing: shares of the cosine and of the square of the sine
    """
    near = range_m.astype(np.float32)
    across = cosine.astype(np.float32)
    one = np.float32(1.0)
    power = shades[source] * (np.float32(lit) * across + np.float32(grazing) * (one - across * across))
    return Echoes(near, source, power / np.maximum(near * near, np.float32(1e-6)))


@kernel
def measured_points(
    echoes: Echoes, draws: NDArray[np.uint64], receiver: Receiver, firings: Firings
) -> tuple[Singles, Singles, Singles, NDArray[np.uint8], Ints]:
    """The columns of `Points`, and the source of each, of the echoes that are found.

    draws: (m, c), of which the lowest bits are two rows of the receiver's tables
    """
    range_m, source, power = echoes
    measured = range_m + receiver.noise[draws & np.uint64(_LEVELS - 1)]
    kept = (power > 0.0) & (power >= receiver.least[_fade(draws)])
    kept &= (range_m >= receiver.nearest_m) & (measured <= receiver.farthest_m)
    azimuth, channel = np.nonzero(kept)
    along, near = measured[kept][:, None], range_m[kept]
    ahead, left, up = np.moveaxis(firings.axes[azimuth], 2, 0)
    x, y, z = (each[channel][:, None] for each in firings.channels)
    position = firings.origin[azimuth] + along * (ahead * x + left * y + up * z)
    intensity = np.minimum(power[kept] * (near * near) * np.float32(receiver.unit), np.float32(1.0))
    return position, intensity, firings.time_s[azimuth], channel.astype(np.uint8), source[kept].astype(np.int64)


class _Particles(NamedTuple):
    """The first particle on a beam that returns enough light, by draw.

    range_m: (k,) m, by draw of 20 bits; draws from k on have no particle
    scale:   (k,) mean of the exponential excess above the limit: of the power (dust), of its root (rain)
    """

    range_m: Singles
    scale: Singles


@dataclass(kw_only=True, eq=False)
class Returns:
    """Turns scans into points: one return of each beam at most.

    range_std_m:      m, of the measured range
    dark_range_m:     m, to which half of the surfaces of 10 % reflectivity are found that face the lidar; data sheets
                      have 50 m for the HDL-64E, 80 m for the XT32, 90 m for the OS1 and 200 m for the AT128
    fading:           standard deviation of the logarithm of the power
    dropout:          share of returns lost at random
    ground_reflectivity, wall_reflectivity: 0 to 1, of asphalt and concrete by default (Wehr and Lohr 1999, table 1)
    roughness_rad:    rad, of surfaces, Oren and Nayar 1994; 0: Lambertian
    returns:          which of two is reported: the strongest or the last. There are two where rain or dust is before a
                      surface and, for "last", where the footprint of a beam reaches over an edge to the next azimuth
    divergence_rad:   rad, full angle of a beam; 3 mrad of the VLP-16 (Velodyne 63-9243)
    rain_mm_h:        mm/h, of rain: drops by Marshall and Palmer 1948, extinction by twice their cross-section
    visibility_m:     m, in dust, by Koschmieder; 0: no dust. Rain and dust exclude each other

    Raises ValueError for a number that is not as described.
    """

    range_std_m: float = 0.02
    dark_range_m: float = 60.0
    fading: float = 0.3
    dropout: float = 0.0
    ground_reflectivity: float = 0.17
    wall_reflectivity: float = 0.24
    roughness_rad: float = 0.3
    returns: Literal["strongest", "last"] = "strongest"
    divergence_rad: float = 0.003
    rain_mm_h: float = 0.0
    visibility_m: float = 0.0
    _known: dict[float, _Particles] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        check("0 or more, finite", range_std_m=self.range_std_m, fading=self.fading, roughness_rad=self.roughness_rad)
        check("more than 0, finite", dark_range_m=self.dark_range_m, divergence_rad=self.divergence_rad)
        check("0 to 1", dropout=self.dropout)
        check("0 to 1", ground_reflectivity=self.ground_reflectivity, wall_reflectivity=self.wall_reflectivity)
        check("0 to 1000", rain_mm_h=self.rain_mm_h)
        check("0 or more, finite", visibility_m=self.visibility_m)
        if self.returns not in ("strongest", "last"):
            raise ValueError(f"returns: found {self.returns!r}, expected 'strongest' or 'last'")
        if self.rain_mm_h > 0.0 and self.visibility_m > 0.0:
            raise ValueError(f"visibility_m: found {self.visibility_m} with rain_mm_h, expected one of them")

    def measure(
        self,
        scan: Scan,
        beams: Beams,
        lidar: Moving,
        mount: Floats,
        reflectivity: Floats,
        random: np.random.Generator,
    ) -> tuple[Points, Ints]:
        """The points of a scan, and the source (n,) of each: row of an object, GROUND, WALL, RAIN or DUST.

        scan, beams, lidar, mount: see `scan.cast`;  reflectivity: (n,) of the objects, 0 to 1 (`REFLECTIVITY`)

        As many numbers are drawn for each beam whatever it meets, so what one object more changes are the points of
        the beams that meet it and, for "last", of those beside them.
        """
        m, c = scan.range_m.shape
        if c > 256:
            raise ValueError(f"channels: found {c}, expected at most 256")
        draws = random.integers(0, 1 << 64, (m, c), np.uint64)
        shades = np.concatenate([reflectivity, [0.0, self.wall_reflectivity, self.ground_reflectivity]])
        shades *= self.dark_range_m**2 / _DARK
        square = self.roughness_rad**2
        lit, grazing = 1.0 - 0.5 * square / (square + 0.33), 0.45 * square / (square + 0.09)
        echoes = surface_echoes(*scan, shades.astype(np.float32), lit, grazing)
        if self._extinction:
            echoes.power[:] *= np.exp(np.float32(-2.0 * self._extinction) * echoes.range_m)
        if self.returns == "last":
            echoes = self._behind_edges(echoes, draws, beams)
        if self._extinction:
            echoes = self._with_particles(echoes, draws, beams.min_range_m)
        unit = _DARK / self.dark_range_m**2
        receiver = Receiver(self._noise, self._least, unit, beams.min_range_m, beams.max_range_m)
        columns = measured_points(echoes, draws, receiver, _firings(beams, lidar, mount))
        return Points(*columns[:4]), columns[4]

    @cached_property
    def _extinction(self) -> float:
        """1/m."""
        if self.rain_mm_h > 0.0:
            return np.pi * _DROPS / _slope(self.rain_mm_h) ** 3 * 1e-6
        return float(-np.log(0.02) / self.visibility_m) if self.visibility_m > 0.0 else 0.0

    @cached_property
    def _noise(self) -> Singles:
        return (self.range_std_m * _normal()).astype(np.float32)

    @cached_property
    def _least(self) -> Singles:
        lost = np.random.default_rng(0).permutation(_LEVELS) < round(self.dropout * _LEVELS)
        return np.where(lost, np.inf, np.exp(self.fading * _normal())).astype(np.float32)

    def _behind_edges(self, echoes: Echoes, draws: NDArray[np.uint64], beams: Beams) -> Echoes:
        """The echoes, with those from behind edges inside footprints; an edge is anywhere between two azimuths."""
        least = self._least[_fade(draws)]
        share = np.float32(0.5) - _uniform(_place(draws)) * np.float32(beams.step / self.divergence_rad)
        last = echoes
        for side in (1, -1):
            beside = Echoes._make(np.roll(column, side, axis=0) for column in echoes)
            beside.power[:] *= share
            behind = (beside.range_m < np.inf) & (beside.range_m > last.range_m + np.float32(_PULSE_M))
            behind &= beside.power >= least
            if len(beams.azimuth) < beams.turn:
                behind[0 if side == 1 else -1] = False  # no azimuth is beside it
            last = Echoes._make(np.where(behind, *columns) for columns in zip(beside, last, strict=True))
        return last

    def _particles(self, min_range_m: float) -> _Particles:
        """The particles of rain or dust, by draw, for beams that return from `min_range_m` on."""
        if min_range_m in self._known:
            return self._known[min_range_m]
        edges = np.linspace(min_range_m, min_range_m + 60.0, 6001)
        step, r = edges[1] - edges[0], (edges[1:] + edges[:-1]) / 2
        overlap = np.minimum(r / _OVERLAP_M, 1.0) ** 2
        gain = overlap * np.exp(-2.0 * self._extinction * r) * (self.dark_range_m / r) ** 2 / _DARK
        if self.rain_mm_h > 0.0:  # (drops that are large enough, times the section of the beam)
            width, slope = 1e3 * self.divergence_rad * r, _slope(self.rain_mm_h)
            least_mm = width / np.sqrt(_WATER * gain)
            density = _DROPS / slope * np.exp(-slope * least_mm) * np.pi / 4 * (width * 1e-3) ** 2
            density, scale = np.where(least_mm < width, density, 0.0), 1.0 / (slope * least_mm)
        else:  # a share of all cells, whose power is exponential as that of speckle
            scale = np.pi * self._extinction / _DUST_SR * _PULSE_M * gain
            density = np.exp(-1.0 / np.maximum(scale, 1e-9)) / _PULSE_M
        met = 1.0 - np.exp(-np.concatenate([[0.0], np.cumsum(density * step)]))
        places = (np.arange(_PLACES) + 0.5) / _PLACES
        where = np.interp(places[: np.searchsorted(places, met[-1])], met, edges)
        scale = np.interp(where, r, scale)
        self._known[min_range_m] = _Particles(where.astype(np.float32), scale.astype(np.float32))
        return self._known[min_range_m]

    def _with_particles(self, echoes: Echoes, draws: NDArray[np.uint64], min_range_m: float) -> Echoes:
        """The echoes, with particles where these are reported instead of surfaces."""
        particles = self._particles(min_range_m)
        beam = np.nonzero(_place(draws) < len(particles.range_m))
        chance, power = draws[beam], echoes.power[beam]
        rows, least = _place(chance), self._least[_fade(chance)]
        more = -np.log(_uniform(chance >> np.uint64(64 - _PLACE_BITS))) * particles.scale[rows]
        near, returned = particles.range_m[rows], 1.0 + more
        if self.rain_mm_h > 0.0:
            returned *= returned
        surface = np.where(power >= least, power, 0.0)
        instead = (near < echoes.range_m[beam]) & (returned >= least)
        instead &= returned > surface if self.returns == "strongest" else surface == 0.0
        beam, result = (beam[0][instead], beam[1][instead]), Echoes._make(column.copy() for column in echoes)
        result.range_m[beam], result.power[beam] = near[instead], returned[instead]
        result.source[beam] = RAIN if self.rain_mm_h > 0.0 else DUST
        return result


#: 1/m^3/mm, number of raindrops by diameter, towards 0 mm: Marshall and Palmer 1948.
_DROPS = 8000.0


def _slope(rain_mm_h: float) -> float:
    """1/mm, by which the number of raindrops falls with their diameter: Marshall and Palmer 1948."""
    return float(4.1 * rain_mm_h**-0.21)


def _fade(draws: NDArray[np.uint64]) -> NDArray[np.uint64]:
    return draws >> np.uint64(_BITS) & np.uint64(_LEVELS - 1)


def _place(draws: NDArray[np.uint64]) -> NDArray[np.uint64]:
    return draws >> np.uint64(2 * _BITS) & np.uint64(_PLACES - 1)


def _uniform(place: NDArray[np.uint64]) -> Singles:
    """0 to 1, both excluded."""
    return (place.astype(np.float32) + np.float32(0.5)) / np.float32(_PLACES)


def _normal() -> Floats:
    """(4096,) standard normal quantiles."""
    return np.array([NormalDist().inv_cdf((level + 0.5) / _LEVELS) for level in range(_LEVELS)])


def _firings(beams: Beams, lidar: Moving, mount: Floats) -> Firings:
    """The beams of a lidar that moves."""
    pose = ScanPose.of(lidar, mount)
    columns, channels = firings(beams)
    origin, *axes = firing_axes(columns, pose)
    rotation = rotation_from_yaw(float(lidar.yaw[0])) @ mount
    local = np.stack([axis @ rotation for axis in axes], axis=-1)
    parts = (origin - pose.position) @ rotation, local, channels, beams.time_s
    return Firings(*(each.astype(np.float32) for each in parts))

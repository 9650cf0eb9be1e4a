"""Attacks on the points of a lidar: the base class, removal of a sector, and scans of another time.

They change what beams return, and keep the beams' keys (`Points.keys`), so that effects can be measured beam by beam.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter, deque
from dataclasses import dataclass, field
from functools import partial
from math import inf
from typing import ClassVar, Literal

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import angles_of, wrap_angle
from mast_zenoh.arrays.states import Floats
from mast_zenoh.attacks.attack import Attack, ObjectsUnchanged
from mast_zenoh.attacks.campaign import NANOSECONDS
from mast_zenoh.attacks.spoofers import Following, Spoofer
from mast_zenoh.attacks.surroundings import UNKNOWN, Surroundings
from mast_zenoh.sensing.points import Points
from mast_zenoh.sensing.sectors import BeamMemory, NoBeams, Sector
from mast_zenoh.streams import stream

#: m, to which a pulse travels and back in a microsecond.
METRES_PER_US = 150.0


@dataclass(frozen=True, eq=False)
class AttackedScan:
    """A scan under attack.

    time_s:  s of scene time;  points: as measured;  lidar: its position and rotation
    towards: (3,) m, the spoofer in the frame of the lidar; ahead of it if there is none
    random:  the stream of this scan;  memory: of the lidar
    """

    time_s: float
    points: Points
    lidar: tuple[Floats, Floats]
    towards: Floats
    random: np.random.Generator
    memory: BeamMemory

    @property
    def bearing(self) -> float:
        """rad, azimuth of the spoofer."""
        return float(angles_of(self.towards)[0])

    def sector(self, towards: Floats, half_rad: float) -> Sector:
        """The firings within `half_rad` of the azimuth of (3,) m; raises NoBeams: then the scan stays as it is."""
        return self.memory.near(self.points, float(angles_of(towards)[0]), half_rad)


@dataclass(kw_only=True, eq=False)
class PointAttack(ObjectsUnchanged, Attack):
    """Base class of attacks on points, with or without a spoofer.

    A scan is attacked with the probability P(aim) x P(timing) x P(width covers), drawn for each scan, and if the
    spoofer has sight of the lidar. Empty scans, and those with points that are not finite or without firing times, stay
    as they are, except under attacks that replace whole scans.

    start_s: s of scene time at which it begins;  end_s: s of scene time at which it ends
    place:   where the spoofer is; None: behind the sensor, where the attack always works
    success: 0 to 1, P(timing): share of scans in which the pulses meet the lidar's windows
    """

    start_s: float = 4.0
    end_s: float = inf
    place: Spoofer | None = None
    success: float = 1.0
    #: Whether it replaces whole scans, whatever is in them.
    whole: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check("0 or more, finite", start_s=self.start_s)
        check("0 or more", end_s=self.end_s)
        check("0 to 1", success=self.success)
        self._seed, self._name = 0, ""
        self._surroundings = UNKNOWN
        self._memory = BeamMemory()
        self._sight: tuple[float, Floats] | None = None
        self._counts: Counter[str] = Counter()

    def inform(self, surroundings: Surroundings) -> None:
        self._surroundings = surroundings

    def bind(self, seed: int, name: str) -> None:
        self._seed, self._name = seed, name

    def counts(self) -> dict[str, int]:
        """Numbers of `scans` in the time of the attack, and of those left as they are by reason.

        Reasons: unusable, no_sight, out_of_reach, first, missed, untimed, no_beams, same, or the text of a NoBeams.
        """
        return dict(self._counts)

    def forge_points(self, frame: int, time_ns: int, points: Points, lidar: tuple[Floats, Floats]) -> Points:
        time_s = time_ns / NANOSECONDS
        self._memory.move(time_s, *lidar)
        self._overhear(time_s, points)
        offset = None if self.place is None else self.place.position(time_s, lidar, self._surroundings) - lidar[0]
        across = self._speed_across(time_s, offset)
        if not self.start_s <= time_s < self.end_s:
            return points
        self._counts["scans"] += 1
        if not (self.whole or (len(points) and np.isfinite(points.position).all())):
            return self._left(points, "unusable")
        random = stream(self._seed, self._surroundings.scene, self._name, "spoofer", frame)
        towards = np.array([1.0, 0.0, 0.0]) if offset is None else offset @ lidar[1]
        if self.place is not None:
            distance = float(np.linalg.norm(towards))
            aim, covers = self.place.aim(distance, across), self._covers(distance)
            if not random.random() < aim * self.success * covers:
                return self._left(points, "out_of_reach" if not covers else "missed" if aim else "first")
            if not self.place.in_sight(points, towards):
                return self._left(points, "no_sight")
        try:
            forged = self._forged(AttackedScan(time_s, points, lidar, towards, random, self._memory))
        except NoBeams as error:
            return self._left(points, str(error) or "no_beams")
        return self._left(points, "same") if forged is points else forged

    def _left(self, points: Points, reason: str) -> Points:
        """The points, after counting why they stay as they are."""
        self._counts[reason] += 1
        return points

    def _speed_across(self, time_s: float, offset: Floats | None) -> float:
        """m/s, of the lidar across the line of sight, inf: not known; offset: (3,) m, from the lidar to the spoofer"""
        before, self._sight = self._sight, None if offset is None else (time_s, offset)
        if before is None or offset is None or time_s <= before[0]:
            return inf
        along = offset / max(float(np.linalg.norm(offset)), 1e-9)
        velocity = (offset - before[1]) / (time_s - before[0])
        return float(np.linalg.norm(velocity - (velocity @ along) * along))

    def _covers(self, distance_m: float) -> float:
        """P(width covers), 0 to 1: the part of the budget that depends on the attack. distance_m: to the spoofer"""
        return 1.0

    def _overhear(self, time_s: float, points: Points) -> None:
        """Take note of a scan, attacked or not."""

    @abstractmethod
    def _forged(self, scan: AttackedScan) -> Points:
        """What the lidar delivers instead; raises NoBeams, with the reason: the scan stays as it is."""


#: By lidar and asked width, deg: P(removal); mean and deviation of the width if it is removed, deg. From the share of
#: frames, median and 90th percentile of each recording (Keio-CSG/lidar-spoofing-artifacts@0d2c3de,
#: docs/attack_check.json). The latter are of all frames, so they are quantiles of the removed ones after those without
#: effect. The median of 40 deg is of frames without effect: it has the deviation of its neighbours.
_ASKED_DEG = (0, 10, 20, 30, 40, 50, 60)
_SHARE = {"AT128": (1.0, 1.0, 1.0, 0.79, 0.414, 0.821, 0.568), "XT32": (1.0, 1.0, 1.0, 1.0, 1.0, 0.94, 0.889)}
_MEAN_DEG = {"AT128": (0, 15, 20, 20.9, 15.2, 11.3, 16.9), "XT32": (0, 9, 13, 13, 13, 13, 13)}
_DEVIATION_DEG = {"AT128": (0, 0.4, 3.1, 2.7, 4.0, 4.85, 3.3), "XT32": (0, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8)}
#: Share of frames in which plain HFR works against pulse fingerprints: 0.3 % at 5, 0.6 % at 15 MHz (same source).
_FINGERPRINTED = 0.0045


@dataclass(kw_only=True, eq=False)
class HighFrequencyRemoval(PointAttack):
    """Removes a sector by pulses at a high frequency (HFR, A-HFR): its beams return noise near the lidar.

    The lidar takes the first strong pulse of each window, so a beam returns from a random distance below 150 / f m
    beyond its shortest range. The width that is reached, and how often, are those that were measured by asked width:
    it saturates at 13 to 20 deg.

    Source: Sato et al., NDSS 2024 (HFR) and 2025 (A-HFR, whose pulses follow the lidar's window and fingerprint);
    measured widths: Keio-CSG/lidar-spoofing-artifacts@0d2c3de, docs/attack_check.json.

    sector_deg:     deg, asked width around the spoofer;  lidar: model whose measured widths count
    frequency_mhz:  MHz, of the pulses: 15 against an AT128, 24 against an XT32
    adaptive:       False: plain HFR
    fingerprinting: whether the victim tells its pulses from others: plain HFR then works in 0.45 % of scans
    min_range_m:    m, the lidar's shortest range
    """

    place: Spoofer | None = field(default_factory=Following)
    sector_deg: float = 20.0
    frequency_mhz: float = 15.0
    lidar: Literal["AT128", "XT32"] = "AT128"
    adaptive: bool = True
    fingerprinting: bool = True
    min_range_m: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        check("more than 0, finite", sector_deg=self.sector_deg, frequency_mhz=self.frequency_mhz)
        check("0 or more, finite", min_range_m=self.min_range_m)
        tables = (of[self.lidar] for of in (_SHARE, _MEAN_DEG, _DEVIATION_DEG))
        self._share, self._mean, self._deviation = (float(np.interp(self.sector_deg, _ASKED_DEG, of)) for of in tables)

    def _covers(self, distance_m: float) -> float:
        return self._share if self.adaptive or not self.fingerprinting else _FINGERPRINTED

    def _forged(self, scan: AttackedScan) -> Points:
        half = np.radians(max(scan.random.normal(self._mean, self._deviation), 0.0)) / 2
        sector = scan.sector(scan.towards, half)
        inside = np.abs(wrap_angle(sector.angles()[0] - scan.bearing)) <= half
        apart = METRES_PER_US / self.frequency_mhz
        return sector.changed(inside, self.min_range_m + apart * scan.random.random(inside.shape))


@dataclass(kw_only=True, eq=False)
class EarlyEcho(PointAttack):
    """Removes a sector by echoes that arrive before all others (physical removal attack, PRA).

    The lidar takes the early echo and drops it, because it is below its shortest range: the sector has no returns.

    Source: Cao et al., USENIX Security 2023 (arXiv 2210.09482), attacker within about 5 m in the first tests. Its
    angles are not known to us: the width is an assumption.

    sector_deg: deg, width around the spoofer;  reach_m: m, farthest spoofer that has an effect
    """

    place: Spoofer | None = field(default_factory=partial(Following, distance_m=4.0))
    sector_deg: float = 30.0
    reach_m: float = 5.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check("more than 0, finite", sector_deg=self.sector_deg, reach_m=self.reach_m)

    def _covers(self, distance_m: float) -> float:
        return float(distance_m <= self.reach_m)

    def _forged(self, scan: AttackedScan) -> Points:
        half = np.radians(self.sector_deg) / 2
        sector = scan.sector(scan.towards, half)
        inside = np.abs(wrap_angle(sector.angles()[0] - scan.bearing)) <= half
        return sector.changed(inside, np.full(inside.shape, np.inf))


@dataclass(kw_only=True, eq=False)
class Saturation(PointAttack):
    """Blinds the beams in a cone around the spoofer: no returns, and now and then a random one.

    Source: Shin et al., CHES 2017 ("Illusion and Dazzle"), a strong light on a VLP-16. It gives no numbers of points:
    share and cone are assumptions.

    cone_deg: deg, half of its angle;  noise: 0 to 1, share of its beams with a random return
    longest_m: m, of these returns
    """

    place: Spoofer | None = field(default_factory=Following)
    cone_deg: float = 10.0
    noise: float = 0.05
    longest_m: float = 100.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check("more than 0, finite", cone_deg=self.cone_deg, longest_m=self.longest_m)
        check("0 to 1", noise=self.noise)

    def _forged(self, scan: AttackedScan) -> Points:
        sector = scan.sector(scan.towards, np.radians(self.cone_deg))
        azimuth, elevation = sector.angles()
        up = angles_of(scan.towards)[1]
        cosine = np.sin(elevation) * np.sin(up) + np.cos(elevation) * np.cos(up) * np.cos(azimuth - scan.bearing)
        random = scan.random.random((2, *azimuth.shape))
        range_m = np.where(random[0] < self.noise, 0.5 + random[1] * self.longest_m, np.inf)
        return sector.changed(cosine >= np.cos(np.radians(self.cone_deg)), range_m)


@dataclass(kw_only=True, eq=False)
class RelayedScan(PointAttack):
    """Replays recorded scans, one after the other, again and again.

    Source: Petit et al., Black Hat Europe 2015 (relay and replay); replay of lidar frames in lib-avstack-security,
    avsec/attack/lidar. Threat model: software behind the sensor; no spoofer replays a whole scan.

    record_s: s of scene time at which the recording begins;  length_s: s, of it; it ends at `start_s` at the latest
    """

    whole: ClassVar[bool] = True
    record_s: float = 0.0
    length_s: float = 2.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check("0 or more, finite", record_s=self.record_s)
        check("more than 0, finite", length_s=self.length_s)
        self._recorded: list[Points] = []
        self._next = 0

    def _overhear(self, time_s: float, points: Points) -> None:
        if self.record_s <= time_s < min(self.record_s + self.length_s, self.start_s):
            self._recorded.append(points)

    def _forged(self, scan: AttackedScan) -> Points:
        if not self._recorded:
            return scan.points
        self._next += 1
        return self._recorded[(self._next - 1) % len(self._recorded)]


@dataclass(kw_only=True, eq=False)
class DelayedScan(PointAttack):
    """Delivers each scan some scans late.

    Source: DejaVu (arXiv 2507.09095): one lidar frame of delay costs fusion with cameras 88.5 % of its average
    precision. Threat model: software behind the sensor.

    scans: how many; the oldest one so far if there are fewer
    """

    whole: ClassVar[bool] = True
    scans: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        check("1 or more", scans=self.scans)
        self._last: deque[Points] = deque(maxlen=self.scans + 1)

    def _overhear(self, time_s: float, points: Points) -> None:
        self._last.append(points)

    def _forged(self, scan: AttackedScan) -> Points:
        return self._last[0]

"""Attacks that put objects among the points of a lidar: injected phantoms, ghost walls, mirrors and forged meshes.

A phantom is cast with the beams of the victim's lidar, so that its points lie on them, however few the budget allows.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import angles_of, heading, rotation_from_yaw, wrap_angle
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Floats
from mast_zenoh.attacks.point_attacks import AttackedScan, PointAttack
from mast_zenoh.attacks.spoofers import Following, Spoofer
from mast_zenoh.sensing.beams import Beams
from mast_zenoh.sensing.points import Points, Singles
from mast_zenoh.sensing.scan import Moving, cast
from mast_zenoh.sensing.sectors import NO_GROUND_M, Sector, chords, nearest, ordered
from mast_zenoh.sensing.shapes import Parts

#: m, length, width and height of the usual phantom.
CAR = (4.5, 1.8, 1.5)
#: m, height of a lidar, where a scan shows no ground.
_USUAL_HEIGHT_M = 1.8
#: m, range up to which points may be of the ground below a lidar, and the bins of their heights.
_GROUND_M, _BIN_M = 25.0, 0.1
#: m, depth over which the points of a phantom that ignores depth lie.
_DEPTH_M = 1.5


def ground_below(points: Points, rotation: Floats) -> float:
    """m, z of the ground from the lidar, below 0: the most frequent height of near points. rotation: (3, 3) active"""
    z = points.position[points.range_m() < _GROUND_M] @ rotation[2].astype(np.float32)
    z = z[z < -0.5]
    if not len(z):
        return -_USUAL_HEIGHT_M
    bins = np.floor(z / _BIN_M).astype(np.int64)
    lowest = int(bins.min())
    at = int(np.bincount(bins - lowest).argmax()) + lowest
    return float(np.median(z[bins == at]))


@dataclass(kw_only=True, eq=False)
class InjectedPoints(PointAttack):
    """Injects points that look like a vehicle, as many as the spoofer can, on the lidar's beams.

    Each injected point takes a beam: its real return vanishes. Beams that the budget does not reach still return from
    behind the phantom. With `occlusion`, beams that meet something nearer are left alone, and the points lie on the
    phantom's surface; without, the stronger pulse wins on any beam, and the depth is random, which free space betrays.

    Budgets as published: CaoInjection, SunInjection, PlaInjection. Range noise and jitter are those of a follower's
    model of PLA-LiDAR.

    points:       largest number of a scan
    distance_m:   m, from the lidar to the near side;  angle_deg: deg, left of the direction to the spoofer
    closing_mps:  m/s, at which it comes nearer, down to 4 m
    what:         class, whose shape it has;  size: m, its length, width and height
    yaw_deg:      deg, left of facing away from the lidar
    reach_deg:    (2,) deg, azimuth and elevation around the spoofer that its pulses reach
    jitter_deg:   deg rms, of the direction for which a pulse is meant
    noise_m:      m rms, of the range;  noise_per_deg_m: m rms, more of it for each degree away from the spoofer
    occlusion:    whether it leaves alone what is in front
    """

    place: Spoofer | None = field(default_factory=Following)
    points: int = 200
    distance_m: float = 7.0
    angle_deg: float = 0.0
    closing_mps: float = 0.0
    what: Literal["car", "truck", "bus", "motorcycle", "bicycle", "pedestrian", "unknown"] = "car"
    size: tuple[float, float, float] = CAR
    yaw_deg: float = 0.0
    reach_deg: tuple[float, float] = (10.0, 15.0)
    jitter_deg: float = 0.2
    noise_m: float = 0.05
    noise_per_deg_m: float = 0.0067
    occlusion: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        check("1 or more", points=self.points)
        check("more than 0, finite", distance_m=self.distance_m, size=min(self.size), reach_deg=min(self.reach_deg))
        for name in ("jitter_deg", "noise_m", "noise_per_deg_m", "closing_mps"):
            check("0 or more, finite", **{name: getattr(self, name)})
        self._parts = Parts.of(np.array([CLASS_INDEX[self.what]]), np.array([self.size]))

    def _forged(self, scan: AttackedScan) -> Points:
        closest = min(4.0, self.distance_m)
        distance = max(self.distance_m - self.closing_mps * (scan.time_s - self.start_s), closest) + self.size[0] / 2
        ahead = angles_of(scan.lidar[1] @ scan.towards)[0] + np.radians(self.angle_deg)
        height = ground_below(scan.points, scan.lidar[1]) + self.size[2] / 2
        middle = np.array([distance * np.cos(ahead), distance * np.sin(ahead), height])
        half = np.arctan2(float(np.hypot(*self.size[:2])) / 2, distance) + np.radians(2.0)
        sector = scan.sector(middle @ scan.lidar[1], half)
        range_m = self._jittered(sector, scan, sector.to_shape(middle, ahead + np.radians(self.yaw_deg), self._parts))
        azimuth, elevation = sector.angles()
        aside = np.degrees(np.abs(wrap_angle(azimuth - scan.bearing)))
        above = np.degrees(np.abs(elevation - angles_of(scan.towards)[1]))
        deviation = self.noise_m + self.noise_per_deg_m * np.hypot(aside, above)
        allowed = np.isfinite(range_m) & (aside <= self.reach_deg[0]) & (above <= self.reach_deg[1])
        range_m = range_m + deviation * scan.random.standard_normal(range_m.shape)
        if self.occlusion:
            allowed &= range_m < sector.range_m
        else:
            range_m = range_m + _DEPTH_M * scan.random.random(range_m.shape)
        candidates = np.flatnonzero(allowed)
        chosen = candidates[np.linspace(0, len(candidates) - 1, min(self.points, len(candidates))).astype(np.int64)]
        which = np.zeros(allowed.shape, bool)
        which.flat[chosen] = True
        return sector.changed(which, np.maximum(range_m, 0.1))

    def _jittered(self, sector: Sector, scan: AttackedScan, range_m: Floats) -> Floats:
        """Ranges (f, c), each of the beam that a pulse with jitter was meant for."""
        if not self.jitter_deg or min(range_m.shape) < 2:
            return range_m
        jitter = np.radians(self.jitter_deg) * scan.random.standard_normal((2, *range_m.shape))
        firing, channel = np.indices(range_m.shape)
        step = max(float(np.median(np.diff(sector.azimuth))), 1e-6)
        firing = np.clip(firing + np.rint(jitter[0] / step).astype(np.int64), 0, len(range_m) - 1)
        elevation = sector.channels.elevation
        return np.asarray(range_m[firing, nearest(elevation, elevation[channel] + jitter[1])])


@dataclass(kw_only=True, eq=False)
class CaoInjection(InjectedPoints):
    """Injects about 60 points near the front, as Cao et al., CCS 2019: 75 % success against a trained network."""

    points: int = 60
    distance_m: float = 5.0


@dataclass(kw_only=True, eq=False)
class SunInjection(InjectedPoints):
    """Injects up to 200 points 5 to 8 m ahead, as Sun et al., USENIX Security 2020 (arXiv 2006.16974): about 80 %."""

    distance_m: float = 6.5


@dataclass(kw_only=True, eq=False)
class PlaInjection(InjectedPoints):
    """Injects up to 4,200 points, as PLA-LiDAR (Jin et al., IEEE S&P 2023): whole surfaces."""

    points: int = 4200
    distance_m: float = 10.0


@dataclass(kw_only=True, eq=False)
class GhostWall(InjectedPoints):
    """Injects a wall across the road.

    Source: ghost wall in front of a moving car with a VLP-32C at 30 and 40 km/h, Keio-CSG/lidar-spoofing-artifacts;
    its size is not published: an assumption.
    """

    points: int = 4200
    distance_m: float = 12.0
    what: Literal["car", "truck", "bus", "motorcycle", "bicycle", "pedestrian", "unknown"] = "unknown"
    size: tuple[float, float, float] = (0.3, 4.0, 2.0)


@dataclass(kw_only=True, eq=False)
class Mirror(PointAttack):
    """A flat mirror that stands in the scene: what is behind it vanishes, and what it shows appears there.

    The mirrored world is that of the scan's own points: a mirror that shows what the lidar does not see itself shows
    nothing, and sides of objects that are turned away are missing.

    Source: mirrors against an Autoware car, arXiv 2509.17253 (adds and removes obstacles).

    x, y, z:           m, its middle, world frame;  yaw_deg: deg, of its normal, counter-clockwise from x
    width_m, height_m: m
    """

    x: float = 20.0
    y: float = 0.0
    z: float = 1.0
    yaw_deg: float = 135.0
    width_m: float = 1.5
    height_m: float = 1.5

    def __post_init__(self) -> None:
        super().__post_init__()
        check("more than 0, finite", width_m=self.width_m, height_m=self.height_m)

    def _forged(self, scan: AttackedScan) -> Points:
        position, rotation = scan.lidar
        axes = rotation.T @ rotation_from_yaw(np.radians(self.yaw_deg))  # columns: normal, across, up
        middle = (np.array([self.x, self.y, self.z]) - position) @ rotation
        half = np.arctan2(np.hypot(self.width_m, self.height_m) / 2, np.linalg.norm(middle)) + 0.02
        sector = scan.sector(middle, half)
        to_mirror = self._along(sector.directions().reshape(-1, 3), middle, axes).reshape(sector.row.shape)
        meets = to_mirror < sector.range_m
        real = scan.points.position.astype(np.float64)
        beyond = (real - middle) @ axes[:, 0]
        mirrored = real - 2.0 * beyond[:, None] * axes[:, 0]
        length = np.linalg.norm(mirrored, axis=1)
        shown = (beyond * (middle @ axes[:, 0]) < 0.0) & (length <= scan.points.range_m().max())
        shown &= self._along(mirrored, middle, axes) < 1.0
        seen = np.full(sector.row.shape, np.inf)
        firing, channel, looks = sector.beams_at(mirrored[shown])
        np.minimum.at(seen, (firing[looks], channel[looks]), length[shown][looks])
        return sector.changed(meets, seen, float(np.median(scan.points.intensity)))

    def _along(self, beam: Floats, middle: Floats, axes: Floats) -> Floats:
        """(n,) lengths of (n, 3) after which they meet the mirror, inf: not. All in the lidar's frame."""
        fall = beam @ axes[:, 0]
        along = (middle @ axes[:, 0]) / np.where(np.abs(fall) < 1e-12, 1e-12, fall)
        off = np.abs((along[:, None] * beam - middle) @ axes[:, 1:])
        met = (along > 0.0) & (off[:, 0] <= self.width_m / 2) & (off[:, 1] <= self.height_m / 2)
        return np.where(met, along, np.inf)


@dataclass(kw_only=True, eq=False)
class ForgedMesh(PointAttack):
    """Adds a car as dense as one 10 m away, or removes one: a forged message of early fusion, without any budget.

    Its points share beams with others, which no lidar delivers: the upper bound of what attacks on points can do.
    Adding casts a car from 10 m before it. Removing drops the points of the box and 0.6 m more, and puts those beams
    on walls 0.3 m around it.

    Source: Zhang et al., USENIX Security 2024 (arXiv 2309.12955), lidar_spoof_early and lidar_remove_early of their
    repository: more than 86 % success; found in 91.5 % at 3 % false alarms. Theirs sample the walls by what others see.

    remove:     whether an object is removed instead of added
    distance_m: m, from the lidar to the middle;  angle_deg: deg, left of the lidar's x
    yaw_deg:    deg, of the car, left of the lidar's x
    size:       m, length, width and height
    """

    remove: bool = False
    distance_m: float = 15.0
    angle_deg: float = 0.0
    yaw_deg: float = 0.0
    size: tuple[float, float, float] = CAR

    def __post_init__(self) -> None:
        super().__post_init__()
        check("more than 0, finite", distance_m=self.distance_m, size=min(self.size))

    def _forged(self, scan: AttackedScan) -> Points:
        rotation = scan.lidar[1]
        ground, facing = ground_below(scan.points, rotation), float(heading(rotation))
        bearing, yaw = facing + np.radians(self.angle_deg), facing + np.radians(self.yaw_deg)
        aside = self.distance_m * np.cos(bearing), self.distance_m * np.sin(bearing)
        middle = np.array([*aside, ground + self.size[2] / 2])
        sector = scan.sector(middle @ rotation, np.pi)
        made, intensity = (self._without if self.remove else self._with_car)(scan, middle, yaw)
        firing, channel, _ = sector.beams_at(made.astype(np.float64))
        new = Points(made, intensity, sector.time_s[firing], sector.channels.channel[channel])
        kept = self._kept(scan, middle, yaw)
        return ordered(Points.joined([scan.points.select(kept), new]))

    def _kept(self, scan: AttackedScan, middle: Floats, yaw: float) -> Bools:
        """(n,) the points outside the box, and not hidden by a car that is added."""
        level = scan.points.position @ scan.lidar[1].T
        if not self.remove:
            enter, leave = chords(level, middle[None], np.array([self.size]), np.array([yaw]))
            return np.asarray(~((enter <= leave) & (leave > 0.0) & (enter < 1.0))[:, 0])
        along = (level - middle) @ rotation_from_yaw(yaw)
        return np.asarray(~(np.abs(along[:, :2]) <= (np.array(self.size[:2]) + 0.6) / 2).all(axis=1))

    def _with_car(self, scan: AttackedScan, middle: Floats, yaw: float) -> tuple[Singles, Singles]:
        """Positions (k, 3) m and intensities (k,) of a car's points, in the lidar's frame."""
        away = max(float(np.hypot(*middle[:2])), 1e-9)
        eye = np.append(middle[:2] * (1.0 - 10.0 / away), 0.0)
        azimuth, elevation = np.radians(np.arange(-180.0, 180.0, 0.2)), np.radians(np.arange(-15.0, 5.0, 0.2))
        beams = Beams(azimuth, elevation, np.zeros_like(elevation), np.zeros_like(azimuth), 0.0, 30.0)
        still = np.zeros((1, 3)), np.zeros(1), np.zeros(1)
        parts = Parts.of(np.array([CLASS_INDEX["car"]]), np.array([self.size]))
        objects = Moving(middle[None], still[0], np.array([yaw]), still[2])
        hits = cast(beams, Moving(eye[None], *still), np.eye(3), objects, parts, NO_GROUND_M)
        met = hits.source == 0
        made = (beams.directions()[met] * hits.range_m[met][:, None] + eye) @ scan.lidar[1]
        return made.astype(np.float32), np.full(len(made), 0.5, np.float32)

    def _without(self, scan: AttackedScan, middle: Floats, yaw: float) -> tuple[Singles, Singles]:
        """Positions (k, 3) m and intensities (k,) of the points behind a car that is removed, in the lidar's frame."""
        gone = scan.points.select(~self._kept(scan, middle, yaw))
        level = (gone.position @ scan.lidar[1].T).astype(np.float64)
        walls = np.array([self.size]) + np.array([0.6, 0.6, 0.0])
        enter, leave = (each[:, 0] for each in chords(level, middle[None], walls, np.array([yaw])))
        on_wall = np.where(scan.random.random(len(gone)) < 0.5, enter, leave)
        some = (enter <= leave) & (on_wall > 0.0)
        moved = (level * on_wall[:, None])[some] @ scan.lidar[1]
        return moved.astype(np.float32), gone.intensity[some]

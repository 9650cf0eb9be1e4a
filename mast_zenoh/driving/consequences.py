"""What happened to a car that was driven: collisions, near misses, braking, comfort, progress, and those behind it.

Where the outlines of a car and of objects overlap: at the same time, and one after the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from mast_zenoh.arrays.boxes import overlapping
from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.driving import braking
from mast_zenoh.driving.braking import Belief, Commands, spans
from mast_zenoh.driving.corridor import InCorridor, crossing, in_corridor, needed_braking
from mast_zenoh.driving.followers import behind_car
from mast_zenoh.driving.motion import HARD_BRAKING_MPS2, RouteAhead, uncomfortable
from mast_zenoh.metrics.driving import STANDING_MPS, Driving, RoadUsers, SafeDistance, VehicleCourse

#: s and m/s^2: below this time to collision, and above this braking that avoids it, an encounter is a near miss.
#: Source: thresholds of TTC and DRAC of SUMO's device "ssm". There, either is a conflict; an ordinary stop behind
#: others falls below the first, so here it needs both.
NEAR_MISS_TTC_S, NEAR_MISS_BRAKING_MPS2 = 3.0, 3.0
#: m; who stands so near to what is ahead, or to a line, waits for it.
_WAITING_M = 5.0
#: s; a collision is with a hidden object if for most of this time before its driver did not know what the car's
#: sensors had, and with one ahead if it was in the corridor then.
_BEFORE_CONTACT_S = 1.0
#: s, over which derivatives of accelerations are smoothed, as by nuPlan.
_SMOOTHED_S = 1.5


@dataclass(frozen=True, eq=False, kw_only=True)
class DrivenCar:
    """What is known of one car in f frames, and of the n other objects, from the truth and from messages.

    car, objects: world frame; ids: (n,); seen: (n,) whether the car's own sensors have the object
    known:      (n,) whether the driver's estimate had an object there
    frames:     (f,) numbers of the frames; times_s: (f,) s; period_s: s between two frames
    routes:     of the car, by row of the frames
    believed:   m objects that the driver believed in, ascending by frame; belief: what they are
    commands:   what the car obeyed
    look:       how far and how wide the corridor of the car is
    on_truth:   (f,) m/s^2, braking that its driver would command on the truth, NaN: not known; None: never
    """

    car: VehicleCourse
    objects: RoadUsers
    ids: Ints
    seen: Bools
    known: Bools
    frames: Ints
    times_s: Floats
    period_s: float
    routes: Mapping[int, RouteAhead]
    believed: RoadUsers
    belief: Belief
    commands: Commands
    look: Driving
    on_truth: Floats | None = None

    def part(self, rows: slice, later: int) -> DrivenCar:
        """What is known of some rows of the frames; later: by how much their numbers in a longer run are greater."""
        there, held = (
            (frame >= rows.start) & (frame < rows.stop) for frame in (self.objects.frame, self.believed.frame)
        )
        car, commands = self.car, self.commands
        of = commands.of[rows]
        return replace(
            self,
            car=car._replace(position=car.position[rows], velocity=car.velocity[rows], heading=car.heading[rows]),
            objects=self.objects.select(there, later),
            ids=self.ids[there],
            seen=self.seen[there],
            known=self.known[there],
            frames=self.frames[rows],
            times_s=self.times_s[rows],
            routes={row + later: route for row, route in self.routes.items() if rows.start <= row < rows.stop},
            believed=self.believed.select(held, later),
            belief=Belief._make(column[held] for column in self.belief),
            commands=commands._replace(
                of=np.where(of >= 0, of + later, -1),
                informed=commands.informed[rows],
                tampered=commands.tampered[rows],
            ),
            on_truth=None if self.on_truth is None else self.on_truth[rows],
        )

    @classmethod
    def joined(cls, parts: Sequence[DrivenCar], take_over: int) -> DrivenCar:
        """A car in consecutive parts of a run; take_over: the frame from which on it is driven."""
        cars, commands = [part.car for part in parts], [part.commands for part in parts]
        on_truth = [part.on_truth for part in parts if part.on_truth is not None]
        frames, ids, seen, known, times_s = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("frames", "ids", "seen", "known", "times_s")
        )
        return replace(
            parts[-1],
            car=cars[-1]._replace(
                position=np.concatenate([car.position for car in cars]),
                velocity=np.concatenate([car.velocity for car in cars]),
                heading=np.concatenate([car.heading for car in cars]),
            ),
            objects=RoadUsers(*map(np.concatenate, zip(*(part.objects for part in parts), strict=True))),
            ids=ids,
            seen=seen,
            known=known,
            frames=frames,
            times_s=times_s,
            routes={row: route for part in parts for row, route in part.routes.items()},
            believed=RoadUsers(*map(np.concatenate, zip(*(part.believed for part in parts), strict=True))),
            belief=Belief(*map(np.concatenate, zip(*(part.belief for part in parts), strict=True))),
            commands=Commands(
                of=np.concatenate([each.of for each in commands]),
                informed=np.concatenate([each.informed for each in commands]),
                tampered=[by for each in commands for by in each.tampered],
                left_out=commands[-1].left_out,
                first=int(frames.searchsorted(take_over)),
            ),
            on_truth=np.concatenate(on_truth) if len(on_truth) == len(parts) else None,
        )

    @cached_property
    def speed(self) -> Floats:
        """(f,) m/s, of the car."""
        return np.hypot(self.car.velocity[:, 0], self.car.velocity[:, 1])

    @cached_property
    def acceleration(self) -> Floats:
        """(f - 1,) m/s^2, from each frame to the next."""
        return accelerations(self.speed, self.period_s)

    @cached_property
    def truth(self) -> InCorridor:
        """What is there in the corridor of the car."""
        return in_corridor(self.car, self.routes, self.objects, self.look)

    @cached_property
    def brakes(self) -> list[braking.Brake]:
        """The brakes of the car."""
        return braking.brakes_of(self.acceleration, self.period_s)


def accelerations(speed: Floats, period_s: float) -> Floats:
    """Acceleration (f - 1,) m/s^2 from each frame to the next. speed: (f,) m/s"""
    return np.diff(speed) / period_s


def consequences(driven: DrivenCar) -> dict[str, Any]:
    """What happened to a driven car, as numbers for metrics.json; docs/explanation-driving.md says how they are
    measured.

    Keys:
    collisions: for each object, its `id`, the first `frame` of contact, the relative speed, m/s, and whether it was
        `hidden` from the driver though the car's own sensors had it; None: a replay does not know
    near_misses: number of objects that it nearly hit, and did not
    min_ttc_s: least time to collision in its lane; None: none
    min_gap_m: least gap in its lane; None: none
    min_pet_s: shortest time between the car and what crosses its way; None: nothing did
    max_drac_mps2: greatest braking that just avoids contact with what is ahead
    rss_unsafe_s: time nearer to something ahead than the safe distance of RSS
    brakes: each with `from_s`, `until_s`, `hardest_mps2`, that of its driver on the truth (`on_truth_mps2`; None: not
        known), its `cause` (`kind`, `object`, `adversary`), and whether it is `needless`
    needless_brakes: number of brakes that its driver would not have made on the truth
    missed_brakes: number of emergencies, and of contacts with what was ahead, without braking
    hard_brakes: number of times of braking harder than 4.05 m/s²
    hardest_braking_mps2: hardest braking
    jerk_max_mps3: m/s³, greatest change of the acceleration
    uncomfortable_s: by bound of nuPlan's comfort metric, time outside it
    progress_m: way driven
    stops: how often it came to a stop
    standing_s: time below 0.3 m/s
    blocked_s: time standing with nothing to wait for within 5 m ahead
    blind_frames: frames in which it obeyed a command given without an estimate; None: a replay does not know
    obeyed_commands, uncommanded_frames: commands that it obeyed; frames without a new one
    behind: of the cars in its lane up to 100 m behind it: number, braking, standing and lost time, and shock wave
    """
    car, period, truth = driven.car, driven.period_s, driven.truth
    speed, acceleration = driven.speed, driven.acceleration
    hit = collisions(car, driven.objects)
    contacts = _contacts(driven, hit)
    emergencies = braking.emergencies(truth, len(speed))
    brakes = _brakes(driven)
    standing = speed <= STANDING_MPS
    return {
        "collisions": contacts,
        "near_misses": len(set(driven.ids[truth.row[_near_miss(truth)]].tolist()) - set(driven.ids[hit].tolist())),
        "min_gap_m": _finite(truth.gap_m.min(initial=np.inf)),
        "min_ttc_s": _finite(truth.ttc_s.min(initial=np.inf)),
        "min_pet_s": post_encroachment_s(car, driven.objects, period),
        "max_drac_mps2": float(
            needed_braking(truth.gap_m, truth.own_mps, truth.ahead_mps)[truth.gap_m > 0.0].max(initial=0.0)
        ),
        "rss_unsafe_s": _below_safe_distance(driven.look, truth) * period,
        "brakes": brakes,
        "needless_brakes": sum(brake["needless"] for brake in brakes),
        "missed_brakes": braking.missed_brakes(emergencies, _hit_ahead(driven, contacts), acceleration, period),
        "hard_brakes": len(spans(acceleration < -HARD_BRAKING_MPS2)),
        "hardest_braking_mps2": float(abs(acceleration.min(initial=0.0))),
        "jerk_max_mps3": float(np.abs(np.diff(acceleration)).max(initial=0.0) / period),
        "uncomfortable_s": uncomfortable_s(car, period),
        "progress_m": float(np.hypot(*np.diff(car.position[:, :2], axis=0).T).sum()),
        "stops": sum(first > 0 for first, _ in spans(standing)),
        "standing_s": float(np.count_nonzero(standing) * period),
        "blocked_s": float(np.count_nonzero(standing & ~_waits(driven, truth)) * period),
        "blind_frames": _blind_frames(driven.commands),
        "obeyed_commands": driven.commands.obeyed,
        "uncommanded_frames": driven.commands.uncommanded,
        "behind": behind_car(car, driven.objects, driven.ids, period, HARD_BRAKING_MPS2, driven.brakes),
    }


def course(driven: DrivenCar) -> dict[str, Any]:
    """The course of a driven car as columns of driven.parquet: a row per frame
    (docs/explanation-metrics-and-causes.md).

    Columns:
    agent: whose car it is
    frame: number of the frame, from 0
    time_s: of scene time
    x, y: m, place in the world
    heading: rad, counter-clockwise from east
    speed_mps: along the car
    acceleration_mps2: to the next frame; missing in the last one
    brake: whether the frame is in a brake, see docs/explanation-driving.md
    gap_m, ttc_s: to the nearest object in its lane, and least time to collision there; missing: nothing
    """
    frames, truth = len(driven.frames), driven.truth
    gap, ttc, brake = np.full(frames, np.inf), np.full(frames, np.inf), np.zeros(frames, bool)
    np.minimum.at(gap, truth.frame, truth.gap_m)
    np.minimum.at(ttc, truth.frame, truth.ttc_s)
    for first, _, end in driven.brakes:
        brake[first:end] = True
    return {
        "frame": driven.frames,
        "time_s": driven.times_s,
        "x": driven.car.position[:, 0],
        "y": driven.car.position[:, 1],
        "heading": driven.car.heading,
        "speed_mps": driven.speed,
        "acceleration_mps2": np.append(driven.acceleration, np.nan)[:frames],
        "brake": brake,
        "gap_m": np.where(np.isfinite(gap), gap, np.nan),
        "ttc_s": np.where(np.isfinite(ttc), ttc, np.nan),
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _contacts(driven: DrivenCar, hit: Ints) -> list[dict[str, Any]]:
    """The first contact with each object. hit: rows of the objects that overlap the car"""
    contacts = []
    before = round(_BEFORE_CONTACT_S / driven.period_s)
    for number in np.unique(driven.ids[hit]).tolist():
        row = hit[driven.ids[hit] == number][0]
        frame = driven.objects.frame[row]
        relative = driven.objects.velocity[row, :2] - driven.car.velocity[frame, :2]
        near = (driven.ids == number) & (driven.objects.frame < frame) & (driven.objects.frame >= frame - before)
        hidden = np.count_nonzero(near & driven.seen & ~driven.known) > 0.5 * min(before, frame)
        contact = {"object": number, "frame": int(driven.frames[frame]), "speed_mps": float(np.hypot(*relative))}
        contacts.append(contact | {"hidden": None if driven.commands.left_out else bool(hidden)})
    return contacts


def _hit_ahead(driven: DrivenCar, contacts: Sequence[Mapping[str, Any]]) -> list[tuple[int, int]]:
    """The time before each contact with what was ahead: row of its first frame, and that of the contact."""
    truth, before = driven.truth, round(_BEFORE_CONTACT_S / driven.period_s)
    result = []
    for contact in contacts:
        end = int(driven.frames.searchsorted(contact["frame"]))
        first = max(end - before, 0)
        same = driven.ids[truth.row] == contact["object"]
        if (same & (truth.frame >= first) & (truth.frame < end)).any():
            result.append((first, end))
    return result


def _blind_frames(commands: Commands) -> int | None:
    """Number of frames in which a car obeyed a command that its driver gave without an estimate; None: not known."""
    if commands.left_out:
        return None
    return int(np.count_nonzero(~commands.informed[commands.of[commands.of >= 0]]))


def _near_miss(truth: InCorridor) -> Bools:
    """Whether each object in the corridor (n,) is nearly hit in its frame."""
    needed = needed_braking(truth.gap_m, truth.own_mps, truth.ahead_mps)
    return np.asarray((truth.ttc_s < NEAR_MISS_TTC_S) & (needed > NEAR_MISS_BRAKING_MPS2))


def _below_safe_distance(look: Driving, truth: InCorridor) -> int:
    """Number of frames in which something is nearer than the safe distance of RSS."""
    rule = look.rule if isinstance(look.rule, SafeDistance) else SafeDistance()
    return len(np.unique(truth.frame[rule.brakes(truth.gap_m, truth.own_mps, truth.ahead_mps)]))


def _brakes(driven: DrivenCar) -> list[dict[str, Any]]:
    """The brakes of a car with their causes.

    What is ahead explains a brake before what crosses: nothing real that crosses excuses one for a false object ahead.
    """
    brakes, speed, period = driven.brakes, driven.speed, driven.period_s
    lines, road = braking.demanded_by_lines(speed, driven.routes), braking.demanded_by_road(speed, driven.routes)
    rows = braking.around(brakes, period)
    rows = sorted({*rows, *driven.commands.of[rows].tolist()})  # in these, too, it was decided
    near = {row: driven.routes[row] for row in rows if row in driven.routes}
    believed = in_corridor(driven.car, near, driven.believed, driven.look)
    from_side = crossing(driven.car, near, driven.believed, driven.look)
    ahead = np.max([lines, road, braking.hardest_per_frame(driven.truth, len(speed))], axis=0)
    crossers = crossing(driven.car, near, driven.objects, driven.look)
    crossed = np.maximum(ahead, braking.hardest_per_frame(crossers, len(speed)))
    result = []
    for brake, of_ahead, of_crosser in zip(
        brakes,
        braking.causes(brakes, believed, driven.belief, lines, driven.commands),
        braking.causes(brakes, from_side, driven.belief, np.zeros_like(lines), driven.commands),
        strict=True,
    ):
        is_ahead = of_ahead[0]["kind"] != "none"
        cause, asked = of_ahead if is_ahead else of_crosser
        false = cause["kind"] == "false"
        demanded = ahead if false and is_ahead else crossed
        hardest = float(-driven.acceleration[brake.hardest])
        on_truth = None if driven.on_truth is None else braking.on_truth(brake, driven.on_truth, period)
        if on_truth is None:
            needless = braking.needless(brake, demanded, period, asked if false else 0.0)
        else:
            needless = braking.needless_on_truth(hardest, on_truth)
        result.append(
            {
                "from_s": float(driven.times_s[brake.first]),
                "until_s": float(driven.times_s[brake.end]),
                "hardest_mps2": hardest,
                "on_truth_mps2": on_truth,
                "needless": needless,
                "cause": cause,
            }
        )
    return result


def _waits(driven: DrivenCar, truth: InCorridor) -> Bools:
    """Whether (f,) something real, or a line, is so near ahead that a standing car waits for it."""
    near = np.bincount(truth.frame[truth.gap_m <= _WAITING_M], minlength=len(driven.frames)) > 0
    for frame, route in driven.routes.items():
        near[frame] |= route.stop_m <= _WAITING_M
    return near


def uncomfortable_s(car: VehicleCourse, period_s: float) -> dict[str, float]:
    """Time in s during which a car was outside each of the bounds of COMFORT.

    Accelerations are those of the velocity from frame to frame. Their derivatives are smoothed over 1.5 s by a
    polynomial of second order (Savitzky and Golay), as nuPlan does it; the first and last 0.7 s have none.
    """
    along = np.column_stack([np.cos(car.heading), np.sin(car.heading)])[:-1]
    change = np.diff(car.velocity[:, :2], axis=0) / period_s
    forward = (change * along).sum(axis=1)
    sideways = along[:, 0] * change[:, 1] - along[:, 1] * change[:, 0]
    turning = wrap_angle(np.diff(car.heading)) / period_s
    values = {
        "braking": forward,
        "acceleration": forward,
        "lateral_acceleration": sideways,
        "jerk": _slope(np.hypot(forward, sideways), period_s),
        "longitudinal_jerk": _slope(forward, period_s),
        "yaw_rate": turning,
        "yaw_acceleration": _slope(turning, period_s),
    }
    return {name: float(np.count_nonzero(uncomfortable(name, values[name])) * period_s) for name in values}


def _slope(values: Floats, period_s: float) -> Floats:
    """Smoothed derivative of values per s, of those in the middle of a whole window; empty if there is none."""
    half = max(round(_SMOOTHED_S / period_s) // 2, 1)
    if len(values) <= 2 * half:
        return np.zeros(0)
    weight = np.arange(half, -half - 1, -1.0)  # the slope of the parabola through a window is that of the line
    return np.convolve(values, weight / (period_s * (weight**2).sum()), "valid")


#: s; a longer time between two that use the same place is no encounter.
_LONGEST_S = 5.0
#: rad; who comes at a smaller angle follows, and does not cross.
_CROSSING = np.deg2rad(30.0)


def collisions(car: VehicleCourse, objects: RoadUsers) -> Ints:
    """Rows (k,) of the n objects whose outlines overlap that of the car in the same frame, ascending."""
    return _overlapping(car, objects, np.arange(len(objects.frame)), objects.frame)


def post_encroachment_s(car: VehicleCourse, objects: RoadUsers, period_s: float) -> float | None:
    """The shortest post-encroachment time of a car and the objects that cross its way, s; None: above 5 s.

    It is the time between the last moment at which one of the two is at a place, and the first at which the other is;
    here between two frames, so that it is too long by less than two. Who follows the car, or is followed, does not
    count.

    Source: Allen, Shin and Cooper, Analysis of traffic conflicts and collisions (Transportation Research Record 667,
    1978).
    """
    frames = len(car.position)
    for apart in range(round(_LONGEST_S / period_s) + 1):
        for shift in {apart, -apart}:
            row = objects.frame + shift
            rows = np.flatnonzero((row >= 0) & (row < frames))
            met = _overlapping(car, objects, rows, row[rows])
            if (np.abs(wrap_angle(objects.yaw[met] - car.heading[row[met]])) >= _CROSSING).any():
                return apart * period_s
    return None


def _overlapping(car: VehicleCourse, objects: RoadUsers, rows: Ints, at: Ints) -> Ints:
    """Of (k,) rows of objects, those whose outlines overlap that of the car in its frames `at` (k,)."""
    offset = objects.position[rows, :2] - car.position[at, :2]
    own = np.broadcast_to([car.length, car.width], offset.shape)
    return rows[overlapping(offset, own, car.heading[at], objects.size[rows], objects.yaw[rows])]

"""When a driven car brakes, what made that needful, and whether the truth did."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.driving.corridor import InCorridor, needed_braking
from mast_zenoh.driving.following import IntelligentDriverModel
from mast_zenoh.driving.motion import CarLimits, RouteAhead
from mast_zenoh.metrics.driving import SafeDistance, TimeToCollision

#: m/s^2; a car brakes when it slows down more than this. Source: UN Regulation No. 13-H, 5.2.22.4: braking above it has
#: to light the stop lamps.
BRAKING_MPS2 = 1.3
#: m/s^2; less is no reason to brake: a car that follows another at a constant speed comes to 0.73 in the model.
_REASON_MPS2 = 1.0
#: Of a brake, and of the braking that a false object asks for, the share that the truth has to ask for, too.
_REASON_SHARE = 0.5
#: s; a shorter interruption does not end a brake, and a reason counts for as long after it has gone.
_PAUSE_S = 0.5
#: m/s^2; an emergency needs more braking than this. Source: see `consequences.NEAR_MISS_BRAKING_MPS2`.
_EMERGENCY_MPS2 = 3.0
#: s, in which a car that is too fast slows down, and m, the least way in which it does.
_ADAPT_S, _LEAST_M = 1.0, 1.0
#: m/s^2; by so little, braking is no harder.
_EQUAL_MPS2 = 1e-6
#: How cars brake: for objects, as one that comes to a standstill before lines, and before bends.
_REFERENCE = IntelligentDriverModel()
#: When they brake as hard as they can, whatever the model asks for: see `FollowingDriver`.
_EMERGENCY = TimeToCollision()


class Belief(NamedTuple):
    """n objects that a driver believed in, each at the time of the frame in which it decided.

    id: (n,) of the track; real: (n,) id of the object that it is, -1: it is false
    adversary: (n,) str, who showed a false object, or moved a real one, "": nobody
    """

    id: Ints
    real: Ints
    adversary: np.ndarray


class Commands(NamedTuple):
    """What a car obeyed in f frames.

    of: (f,) row of the frame whose command it obeyed until the next frame; -1: it had none, or was not driven yet
    informed: (f,) whether its driver had an estimate
    tampered: (f,) adversaries that made it brake harder, or withheld that of the frame, joined by "+"; "": none
    left_out: ports of the driver whose messages are not known, as a replay leaves them out; "command": the commands
    first:    row from which on it is driven
    """

    of: Ints
    informed: Bools
    tampered: Sequence[str]
    left_out: frozenset[str] = frozenset()
    first: int = 0

    @property
    def obeyed(self) -> int | None:
        """The number of commands that the car obeyed, until the last frame; None: not known."""
        return None if "command" in self.left_out else len(np.unique(self.of[:-1][self.of[:-1] >= 0]))

    @property
    def uncommanded(self) -> int | None:
        """The number of frames, but the last, in which the driven car had no new command; None: not known.

        It went on as it was told, or braked.
        """
        if "command" in self.left_out:
            return None
        driven = self.of[self.first : -1]
        return int(np.count_nonzero(driven < np.arange(self.first, self.first + len(driven))))


class Brake(NamedTuple):
    """An uninterrupted time of braking: rows of frames in which it begins, is hardest for the first time, and ends."""

    first: int
    hardest: int
    end: int


def spans(during: Bools, pause: int = 0) -> list[tuple[int, int]]:
    """First frame and end of the times in which a condition (f,) holds; shorter breaks than `pause` frames included."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], during, [False]]).astype(np.int8)))
    result: list[tuple[int, int]] = []
    for first, end in edges.reshape(-1, 2).tolist():
        if result and first - result[-1][1] < pause:
            first = result.pop()[0]
        result.append((first, end))
    return result


def brakes_of(acceleration: Floats, period_s: float) -> list[Brake]:
    """The brakes of a car by its acceleration (f - 1,) m/s^2 from each frame to the next."""
    during = spans(acceleration < -BRAKING_MPS2, round(_PAUSE_S / period_s))
    least = [float(acceleration[first:end].min()) + _EQUAL_MPS2 for first, end in during]
    return [
        Brake(first, first + int((acceleration[first:end] <= hardest).argmax()), end)
        for (first, end), hardest in zip(during, least, strict=True)
    ]


def around(brakes: Sequence[Brake], period_s: float) -> list[int]:
    """Rows of the frames in which there may be a reason for a brake, ascending: see `needless`."""
    pause = round(_PAUSE_S / period_s)
    return sorted({row for brake in brakes for row in range(max(brake.first - pause, 0), brake.hardest + 1)})


def demanded_by_objects(corridor: InCorridor) -> Floats:
    """Braking (n,) m/s^2 that each object in the corridor of a car asks of a driver that follows it.

    A slow car whose time to collision with something oncoming is short has to brake fully, though the model, made for
    cars that drive one after the other, asks for little.
    """
    own, gap, ahead = corridor.own_mps, corridor.gap_m, corridor.ahead_mps
    full = np.where(_EMERGENCY.brakes(gap, own, ahead), CarLimits().braking, 0.0)
    return np.maximum(-_REFERENCE.interaction(own, gap, ahead), full)


def demanded_by_lines(speed: Floats, routes: Mapping[int, RouteAhead]) -> Floats:
    """Braking (f,) m/s^2 that the line ahead asks of a driver in each frame; 0: none. speed: (f,) m/s"""
    gap = np.full(len(speed), np.inf)
    for frame, route in routes.items():
        gap[frame] = route.stop_m + _REFERENCE.gap_m  # it stops at the line, not before it
    return -_REFERENCE.interaction(speed, gap, np.zeros_like(speed))


def demanded_by_road(speed: Floats, routes: Mapping[int, RouteAhead]) -> Floats:
    """Braking (f,) m/s^2 that bends and limits ahead ask of a driver in each frame; 0: none. speed: (f,) m/s

    The constant braking after which the car is everywhere as slow as it has to be, where it is now in `_ADAPT_S`; none
    if that needs no brake.
    """
    result = np.zeros(len(speed))
    for frame, route in routes.items():
        distance = np.maximum(route.along, max(_ADAPT_S * speed[frame], _LEAST_M))
        result[frame] = ((speed[frame] ** 2 - route.speed**2) / (2.0 * distance)).max(initial=0.0)
    return np.where(result > BRAKING_MPS2, result, 0.0)


def hardest_per_frame(corridor: InCorridor, frames: int) -> Floats:
    """The hardest braking (f,) m/s^2 that any object asks for in each frame."""
    result = np.zeros(frames)
    np.maximum.at(result, corridor.frame, demanded_by_objects(corridor))
    return result


def causes(
    brakes: Sequence[Brake],
    believed: InCorridor,
    belief: Belief,
    lines: Floats,
    commands: Commands,
) -> list[tuple[dict[str, Any], float]]:
    """What made each brake needful, and the braking in m/s^2 that it asked for.

    The former is the "cause" of metrics.json, see `consequences.consequences`; the latter is at most what a car can do,
    and 0 if neither an object nor a line is the cause.

    In the frames whose commands the car obeys from a brake's first frame to its hardest one, the object of the driver's
    estimate, or the line, that asks for the hardest braking: "real", "false", "line", or "none". Without a command in
    the hardest one it is "no command", and "no estimate" if the driver had none when it gave that command. Where an
    adversary made the command of the hardest frame brake harder, no estimate explains it. It is "unknown" where what
    would tell is left out.

    believed: the objects that the driver believed in its corridor; belief: what each of its objects is, by row
    lines: (f,) m/s^2, braking for lines; commands: what the car obeyed
    """
    demanded = demanded_by_objects(believed)
    result = []
    for brake in brakes:
        adversaries = commands.tampered[brake.hardest]
        obeyed, decided = int(commands.of[brake.hardest]), commands.of[brake.first : brake.hardest + 1]
        cause: dict[str, Any] = {"object": None, "kind": "none", "adversary": adversaries or None}
        rows = np.flatnonzero(np.isin(believed.frame, decided))
        asked, line = 0.0, float(lines[decided[decided >= 0]].max(initial=0.0))
        hardest = float(demanded[rows].max(initial=0.0))
        if "command" in commands.left_out:
            cause |= {"kind": "unknown", "adversary": None}
        elif obeyed < 0:
            cause["kind"] = "no command"
        elif not adversaries and commands.left_out:
            cause["kind"] = "unknown"
        elif not adversaries and not commands.informed[obeyed]:
            cause["kind"] = "no estimate"
        elif not adversaries and max(line, hardest) >= _REASON_MPS2:
            asked = min(max(line, hardest), CarLimits().braking)
            if line >= hardest:
                cause["kind"] = "line"
            else:
                row = believed.row[rows[demanded[rows].argmax()]]
                real = int(belief.real[row])
                cause["object"] = int(belief.id[row]) if real < 0 else real
                cause["kind"] = "false" if real < 0 else "real"
                cause["adversary"] = str(belief.adversary[row]) or None
        result.append((cause, asked))
    return result


def needless(brake: Brake, demanded: Floats, period_s: float, ghost_mps2: float = 0.0) -> bool:
    """Whether the truth gave no reason for a brake, from shortly before its first frame to its hardest one.

    By how cars brake in general, where it is not known what this car's driver would have done, see `on_truth`.
    A slight reason is none for a hard brake for what is not there: then the truth has to ask for half as much.

    demanded: (f,) m/s^2, braking that the objects that are there, the line and the road ask for
    ghost_mps2: braking that the brake's cause asks for, if it is false, else 0
    """
    first = max(brake.first - round(_PAUSE_S / period_s), 0)
    reason = max(_REASON_MPS2, _REASON_SHARE * ghost_mps2)
    return bool(demanded[first : brake.hardest + 1].max(initial=0.0) < reason)


def on_truth(brake: Brake, commanded: Floats, period_s: float) -> float | None:
    """The hardest braking in m/s^2 that a car's driver, given the truth, commands around a brake, see `needless`.

    commanded: (f,) m/s^2, NaN: not known; None: it is not known in all of these frames
    """
    hardest = float(commanded[max(brake.first - round(_PAUSE_S / period_s), 0) : brake.hardest + 1].max())
    return None if np.isnan(hardest) else max(hardest, 0.0)


def needless_on_truth(hardest_mps2: float, on_truth_mps2: float) -> bool:
    """Whether a driver that brakes by `on_truth_mps2` on the truth would not have braked, or not half as hard."""
    return on_truth_mps2 < max(_REASON_MPS2, _REASON_SHARE * hardest_mps2)


def emergencies(truth: InCorridor, frames: int) -> Bools:
    """Whether (f,) the truth demands emergency braking in each frame: contact in less than 1.5 s without it."""
    braking = needed_braking(truth.gap_m, truth.own_mps, truth.ahead_mps)
    critical = _EMERGENCY.brakes(truth.gap_m, truth.own_mps, truth.ahead_mps) & (braking > _EMERGENCY_MPS2)
    return np.bincount(truth.frame[critical], minlength=frames) > 0


def missed_brakes(demanded: Bools, hit_ahead: Sequence[tuple[int, int]], acceleration: Floats, period_s: float) -> int:
    """Emergencies and contacts with what is ahead before which a car did not brake although there was time to.

    demanded: (f,) whether the truth demands emergency braking: for longer than the response time of `SafeDistance`
    hit_ahead: of each contact with what was ahead, the rows of frames between which it would have had to brake; one
        that ends an emergency is the same miss
    acceleration: (f - 1,) m/s^2
    """
    response = round(SafeDistance().response_s / period_s)
    long = [(first, end) for first, end in spans(demanded) if end - first > response]
    missed = [during for during in long if not _brakes_in(during, acceleration)]
    slow = [before for before in hit_ahead if not _brakes_in(before, acceleration)]
    return len(missed) + sum(not any(first <= at and end >= start for first, end in missed) for start, at in slow)


def _brakes_in(during: tuple[int, int], acceleration: Floats) -> bool:
    return bool((acceleration[slice(*during)] < -BRAKING_MPS2).any())

"""Fits a pose error and a time offset to how an agent's tracks differ from those of other agents.

A fault is (4,): x and y in m, a turn in rad, and a lead in s, by which its tracks are ahead; it moves all tracks of the
agent alike.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_yaw
from mast_zenoh.arrays.matching import neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.integrity.calibration import MAX_STEP_S, SAMPLES_PER_S
from mast_zenoh.integrity.views import SweptView

#: m, farthest from a track of another agent that the same object may be reported, by an agent with a fault.
GATE_M = 6.0
#: Tracks of an agent that a fault is fitted to, at most, and tracks of others for each: a flood must cost little.
MAX_TRACKS, MAX_PAIRS = 200, 16
#: m, distance from where a fault puts a track within which another agent's track is of the same object.
MATCH_M = 1.6
#: Share of the tracks that must be matched so; else the fault is not the known one.
MATCHED = 0.6
#: m, standard deviation of a displacement that the covariances do not contain: boxes seen from two sides.
FLOOR_M = 0.1
#: m, how far displacements of two objects may differ that have one cause.
COMMON_M = 0.8
#: Standard deviations at which a displacement stops to count for more.
CLIP = 1.5
#: Standard deviations up to which a fit explains a displacement.
EXPLAINED_SD = 3.0
#: Tracks that two agents must share to be compared, and mean squared deviation up to which they agree; 2 is the mean of
#: honest agents.
COMPARABLE, AGREEING = 3, 3.5
#: Gain of log-likelihood from which a fault explains the difference of two agents clearly better than none.
CLEARLY = 3.0
#: Sums of no batches.
NOTHING = np.zeros((4, 4)), np.zeros(4)
#: Variances of the parameters before any evidence: (2 m, 2 m, 0.1 rad, 0.3 s) squared.
PRIOR = np.array([4.0, 4.0, 0.01, 0.09])


@dataclass(frozen=True, slots=True, eq=False)
class Displacements:
    """k displacements of an agent's tracks from other agents' tracks of the same objects.

    offset: (k, 2) m; information: (k, 2, 2) 1/m^2; design: (k, 2, 4) derivatives of the offset by the parameters
    agent: (k,) numbers of the other agents
    """

    offset: Floats
    information: Floats
    design: Floats
    agent: Ints

    @property
    def others(self) -> int:
        """Number of other agents."""
        return len(np.unique(self.agent))


def displacements(own: ObjectStates, other: ObjectStates, agent: Ints, pivot: Floats, fault: Floats) -> Displacements:
    """Displacements of the tracks of one agent.

    own: n tracks of the agent; other: m of the others, with agent (m,); all in the world frame at one time
    pivot: (2,) m, about which the agent turns; fault: (4,) that it is known to have

    Two tracks are of one object if they are where the known fault puts them. Where that matches few of the tracks, it
    is decided by the displacement that most of them have in common, which can be larger than the distance between
    objects.
    """
    own = own.select(slice(MAX_TRACKS))
    i, j, dx, dy = _nearest(own.position, other.position)
    design = np.zeros((len(i), 2, 4))
    design[:, 0, 0] = design[:, 1, 1] = 1.0
    arm = own.position[i, :2] - pivot
    design[:, 0, 2], design[:, 1, 2] = -arm[:, 1], arm[:, 0]
    design[:, :, 3] = other.velocity[j, :2]
    shift = -np.column_stack([dx, dy])
    away = shift - design @ fault
    near = np.zeros(len(own), np.bool_)
    near[i[np.hypot(away[:, 0], away[:, 1]) <= MATCH_M]] = True
    if len(i) and near.sum() < MATCHED * len(np.unique(i)):
        away = shift - shift[_most_common(shift, i, len(own))]
    distance = np.hypot(away[:, 0], away[:, 1])
    order = np.lexsort((distance, agent[j], i))
    order = order[distance[order] <= MATCH_M]
    pair = i[order] * (int(agent.max(initial=0)) + 1) + agent[j[order]]
    first = order[np.flatnonzero(np.diff(pair, prepend=-1))]  # the nearest track of each other agent
    i, j = i[first], j[first]
    covariance = own.covariance[i, :2, :2] + other.covariance[j, :2, :2] + FLOOR_M**2 * np.eye(2)
    information: Floats = np.asarray(np.linalg.inv(covariance), np.float64)
    return Displacements(shift[first], information, design[first], agent[j])


def _nearest(own: Floats, other: Floats) -> tuple[Ints, Ints, Floats, Floats]:
    """As `neighbours` within GATE_M, with at most MAX_PAIRS for each of the own tracks, the nearest."""
    i, j, dx, dy = neighbours(own, other, np.full(len(own), GATE_M))
    order = np.lexsort((np.hypot(dx, dy), i))
    start = np.flatnonzero(np.diff(i[order], prepend=-1))
    rank = np.arange(len(order)) - np.repeat(start, np.diff(start, append=len(order)))
    kept = np.sort(order[rank < MAX_PAIRS])
    return i[kept], j[kept], dx[kept], dy[kept]


def _most_common(shift: Floats, own: Ints, n: int) -> int:
    """The displacement (p, 2) that most of n tracks nearly have; the smallest of equals.

    own: (p,) track of each displacement
    """
    i, j, _, _ = neighbours(shift, shift, np.full(len(shift), COMMON_M))
    supporters = np.zeros((len(shift), n), np.bool_)
    supporters[i, own[j]] = True
    count = supporters.sum(axis=1)
    return int(np.lexsort((np.hypot(shift[:, 0], shift[:, 1]), -count))[0])


def normal_equations(found: Displacements, estimate: Floats | None) -> tuple[Floats, Floats]:
    """Sums (4, 4) and (4,) of weighted least squares.

    estimate: (4,) fault from which outliers are judged, and their weight limited; None: nothing is an outlier
    """
    weight = np.ones(len(found.offset))
    if estimate is not None:
        weight = np.minimum(1.0, CLIP / np.maximum(_deviations(found, estimate), 1e-9))
    design, offset = found.design.reshape(-1, 4), found.offset.reshape(-1)
    scaled = ((found.information * weight[:, None, None]) @ found.design).reshape(-1, 4).T
    return scaled @ design, scaled @ offset


def misfit(found: Displacements, estimate: Floats) -> float:
    """Sum of Huber's loss over the displacements that a fault (4,) leaves."""
    return float(huber_loss(_deviations(found, estimate)).sum())


def huber_loss(deviation: Floats) -> Floats:
    """Huber's loss of deviations."""
    return np.where(deviation <= CLIP, 0.5 * deviation**2, CLIP * (deviation - 0.5 * CLIP))


def explained(found: Displacements, estimate: Floats) -> float:
    """Share of the displacements that a fault (4,) explains."""
    return float((_deviations(found, estimate) <= EXPLAINED_SD).mean()) if len(found.offset) else 0.0


def agreeing(found: Displacements, known: Floats, fitted: Floats, corrected: Ints) -> Ints:
    """Numbers of the other agents whose tracks are where those of the agent are, without its known fault (4,).

    fitted: (4,) fault that fits the agent's tracks best. Where it explains the differences from another agent clearly
    better, the two do not agree, even if most of their objects stand and show nothing of a wrong clock.
    corrected: numbers of agents with a known fault; what is left of theirs looks like a fault of the agent's own, so
    that they do not count for this
    Of fewer than COMPARABLE tracks of one other agent, nothing is said.
    """
    deviation = _deviations(found, known)
    count = np.bincount(found.agent)
    mean = np.bincount(found.agent, np.minimum(deviation, EXPLAINED_SD) ** 2) / np.maximum(count, 1)
    gain = np.bincount(found.agent, huber_loss(deviation) - huber_loss(_deviations(found, fitted)))
    gain[corrected[corrected < len(gain)]] = 0.0
    return np.flatnonzero((count >= COMPARABLE) & (mean <= AGREEING) & (gain <= CLEARLY))


def _deviations(found: Displacements, estimate: Floats) -> Floats:
    """(k,) standard deviations by which displacements differ from those of a fault (4,)."""
    residual = found.offset - found.design @ estimate
    squared = (residual * (found.information @ residual[:, :, None])[:, :, 0]).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


def solved(
    found: Displacements,
    samples: float,
    past: tuple[Floats, Floats],
    start: Floats | None,
    expected: Floats,
    steps: int = 1,
) -> tuple[Floats, tuple[Floats, Floats]]:
    """The fault (4,) that fits best, and the sums (4, 4), (4,) with those of the past.

    samples: independent ones that the displacements stand for
    start: (4,) fault from which outliers are judged at first; None: none are
    expected: (4,) fault, as far as nothing shows another: standing objects show no delay
    steps: number of fits; outliers of each are judged from the one before
    """
    for _ in range(steps):
        information, score = normal_equations(found, start)
        total = past[0] + samples * information, past[1] + samples * score
        solution = np.linalg.solve(total[0] + np.diag(1.0 / PRIOR), total[1] + expected / PRIOR)
        start = np.asarray(solution, np.float64)
    assert start is not None
    return start, total


#: Mean of Huber's loss of a displacement up to which a fit is good.
FIT = 1.2
#: Difference of the sums of Huber's loss from which a batch shows another fault than those before.
CHANGED = 5.0


@dataclass(slots=True)
class FaultEstimate:
    """Sums and fault of one agent.

    time_ns: ns, of the last fit, or of the first batch
    fault: see `faults`; statistic: twice the log-likelihood that it gains
    share: of the tracks in the last fit that the fault explains; others: agents that reported them, too
    applied: whether the agent's tracks are corrected
    excused_until_ns: ns, until when no further fault excuses what the agent did before it was found
    loss: 0 to 1, share of frames in which nothing of the agent arrived
    """

    time_ns: int
    information: Floats = field(default_factory=lambda: np.zeros((4, 4)))
    score: Floats = field(default_factory=lambda: np.zeros(4))
    fault: Floats = field(default_factory=lambda: np.zeros(4))
    statistic: float = 0.0
    share: float = 0.0
    others: int = 0
    applied: bool = False
    excused_until_ns: int = 0
    loss: float = 0.0

    @property
    def known(self) -> Floats:
        """(4,) the fault that is corrected; zeros: none."""
        return self.fault * self.applied

    def update(self, time_ns: int, found: Displacements, memory_s: float) -> None:
        """Add the displacements of a batch. memory_s: s, after which they count 1/e"""
        elapsed_s = (time_ns - self.time_ns) * 1e-9
        samples = SAMPLES_PER_S * min(elapsed_s, MAX_STEP_S)
        keep = np.exp(-elapsed_s / memory_s)
        self.time_ns = time_ns
        past = keep * self.information, keep * self.score
        fault, total = solved(found, samples, past, self.fault, self.known)
        self.others = found.others
        if self.others and misfit(found, fault) > FIT * len(found.offset):
            # What was known does not explain this batch. It may be a new fault: fitted to this batch alone.
            anew, sums = solved(found, samples, NOTHING, None, np.zeros(4), steps=3)
            if misfit(found, anew) < misfit(found, fault) - CHANGED:
                fault, total = anew, sums
        self.fault, (self.information, self.score) = fault, total
        self.statistic = float(self.score @ fault)
        self.share = explained(found, fault)

    def forget(self) -> None:
        """Forget the sums, but not a fault that is corrected."""
        self.fault = self.known
        self.information, self.score = NOTHING
        self.statistic = 0.0


#: m, m/s: a track by which turns and delays are compared with displacements.
ARM_M, SPEED_MPS = 30.0, 10.0


def without_fault(states: ObjectStates, rows: Bools, fault: Floats, pivot: Floats) -> ObjectStates:
    """Tracks without the fault (4,) of an agent.

    rows: (n,) of the agent; pivot: (2,) m
    """
    x, y, turn, lead = fault.tolist()
    position, velocity, yaw = states.position.copy(), states.velocity.copy(), states.yaw.copy()
    arm = position[rows, :2] - pivot
    moved = np.column_stack([x - turn * arm[:, 1], y + turn * arm[:, 0]]) + lead * velocity[rows, :2]
    position[rows, :2] -= moved
    vx, vy = velocity[rows, :2].T
    velocity[rows, :2] = np.column_stack([vx + turn * vy, vy - turn * vx])
    yaw[rows] -= turn
    return states.with_(position=position, velocity=velocity, yaw=yaw)


def displacement_m(fault: Floats) -> Floats:
    """(...) m, by which faults (..., 4) move a track that is ARM_M away and drives at SPEED_MPS."""
    shift = np.hypot(fault[..., 0], fault[..., 1])
    return np.asarray(np.maximum(shift, np.maximum(ARM_M * np.abs(fault[..., 2]), SPEED_MPS * np.abs(fault[..., 3]))))


def described(fault: Floats) -> str:
    """A fault (4,) in words, as far as it shows: "all its tracks are shifted by 0.8 m, turned by -0.6°"."""
    x, y, turn, lead = fault.tolist()
    shift, degrees = float(np.hypot(x, y)), float(np.degrees(turn))
    parts = [
        f"shifted by {shift:.1f} m" if round(shift, 1) else "",
        f"turned by {degrees:.1f}°" if round(degrees, 1) else "",
        f"{abs(lead):.2f} s {'early' if lead > 0.0 else 'late'}" if round(lead, 2) else "",
    ]
    return f"all its tracks are {', '.join(part for part in parts if part) or 'slightly off'}"


def view_without_fault(view: SweptView, fault: Floats) -> SweptView:
    """A view without the fault (4,) of its agent; its sensor is the pivot of the turn."""
    position = view.view.position - np.array([fault[0], fault[1], 0.0])
    return replace(
        view, view=replace(view.view, position=position, rotation=rotation_from_yaw(-fault[2]) @ view.view.rotation)
    )

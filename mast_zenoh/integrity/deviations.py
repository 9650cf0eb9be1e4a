"""How far each agent's tracks are from what the other agents report of the same objects, for how long, and how usual
that is in the run.

Errors of real detectors last for seconds, so their mean does not shrink with the number of frames, and no number of
frames makes evidence. What counts is how a mean compares with those of all agents and objects in the same run.

What a fault of an agent does to its tracks and its view, and how to undo it.

A fault is (4,): x and y in m, a turn in rad, and a lead in s, by which its tracks are ahead; it moves all tracks of the
agent alike.

Medians of columns, of groups, and of the members of clusters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_yaw
from mast_zenoh.arrays.matching import neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.integrity.base import Batch, ClusterBoxes
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.integrity.visibility import MAX_ERROR_M
from mast_zenoh.kernels import kernel

#: What is compared, two numbers of each: x and y of position, m, and velocity, m/s; heading of the length axis, rad,
#: modulo 180 degrees; length and width, relative to the middle.
POSITION, VELOCITY, HEADING, SIZE = range(4)
#: Tracks of an object, at least, for a middle that one liar cannot move far.
MIN_MEMBERS = 3
#: Standard deviations of the part of each quantity that covariances do not show: boxes seen from two sides.
FLOORS = np.array([0.2, 0.5, 0.1, 0.1])
#: Standard deviations that a track may claim at most of each quantity: a large one is in its favour.
MOST_CLAIMED = np.array([MAX_ERROR_M, 3.0, 0.0, 0.2])
#: m, that of positions of objects shorter than SMALL_M: trackers swap pedestrians that walk together.
SMALL_FLOOR_M, SMALL_M = 0.35, 1.5
#: Length over width from which a box shows its heading, and rad, standard deviation of that of an object slower than
#: SLOW_MPS: trackers take the heading from the motion.
LONG, SLOW_FLOOR_RAD, SLOW_MPS = 1.5, 0.3, 1.0
#: m, between two clusters: nearer ones may have swapped members.
CROWD_M = 3.5
#: Variance of the median of normal errors, relative to that of their mean.
MEDIAN_VARIANCE = np.pi / 2
#: Standard deviations at which a deviation stops to count for more: a track of another object may be near for a moment.
CLIP = 8.0

#: The means of deviations: what each is of, and s after which a deviation has fallen to 1/e. Only positions are judged
#: at once: trackers that swap two objects err in all else for half a second.
QUANTITY = np.array([POSITION, POSITION, VELOCITY, HEADING, SIZE])
MEMORY_S = np.array([0.3, 3.0, 3.0, 3.0, 3.0])
NAMES = ("position", "position", "velocity", "heading", "size")
#: How the reason of a suspension begins, by name.
REASONS = {name: f"reports a {name} that differs from the other agents'" for name in NAMES}
#: Their usual length, standard deviations, before a run shows it, and by what factor a run's may differ from it: liars
#: cannot stretch it far.
USUAL = np.array([0.6, 0.3, 0.22, 0.4, 0.44])
USUAL_FACTOR = 2.0
#: By what the greatest, second, third and fourth mean of an agent are multiplied: honest agents have as large products
#: of each, so several smaller deviations are as much evidence as one.
RANKS = np.array([1.0, 1.4, 1.7, 2.0])
#: Greatest lengths that count. Two objects alone are evidence only where they are: an honest track that begins with a
#: false detection has the size of something else for seconds, and two that are swapped have each other's velocity.
GREATEST = np.array([np.inf, np.inf, 9.4, 9.4, 9.4])
#: s, over which the usual length is averaged, and between two looks at it.
USUAL_S, LOOK_S = 10.0, 1.0
#: s, greatest time for which a track stands that was not there before.
STEP_S = 0.2

_VARIANCES = 10 * np.array([0, 1, 6, 7, 0, 0, 3, 4])  # of each number, in a flat covariance; the heading has none


@dataclass(frozen=True, slots=True, eq=False)
class Deviations:
    """k tracks' deviations from the middle of their clusters.

    cluster, agent: (k,) of each track, no pair twice
    whitened: (k, 4, 2) deviation in standard deviations of an honest agent's; 0 where it is not judged
    judged: (k, 4) whether the object shows the quantity
    std: (k, 4) the standard deviations, in the units of the quantities
    """

    cluster: Ints
    agent: Ints
    whitened: Floats
    judged: Bools
    std: Floats


def deviations(batch: Batch, boxes: ClusterBoxes, weight: Floats) -> Deviations:
    """Deviations of the tracks of agents from the weighted medians of their clusters.

    boxes: of the clusters; weight: (a,) >= 0, of each agent in the median; 0: it is not counted

    The median, number by number, is near the honest majority's wherever a single liar is. Clusters with fewer than
    MIN_MEMBERS tracks that count have no middle, nor have those nearer than CROWD_M to another one.
    """
    isolated = np.ones(batch.clusters, np.bool_)
    i, j, _, _ = neighbours(boxes.position, boxes.position, np.full(batch.clusters, CROWD_M))
    isolated[i[i != j]] = False
    counted = batch.reported & (weight > 0.0)
    count = counted.sum(axis=1)
    kept = np.flatnonzero(isolated & (count >= MIN_MEMBERS))
    member, counted, count = batch.member[kept], counted[kept], count[kept]
    row_of, agent = np.nonzero(member >= 0)
    track, states = member[row_of, agent], batch.states
    axis = np.column_stack([np.cos(2.0 * states.yaw), np.sin(2.0 * states.yaw)])
    values = np.column_stack([states.position[:, :2], states.velocity[:, :2], axis, states.size[:, :2]])
    middle = weighted_medians(values, member, counted * weight)
    size = np.maximum(middle[:, 6:], 0.1)
    own, of = values[track].reshape(-1, 4, 2), middle[row_of].reshape(-1, 4, 2)
    value = own - of
    # Half the difference of doubled angles, along and across the middle axis: the sine of the angle between the axes.
    length = 0.5 / np.maximum(np.hypot(of[:, HEADING, 0], of[:, HEADING, 1]), 1e-9)
    along = length * (own[:, HEADING] * of[:, HEADING]).sum(axis=1)
    across = length * (own[:, HEADING, 1] * of[:, HEADING, 0] - own[:, HEADING, 0] * of[:, HEADING, 1])
    value[:, HEADING, 0], value[:, HEADING, 1] = along - 0.5, across
    value[:, SIZE] /= size[row_of]
    claimed = states.covariance.reshape(-1, 81)[track[:, None], _VARIANCES].reshape(-1, 4, 2)
    claimed[:, SIZE] /= size[row_of] ** 2
    claimed = np.clip(claimed.mean(axis=2), 0.0, MOST_CLAIMED**2)
    starts = np.searchsorted(row_of, np.arange(len(kept)))
    of_middle = np.add.reduceat(claimed * counted[row_of, agent][:, None], starts) if len(kept) else np.zeros((0, 4))
    of_middle *= (MEDIAN_VARIANCE / count**2)[:, None]
    floor = np.tile(FLOORS, (len(kept), 1))
    small = size[:, 0] < SMALL_M
    floor[small, POSITION] = SMALL_FLOOR_M
    floor[np.hypot(middle[:, 2], middle[:, 3]) < SLOW_MPS, HEADING] = SLOW_FLOOR_RAD
    std = np.sqrt(claimed + (of_middle + floor**2)[row_of])
    judged = np.ones((len(kept), 4), np.bool_)
    judged[:, HEADING] = size[:, 0] >= LONG * size[:, 1]
    judged[:, SIZE] = ~small
    judged = judged[row_of]
    whitened = np.where(judged[..., None], value / std[..., None], 0.0)
    return Deviations(kept[row_of], agent, whitened, judged, std)


@dataclass(frozen=True, slots=True, eq=False)
class Means:
    """Means of the deviations of k tracks over time, until a batch.

    cluster, agent: (k,) of each track, no pair twice
    mean: (k, 5, 2) relative to the usual length of such a mean, in the order of NAMES
    usual: (k, 5) the usual lengths, in the units of the quantities
    weight: (k, 5) 0 to 1, what the mean of a deviation that was always 1 would be: less of a track that began lately
    """

    cluster: Ints
    agent: Ints
    mean: Floats
    usual: Floats
    weight: Floats

    @property
    def length(self) -> Floats:
        """(k, 5) lengths of the means, at most GREATEST of each; an honest agent's are about 1."""
        return np.asarray(np.minimum(np.sqrt((self.mean**2).sum(axis=2)), GREATEST))

    def of_agents(self, agents: int) -> tuple[Floats, Bools]:
        """(a,) statistic of each agent, the greatest of its largest means times RANKS; (k,) the tracks that make it."""
        length = self.length.max(axis=1, initial=0.0)
        largest = _largest(length, self.agent, agents)
        statistics = largest * RANKS
        last = statistics.argmax(axis=1)
        rows = np.arange(agents)
        return statistics[rows, last], np.asarray(length >= largest[rows, last][self.agent])

    def apart(self, compared: Bools) -> tuple[Ints, Ints, Floats]:
        """Pairs of agents (p,), (p,), and how far their tracks are apart, as the statistic of an agent.

        compared: (k,) tracks that are compared with all others of their objects

        As if both were seen since the later one began: what moves the middle of an object has moved the mean of a track
        that has been there for longer by more.
        """
        one, other = np.nonzero(compared[:, None] & (self.cluster[:, None] == self.cluster))
        one, other = one[one != other], other[one != other]
        absolute = self.mean * (self.usual / self.weight)[..., None]
        scale = np.minimum(self.weight[one], self.weight[other]) ** 2
        scale /= self.usual[one] ** 2 + self.usual[other] ** 2
        difference = np.sqrt(((absolute[one] - absolute[other]) ** 2).sum(axis=2) * scale)
        agents = self.agent.max(initial=0) + 1
        pairs, row = np.unique(self.agent[one] * agents + self.agent[other], return_inverse=True)
        largest = _largest(np.minimum(difference, GREATEST).max(axis=1, initial=0.0), row, len(pairs))
        return pairs // agents, pairs % agents, (largest * RANKS).max(axis=1)

    def left_by_fault(self, agent: int, kind: int, design: Floats) -> float:
        """Share of an agent's squared deviations of position that the fault that fits them best leaves, 0 to 1.

        kind: of the means, one of the two of positions;  design: (c, 2, 4) of the objects, see `displacements`
        """
        rows = np.flatnonzero(self.agent == agent)
        of, fits = self.mean[rows, kind], design[self.cluster[rows]] / self.usual[rows, kind, None, None]
        information = np.diag(1.0 / PRIOR) + np.einsum("kij,kil->jl", fits, fits)
        fault = np.linalg.solve(information, np.einsum("kij,ki->j", fits, of))
        return min(1.0, float(((of - fits @ fault) ** 2).sum() / max((of**2).sum(), 1e-12)))


def _largest(values: Floats, group: Ints, groups: int) -> Floats:
    """(groups, len(RANKS)) the largest values of each group, descending; 0 where it has fewer. values, group: (k,)"""
    order = np.lexsort((-values, group))
    grouped = group[order]
    rank = np.arange(len(order)) - np.searchsorted(grouped, grouped)
    first = rank < len(RANKS)
    largest = np.zeros((groups, len(RANKS)))
    largest[grouped[first], rank[first]] = values[order[first]]
    return largest


class LastingDeviations:
    """Exponentially forgotten means of each agent's deviations from each object, and what is usual of them.

    A mean begins at 0, and returns to it while the agent does not report the object: a new or rare track shows little.
    Objects are those of the command centre: an agent that gives its tracks new ids does not lose their means.

    limit: pairs of an agent and an object that are remembered at most; those not seen for longest are forgotten first
    """

    def __init__(self, limit: int = 10_000) -> None:
        self._limit = limit
        self._usual = USUAL.copy()
        self._looked_ns: int | None = None
        self.forget_all()

    def forget_all(self) -> None:
        """Forget all deviations, but not what is usual."""
        self._row: dict[tuple[int, int], int] = {}  # by (agent, object)
        self._mean, self._weight = np.zeros((0, len(QUANTITY), 2)), np.zeros((0, len(QUANTITY)))
        self._time_ns = np.zeros(0, np.int64)
        self._most = min(100, self._limit)  # pairs from which the oldest are forgotten

    def forget(self, agent: int) -> None:
        """Forget the deviations of an agent."""
        self._keep([(key, row) for key, row in self._row.items() if key[0] != agent])

    def update(self, time_ns: int, number: Ints, obj: Ints, measured: Deviations, believed: Bools) -> Means:
        """The means of deviations, with a batch.

        number: (a,), obj: (c,) numbers of the agents and objects, which never change; measured: k deviations of a batch
        believed: (a,) agents that show what is usual
        """
        keys = zip(number[measured.agent].tolist(), obj[measured.cluster].tolist(), strict=True)
        rows = np.array([self._row.setdefault(key, len(self._row)) for key in keys], np.int64)
        new = len(self._row) - len(self._mean)
        self._mean = np.concatenate([self._mean, np.zeros((new, len(QUANTITY), 2))])
        self._weight = np.concatenate([self._weight, np.zeros((new, len(QUANTITY)))])
        self._time_ns = np.concatenate([self._time_ns, np.full(new, time_ns - round(0.5 * STEP_S * 1e9))])
        elapsed_s = (time_ns - self._time_ns[rows]) * 1e-9
        keep = np.exp(-elapsed_s[:, None] / MEMORY_S)
        add = 1.0 - np.maximum(keep, np.exp(-STEP_S / MEMORY_S))
        length = np.sqrt((measured.whitened**2).sum(axis=2, keepdims=True))
        clipped = measured.whitened * np.minimum(1.0, CLIP / np.maximum(length, 1e-12))
        mean = self._mean[rows] * keep[..., None] + add[..., None] * clipped[:, QUANTITY]
        weight = self._weight[rows] * keep + add
        self._mean[rows], self._weight[rows], self._time_ns[rows] = mean, weight, time_ns
        self._forget_oldest(time_ns)
        self._learn_usual(time_ns, mean, measured, believed)
        usual = measured.std[:, QUANTITY] * self._usual
        return Means(measured.cluster, measured.agent, mean / self._usual[:, None], usual, weight)

    def _learn_usual(self, time_ns: int, mean: Floats, measured: Deviations, believed: Bools) -> None:
        """Update what is usual by the means of a batch: the median over agents of the medians over their objects."""
        elapsed_s = LOOK_S if self._looked_ns is None else (time_ns - self._looked_ns) * 1e-9
        if elapsed_s < LOOK_S:
            return
        self._looked_ns = time_ns
        length = np.sqrt((mean**2).sum(axis=2))
        length[~measured.judged[:, QUANTITY]] = np.nan
        of_agents = [column_medians(length[measured.agent == each]) for each in np.flatnonzero(believed).tolist()]
        seen = column_medians(np.array(of_agents).reshape(-1, len(QUANTITY)))
        seen = np.where(np.isnan(seen), self._usual, np.clip(seen, USUAL / USUAL_FACTOR, USUAL * USUAL_FACTOR))
        self._usual += (seen - self._usual) * (1.0 - np.exp(-min(elapsed_s, USUAL_S) / USUAL_S))

    def _forget_oldest(self, time_ns: int) -> None:
        if len(self._row) > self._most:
            oldest_ns = time_ns - round(5.0 * MEMORY_S.max() * 1e9)
            newest = sorted(self._row.items(), key=lambda item: -self._time_ns[item[1]])[: self._limit]
            self._keep([(key, row) for key, row in newest if self._time_ns[row] >= oldest_ns])
            self._most = min(2 * len(self._row) + 100, self._limit)

    def _keep(self, kept: list[tuple[tuple[int, int], int]]) -> None:
        rows = np.array([row for _, row in kept], np.int64)
        self._row = {key: row for row, (key, _) in enumerate(kept)}
        self._mean, self._weight, self._time_ns = self._mean[rows], self._weight[rows], self._time_ns[rows]


#: m, m/s: a track by which turns and delays are compared with displacements.
ARM_M, SPEED_MPS = 30.0, 10.0
#: Variances of a fault before any evidence: (2 m, 2 m, 0.1 rad, 0.3 s) squared.
PRIOR = np.array([4.0, 4.0, 0.01, 0.09])


def displacements(arm: Floats, velocity: Floats) -> Floats:
    """(k, 2, 4) derivatives of the displacement of tracks by a fault.

    arm: (k, 2) m, from the point about which the agent turns; velocity: (k, 2) m/s
    """
    result = np.zeros((len(arm), 2, 4))
    result[:, 0, 0] = result[:, 1, 1] = 1.0
    result[:, 0, 2], result[:, 1, 2] = -arm[:, 1], arm[:, 0]
    result[:, :, 3] = velocity
    return result


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


def column_medians(values: Floats | Ints) -> Floats:
    """(q,) medians of the numbers in each column (k, q); NaN for a column without any."""
    if not len(values):
        return np.full(values.shape[1], np.nan)
    ordered, count = np.sort(values, axis=0), (~np.isnan(values)).sum(axis=0)  # NaN are the last
    low, high = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, len(values) - 1)
    column = np.arange(values.shape[1])
    return np.asarray(0.5 * (ordered[low, column] + ordered[high, column]))


def group_medians(values: Floats, group: Ints) -> Floats:
    """(g, k) medians of the columns of values (n, k) in each of g groups that occur. group: (n,) >= 0"""
    count = np.bincount(group)
    count = count[count > 0]
    first = np.cumsum(count) - count
    low, high = first + (count - 1) // 2, first + count // 2
    ordered = np.column_stack([column[np.lexsort((column, group))] for column in values.T])
    return np.asarray(0.5 * (ordered[low] + ordered[high]))


@kernel
def weighted_medians(values: Floats, member: Ints, weight: Floats) -> Floats:
    """(c, q) weighted medians of the values of the members of clusters, the middle of their ends where they differ.

    values: (n, q) of n tracks; member: (c, a) rows of tracks; weight: (c, a) >= 0, of each member
    """
    table = values[member].transpose(0, 2, 1)
    order = np.argsort(table, axis=2, kind="stable")
    ordered = np.take_along_axis(table, order, axis=2)
    below = np.cumsum(np.take_along_axis(np.broadcast_to(weight[:, None], table.shape), order, axis=2), axis=2)
    half = 0.5 * below[..., -1:]
    ends = [(below >= half * (1.0 - 1e-9)).argmax(axis=2), (below > half * (1.0 + 1e-9)).argmax(axis=2)]
    low, high = (np.take_along_axis(ordered, end[..., None], axis=2)[..., 0] for end in ends)
    return np.asarray(0.5 * (low + high))

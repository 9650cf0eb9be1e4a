"""How far each agent's tracks are from what the other agents report of the same objects, at once and over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.matching import neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.base import Batch, ClusterBoxes
from mast_zenoh.integrity.visibility import MAX_ERROR_M
from mast_zenoh.kernels import kernel

#: Tracks of an object, at least, for a middle that one liar cannot move far.
MIN_MEMBERS = 3
#: m, standard deviation of the part of an offset that the covariances do not show: boxes seen from two sides.
FLOOR_M = 0.1
#: m, the same of objects shorter than SMALL_M: trackers swap pedestrians that walk together.
SMALL_FLOOR_M, SMALL_M = 0.35, 1.5
#: m, between two clusters: nearer ones may have swapped members.
CROWD_M = 3.5
#: Variance of the median of normal errors, relative to that of their mean.
MEDIAN = np.pi / 2


@dataclass(frozen=True, slots=True, eq=False)
class Offsets:
    """Offsets of the tracks of `a` agents from the middle of their `c` clusters.

    valid:  (c, a) whether the agent has a track in the cluster, and the cluster a middle
    offset: (c, a, 2) m, of the track's position from the middle
    information: (c, a, 2, 2) 1/m^2, inverse covariance of the offset of an honest agent
    """

    valid: Bools
    offset: Floats
    information: Floats


def offsets(batch: Batch, boxes: ClusterBoxes, weight: Floats) -> Offsets:
    """Offsets of the tracks of agents from the weighted median of their clusters.

    boxes: of the clusters; weight: (a,) >= 0, of each agent in the median; 0: it is not counted

    The median, coordinate by coordinate, is near the honest majority's position wherever a single liar is. Where two
    halves of the members disagree, it is anywhere between them, and none of them is off. Clusters with fewer than
    MIN_MEMBERS tracks that count have no middle, nor have those nearer than CROWD_M to another one.
    """
    isolated = np.ones(batch.clusters, np.bool_)
    i, j, _, _ = neighbours(boxes.position, boxes.position, np.full(batch.clusters, CROWD_M))
    isolated[i[i != j]] = False
    states = batch.states
    return Offsets(
        *track_offsets(
            states.position,
            states.covariance,
            batch.member,
            weight,
            isolated,
            floors(boxes),
            MAX_ERROR_M,
            MIN_MEMBERS,
            MEDIAN,
        )
    )


def floors(boxes: ClusterBoxes) -> Floats:
    """(c,) m, standard deviation of the part of an offset from each object that covariances do not show."""
    return np.where(boxes.size[:, 0] < SMALL_M, SMALL_FLOOR_M, FLOOR_M)


@kernel
def track_offsets(
    position: Floats,
    covariance: Floats,
    member: Ints,
    weight: Floats,
    isolated: Bools,
    floor_m: Floats,
    max_error_m: float,
    members: int,
    inefficiency: float,
) -> tuple[Bools, Floats, Floats]:
    """The columns of `Offsets`, in its order.

    position: (n, 3) m, covariance: (n, 9, 9), of n tracks; member: (c, a) their rows, -1: none; weight: (a,) >= 0
    isolated: (c,) whether a cluster may have a middle; floor_m: (c,) m, see FLOOR_M
    max_error_m, members, inefficiency: MAX_ERROR_M, MIN_MEMBERS, MEDIAN
    """
    present = (member >= 0) & (weight > 0.0)
    count = present.sum(axis=1)
    valid = (member >= 0) & (isolated & (count >= members))[:, None]
    if not valid.any():
        return valid, np.zeros((*valid.shape, 2)), np.zeros((*valid.shape, 2, 2))
    place = position[member, :2]
    ends = [weighted_median(place[..., axis], present * weight) for axis in range(2)]
    low, high = (np.stack([each[end] for each in ends], axis=-1)[:, None, :] for end in range(2))
    claimed = limited(covariance[member, :2, :2], max_error_m)
    spread = (
        np.where(present[..., None, None], claimed, 0.0).sum(axis=1, keepdims=True)
        * (inefficiency / np.maximum(count, 1) ** 2)[:, None, None, None]
    )
    total = claimed + spread + (floor_m**2)[:, None, None, None] * np.eye(2)
    information = np.where(
        valid[..., None, None], np.linalg.inv(np.where(valid[..., None, None], total, np.eye(2))), 0.0
    )
    return valid, np.where(valid[..., None], place - np.clip(place, low, high), 0.0), information


def limited(covariance: Floats, max_error_m: float) -> Floats:
    """Covariances (..., 2, 2) m², scaled down so that no track claims a standard deviation above `max_error_m`."""
    largest = np.maximum(covariance[..., 0, 0], covariance[..., 1, 1])
    return np.asarray(covariance * np.minimum(1.0, max_error_m**2 / np.maximum(largest, 1e-12))[..., None, None])


def weighted_median(values: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """(c,) ends of the weighted median of each row of values (c, a); they differ where two halves weigh the same.

    weight: (c, a) >= 0
    """
    order = np.argsort(values, axis=1, kind="stable")
    ordered = np.take_along_axis(values, order, axis=1)
    below = np.cumsum(np.take_along_axis(weight, order, axis=1), axis=1)
    half = 0.5 * below[:, -1:]
    low, high = (below >= half * (1.0 - 1e-9)).argmax(axis=1), (below > half * (1.0 + 1e-9)).argmax(axis=1)
    rows = np.arange(len(values))
    return ordered[rows, low], ordered[rows, high]


#: Limits (standard deviations) on the influence of one offset, and of one in the sums of known sizes and of pairs: a
#: track of another object may be near for a moment.
CLIP, KNOWN_CLIP = 2.0, 4.0


class _ObjectSums:
    """Numbers for each agent and object, forgotten when it has not been seen for long.

    memory_s: s after which a summand has fallen to 1/e
    width: how many numbers; limit: pairs that are remembered at most; those not seen for longest are forgotten first

    Objects are those of the command centre: an agent that gives its tracks new ids does not lose their sums.
    """

    def __init__(self, memory_s: float, width: int, limit: int) -> None:
        self._memory_s, self._width, self._limit = memory_s, width, limit
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._row: dict[tuple[int, int], int] = {}  # by (agent, object)
        self._sum = np.zeros((0, self._width))
        self._time_ns = np.zeros(0, np.int64)
        self._most = min(100, self._limit)  # pairs from which the oldest are forgotten

    def forget(self, agent: int) -> None:
        """Forget the offsets of an agent."""
        self._keep([(key, row) for key, row in self._row.items() if key[0] != agent])

    def _known(self, time_ns: int, agent: Ints, obj: Ints) -> tuple[Ints, Floats]:
        """Rows (k,) of pairs, and s since each was seen last. agent, obj: (k,), no pair twice"""
        keys = zip(agent.tolist(), obj.tolist(), strict=True)
        rows = np.array([self._row.setdefault(key, len(self._row)) for key in keys], np.int64)
        new = len(self._row) - len(self._sum)
        self._sum = np.concatenate([self._sum, np.zeros((new, self._width))])
        self._time_ns = np.concatenate([self._time_ns, np.full(new, time_ns)])
        return rows, np.asarray((time_ns - self._time_ns[rows]) * 1e-9, np.float64)

    def _set(self, time_ns: int, rows: Ints, values: Floats) -> None:
        """Note the numbers (k, width) of pairs, and forget the oldest ones of others."""
        self._sum[rows], self._time_ns[rows] = values, time_ns
        if len(self._row) > self._most:
            oldest_ns = time_ns - round(10 * self._memory_s * 1e9)
            newest = sorted(self._row.items(), key=lambda item: -self._time_ns[item[1]])[: self._limit]
            self._keep([(key, row) for key, row in newest if self._time_ns[row] >= oldest_ns])
            self._most = min(2 * len(self._row) + 100, self._limit)

    def _keep(self, kept: list[tuple[tuple[int, int], int]]) -> None:
        rows = np.array([row for _, row in kept], np.int64)
        self._row = {key: row for row, (key, _) in enumerate(kept)}
        self._sum, self._time_ns = self._sum[rows], self._time_ns[rows]


class OffsetSums(_ObjectSums):
    """Exponentially forgotten sums of each agent's offsets from the other agents, for each object.

    memory_s: s after which a summand has fallen to 1/e
    limit: pairs of an agent and an object that are remembered at most
    """

    clip = CLIP

    def __init__(self, memory_s: float, limit: int = 10_000) -> None:
        # the information xx, xy, yy; the scores in x and y, with limited influence, and as measured
        super().__init__(memory_s, 7, limit)

    def of_objects(self, time_ns: int, agent: Ints, obj: Ints, measured: Offsets) -> Floats:
        """(c, a) likelihood ratio statistic of a constant offset of each agent from each object; 0 without a track.

        agent: (a,), obj: (c,) numbers of the agents and objects, which never change; measured: offsets of a batch
        """
        statistics = np.zeros(measured.valid.shape)
        cluster, column = measured.valid.nonzero()
        if len(cluster) == 0:
            return statistics
        offset, information = measured.offset[cluster, column], measured.information[cluster, column]
        score = np.einsum("kij,kj->ki", information, offset)
        distance = np.sqrt(np.maximum(np.einsum("ki,ki->k", offset, score), 1e-12))
        limited_score = score * np.minimum(1.0, self.clip / distance)[:, None]
        values = np.column_stack([information.reshape(-1, 4)[:, [0, 1, 3]], limited_score, score])
        rows, age_s = self._known(time_ns, agent[column], obj[cluster])
        total = self._sum[rows] * np.exp(-age_s / self._memory_s)[:, None] + values
        self._set(time_ns, rows, total)
        a, b, c, x, y = total.T[:5]
        statistics[cluster, column] = (c * x * x - 2.0 * b * x * y + a * y * y) / np.maximum(a * c - b * b, 1e-12)
        return statistics

    def beyond_fault(self, agent: int, obj: Ints, row: int, design: Floats, prior: Floats) -> float:
        """Share of the statistic of one offset that is left without the fault that fits the agent's other objects best.

        1: the agent's other objects are where they should be; near 0: a fault of the agent moves all of them alike

        agent, obj: (k,) numbers of the agent and of k objects; row: of them, the one that is asked about
        design: (k, 2, 4), see `displacements`; prior: (4, 4) inverse covariance of a fault before any evidence
        """
        of = [
            (each, self._row[agent, number]) for each, number in enumerate(obj.tolist()) if (agent, number) in self._row
        ]
        sums = {each: self._sum[position] for each, position in of}
        if row not in sums:
            return 1.0
        information, vector = prior.copy(), np.zeros(4)
        for each, (xx, xy, yy, _, _, x, y) in sums.items():
            if each != row:
                weighted = design[each].T @ np.array([[xx, xy], [xy, yy]])
                information += weighted @ design[each]
                vector += design[each].T @ [x, y]
        xx, xy, yy, _, _, x, y = sums[row]
        own = np.linalg.inv([[xx, xy], [xy, yy]])
        offset, spread = own @ [x, y], np.linalg.inv(information)
        left = offset - design[row] @ spread @ vector
        total = own + design[row] @ spread @ design[row].T
        return float(left @ np.linalg.solve(total, left) / max(offset @ [x, y], 1e-12))


#: Agents with smaller numbers than this can be told apart in a pair.
_NUMBERS = 1 << 31


class PairOffsetSums(OffsetSums):
    """As `OffsetSums`, of how far one agent's tracks are from another one's."""

    clip = KNOWN_CLIP

    def forget(self, agent: int) -> None:
        """Forget the offsets of all pairs with an agent."""
        self._keep([(key, row) for key, row in self._row.items() if agent not in divmod(key[0], _NUMBERS)])

    def of_pairs(
        self, time_ns: int, number: Ints, obj: Ints, batch: Batch, off: Bools, floor_m: Floats
    ) -> tuple[Ints, Ints, Floats]:
        """Pairs of agents (p,), (p,), columns of the batch, and the statistic (c, p) of each object.

        number: (a,), obj: (c,) numbers of agents and objects, which never change
        off: (c, a) agents that are compared with all others that report the object; floor_m: (c,) m, see FLOOR_M
        """
        cluster, one, other = np.nonzero(off[:, :, None] & batch.reported[:, None, :])
        kept = one != other
        cluster, one, other = cluster[kept], one[kept], other[kept]
        a = len(number)
        pairs, column = np.unique(one * a + other, return_inverse=True)
        shape = batch.clusters, len(pairs)
        valid, offset, information = np.zeros(shape, np.bool_), np.zeros((*shape, 2)), np.zeros((*shape, 2, 2))
        rows = batch.member[cluster, one], batch.member[cluster, other]
        position, covariance = batch.states.position[:, :2], batch.states.covariance[:, :2, :2]
        total = (floor_m[cluster] ** 2)[:, None, None] * np.eye(2)
        for row in rows:
            total += limited(covariance[row], MAX_ERROR_M)
        valid[cluster, column] = True
        offset[cluster, column] = position[rows[0]] - position[rows[1]]
        information[cluster, column] = np.linalg.inv(total)
        first, second = np.divmod(pairs, a)
        measured = Offsets(valid, offset, information)
        statistics = self.of_objects(time_ns, number[first] * _NUMBERS + number[second], obj, measured)
        return first, second, statistics


#: Unit vectors in which an offset of a known size is looked for.
DIRECTIONS = np.array([[np.cos(angle), np.sin(angle)] for angle in np.arange(8) * (np.pi / 4)])


class KnownOffsetSums(_ObjectSums):
    """Cumulative sums (Page 1954) of how much more likely an offset of a known size is than none, for each object.

    Quicker than `OffsetSums` for an offset of about this size, which need not be weighed against earlier honest ones.

    sizes_m: m, of the offset, in any of eight directions;  samples_per_s: independent samples in a second of offsets
    """

    def __init__(self, sizes_m: tuple[float, ...], samples_per_s: float, limit: int = 10_000) -> None:
        super().__init__(1.0, len(sizes_m) * len(DIRECTIONS), limit)
        self._sizes, self._samples_per_s = len(sizes_m), samples_per_s
        self._offsets = (np.array(sizes_m)[:, None, None] * DIRECTIONS).reshape(-1, 2)

    def of_objects(self, time_ns: int, agent: Ints, obj: Ints, measured: Offsets, step_s: float) -> Floats:
        """(c, a, sizes) greatest log-likelihood ratio of each agent's offset from each object; 0 without a track.

        agent, obj, measured: as in `OffsetSums.of_objects`;  step_s: s, for which the batch stands
        """
        statistics = np.zeros((*measured.valid.shape, self._sizes))
        cluster, column = measured.valid.nonzero()
        if len(cluster) == 0:
            return statistics
        offset, information = measured.offset[cluster, column], measured.information[cluster, column]
        whitened = np.sqrt(np.maximum(np.einsum("ki,kij,kj->k", offset, information, offset), 1e-12))
        offset = offset * np.minimum(1.0, KNOWN_CLIP / whitened)[:, None]
        towards = information @ self._offsets.T  # (k, 2, d)
        gain = np.einsum("ki,kid->kd", offset, towards) - 0.5 * np.einsum("di,kid->kd", self._offsets, towards)
        rows, _ = self._known(time_ns, agent[column], obj[cluster])
        total = np.maximum(0.0, self._sum[rows] + self._samples_per_s * step_s * gain)
        self._set(time_ns, rows, total)
        statistics[cluster, column] = total.reshape(-1, self._sizes, len(DIRECTIONS)).max(axis=2)
        return statistics

"""How far each agent's positions of objects are off, over time."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.integrity.offsets import Offsets

#: Limit (standard deviations) on the influence of one offset: a track of another object may be near for a moment.
CLIP = 2.0


class OffsetSums:
    """Exponentially forgotten sums of each agent's offsets from the other agents, for each object.

    memory_s: s after which a summand has fallen to 1/e
    limit: pairs of an agent and an object that are remembered at most; those not seen for longest are forgotten first

    Objects are those of the command centre: an agent that gives its tracks new ids does not lose their sums.
    """

    def __init__(self, memory_s: float, limit: int = 10_000) -> None:
        self._memory_s = memory_s
        self._limit = limit
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._row: dict[tuple[int, int], int] = {}  # by (agent, object)
        self._sum = np.zeros((0, 5))  # of the scores in x and y, and of the information xx, xy, yy
        self._time_ns = np.zeros(0, np.int64)
        self._most = min(100, self._limit)  # pairs from which the oldest are forgotten

    def forget(self, agent: int) -> None:
        """Forget the offsets of an agent."""
        self._keep([(key, row) for key, row in self._row.items() if key[0] != agent])

    def statistics(self, time_ns: int, agent: Ints, obj: Ints, measured: Offsets) -> Floats:
        """(a,) greatest likelihood ratio statistic of a constant offset from one object; 0 without any.

        agent: (a,), obj: (c,) numbers of the agents and objects, which never change; measured: offsets of a batch
        """
        greatest = np.zeros(len(agent))
        cluster, column = measured.valid.nonzero()
        if len(cluster) == 0:
            return greatest
        offset, information = measured.offset[cluster, column], measured.information[cluster, column]
        score = np.einsum("kij,kj->ki", information, offset)
        distance = np.sqrt(np.maximum(np.einsum("ki,ki->k", offset, score), 1e-12))
        score *= np.minimum(1.0, CLIP / distance)[:, None]
        values = np.column_stack([score, information.reshape(-1, 4)[:, [0, 1, 3]]])
        x, y, a, b, c = self._add(time_ns, agent[column], obj[cluster], values).T
        statistic = (c * x * x - 2.0 * b * x * y + a * y * y) / np.maximum(a * c - b * b, 1e-12)
        np.maximum.at(greatest, column, statistic)
        return greatest

    def _add(self, time_ns: int, agent: Ints, obj: Ints, values: Floats) -> Floats:
        """Add `values` (k, 5) and return the sums (k, 5). agent, obj: (k,), no pair twice"""
        keys = zip(agent.tolist(), obj.tolist(), strict=True)
        rows = np.array([self._row.setdefault(key, len(self._row)) for key in keys], np.int64)
        new = len(self._row) - len(self._sum)
        self._sum = np.concatenate([self._sum, np.zeros((new, 5))])
        self._time_ns = np.concatenate([self._time_ns, np.full(new, time_ns)])
        age_s = (time_ns - self._time_ns[rows]) * 1e-9
        total: Floats = self._sum[rows] * np.exp(-age_s / self._memory_s)[:, None] + values
        self._sum[rows], self._time_ns[rows] = total, time_ns
        if len(self._row) > self._most:
            oldest_ns = time_ns - round(10 * self._memory_s * 1e9)
            newest = sorted(self._row.items(), key=lambda item: -self._time_ns[item[1]])[: self._limit]
            self._keep([(key, row) for key, row in newest if self._time_ns[row] >= oldest_ns])
            self._most = min(2 * len(self._row) + 100, self._limit)
        return total

    def _keep(self, kept: list[tuple[tuple[int, int], int]]) -> None:
        rows = np.array([row for _, row in kept], np.int64)
        self._row = {key: row for row, (key, _) in enumerate(kept)}
        self._sum, self._time_ns = self._sum[rows], self._time_ns[rows]

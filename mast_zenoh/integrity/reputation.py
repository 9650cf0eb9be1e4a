"""How often each agent's claims have held up."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.integrity.base import Batch
from mast_zenoh.integrity.memory import AgentMemory

#: s between independent pieces of evidence about one object: consecutive offsets of two honest tracks correlate at 0.8
#: at 10 Hz, which leaves about one independent sample a second.
INDEPENDENT_S = 1.0


class BetaReputation:
    """Beta record of each agent: claims upheld and refuted, with forgetting.

    The mean is (1 + upheld) / (2 + upheld + refuted), so that a new agent has 0.5.

    record_s: s, after which a claim counts 1/e
    """

    def __init__(self, *, record_s: float) -> None:
        check("more than 0", record_s=record_s)
        self._record_s = record_s
        self._agents = AgentMemory(counts=(0.0, 0.0))
        self._last_ns: int | None = None

    def mean(self, names: tuple[str, ...]) -> Floats:
        """(a,) the present mean of agents; 0.5 for unknown ones."""
        known = dict(zip(self._agents.names, _mean(self._agents.of.counts).tolist(), strict=True))
        return np.array([known.get(name, 0.5) for name in names], np.float64)

    def update(self, batch: Batch, upheld: Bools, refuted: Bools) -> Floats:
        """(a,) the mean after a batch.

        upheld: (k, a), refuted: (m, a) claims of its agents, such as those about its clusters. Each counts for the time
        since the last batch, at most INDEPENDENT_S, so that an object counts once a second however often it is
        reported.
        """
        elapsed = 0.0 if self._last_ns is None else (batch.time_ns - self._last_ns) * 1e-9
        self._last_ns = batch.time_ns
        rows = self._agents.meet(batch.time_ns, batch.agents)
        counts = self._agents.of.counts
        counts *= np.exp(-elapsed / self._record_s)
        claims = np.column_stack([upheld.sum(axis=0), refuted.sum(axis=0)])
        counts[rows] += claims * min(elapsed / INDEPENDENT_S, 1.0)
        return _mean(counts)[rows]


def _mean(counts: Floats) -> Floats:
    """(m,) means of (m, 2) counts of upheld and refuted claims."""
    return np.asarray((1.0 + counts[:, 0]) / (2.0 + counts.sum(axis=1)))

"""ROBOSAC: random groups of agents, until one agrees with the ego."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor, inf, log1p

from mast_zenoh.arrays.checks import check
from mast_zenoh.integrity.consensus import EgoConsensus, EgoReference
from mast_zenoh.streams import stream

#: Most groups in one batch if their number follows from the formula, which has no limit.
MAX_GROUPS = 1000


@dataclass(kw_only=True, eq=False)
class Robosac(EgoConsensus):
    """Admits the first random group of agents with which the ego's perception agrees.

    After ROBOSAC, on tracks. ROBOSAC (Li et al.: Among Us, ICCV 2023, arXiv:2303.09495; read in its code:
    coperception/ROBOSAC 4642aa2, robosac and box_matching). In each batch, up to `budget` groups of `sample_size`
    agents are drawn. A group agrees if the Jaccard index of the ego's boxes with those of the ego and the group is
    `agree` or more. The first that does is admitted and everybody else is left out; if none does, the ego is alone. A
    group is free of attackers with probability `confidence` after N = ceil(ln(1 - p) / ln(1 - (1 - eta)^s)) draws, eta
    being the share of attackers among the others and s the size of the group.

    attackers: number that is expected among the other agents
    budget: most groups in one batch; None: N, from `sample_size`, at most MAX_GROUPS
    sample_size: agents in a group; None: the most for which N is within the budget
    confidence: probability p that one of the groups is free of attackers
    agree: least Jaccard index

    What differs from the original: perception is the median of tracks, not the output of a network on fused features.
    It stops if no group is small enough for the budget; here a group has at least one agent.

    Weaknesses: the ego decides, so a lying ego excludes the honest ones; a few phantoms or displaced objects leave the
    Jaccard index above the limit; honest agents that were not drawn are left out.
    """

    attackers: int = 1
    budget: int | None = 3
    sample_size: int | None = None
    confidence: float = 0.99
    agree: float = 0.3

    def __post_init__(self) -> None:
        check("0 or more, finite", attackers=self.attackers)
        check("more than 0 and less than 1", confidence=self.confidence)
        check("0 to 1", agree=self.agree)
        if self.budget is None and self.sample_size is None:
            raise ValueError("budget, sample_size: found None for both, expected a number for one at least")
        for name, number in (("budget", self.budget), ("sample_size", self.sample_size)):
            if number is not None:
                check("1 or more", **{name: number})
                check("a whole number", **{name: number})
        self._seed, self._name = 0, "integrity"
        super().__post_init__()

    def bind(self, seed: int, name: str) -> None:
        self._seed, self._name = seed, name

    def _plan(self, others: int) -> tuple[int, int]:
        """Number of groups to draw from `others` agents, and their size."""
        eta = min(self.attackers / others, 1.0)
        size = self.sample_size
        if size is None:
            assert self.budget is not None
            return self.budget, largest_sample(self.confidence, eta, self.budget, others)
        size = min(size, others)
        if self.budget is not None:
            return self.budget, size
        return int(min(samples_needed(self.confidence, eta, size), MAX_GROUPS)), size

    def _admit(self, time_ns: int, others: Sequence[int], reference: EgoReference) -> Sequence[int]:
        if not others:
            return ()
        budget, size = self._plan(len(others))
        random = stream(self._seed, self._name, "robosac", time_ns)
        for _ in range(budget):
            group = sorted(random.choice(others, size, replace=False).tolist())
            if reference.agreement(group) >= self.agree:
                return group
        return ()


def samples_needed(confidence: float, eta: float, size: int) -> float:
    """Number of groups of which one at least is free of attackers.

    confidence: probability of it; eta: share of attackers, 0 to 1; size: agents in a group, drawn as if with
    replacement. A whole number, or inf if all are attackers: no group is free of them, and the formula has no limit.
    """
    free = (1.0 - eta) ** size
    if free <= 0.0:
        return inf
    return 1 if free >= 1.0 else max(ceil(log1p(-confidence) / log1p(-free)), 1)


def largest_sample(confidence: float, eta: float, budget: int, others: int) -> int:
    """Agents in a group, 1 to `others`, for which `budget` groups are enough.

    See `samples_needed`.
    """
    if eta <= 0.0:
        return others
    if eta >= 1.0:
        return 1
    size = floor(log1p(-((1.0 - confidence) ** (1.0 / budget))) / log1p(-eta))
    return min(max(size, 1), others)

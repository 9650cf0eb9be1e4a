"""Which agents must be lying, and which may be, given who disagrees with whom.

Two agents that disagree about what is there are not both honest. So the liars are a vertex cover of the graph of
disputes: a set of agents that contains one of each two that disagree. A set of fewer than half of the agents is an
explanation. What is true in every explanation holds whatever the liars say, as long as they are fewer than half; what
differs between explanations, nobody can know (secure state estimation: Fawzi, Tabuada, Diggavi, IEEE Transactions on
Automatic Control 2014, proposition 3).

Sets of agents are whole numbers, with bit i for agent i.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats

#: Results that are remembered for one graph of disputes: liars that flood it with disputes gain no memory by it.
_REMEMBERED = 4096
#: Branches of the search for covers, in all for one graph; 29 agents need fewer. Beyond, nothing counts as certain.
_BRANCHES = 100_000


class Verdict(NamedTuple):
    """What the explanations say of `a` agents.

    lying: (a,) whether the agent lies in every explanation
    open:  (a,) whether it lies in one that needs it, and in another one it does not; without an explanation: whether it
           disagrees with anybody
    """

    lying: Bools
    open: Bools


class Explanations:
    """The sets of agents, fewer than half of all, that contain one of each two that disagree.

    disputes: (a, a) bool, symmetric, which agents disagree
    lying:    (a,) which agents are known to lie: they are in every set
    honest:   (a,) which are known to be honest: they are in none
    """

    def __init__(self, disputes: Bools, lying: Bools, honest: Bools) -> None:
        a = len(lying)
        self._agents = a
        self._others = [mask_of(row) for row in disputes]
        self._lying, self._honest = mask_of(lying & ~honest), mask_of(honest)
        self.most = (a - 1) // 2
        self._branches = _BRANCHES
        self._fewest = lru_cache(_REMEMBERED)(self._fewest_with)

    def possible(self, lying: int = 0, honest: int = 0) -> bool:
        """Whether there is an explanation in which some agents lie and others do not."""
        lying |= self._lying
        honest |= self._honest
        for agent in members(honest):
            lying |= self._others[agent]
        if lying & honest:
            return False
        return self._fewest(lying) <= self.most

    def verdict(self) -> Verdict:
        """What the explanations say of each agent."""
        every = range(self._agents)
        if not self.possible():
            lying = np.array([bool(self._lying >> agent & 1) for agent in every], np.bool_)
            disputed = [bool(others) and not self._honest >> agent & 1 for agent, others in enumerate(self._others)]
            return Verdict(lying, ~lying & np.array(disputed, np.bool_))
        honest = [self.possible(honest=1 << agent) for agent in every]
        # An agent lies in an explanation that needs it if one of those that it disagrees with is honest there.
        needed = [
            any(honest[other] for other in members(others)) and not self._honest >> agent & 1
            for agent, others in enumerate(self._others)
        ]
        return Verdict(~np.array(honest, np.bool_), np.array(honest, np.bool_) & np.array(needed, np.bool_))

    def smallest(self) -> Bools | None:
        """(a,) the smallest explanation; None if several are, or there is none."""
        fewest = self._fewest(self._lying)
        if fewest > self.most:
            return None
        every = np.array([self._fewest(self._lying | others) > fewest for others in self._others], np.bool_)
        every |= np.array([self._lying >> agent & 1 for agent in range(self._agents)], np.bool_)
        return every if every.sum() == fewest else None

    def false(self, claiming: int, denying: int) -> bool:
        """Whether in every explanation all that claim something lie: if one is honest, all that deny it lie.

        Without an explanation, whether all that claim it are known to lie.
        """
        if not self.possible():
            return not claiming & ~self._lying
        return not any(self.possible(denying, 1 << agent) for agent in members(claiming))

    def _fewest_with(self, lying: int) -> int:
        """Size of the smallest cover that contains some agents; beyond `most`, only that it is larger."""
        return lying.bit_count() + self._cover(lying, self.most - lying.bit_count())

    def _cover(self, gone: int, most: int) -> int:
        """Size of the smallest cover of the disputes without some agents; more than `most` if it is larger.

        When all branches are used up, a lower bound, so that no agent seems to lie that may be honest.
        Branches on the agent with the most disputes left: it lies, or all that it disagrees with do.
        """
        left = [0 if gone >> agent & 1 else others & ~gone for agent, others in enumerate(self._others)]
        degrees = [others.bit_count() for others in left]
        degree = max(degrees, default=0)
        if degree == 0:
            return 0
        if most <= 0 or sum(degrees) > 2 * degree * most:  # `most` agents have fewer disputes
            return most + 1
        self._branches -= 1
        if self._branches < 0:
            return -(-sum(degrees) // (2 * degree))
        agent = degrees.index(degree)
        rest = gone | left[agent] | 1 << agent
        if degree == 1:  # pairs alone are left: either lies
            return 1 + self._cover(rest, most - 1)
        lies = 1 + self._cover(gone | 1 << agent, most - 1)
        most = min(most, lies - 1)
        return min(lies, degree + self._cover(rest, most - degree)) if degree <= most else lies


def of_strongest(disputes: Bools, strength: Floats, lying: Bools, honest: Bools) -> Explanations:
    """The explanations of the strongest disputes that have one.

    disputes, lying, honest: see `Explanations`;  strength: (a, a) of each dispute

    Each dispute is taken in turn, the strongest first, unless there is no explanation with it. Where more agents are
    known to lie than there may be, there is none in any case.
    """
    kept = np.zeros_like(disputes)
    ones, others = np.nonzero(np.triu(disputes))
    for pair in np.argsort(-strength[ones, others], kind="stable").tolist():
        one, other = ones[pair], others[pair]
        kept[one, other] = kept[other, one] = True
        if not Explanations(kept, lying, honest).possible():
            kept[one, other] = kept[other, one] = False
    return Explanations(kept, lying, honest)


def mask_of(members: Bools) -> int:
    """The set of the agents (a,) for which it is true."""
    return sum(1 << agent for agent in np.flatnonzero(members).tolist())


def members(mask: int) -> Iterator[int]:
    """The agents of a set, in their order."""
    while mask:
        lowest = mask & -mask
        yield lowest.bit_length() - 1
        mask ^= lowest

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
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats

#: Results that are remembered for one graph of disputes: liars that flood it with disputes gain no memory by it.
_REMEMBERED = 4096
#: Branches of the search for covers, in one question; 40 agents need fewer. Beyond, nothing counts as certain.
BRANCHES = 10_000


class Verdict(NamedTuple):
    """What the explanations say of `a` agents.

    lying: (a,) whether the agent lies in every explanation
    undecided: (a,) whether it lies in one that needs it, and in another one it does not; without an explanation:
        whether it disagrees with anybody
    """

    lying: Bools
    undecided: Bools


class Explanations:
    """The sets of agents, fewer than half of all, that contain one of each two that disagree.

    disputes: (a, a) bool, symmetric, which agents disagree
    lying:    (a,) which agents are known to lie: they are in every set
    honest:   (a,) which are known to be honest: they are in none
    left_out: (a,) which disagree about something else, too, that is left out here; None: nobody
    branches: of the search for covers, in one question

    branches_left: of the last question; below 0: it took too long, and nothing counts as certain
    """

    def __init__(
        self, disputes: Bools, lying: Bools, honest: Bools, left_out: Bools | None = None, branches: int = BRANCHES
    ) -> None:
        a = len(lying)
        self._agents = a
        self._others = [mask_of(row) for row in disputes]
        self._lying, self._honest = mask_of(lying & ~honest), mask_of(honest)
        self._left_out = np.zeros(a, np.bool_) if left_out is None else left_out & ~honest
        self._most = (a - 1) // 2
        self._branches = self.branches_left = branches
        self._fewest_of: dict[int, int] = {}

    @property
    def whole(self) -> bool:
        """Whether they explain all disputes."""
        return not self._left_out.any()

    def possible(self, lying: int = 0, honest: int = 0) -> bool:
        """Whether there is an explanation in which some agents lie and others do not."""
        lying |= self._lying
        honest |= self._honest
        for agent in members(honest):
            lying |= self._others[agent]
        if lying & honest:
            return False
        return self._fewest(lying) <= self._most

    def verdict(self) -> Verdict:
        """What the explanations say of each agent."""
        self.branches_left = self._branches
        every = range(self._agents)
        if not self.possible():
            lying = np.array([bool(self._lying >> agent & 1) for agent in every], np.bool_)
            disputed = [bool(others) and not self._honest >> agent & 1 for agent, others in enumerate(self._others)]
            return Verdict(lying, ~lying & (self._left_out | np.array(disputed, np.bool_)))
        honest = [self.possible(honest=1 << agent) for agent in every]
        # An agent lies in an explanation that needs it if one of those that it disagrees with is honest there.
        needed = [
            any(honest[other] for other in members(others)) and not self._honest >> agent & 1
            for agent, others in enumerate(self._others)
        ]
        may_be_honest = np.array(honest, np.bool_)
        return Verdict(~may_be_honest, may_be_honest & (self._left_out | np.array(needed, np.bool_)))

    def false(self, claiming: Bools, denying: Bools) -> Bools:
        """(c,) which of c claims are false in every explanation.

        claiming, denying: (c, a) agents that make each claim, and that deny it

        Either all that claim it lie, or all that deny it. It is false if all that claim it may be lying, and in no
        explanation all that deny it lie while one that claims it is honest. Where neither side can be lying, nothing is
        proved. Without an explanation, what known liars alone claim is false.
        """
        self.branches_left = self._branches
        claims = [(mask_of(claim), mask_of(denial)) for claim, denial in zip(claiming, denying, strict=True)]
        if not self.possible():
            return np.array([not claim & ~self._lying for claim, _ in claims], np.bool_)
        result = [
            self.possible(claim) and not any(self.possible(denial, 1 << agent) for agent in members(claim))
            for claim, denial in claims
        ]
        return np.array(result, np.bool_)

    def _fewest(self, lying: int) -> int:
        """Size of the smallest cover that contains some agents; beyond `_most`, only that it is larger."""
        known = self._fewest_of.get(lying)
        if known is None:
            known = lying.bit_count() + self._cover(lying, self._most - lying.bit_count())
            if self.branches_left >= 0 and len(self._fewest_of) < _REMEMBERED:
                self._fewest_of[lying] = known
        return known

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
        self.branches_left -= 1
        if self.branches_left < 0:
            return -(-sum(degrees) // (2 * degree))
        agent = degrees.index(degree)
        rest = gone | left[agent] | 1 << agent
        if degree == 1:  # pairs alone are left: either lies
            return 1 + self._cover(rest, most - 1)
        lies = 1 + self._cover(gone | 1 << agent, most - 1)
        most = min(most, lies - 1)
        return min(lies, degree + self._cover(rest, most - degree)) if degree <= most else lies


def explained(disputes: Bools, strength: Floats, lying: Bools, honest: Bools) -> Explanations:
    """The explanations of all disputes; where there is none, of the strongest.

    disputes, lying, honest: see `Explanations`;  strength: (a, a) of each dispute

    Disputes are taken the strongest first, those of one strength together, unless there is no explanation with them:
    honest agents disagree by chance, too. It is open whether those lie whose disputes are left out.
    """
    every = Explanations(disputes, lying, honest)
    if every.possible():
        return every
    kept, left = np.zeros_like(disputes), BRANCHES
    for level in np.unique(strength[disputes])[::-1].tolist():
        tried = Explanations(more := kept | (disputes & (strength == level)), lying, honest, branches=left)
        if tried.possible() and tried.branches_left >= 0:
            kept = more
        left = max(tried.branches_left, 0)
    return Explanations(kept, lying, honest, left_out=np.asarray((disputes & ~kept).any(axis=1)))


def mask_of(members: Bools) -> int:
    """The set of the agents (a,) for which it is true."""
    return sum(1 << agent for agent in np.flatnonzero(members).tolist())


def members(mask: int) -> Iterator[int]:
    """The agents of a set, in their order."""
    while mask:
        lowest = mask & -mask
        yield lowest.bit_length() - 1
        mask ^= lowest

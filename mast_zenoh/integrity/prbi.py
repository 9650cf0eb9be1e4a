"""PRBI: pseudo-random groups against the last picture, without a trusted agent."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from math import floor, log2, sqrt
from typing import Any

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.base import Assessment, Batch, ClusterBoxes, Integrity
from mast_zenoh.integrity.consensus import CheckCount, admission, jaccard, matched_boxes, members_of, perception
from mast_zenoh.integrity.memory import AgentMemory
from mast_zenoh.integrity.visibility import sightings
from mast_zenoh.streams import stream

#: Batches whose checks are remembered at most.
MAX_MEMORY = 500
#: s since the last batch after which its perception is no reference: a car that brakes is elsewhere by its own length.
MAX_GAP_S = 1.0

#: The members of a checked group, and whether it was normal.
Check = tuple[frozenset[str], bool]


@dataclass(kw_only=True, eq=False)
class Prbi(Integrity):
    """Compares random groups with the last picture and infers which agents lie.

    After PRBI, on tracks, from summaries only. Pseudo-random Bayesian inference (Yu et al.: All Vehicles Can Lie, CVPR
    2026, arXiv:2603.08498). There is no public code, and only summaries of the paper were at hand; where they leave a
    formula open, ours is given here.

    No agent is trusted. In each batch the agents are divided into two groups: the floor(m) most suspicious, and the
    rest; at random while m is below 1, and among equals. A group is normal if the Jaccard index of its perception with
    the last believed one is `agree` or more. From the share eta of normal groups follows the number of attackers,
    m = log2(1 / eta), because a random group is free of m attackers with probability 2^-m. If A is an abnormal group
    and B_j that agent j is honest,

        P(B_j | A) = P(A | B_j) P(B_j) / P(A),    P(B_j) = short_term p_j + (1 - short_term) beta_j,

    with p_j the last result, beta_j the share of normal groups among those of j, P(A) = 1 - eta, and P(A | B_j) the
    share of abnormal groups among those without j, and one more that is abnormal with P(A) (ours). P(B_j | A) is 0 if
    no group of j was normal. Agents at 0 are left out. When a t-test finds that m stays at the number of agents at 0,
    these are excluded for good, and the counts of the others start anew (the original ends here).

    The believed perception is that of everybody if both groups are normal, else of the agents above 0 if a third check
    finds it normal, else of the normal group if there is one. Otherwise the last one stays, and the agents above 0 are
    admitted. So there are two or three checks in a batch. The first perception is believed without a check, as is that
    after a gap of more than MAX_GAP_S. If no agent has been above 0 for `memory` batches, the last perception is at
    fault: the counts start anew with the present one. Never is everybody excluded (all of this is ours).

    agree: least Jaccard index of a normal group
    match_iou: intersection over union, seen from above, from which two boxes are one object
    short_term: weight of the last result in the prior
    memory: batches whose checks count; None: MAX_MEMORY. In the summaries all count, so that an attacker that begins
        late is never at 0
    settled: values of m that the t-test needs
    level: significance of the t-test

    What differs from the original: perception is the median of tracks. The last one is moved by its velocities, and an
    object of it that no agent of the group has in view or reports does not count against the group: an agent sees only
    a part of the picture.

    Weaknesses: what is believed in the first batch is the reference of all later ones; a lie that lasts, once
    believed, is as normal as the truth; a few phantoms leave the Jaccard index above the limit.
    """

    agree: float = 0.35
    match_iou: float = 0.5
    short_term: float = 0.5
    memory: int | None = 20
    settled: int = 5
    level: float = 0.05

    def __post_init__(self) -> None:
        check("0 to 1", agree=self.agree, short_term=self.short_term)
        check("more than 0 and at most 1", match_iou=self.match_iou)
        check("more than 0 and less than 1", level=self.level)
        check("2 or more", settled=self.settled)
        check("a whole number", settled=self.settled)
        if self.memory is not None:
            check("a whole number", memory=self.memory)
            if not 1 <= self.memory <= MAX_MEMORY:
                raise ValueError(f"memory: found {self.memory}, expected 1 to {MAX_MEMORY}, or None")
        self._seed, self._name = 0, "integrity"
        # Slow to import: done before the first batch.
        from scipy.special import stdtrit

        self._quantile = float(stdtrit(self.settled - 1, 1.0 - 0.5 * self.level))
        self.reset()

    def bind(self, seed: int, name: str) -> None:
        self._seed, self._name = seed, name

    def reset(self) -> None:
        self._count = CheckCount()
        self._believed: ClusterBoxes | None = None
        self._time_ns = 0
        self._agents = AgentMemory(forget_s=600.0, honest=1.0, excluded=False)
        self._batches: deque[list[Check]] = deque(maxlen=self.memory or MAX_MEMORY)
        self._estimates: deque[float] = deque(maxlen=self.settled)  # of m

    def facts(self) -> dict[str, Any]:
        excluded = sorted(np.array(self._agents.names, object)[self._agents.of.excluded].tolist())
        return self._count.facts() | {"excluded": excluded}

    def assess(self, batch: Batch) -> Assessment:
        elapsed_s = (batch.time_ns - self._time_ns) * 1e-9
        self._time_ns = batch.time_ns
        rows = self._agents.meet(batch.time_ns, batch.agents)
        candidates = np.flatnonzero(~self._agents.of.excluded[rows])
        if elapsed_s > MAX_GAP_S:
            self._believed = None
        if self._believed is None or not len(candidates) or not len(self._believed.yaw):
            self._count.without_reference += 1
            self._believed = perception(batch, members_of(batch, candidates.tolist()))
        else:
            reference = PastReference(batch, self._believed.moved(elapsed_s), self.match_iou)
            self._judge(batch, rows, candidates, reference)
        honest = np.where(self._agents.of.excluded[rows], 0.0, self._agents.of.honest[rows])
        return admission(batch, honest > 0.0, honest, "no group with it fits the last believed picture")

    def _judge(self, batch: Batch, rows: Ints, candidates: Ints, reference: PastReference) -> None:
        """Check two groups, update the trust in agents, choose the believed perception."""
        names = [batch.agents[row] for row in candidates.tolist()]
        groups = self._groups(batch.time_ns, candidates, self._agents.of.honest[rows[candidates]])
        normal = [reference.agreement(group) >= self.agree for group in groups]
        members = [frozenset(batch.agents[row] for row in group) for group in groups]
        self._batches.append(list(zip(members, normal, strict=True)))
        honest = self._update(names, self._agents.of.honest[rows[candidates]])
        self._agents.of.honest[rows[candidates]] = honest
        believed: Sequence[int] | None = candidates.tolist()
        if not all(normal):
            fitting = [group for group, fits in zip(groups, normal, strict=True) if fits]
            believed = self._confirmed(candidates[honest > 0.0].tolist(), fitting, reference)
        self._believed = reference.boxes if believed is None else perception(batch, members_of(batch, believed))
        self._count.add(reference.checks)
        if self._is_lost(honest):
            self._start_anew(rows[candidates])
            self._believed = perception(batch, members_of(batch, candidates.tolist()))
        else:
            self._settle(rows[candidates], honest)

    def _groups(self, time_ns: int, candidates: Ints, honest: Floats) -> list[list[int]]:
        """One or two groups of candidates, rows of agents, none of them empty."""
        n = len(candidates)
        random = stream(self._seed, self._name, "prbi", time_ns)
        shuffled = random.permutation(n)
        order = shuffled[np.argsort(honest[shuffled], kind="stable")]
        suspicious = floor(estimated(self._checks()))
        size = suspicious if suspicious >= 1 else int(random.binomial(n, 0.5))
        split = candidates[order[:size]], candidates[order[size:]]
        return [sorted(group.tolist()) for group in split if len(group)]

    def _checks(self) -> list[Check]:
        """The remembered checks of all batches."""
        return [check for checks in self._batches for check in checks]

    def _update(self, names: Sequence[str], honest: Floats) -> Floats:
        """(n,) probability that each agent is honest.

        names, honest: (n,), before the batch
        """
        checks = self._checks()
        table = np.array([[name in group for name in names] for group, _ in checks], np.bool_)
        normal = np.array([fits for _, fits in checks], np.bool_)
        return posterior(table.reshape(-1, len(names)), normal, honest, self.short_term)

    def _confirmed(
        self, above: Sequence[int], normal: Sequence[Sequence[int]], reference: PastReference
    ) -> Sequence[int] | None:
        """The agents that are believed if a group was abnormal; None: nobody.

        above: agents above 0; normal: groups that were
        """
        if above and reference.agreement(above) >= self.agree:
            return above
        return normal[0] if normal else None

    def _settle(self, rows: Ints, honest: Floats) -> None:
        """Exclude the agents at 0 if the number of attackers has settled at theirs.

        rows: in the memory of agents
        """
        self._estimates.append(estimated(self._checks()))
        number = int((honest == 0.0).sum())
        if 1 <= number < len(honest) and has_settled(list(self._estimates), number, self.settled, self._quantile):
            self._agents.of.excluded[rows[honest == 0.0]] = True
            self._start_anew(rows[honest > 0.0])

    def _is_lost(self, honest: Floats) -> bool:
        """Whether no agent fits the last believed picture in any remembered check."""
        return not honest.any() and len(self._batches) == self._batches.maxlen

    def _start_anew(self, rows: Ints) -> None:
        """Forget the checks, and take agents to be honest. rows: in the memory of agents"""
        self._agents.of.honest[rows] = 1.0
        self._batches.clear()
        self._estimates.clear()


class PastReference:
    """The last believed perception, with which those of groups are compared.

    boxes: at the time of the batch; match_iou: of matched boxes

    checks: number of groups that were compared
    """

    def __init__(self, batch: Batch, boxes: ClusterBoxes, match_iou: float) -> None:
        self.boxes = boxes
        self._batch, self._match_iou = batch, match_iou
        seen = sightings(boxes.position, boxes.size, boxes.yaw, batch.views).in_view
        # An agent without a view is taken to see everything.
        self._seen = np.asarray(seen | np.array([view is None for view in batch.views], np.bool_))
        self.checks = 0

    def agreement(self, group: Sequence[int]) -> float:
        """Jaccard index of a group's perception with what it should see of the past one.

        group: rows of agents
        """
        self.checks += 1
        members = members_of(self._batch, group)
        boxes = perception(self._batch, members)
        past, _ = matched_boxes(self.boxes, boxes, self._match_iou)
        should: Bools = np.asarray(self._seen[:, members].any(axis=1))
        should[past] = True
        return jaccard(int(should.sum()), len(boxes.yaw), len(past))


def estimated(checks: Sequence[Check]) -> float:
    """Estimated number of attackers, m = log2(1 / eta).

    eta: share of normal groups among those checked; checks: members of each group, and whether it was normal
    0 without a check; with no normal one, as if half a group more had been: eta is at least 1 / (2 n).
    """
    if not checks:
        return 0.0
    normal = sum(fits for _, fits in checks)
    return log2(len(checks) / max(normal, 0.5))


def posterior(member: Bools, normal: Bools, before: Floats, short_term: float) -> Floats:
    """(a,) probability that each agent is honest, see `Prbi`.

    member: (k, a) agents of each checked group; normal: (k,) which are; before: (a,) the last result
    """
    abnormal = ~normal
    groups = member.sum(axis=0)
    beta = np.divide((member & normal[:, None]).sum(axis=0), groups, out=np.ones(len(before)), where=groups > 0)
    prior = short_term * before + (1.0 - short_term) * beta
    evidence = abnormal.mean() if len(normal) else 0.0
    if evidence == 0.0:
        return np.asarray(prior)
    # As if one more group without the agent had been checked: a share of few groups is not 0 or 1.
    likelihood = ((~member & abnormal[:, None]).sum(axis=0) + evidence) / ((~member).sum(axis=0) + 1.0)
    result = np.clip(likelihood * prior / evidence, 0.0, 1.0)
    return np.where(beta > 0.0, result, 0.0)


def has_settled(estimates: Sequence[float], number: int, needed: int, quantile: float) -> bool:
    """Whether a t-test does not reject that the mean of estimates is `number`.

    needed: number of estimates; fewer have not settled; quantile: of Student's distribution with one degree less
    """
    if len(estimates) < needed:
        return False
    offset = float(np.mean(estimates)) - number
    error = float(np.std(estimates, ddof=1)) / sqrt(len(estimates))
    return abs(offset) <= quantile * error or abs(offset) <= 1e-9

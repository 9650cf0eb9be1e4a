"""PASAC: halves of the agents, and halves of those, compared with the ego."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.integrity.consensus import EgoConsensus, EgoReference

#: Factors of the one centre that is known, and of the threshold while none is.
_OF_AGREEING, _OF_OTHERS, _DECAY = 0.8, 1.2, 0.98
#: Batches without a score above the threshold after which it decays; and from which unbalanced scores are forgotten.
_DECAY_AFTER, _FORGET_AFTER = 2, 3
#: Scores of one kind are unbalanced if they are more than this many times those of the other.
_UNBALANCED = 3


@dataclass(kw_only=True, eq=False)
class Pasac(EgoConsensus):
    """Admits the agents that agree with the ego on their own, by recursive halving.

    After CP-Guard, on tracks. Probability-agnostic sample consensus (CP-Guard, AAAI 2025; read in its code:
    CP-Security/CP-Guard a2a98d9, cp_guard) with the online threshold of CP-uniGuard (arXiv:2506.22890; read in its
    code: CP-Security/CP-uniGuard 0a5db98, cp_uniguard and adaptive_threshold). The agents are split into halves, these
    into halves, down to single agents. The score of a group is the Jaccard index of the ego's boxes with those of the
    ego and the group. A single agent is admitted if its score reaches the threshold.

    agree: least Jaccard index; with `adaptive`, at first
    adaptive: as in CP-uniGuard's code, the threshold moves to the middle between the medians of the latest scores above
        and below it, grows by `deeper` with each halving, and halves are split whether they agree or not. False: it
        stays, and halves that do not agree are not split, as in CP-Guard
    smoothing: share of the new threshold in each batch
    deeper: added to the threshold at each halving
    window: number of latest scores above, and of those below, that are kept
    least_scores: number of them from which they count

    A batch of n other agents, two or more, has 2 (n - 1) checks with `adaptive` (the original counts 2 n - 1), and at
    most as many without; that of one other agent has one. What differs from the original: CP-Guard compares maps of
    classes by a consistency loss and asks for 0.08; tracks have no such map, so that both kinds use boxes, as
    CP-uniGuard does for detection.

    Weaknesses: the ego decides, so a lying ego excludes the honest ones; a few phantoms or displaced objects leave the
    Jaccard index above the threshold. The adaptive one calls the lowest score of each batch a bad one even if nobody
    lies: it climbs towards the scores of honest agents, and with `deeper` past them, so that they are left out.
    """

    agree: float = 0.3
    adaptive: bool = True
    smoothing: float = 0.2
    deeper: float = 0.02
    window: int = 30
    least_scores: int = 5

    def __post_init__(self) -> None:
        check("0 to 1", agree=self.agree, smoothing=self.smoothing, deeper=self.deeper)
        check("1 or more", window=self.window, least_scores=self.least_scores)
        check("a whole number", window=self.window, least_scores=self.least_scores)
        check("True or False", adaptive=self.adaptive)
        super().__post_init__()

    def reset(self) -> None:
        super().reset()
        self._threshold = AdaptiveThreshold(self.agree, self.smoothing, self.window, self.least_scores)

    def facts(self) -> dict[str, Any]:
        return super().facts() | {"threshold": self._threshold.value if self.adaptive else self.agree}

    def _admit(self, time_ns: int, others: Sequence[int], reference: EgoReference) -> Sequence[int]:
        if not others:
            return ()
        if not self.adaptive:
            return self._descend(others, reference)
        admitted, scores = self._search(others, reference)
        self._threshold.end_batch(scores, bool(admitted))
        return admitted

    def _descend(self, group: Sequence[int], reference: EgoReference) -> list[int]:
        """The agents of a group that agree, without those of halves that do not."""
        if len(group) == 1:
            return [*group] if reference.agreement(group) >= self.agree else []
        admitted: list[int] = []
        for half in halves(group):
            # A single agent is checked once: its score is that of the half.
            if len(half) == 1 or reference.agreement(half) >= self.agree:
                admitted += self._descend(half, reference)
        return admitted

    def _search(self, others: Sequence[int], reference: EgoReference) -> tuple[list[int], list[tuple[float, bool]]]:
        """The agents that agree on their own, and all scores.

        With each score, whether it reached the threshold.
        """
        admitted: list[int] = []
        scores: list[tuple[float, bool]] = []

        def judge(group: Sequence[int], depth: int, score: float) -> None:
            """Note the score of a single agent, or those of halves, and then of their halves."""
            limit = self._threshold.value + depth * self.deeper
            if len(group) == 1:
                scores.append((score, score >= limit))
                if score >= limit:
                    admitted.extend(group)
                return
            of_halves = [(half, reference.agreement(half)) for half in halves(group)]
            for half, of_half in of_halves:
                scores.append((of_half, of_half >= limit))
                judge(half, depth + 1, of_half)

        judge(others, 0, reference.agreement(others) if len(others) == 1 else 0.0)
        return admitted, scores


def halves(group: Sequence[int]) -> tuple[Sequence[int], Sequence[int]]:
    """Two halves of a group; of an odd number, the second is the larger."""
    middle = len(group) // 2
    return group[:middle], group[middle:]


class AdaptiveThreshold:
    """The threshold of CP-uniGuard: the middle between scores above and below it.

    initial: the first threshold; smoothing, window, least_scores: see `Pasac`

    value: the threshold of the next batch
    """

    def __init__(self, initial: float, smoothing: float, window: int, least_scores: int) -> None:
        self.value = self._initial = initial
        self._smoothing, self._least = smoothing, least_scores
        self._agreeing: deque[float] = deque(maxlen=window)
        self._others: deque[float] = deque(maxlen=window)
        self._empty = 0  # batches in a row without a score above the threshold

    def end_batch(self, scores: Sequence[tuple[float, bool]], admitted: bool) -> None:
        """Update the threshold after a batch.

        scores: in the order of the checks, with whether each reached the threshold; admitted: whether an agent was
        """
        before = self._empty, len(self._agreeing), len(self._others)
        agreeing = [score for score, reached in scores if reached]
        others = [score for score, reached in scores if not reached]
        self._agreeing.extend(agreeing)
        self._empty = 0 if agreeing else self._empty + 1
        self._others.extend(others or sorted(agreeing)[:1])
        self._move()
        # The original decides by the numbers that it had before the batch.
        empty, one, other = before
        if not admitted and empty >= _FORGET_AFTER and (one > _UNBALANCED * other or other > _UNBALANCED * one):
            self.value, self._empty = self._initial, 0
            self._agreeing.clear()
            self._others.clear()

    def _move(self) -> None:
        known = [scores for scores in (self._agreeing, self._others) if len(scores) >= self._least]
        if len(known) == 2:
            target = 0.5 * float(np.median(self._agreeing) + np.median(self._others))
        elif known:
            factor = _OF_AGREEING if known[0] is self._agreeing else _OF_OTHERS
            target = factor * float(np.median(known[0]))
        else:
            if self._empty > _DECAY_AFTER:
                self.value *= _DECAY
            return
        self.value = (1.0 - self._smoothing) * self.value + self._smoothing * target

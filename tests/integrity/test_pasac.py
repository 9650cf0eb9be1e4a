"""`Pasac`: halves of the agents are compared with the ego, down to single agents."""

import plain_boxes as plain
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.integrity import Batch, Pasac
from mast_zenoh.integrity.base import SUSPENDED
from mast_zenoh.integrity.pasac import AdaptiveThreshold


class Transcribed:
    """The method of the originals, written down step by step with plain lists."""

    def __init__(self, agree: float, adaptive: bool) -> None:
        self.threshold = self.first = agree
        self.adaptive = adaptive
        self.agreeing: list[float] = []
        self.others: list[float] = []
        self.empty = 0

    def batch(self, each: Batch) -> tuple[set[int], int]:
        """Rows that are admitted besides the first, the ego; and the number of groups that were compared."""
        alone, asked = self.seen(each, [0]), set[tuple[int, ...]]()

        def score(group: list[int]) -> float:
            asked.add(tuple(group))
            return plain.jaccard(alone, self.seen(each, [0, *group]), 0.5)

        scores: list[tuple[float, bool]] = []

        def recurse(group: list[int], depth: int) -> list[int]:
            limit = self.threshold + 0.02 * depth if self.adaptive else self.threshold
            if len(group) == 1:
                scores.append((score(group), score(group) >= limit))
                return group if scores[-1][1] else []
            middle, found = len(group) // 2, []
            for half in (group[:middle], group[middle:]):
                scores.append((score(half), score(half) >= limit))
                if scores[-1][1] or self.adaptive:
                    found += recurse(half, depth + 1)
            return found

        others = list(range(1, len(each.agents)))
        found = recurse(others, 0) if others else []
        if self.adaptive and others:
            self.end(scores, bool(found))
        return set(found), len(asked)

    def seen(self, each: Batch, rows: list[int]) -> list[plain.Box]:
        return [box for box in plain.perception(each, rows) if plain.in_square(box, each.views[0], 32.0)]

    def end(self, scores: list[tuple[float, bool]], any_admitted: bool) -> None:
        empty, n_agreeing, n_others = self.empty, len(self.agreeing), len(self.others)
        above, below = [s for s, ok in scores if ok], [s for s, ok in scores if not ok]
        self.agreeing = (self.agreeing + above)[-30:]
        self.empty = 0 if above else self.empty + 1
        self.others = (self.others + (below or [min(above)]))[-30:]
        if len(self.agreeing) >= 5 and len(self.others) >= 5:
            self.follow((middle(self.agreeing) + middle(self.others)) / 2.0)
        elif len(self.agreeing) >= 5:
            self.follow(0.8 * middle(self.agreeing))
        elif len(self.others) >= 5:
            self.follow(1.2 * middle(self.others))
        elif self.empty > 2:
            self.threshold *= 0.98
        if not any_admitted and empty >= 3 and max(n_agreeing, n_others) > 3 * min(n_agreeing, n_others):
            self.threshold, self.agreeing, self.others, self.empty = self.first, [], [], 0

    def follow(self, target: float) -> None:
        self.threshold = 0.8 * self.threshold + 0.2 * target


def middle(values: list[float]) -> float:
    ordered, n = sorted(values), len(values)
    return (ordered[(n - 1) // 2] + ordered[n // 2]) / 2.0


@given(
    number=st.integers(0, 10_000),
    agents=st.integers(1, 6),
    objects=st.integers(0, 7),
    agree=st.sampled_from([0.1, 0.3, 0.5, 0.9]),
    adaptive=st.booleans(),
    viewed=st.booleans(),
)
def test_it_admits_whom_the_transcribed_method_admits(number, agents, objects, agree, adaptive, viewed):
    stage, expected = Pasac(ego="agent_0", agree=agree, adaptive=adaptive), Transcribed(agree, adaptive)
    for frame in range(6):
        each = plain.random_batch(number, agents, objects, frame=frame, viewed=viewed)
        before = stage.facts()["checks"]
        state = stage.assess(each).agents.state
        rows, checks = expected.batch(each)
        assert {row for row in range(1, agents) if state[row] != SUSPENDED} == rows
        assert state[0] != SUSPENDED, "the ego is always trusted"
        assert stage.facts()["checks"] - before == checks
        assert stage.facts()["threshold"] == pytest.approx(expected.threshold)


@given(
    batches=st.lists(st.tuples(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=9), st.booleans()), max_size=40),
    first=st.floats(0.0, 1.0),
)
def test_the_threshold_is_that_of_the_transcribed_method(batches: list[tuple[list[float], bool]], first: float) -> None:
    threshold, expected = AdaptiveThreshold(first, 0.2, 30, 5), Transcribed(first, True)
    for values, any_admitted in batches:
        scores = [(value, value >= expected.threshold) for value in values]
        threshold.end_batch(scores, any_admitted)
        expected.end(scores, any_admitted)
        assert threshold.value == pytest.approx(expected.threshold)

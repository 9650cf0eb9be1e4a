"""Which of several effects differ from 0 when all are read together."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from typing import TypeVar

from mast_zenoh.metrics.study_results import LEVEL, Statistic

Effect = TypeVar("Effect", bound=Hashable)


def clearest(effects: Mapping[Effect, Statistic]) -> list[Effect]:
    """The effects that differ from 0 if all are read together (Holm), the clearest first: that with the smallest p.

    With equal numbers of seeds, this is the largest |t|. Effects without spread have no p-value and are left out.
    """
    tested = {name: each for name, each in effects.items() if not math.isnan(each.p)}
    adjusted = zip(tested, holm([each.p for each in tested.values()]), strict=True)
    shown = [name for name, p in adjusted if p <= LEVEL]
    return sorted(shown, key=lambda name: (tested[name].p, -abs(tested[name].value)))


def holm(p_values: Sequence[float]) -> list[float]:
    """p-values adjusted for multiple testing by Holm's procedure.

    Holm (1979), A simple sequentially rejective multiple test procedure, Scandinavian Journal of Statistics 6:65.
    Valid whatever the dependence between the tests.
    """
    order = sorted(range(len(p_values)), key=p_values.__getitem__)
    adjusted, worst = [1.0] * len(p_values), 0.0
    for rank, index in enumerate(order):
        worst = max(worst, min(1.0, (len(p_values) - rank) * p_values[index]))
        adjusted[index] = worst
    return adjusted

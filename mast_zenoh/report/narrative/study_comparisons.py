"""Corrects a study's comparisons with the baseline for multiple testing."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mast_zenoh.report.tables.study_rows import ADDED, PAPER, Column, Series, StudyRow, columns_of

LEVEL = 0.05


@dataclass(frozen=True, slots=True)
class Comparisons:
    """The contrasts with the baseline for which the tables show an interval.

    adjusted: by configuration and series, the p-value adjusted by Holm's procedure
    others:   number of other contrasts with an interval in table.csv, which are not counted
    """

    adjusted: Mapping[tuple[str, Series], float]
    others: int

    @property
    def count(self) -> int:
        """The number of contrasts."""
        return len(self.adjusted)

    @property
    def bonferroni(self) -> float:
        """Bonferroni level of each interval for a joint level of LEVEL."""
        return LEVEL / max(self.count, 1)

    def remains(self, row: StudyRow, column: Column) -> bool:
        """Whether the difference is distinguishable from 0 after Holm's procedure."""
        series = Series(column.owner or row.ego, column.estimator, column.metric)
        return self.adjusted.get((row.label, series), 1.0) <= LEVEL

    def remaining(self) -> int:
        """The number of contrasts that remain distinguishable from 0."""
        return sum(p <= LEVEL for p in self.adjusted.values())


def compare(rows: Sequence[StudyRow], baseline: str) -> Comparisons:
    """The contrasts with an interval in the tables of increments, each counted once."""
    tested = {
        (row.label, series): estimate.p
        for row in rows
        if row.label != baseline
        for series, estimate in row.estimates.items()
        if not math.isnan(estimate.p)
    }
    table_series = {(column.owner, column.estimator, column.metric) for column in columns_of(ADDED + PAPER)}
    ego = {row.label: row.ego for row in rows}
    counted = {
        (label, series): p
        for (label, series), p in tested.items()
        if table_series & {(None if series.owner == ego[label] else series.owner, series.estimator, series.metric)}
    }
    return Comparisons(dict(zip(counted, holm(list(counted.values())), strict=True)), len(tested) - len(counted))


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

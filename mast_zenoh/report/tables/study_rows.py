"""Data of a study's tables: a row per configuration, an estimate per series."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from mast_zenoh.metrics import CAUSES
from mast_zenoh.report.tables.scores import DASH

NAN = float("nan")
#: Minimum number of seeds for an interval.
MIN_SEEDS = 5
#: An increment that is 0 in a larger share of trials than this has no interval.
MOSTLY = 0.5
#: The warning of a table with such an increment.
MOSTLY_ZERO = (
    'Warning: "(0 in N % [a, b])" marks a difference that is 0 in N % of the trials; a to b is the exact 95 % interval '
    "of that share. The mean has no interval: it would be too narrow."
)
#: Differences up to this are rounding errors.
NEGLIGIBLE = 1e-9


class Series(NamedTuple):
    """Identifies a number in results.parquet; `owner` is the column `who`."""

    owner: str
    estimator: str
    metric: str


@dataclass(frozen=True, slots=True)
class Estimate:
    """One series of one configuration; unknown numbers are NaN.

    mean, std: over the frames of all trials, as in the paper; std is NaN for metrics of whole runs
    trial_mean, low, high: mean over the trials of `seeds` seeds in `scenes` scenes, each paired with its baseline, and
               its 95 % interval over seeds of these scenes; without bounds for fewer than five seeds, or equal ones
    scenes_low, scenes_high: 95 % interval to other scenes as well; for five scenes and more
    p:         p-value of no difference from the baseline, over seeds; of increments only
    zero_share, zero_low, zero_high: share of trials in which an increment is 0, and its exact 95 % interval
    left_out:  number of seeds left out of the trial statistics, because a trial failed or has no value
    rate:      whether it is a success rate, from trials that are 0 or 1
    """

    mean: float = NAN
    std: float = NAN
    trial_mean: float = NAN
    low: float = NAN
    high: float = NAN
    scenes_low: float = NAN
    scenes_high: float = NAN
    p: float = NAN
    zero_share: float = NAN
    zero_low: float = NAN
    zero_high: float = NAN
    scenes: int = 0
    seeds: int = 0
    left_out: int = 0
    rate: bool = False

    @property
    def mostly_zero(self) -> bool:
        """Whether an increment is 0 in most trials, of at least five seeds, so that its mean has no interval."""
        return self.seeds >= MIN_SEEDS and self.zero_share > MOSTLY

    @property
    def unchanged(self) -> bool:
        """Whether an increment is 0 in every trial, of at least five seeds."""
        if self.mostly_zero:
            return self.zero_share == 1.0
        return self.seeds >= MIN_SEEDS and self.trial_mean == 0.0 and math.isnan(self.low)

    @property
    def certain(self) -> bool:
        """Whether an increment is equal in every seed and not 0, so without interval."""
        known = self.seeds >= MIN_SEEDS and abs(self.trial_mean) > NEGLIGIBLE
        return known and math.isnan(self.low) and not self.mostly_zero

    def without_interval(self) -> Estimate:
        """A copy whose mean has neither interval nor p-value."""
        return replace(self, low=NAN, high=NAN, scenes_low=NAN, scenes_high=NAN, p=NAN)


@dataclass(frozen=True, slots=True)
class StudyRow:
    """One configuration.

    label: of the configuration; run: label of its run in the study file; point: grid parameters, name to value
    ego:   name of the agent whose estimates are scored
    """

    label: str
    run: str
    point: Mapping[str, object]
    estimates: Mapping[Series, Estimate]
    ego: str = "ego"

    @property
    def title(self) -> str:
        """The label with parameter names: `attacked false_positives=2.0`."""
        return (
            " ".join([self.run, *(f"{name}={value}" for name, value in self.point.items())])
            if self.point
            else self.label
        )

    def get(self, metric: str, estimator: str = "picture", owner: str | None = None) -> Estimate:
        """The estimate of a series, by default of the ego; all NaN if there is none."""
        return self.estimates.get(Series(owner or self.ego, estimator, metric), Estimate())


class Column(NamedTuple):
    """One column of a table: heading and series; owner: None for the ego."""

    heading: str
    metric: str
    estimator: str = "picture"
    owner: str | None = None

    def of(self, row: StudyRow) -> Estimate:
        """The estimate that belongs in this column of a row."""
        return row.get(self.metric, self.estimator, self.owner)


#: Columns in groups with a name.
Groups = tuple[tuple[str, tuple[Column, ...]], ...]

#: The estimates of the ego that tables compare, and their names.
ESTIMATORS = {"local": "ego alone", "picture": "picture", "mission": "ego with the picture"}

_SCORES = (("FN", "fn"), ("FP", "fp"), ("TP", "tp"), ("RMSE m", "rmse_m"), ("ID sw.", "id_switches"))
_DISTANCES = (("OSPA m", "ospa_m"), ("GOSPA m", "gospa_m"), ("complete", "completeness"))


def _of(estimator: str, metrics: Iterable[tuple[str, str]], suffix: str = "") -> tuple[Column, ...]:
    return tuple(Column(heading, metric + suffix, estimator) for heading, metric in metrics)


#: The scores of each estimate, and their increments over the baseline.
SCORES: Groups = tuple((name, _of(estimator, _SCORES)) for estimator, name in ESTIMATORS.items())
ALL_SCORES: Groups = tuple((name, _of(estimator, _SCORES + _DISTANCES)) for estimator, name in ESTIMATORS.items())
ADDED: Groups = tuple((name, _of(estimator, _SCORES, "_iob")) for estimator, name in ESTIMATORS.items())

#: The increments by their names in the paper.
PAPER: Groups = (
    (
        "compromised agents",
        (
            Column("CAFN IoB", "cafn_iob", "local", "compromised"),
            Column("CAFP IoB", "cafp_iob", "local", "compromised"),
        ),
    ),
    (
        "compromised agents, by the centre",
        (
            Column("CAFN centre", "cafn_iob", "picture", "compromised"),
            Column("CAFP centre", "cafp_iob", "picture", "compromised"),
        ),
    ),
    ("ERCC FN", (Column("FN IoB", "fn_iob"), Column("FN IoE", "fn_ioe"))),
    ("ERCC FP", (Column("FP IoB", "fp_iob"), Column("FP IoE", "fp_ioe"))),
    ("ERCC TP", (Column("TP IoB", "tp_iob"), Column("TP IoE", "tp_ioe"))),
)


#: What the command centre's defence did in a run.
DEFENCE: Groups = (
    (
        "defence",
        tuple(
            Column(heading, metric, "defence", "all")
            for heading, metric in (
                ("lying agents", "lying_agents"),
                ("of these suspended", "lying_suspended"),
                ("delay s", "delay_s"),
                ("honest suspended", "honest_suspended"),
                ("false alarms", "false_alarms"),
                ("false withheld", "withheld_false"),
                ("true withheld", "withheld_true"),
            )
        ),
    ),
)


def columns_of(groups: Groups) -> list[Column]:
    """All columns of the groups, one after the other."""
    return [column for _, columns in groups for column in columns]


def present(rows: Sequence[StudyRow], groups: Groups) -> Groups:
    """The groups in which any row has a number."""
    return tuple(
        (name, columns)
        for name, columns in groups
        if any(not math.isnan(column.of(row).mean) for row in rows for column in columns)
    )


def over_frames(estimate: Estimate) -> str:
    """`3.42 ± 1.20`."""
    if math.isnan(estimate.mean):
        return DASH
    mean = number(estimate.mean)
    return mean if math.isnan(estimate.std) else f"{mean} ± {number(estimate.std)}"


def over_trials(estimate: Estimate) -> str:
    """Mean and interval: `3.42 [3.10, 3.80]`, or the reason for none: `3.42 (n < 5)`.

    Success rates are in per cent.
    """
    return f"{value(estimate)} {bounds(estimate)}".strip()


def value(estimate: Estimate) -> str:
    """The mean over trials alone: `3.42`, a success rate as `85 %`."""
    mean = estimate.trial_mean
    return f"{100.0 * mean:.0f} %" if estimate.rate and not math.isnan(mean) else number(mean, _digits(estimate))


def bounds(estimate: Estimate, *, scenes: bool = False) -> str:
    """`[3.10, 3.80]`, or why there is no interval; scenes: that to other scenes."""
    low, high = (estimate.scenes_low, estimate.scenes_high) if scenes else (estimate.low, estimate.high)
    if not math.isnan(low):
        digits = _digits(estimate)
        ends = (f"{100.0 * end:.0f}" if estimate.rate else number(end, digits) for end in (low, high))
        return f"[{', '.join(ends)}]"
    if scenes or math.isnan(estimate.trial_mean):
        return ""
    if estimate.mostly_zero:
        share, first, last = (100.0 * each for each in (estimate.zero_share, estimate.zero_low, estimate.zero_high))
        return f"(0 in {share:.0f} % [{first:.0f}, {last:.0f}])"
    return f"(n < {MIN_SEEDS})" if estimate.seeds < MIN_SEEDS else "(all equal)"


def _digits(estimate: Estimate) -> int:
    """Decimals that show the width of the interval: two, more where it would vanish."""
    half = (estimate.high - estimate.low) / 2.0
    return 2 if math.isnan(half) or half >= 0.01 else min(5, math.ceil(-math.log10(half)))


def number(value: float, digits: int = 2) -> str:
    """A number with `digits` decimals, a proper minus sign and no negative zero."""
    if math.isnan(value):
        return DASH
    text = f"{value:.{digits}f}"
    return text.replace("-", "" if float(text) == 0.0 else "\u2212")


def shares(row: StudyRow, outcome: str, estimator: str = "picture") -> dict[str, float]:
    """Shares (0 to 1) of the causes of an estimate's errors; {} if there are none.

    outcome: "fp" (false objects) or "fn" (missed objects)
    """
    counts = {cause: row.get(f"{outcome} {cause}", estimator).mean for cause in CAUSES}
    counts = {cause: mean for cause, mean in counts.items() if mean > 0.0}
    total = sum(counts.values())
    return {cause: mean / total for cause, mean in counts.items()}

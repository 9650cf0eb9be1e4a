"""What the tables and figures of a study show: a row per configuration, an estimate per metric."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from mast_zenoh.metrics import CAUSES
from mast_zenoh.report.table import DASH

NAN = float("nan")


@dataclass(frozen=True, slots=True)
class Estimate:
    """One metric of one configuration; what is not known is NaN.

    mean, std: over the frames of all trials together, as the paper has them; std is NaN for metrics of whole runs
    trial_mean, low, high: mean over trials, each paired with its baseline, and its 95 % bootstrap interval
    trials:    how many
    """

    mean: float = NAN
    std: float = NAN
    trial_mean: float = NAN
    low: float = NAN
    high: float = NAN
    trials: int = 0


@dataclass(frozen=True, slots=True)
class StudyRow:
    """One configuration.

    label: its own; run: that of the study file's run; point: its choice from the grid, name to value
    """

    label: str
    run: str
    point: Mapping[str, object]
    estimates: Mapping[str, Estimate]

    def get(self, metric: str) -> Estimate:
        """The estimate of a metric, all NaN if there is none."""
        return self.estimates.get(metric, Estimate())


#: Metrics by their names in results.parquet, and how the tables head them: (group, ((heading, metric), …)).
Groups = tuple[tuple[str, tuple[tuple[str, str], ...]], ...]
INCREMENTS: Groups = (
    ("compromised agents", (("CAFN IoB", "cafn_iob"), ("CAFP IoB", "cafp_iob"))),
    ("ERCC FN", (("FN IoB", "fn_iob"), ("FN IoE", "fn_ioe"))),
    ("ERCC FP", (("FP IoB", "fp_iob"), ("FP IoE", "fp_ioe"))),
    ("ERCC TP", (("TP IoB", "tp_iob"), ("TP IoE", "tp_ioe"))),
)
PICTURE: Groups = (
    (
        "picture",
        (
            ("FN", "fn"),
            ("FP", "fp"),
            ("TP", "tp"),
            ("RMSE m", "rmse_m"),
            ("OSPA m", "ospa_m"),
            ("GOSPA m", "gospa_m"),
            ("complete", "completeness"),
            ("ID sw.", "id_switches"),
            ("1st false s", "time_to_first_false_s"),
        ),
    ),
)


def over_frames(estimate: Estimate) -> str:
    """`3.42 ± 1.20`."""
    if math.isnan(estimate.mean):
        return DASH
    mean = number(estimate.mean)
    return mean if math.isnan(estimate.std) else f"{mean} ± {number(estimate.std)}"


def over_trials(estimate: Estimate) -> str:
    """`3.42 [3.10, 3.80]`; without an interval the mean alone."""
    if math.isnan(estimate.trial_mean):
        return DASH
    bounds = "" if math.isnan(estimate.low) else f" [{number(estimate.low)}, {number(estimate.high)}]"
    return number(estimate.trial_mean) + bounds


def number(value: float) -> str:
    """Two decimals, with a proper minus and no negative zero."""
    text = DASH if math.isnan(value) else f"{value:.2f}"
    return "0.00" if text == "-0.00" else text.replace("-", "\u2212")


def shares(row: StudyRow, what: str) -> dict[str, float]:
    """Of the false ("fp") or missed ("fn") objects of the picture the part of each cause, 0 to 1; {} without any."""
    counts = {cause: row.get(f"{what} {cause}").mean for cause in CAUSES}
    counts = {cause: mean for cause, mean in counts.items() if mean > 0.0}
    total = sum(counts.values())
    return {cause: mean / total for cause, mean in counts.items()}

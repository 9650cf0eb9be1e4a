"""The text of numbers, with their intervals.

`measured` is for tables whose note says that few trials have no interval (FEW_TRIALS); `over_trials`, with its parts
`value` and `interval`, is for the studies of runs, where each number says why it has none.
"""

from __future__ import annotations

import math

from mast_zenoh.metrics.study_results import MIN_SEEDS, MOSTLY_ZERO, Statistic
from mast_zenoh.run_folder.finding import whole_percent

#: Placeholder for an unknown number.
DASH = "\u2013"
#: Below tables whose numbers have too few trials for intervals.
FEW_TRIALS = f"Numbers without brackets are of fewer than {MIN_SEEDS} trials, so without an interval."

_NOT_REACHED = "not reached"


def number(value: float | None, digits: int = 2) -> str:
    """A number with `digits` decimals, a proper minus sign and no negative zero; a dash for what is not known."""
    if value is None or math.isnan(value):
        return DASH
    text = f"{value:.{digits}f}"
    return text.replace("-", "" if float(text) == 0.0 else "\u2212")


def whole(each: Statistic) -> str:
    """A number that is whole."""
    return number(each.value, 0)


def digits(*values: float) -> list[str]:
    """All digits of numbers; `inf` is not reached, empty is unknown."""
    return ["" if math.isnan(value) else repr(float(value)) for value in values]


def measured(each: Statistic, decimals: int = 2) -> str:
    """A number with its interval, `3.42 [3.10, 3.80]`; else `3.42 (all equal)`, `(mostly 0)`; `3.42` of few trials.

    Infinite: `not reached [1.20, \u221e)`, or `not reached` if the interval is beyond what was watched, too.
    """
    if math.isnan(each.value):
        return DASH
    if math.isinf(each.value):
        return _not_reached(each)
    if math.isnan(each.low):
        why = "mostly 0" if each.interval == MOSTLY_ZERO else "all equal"
        return number(each.value, decimals) + (f" ({why})" if each.trials >= MIN_SEEDS else "")
    decimals = decimals_of(each, decimals)
    low = number(each.low, decimals)
    interval = f"[{low}, \u221e)" if math.isinf(each.high) else f"[{low}, {number(each.high, decimals)}]"
    return f"{number(each.value, decimals)} {interval}"


def decimals_of(each: Statistic, least: int = 2) -> int:
    """So many decimals that the interval of a number has a width."""
    half = (each.high - each.low) / 2.0
    return min(5, max(least, math.ceil(-math.log10(half)))) if 0.0 < half < 0.01 else least


def median_delay(each: Statistic) -> str:
    """A median delay; if fewer than half were detected, only its lower bound is known."""
    return _not_reached(each) if math.isnan(each.value) and each.trials else measured(each)


def percent(share: Statistic, unit: str = "", beyond: str = "") -> str:
    """`44 [38, 47]`, in per cent; unit: after the value;  beyond: what stands for an infinite number."""
    if not share.known:
        return DASH
    value, low, high = (beyond if math.isinf(each) else whole_percent(each) for each in share[:3])
    return f"{value}{unit}" if math.isnan(share.low) else f"{value}{unit} [{low}, {high}]"


def _not_reached(each: Statistic) -> str:
    return f"{_NOT_REACHED} [{number(each.low)}, \u221e)" if math.isfinite(each.low) else _NOT_REACHED


def over_frames(estimate: Statistic) -> str:
    """`3.42 ± 1.20`."""
    if math.isnan(estimate.mean):
        return DASH
    mean = number(estimate.mean)
    return mean if math.isnan(estimate.std) else f"{mean} ± {number(estimate.std)}"


def over_trials(estimate: Statistic) -> str:
    """Mean and interval: `3.42 [3.10, 3.80]`, or the reason for none: `3.42 (n < 5)`.

    Success rates are in per cent.
    """
    return f"{value(estimate)} {interval(estimate)}".strip()


def value(estimate: Statistic) -> str:
    """The mean over trials alone: `3.42`, a success rate as `85 %`."""
    mean = estimate.value
    return f"{whole_percent(mean)} %" if estimate.rate and not math.isnan(mean) else number(mean, decimals_of(estimate))


def interval(estimate: Statistic, *, scenes: bool = False) -> str:
    """`[3.10, 3.80]`, or why there is no interval; scenes: that to other scenes."""
    low, high = (estimate.scenes_low, estimate.scenes_high) if scenes else (estimate.low, estimate.high)
    if not math.isnan(low):
        decimals = decimals_of(estimate)
        ends = (whole_percent(end) if estimate.rate else number(end, decimals) for end in (low, high))
        return f"[{', '.join(ends)}]"
    if scenes or math.isnan(estimate.value):
        return ""
    if estimate.mostly_zero:
        share, first, last = map(whole_percent, (estimate.zero_share, estimate.zero_low, estimate.zero_high))
        return f"(0 in {share} % [{first}, {last}])"
    return f"(n < {MIN_SEEDS})" if estimate.seeds < MIN_SEEDS else "(all equal)"

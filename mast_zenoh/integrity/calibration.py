"""Cumulative sums of evidence, when they are alarms, and the data on which thresholds were chosen."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.errors import ConfigurationError

#: Samples a second that the errors of tracks give independently; consecutive frames share theirs.
SAMPLES_PER_S = 1.1
#: s, after a suspension in which a fault that is found then excuses it.
EXCUSED_S = 1.0
#: s, greatest step of a sum: a batch after a gap is no more evidence than one.
MAX_STEP_S = 0.5


@dataclass(frozen=True, slots=True)
class Tail:
    """How often a statistic of an honest agent exceeds a value.

    per_hour: times an hour and agent that it exceeds 0, extrapolated from large values
    scale: change of the statistic that makes it e times rarer
    """

    per_hour: float
    scale: float

    def rate(self, statistic: Floats) -> Floats:
        """How often an hour, of one honest agent, a statistic of this size is exceeded."""
        return np.asarray(self.per_hour * np.exp(-np.minimum(statistic / self.scale, 700.0)))

    def value_at(self, per_hour: float) -> float:
        """The value that an honest agent exceeds `per_hour` times."""
        return float(self.scale * np.log(self.per_hour / per_hour))


#: Share of the maxima, the largest, that a tail is fitted to.
LARGEST = 0.1


def fitted_tail(maxima: Floats, hours: float) -> Tail:
    """The exponential tail of the maxima of blocks, by maximum likelihood over a threshold.

    maxima: (n,) of a statistic in n blocks of honest agents, nearly independent; hours: their total length

    Raises ValueError for fewer maxima than a tail can be fitted to.
    """
    threshold = np.quantile(maxima, 1.0 - LARGEST)
    excess = maxima[maxima > threshold] - threshold
    if len(excess) < 2:
        raise ValueError(f"maxima: found {len(maxima)} blocks, expected at least {round(3 / LARGEST)}")
    scale = float(excess.mean())
    return Tail(float(len(excess) / hours * np.exp(threshold / scale)), scale)


def discoveries(rates: Floats, per_hour: float) -> Bools:
    """Which of m statistics are alarms, at `per_hour` false ones among all.

    rates: (...) m numbers, how often an hour an honest agent exceeds each

    The procedure of Benjamini and Hochberg (Journal of the Royal Statistical Society B, 1995), on rates instead of
    probabilities: the i rarest are alarms if the i-th is rarer than i / m times the permitted rate.
    """
    ordered = np.sort(rates, axis=None)
    m = len(ordered)
    passed = np.flatnonzero(ordered <= per_hour * np.arange(1, m + 1) / max(m, 1))
    return np.asarray(rates <= (ordered[passed[-1]] if len(passed) else -1.0))


def accumulate(total: Floats, evidence: Floats, allowance: float, dt: float) -> Floats:
    """Cumulative sums (Page, Biometrika 1954) after `dt` s with `evidence` a second; they never fall below 0.

    allowance: evidence a second that an honest agent gives
    """
    return np.maximum(0.0, total + dt * (evidence - allowance))


#: Seeds, and generated junctions (`Intersection.scene_index`), of the runs from which thresholds were chosen. (Runs of
#: seeds 201 and 202 on other junctions showed a weakness of a statistic, and are test data no more.)
CALIBRATION_SEEDS = range(101, 203)
CALIBRATION_SCENES = range(4)


def refuse_calibration_data(seeds: Iterable[int], scene: Mapping[str, Any], place: str) -> None:
    """Raise ConfigurationError if a test would use seeds or a scene from which thresholds were chosen.

    scene: its configuration, as from `parse_scene`;  place: named in the error
    """
    used = sorted(set(seeds).intersection(CALIBRATION_SEEDS))
    if used:
        raise ConfigurationError(
            f"{place}: seed {used[0]}: thresholds were calibrated on seeds {_span(CALIBRATION_SEEDS)}, "
            "expected other seeds: a defence tested on its calibration data looks better than it is"
        )
    if scene.get("type") == "Intersection" and scene.get("scene_index", 0) in CALIBRATION_SCENES:
        raise ConfigurationError(
            f"{place}: scene intersection:{scene.get('scene_index', 0)}: thresholds were calibrated on the junctions "
            f"{_span(CALIBRATION_SCENES)}, expected intersection:{CALIBRATION_SCENES.stop} or above: a defence tested "
            "on its calibration data looks better than it is"
        )


def _span(numbers: range) -> str:
    return f"{numbers.start} to {numbers.stop - 1}"


#: Match losses of honest agents, see `Made`.
MATCH_LOSSES: tuple[float, ...] = (0.0,)

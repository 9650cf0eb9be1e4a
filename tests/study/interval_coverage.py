"""Simulated coverage of the confidence intervals of studies.

    python tests/study/interval_coverage.py     prints a table, in per cent

Each cell is the share, in per cent, of 10,000 simulated studies whose 95 % interval contains the true mean. The
intervals come from `mast_zenoh.study.statistics`, which also computes the tables of studies.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.special import ndtri

from mast_zenoh.arrays.states import Floats
from mast_zenoh.metrics.study_results import MOSTLY
from mast_zenoh.streams import stream
from mast_zenoh.study import statistics
from mast_zenoh.study.statistics import Interval

STUDIES, AT_ONCE = 10_000, 2_000
SEEDS, SCENES = (5, 20, 60), (1, 3, 10)
BANK = Path(__file__).with_name("increments.csv")

#: Draws (studies, scenes, seeds) outcomes, and their true mean.
Draw = Callable[[np.random.Generator, int, int, int], tuple[Floats, float]]


@dataclass(frozen=True)
class World:
    """A distribution of outcomes: its name, generator and interval.

    scenes: numbers of scenes with an interval; claimed: smallest number of seeds that covers 93 to 97 %, None: never
    zero_share: true share of trials with 0, by number of scenes: where most trials of a study are 0, its interval
                is that of this share, as in the tables; None: always that of the mean
    """

    name: str
    draw: Draw
    interval: Callable[[Floats], Interval]
    scenes: tuple[int, ...] = SCENES
    claimed: int | None = 5
    zero_share: Callable[[int], float] | None = None


def normal(shared: float, between_scenes: float = 0.0) -> Draw:
    """Normal values; shared: correlation of scenes with one seed."""

    def draw(rng: np.random.Generator, n: int, scenes: int, seeds: int) -> tuple[Floats, float]:
        of_seed = np.sqrt(shared) * rng.standard_normal((n, 1, seeds))
        residual = np.sqrt(1.0 - shared) * rng.standard_normal((n, scenes, seeds))
        return 3.0 + of_seed + residual + between_scenes * rng.standard_normal((n, scenes, 1)), 3.0

    return draw


def poisson(mean: float) -> Draw:
    """Counts, independent in every trial."""
    return lambda rng, n, scenes, seeds: (rng.poisson(mean, (n, scenes, seeds)).astype(np.float64), mean)


def recorded(configuration: str, metric: str, *, other_scenes: bool = False) -> Draw:
    """Recorded outcomes, resampled by seed and optionally by scene."""
    bank = _bank()[configuration, metric]

    def draw(rng: np.random.Generator, n: int, scenes: int, seeds: int) -> tuple[Floats, float]:
        seed = rng.integers(0, bank.shape[1], (n, 1, seeds))
        if other_scenes:
            return bank[rng.integers(0, len(bank), (n, scenes, 1)), seed], float(bank.mean())
        return bank[np.arange(scenes)[:, None], seed], float(bank[:scenes].mean())

    return draw


def recorded_zeros(configuration: str, metric: str) -> Callable[[int], float]:
    """Share of zeros among the recorded outcomes of the first scenes."""
    return lambda scenes: float(statistics.zeros(_bank()[configuration, metric][:scenes]).mean())


def success(rate: float, shared: float) -> Draw:
    """Trials that succeed at a rate; `shared`: correlation of scenes of one seed."""
    below = normal(shared)

    def draw(rng: np.random.Generator, n: int, scenes: int, seeds: int) -> tuple[Floats, float]:
        return (below(rng, n, scenes, seeds)[0] - 3.0 < ndtri(rate)).astype(np.float64), rate

    return draw


def _bank() -> dict[tuple[str, str], Floats]:
    """By configuration and metric (scenes, seeds) increments, as recorded."""
    with BANK.open() as file:
        lines = list(csv.reader(line for line in file if not line.startswith("#")))[1:]
    samples: dict[tuple[str, str], list[list[float]]] = {}
    for configuration, metric, _, *values in lines:
        samples.setdefault((configuration, metric), []).append([float(value) for value in values])
    return {key: np.array(rows) for key, rows in samples.items()}


def worlds() -> Iterator[World]:
    """All distributions on the page, in its order."""
    seeds, scenes, rate = statistics.over_seeds, statistics.over_scenes, statistics.rate_interval
    yield World("normal, scenes of a seed correlate at 0.98", normal(0.98), seeds)
    yield World("normal, independent", normal(0.0), seeds)
    yield World("Poisson, mean 5", poisson(5.0), seeds)
    for attack, claimed in (("uncoordinated-2", None), ("coordinated-2", 60)):
        yield World(f"false objects added, {attack}", recorded(attack, "fp_iob"), seeds, claimed=20)
        name, missed = f"missed objects added, {attack}", recorded(attack, "fn_iob")
        yield World(name, missed, seeds, claimed=None, zero_share=recorded_zeros(attack, "fn_iob"))
        yield World(f"{name}, t for every mean", missed, seeds, claimed=claimed)
    yield World("to other scenes: normal, 0.98, scenes alike", normal(0.98), scenes, (10,))
    yield World("to other scenes: normal, 0.98, scenes differ", normal(0.98, 1.0), scenes, (10,))
    yield World("to other scenes: normal, independent, scenes differ", normal(0.0, 1.0), scenes, (10,))
    yield World("to other scenes: normal, independent, scenes alike", normal(0.0), scenes, (10,), claimed=20)
    for attack in ("uncoordinated-2", "coordinated-2"):
        draw = recorded(attack, "fp_iob", other_scenes=True)
        yield World(f"to other scenes: false objects added, {attack}", draw, scenes, (10,), claimed=20)
    for percent in (2, 10, 50):
        for shared in (0.98, 0.0):
            name = f"success rate {percent} %, {'0.98' if shared else 'independent'}"
            yield World(name, success(percent / 100.0, shared), rate, claimed=None)


def coverage(world: World, scenes: int, seeds: int) -> float:
    """Per cent of simulated intervals that contain the true mean."""
    rng = stream(0, "coverage", world.name, scenes, seeds)
    hits = known = 0
    for _ in range(STUDIES // AT_ONCE):
        values, truth = world.draw(rng, AT_ONCE, scenes, seeds)
        low, high = world.interval(values)
        contained, given = (low <= truth) & (truth <= high), ~np.isnan(low)
        if world.zero_share is not None:
            zeros = statistics.zeros(values)
            mostly_zero = zeros.mean(axis=(-2, -1)) > MOSTLY
            low, high = statistics.rate_interval(zeros)
            share = world.zero_share(scenes)
            contained = np.where(mostly_zero, (low <= share) & (share <= high), contained)
            given |= mostly_zero
        hits += np.count_nonzero(contained)
        known += np.count_nonzero(given)
    return 100.0 * hits / known


def table() -> dict[str, dict[tuple[int, int], float]]:
    """Coverage by world and number of (scenes, seeds) with an interval."""
    return {
        world.name: {(scenes, seeds): coverage(world, scenes, seeds) for scenes in world.scenes for seeds in SEEDS}
        for world in worlds()
    }


def as_markdown(coverages: dict[str, dict[tuple[int, int], float]]) -> str:
    """A row per world, a column per number of scenes and seeds, in per cent."""
    cells = [(scenes, seeds) for scenes in SCENES for seeds in SEEDS]
    lines = ["| scenes \u00d7 seeds | " + " | ".join(f"{scenes} \u00d7 {seeds}" for scenes, seeds in cells) + " |"]
    lines.append("|---|" + "---:|" * len(cells))
    for name, values in coverages.items():
        texts = (f"{values[cell]:.1f}" if cell in values else "" for cell in cells)
        lines.append(f"| {name} | " + " | ".join(texts) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(as_markdown(table()))

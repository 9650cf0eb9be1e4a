"""Measures how often honest agents exceed the statistics of a stage, and fits their tails.

    .venv/bin/python tools/calibrate_integrity.py [FIRST_SEED LAST_SEED] [--frames N] [--losses]

Plays unattacked junctions 0 to 3 with the seeds given (101 to 106 by default), which no test of a defence may use, and
prints for each statistic of `SequentialConsistency` the tail to be written into its file, with 95 % intervals from a
bootstrap over runs. With --losses, it prints the match losses of `Made`
in these runs, to be written into `mast_zenoh/integrity/calibration.py`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np

from mast_zenoh import scenario
from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.fusion import SampledAssignmentClusterer
from mast_zenoh.integrity import Batch, Integrity, Made, SequentialConsistency
from mast_zenoh.integrity.alarms import Tail
from mast_zenoh.integrity.made import match_losses
from mast_zenoh.integrity.views import views_of
from mast_zenoh.mesh.inproc import InProcess

SCENES = range(4)
BLOCK_FRAMES = 100  # 10 s: statistics of two blocks are nearly independent
RESAMPLES = 1000
#: Frames of the first match loss, and between two: 1 s, so that they are nearly independent.
FIRST_LOSS, LOSS_PERIOD = 20, 10
QUANTILES = 250
#: Share of the maxima, the largest, that a tail is fitted to.
LARGEST = 0.1


def unattacked(stage: Integrity, seed: int, scene_index: int, frames: int) -> Iterator[Batch]:
    """The batches of an unattacked run, with the faults corrected that a stage finds."""
    path, content = scenario.load_values("defended", {"n_adversaries": 0, "scene_index": scene_index}, [])
    resolved = scenario.resolve(path, content, seed=seed, frames=frames)
    messages: dict[str, dict[int, tuple[int, dict]]] = {"collated": {}, "views": {}}

    def tap(out: object) -> None:
        header, body = out.payload  # type: ignore[attr-defined]
        if header.schema in messages:
            messages[header.schema][header.frame] = header.time_ns, dict(body)

    InProcess(resolved, tap=tap).run()
    clusterer = SampledAssignmentClusterer()
    for frame, (time_ns, body) in sorted(messages["collated"].items()):
        states, names = ObjectStates.from_columns(body), tuple(map(str, body["agents"]))
        views = views_of(messages["views"][frame][1])
        states, views = stage.correct(time_ns, states, body["agent"], names, views)
        labels = clusterer.cluster(states, body["agent"])
        yield Batch(time_ns, states, body["agent"], labels, names, tuple(map(views.get, names)))


def fitted_tail(maxima: Floats, hours: float) -> Tail:
    """The exponential tail of the maxima of blocks, by maximum likelihood over a threshold.

    maxima: (n,) of a statistic in n blocks of honest agents, nearly independent; hours: their total length

    Raises ValueError if too few of them exceed the threshold.
    """
    threshold = np.quantile(maxima, 1.0 - LARGEST)
    excess = maxima[maxima > threshold] - threshold
    if len(excess) < 2:
        found = f"found {len(excess)} of {len(maxima)} above their {1.0 - LARGEST:.0%} quantile, {threshold:g}"
        raise ValueError(f"maxima: {found}, expected at least 2: use more blocks, or a statistic that varies more")
    scale = float(excess.mean())
    return Tail(float(len(excess) / hours * np.exp(threshold / scale)), scale)


def statistics(stage: SequentialConsistency, seed: int, scene_index: int, frames: int) -> dict[str, Floats]:
    """(blocks, k) maxima of each statistic in each block of an unattacked run, by its name."""
    rows = []
    for batch in unattacked(stage, seed, scene_index, frames):
        stage.assess(batch)
        rows.append(stage.calibrated)
    starts = np.arange(0, len(rows), BLOCK_FRAMES)
    return {name: np.maximum.reduceat(np.array([row[name] for row in rows]), starts) for name in rows[0]}


def losses(seed: int, scene_index: int, frames: int) -> Floats:
    """(n,) match losses with the ego of all agents of an unattacked run, in every tenth frame from the twentieth on."""
    stage = Made()
    found = [
        match_losses(batch, batch.agents.index(stage.ego), stage.area_m)
        for frame, batch in enumerate(unattacked(stage, seed, scene_index, frames))
        if frame >= FIRST_LOSS and frame % LOSS_PERIOD == 0
    ]
    return np.array([loss for each in found for loss in each.tolist() if not np.isnan(loss)])


def print_losses(runs: list[tuple[int, int]], frames: int) -> None:
    """Print the quantiles of the losses of some runs, (seed, scene), as Python."""
    found = np.concatenate([losses(seed, index, frames) for seed, index in runs])
    quantiles = np.quantile(found, (np.arange(QUANTILES) + 0.5) / QUANTILES)
    print(f"# {len(found)} losses, as {QUANTILES} quantiles")
    print(f"MATCH_LOSSES = ({', '.join(f'{value:.3f}' for value in quantiles)})")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("first", nargs="?", type=int, default=101)
    parser.add_argument("last", nargs="?", type=int, default=106)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--losses", action="store_true", help="print MATCH_LOSSES of `Made` instead of the tails")
    options = parser.parse_args()
    played = [(seed, index) for seed in range(options.first, options.last + 1) for index in SCENES]
    if options.losses:
        print_losses(played, options.frames)
        return
    runs = [statistics(SequentialConsistency(false_alarms_per_hour=1e-30), *run, options.frames) for run in played]
    random = np.random.default_rng(0)
    for name in runs[0]:
        maxima = [run[name].ravel() for run in runs]
        if np.quantile(np.concatenate(maxima), 1.0 - LARGEST) == 0.0:
            print(f"{name:14} seldom above 0, too seldom for a tail")
            continue
        hours = [len(run) * BLOCK_FRAMES / 36_000 for run in maxima]
        tail = fitted_tail(np.concatenate(maxima), sum(hours))
        draws = []
        for _ in range(RESAMPLES):
            rows = random.integers(0, len(runs), len(runs))
            again = fitted_tail(np.concatenate([maxima[row] for row in rows]), sum(hours[row] for row in rows))
            draws.append((again.per_hour, again.scale, again.value_at(0.1)))
        low, high = np.percentile(draws, [2.5, 97.5], axis=0)
        fits = (tail.per_hour, tail.scale, tail.value_at(0.1))
        for what, value, least, most in zip(("per hour", "scale", "at 0.1 an hour"), fits, low, high, strict=True):
            print(f"{name:14} {what:16} {value:10.3g}  95 % {least:.3g} to {most:.3g}  ({sum(hours):.1f} agent-hours)")


if __name__ == "__main__":
    main()

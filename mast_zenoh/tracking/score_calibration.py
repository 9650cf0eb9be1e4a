"""Calibrates detection scores from how long tracks last.

Scores are no probabilities: 0.3 may mean 90 % in one detector and 20 % in another. Only their order is used here, and
learnt how often a confirmed track lasts whose detections score like that. False detections last for a moment, objects
stay until they are out of view.
"""

from __future__ import annotations

import math
from itertools import islice

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.tracks import DUE, SCORE

#: s from a track's first to its last detection, at which it has survived one more stage; after the last it is
#: established.
STAGES_S = np.array([0.5, 1.0, 2.0])
#: Number of stages.
STAGES = len(STAGES_S)
#: Number of intervals of scores with equally many samples.
INTERVALS = 8
#: Weight of the survival rate of all scores, in samples of each interval.
PRIOR = 2.0
#: Number of samples that are remembered.
MEMORY = 512


class ScoreCalibration:
    """The probability that a confirmed track is an object, by the mean score of its detections and its age.

    A sample is a confirmed track in a stage of its age, with its mean score: it survives the stage, or its existence
    becomes unlikely before. The product of the remaining stages' survival rates is the probability of becoming
    established (product-limit estimate: Kaplan and Meier 1958, which also handles tracks that go out of view). The rate
    of each stage does not decrease with the score (isotonic regression: Zadrozny and Elkan 2002).

    Not every object becomes established. Those with the highest scores are taken to be objects, so that their rate is
    the one of objects, and the probability of being an object is the rate relative to it (learning from positive and
    unlabelled examples: Elkan and Noto 2008, sections 2 and 3). Scores that tell nothing thus change nothing.

    A track gives one sample per stage at most, so false detections that last for ever cannot outvote the others.
    """

    def __init__(self) -> None:
        self._score, self._stage = np.zeros(MEMORY), np.zeros(MEMORY, np.int64)
        self._survived = np.zeros(MEMORY, np.bool_)
        self._count = self._used = 0  # samples in all, and when the table was made
        self._table: Floats | None = None
        self._edges = np.zeros(0)

    def add(self, score: Floats, stage: Ints, survived: Bools) -> None:
        """Add n samples: mean score, stage from 0 and whether it was survived; the oldest ones are forgotten.

        Scores that are not finite are left out.
        """
        samples = zip(score.tolist(), stage.tolist(), survived.tolist(), strict=True)  # they are few
        for sample in islice((each for each in samples if math.isfinite(each[0])), MEMORY):
            place = self._count % MEMORY
            self._score[place], self._stage[place], self._survived[place] = sample
            self._count += 1
        if self._count - self._used >= max(INTERVALS, min(self._count, MEMORY) // 16):
            self._used = self._count
            self._tabulate()

    def probability(self, tracks: Floats) -> Floats | None:
        """(n,) probability that tracks (n, WIDTH) are objects, by mean score and stage; None: nothing is known yet."""
        return None if self._table is None else calibrated(tracks, STAGES_S, self._edges, self._table)

    def _tabulate(self) -> None:
        """Make the table (STAGES + 1, intervals) of probabilities and the inner edges of its intervals of scores."""
        n = min(self._count, MEMORY)
        ordered = np.sort(self._score[:n])
        edges = ordered[np.arange(INTERVALS) * n // INTERVALS]
        self._edges = edges[1:][edges[1:] > edges[:-1]]  # equal scores are in one interval
        samples = self._score[:n], self._stage[:n], self._survived[:n]
        self._table = survival_table(*samples, self._edges, STAGES, PRIOR)


@kernel
def survival_table(score: Floats, stage: Ints, survived: Bools, edges: Floats, stages: int, prior: float) -> Floats:
    """The table (stages + 1, intervals) of `ScoreCalibration` from n samples; established tracks are in the last row.

    edges: (intervals - 1,) inner edges of the intervals of scores; prior: PRIOR
    """
    width = len(edges) + 1
    cell = stage * width + edges.searchsorted(score, "right")
    samples = np.bincount(cell, minlength=stages * width).reshape(stages, width)
    lasting = np.bincount(cell, survived, minlength=stages * width).reshape(stages, width)
    mean = (lasting.sum(1, keepdims=True) + 1.0) / (samples.sum(1, keepdims=True) + 1.0)
    weight = samples + prior
    rate = np.array([isotonic(*row) for row in zip((lasting + prior * mean) / weight, weight, strict=True)])
    established = rate[::-1].cumprod(0)[::-1]
    probability = established / established[:, -1:]
    return np.concatenate([probability, probability[-1:]])  # established tracks keep that of the last stage


@kernel
def calibrated(tracks: Floats, stages: Floats, edges: Floats, table: Floats) -> Floats:
    """(n,) probabilities in a table (STAGES + 1, intervals), by the stages and the mean scores of tracks (n, WIDTH).

    stages: (STAGES,) s, STAGES_S; edges: (intervals - 1,) inner edges of the intervals. Established tracks are in the
    last row.
    """
    return np.asarray(table[stages.searchsorted(np.abs(tracks[:, DUE])), edges.searchsorted(tracks[:, SCORE], "right")])


def isotonic(value: Floats, weight: Floats) -> Floats:
    """The nondecreasing numbers (n,) that are nearest to `value`, in weighted least squares.

    By pooling adjacent violators (Ayer, Brunk, Ewing, Reid and Silverman 1955).
    """
    blocks: list[tuple[float, float, int]] = []  # mean, weight and number of values
    for mean, total in zip(value.tolist(), weight.tolist(), strict=True):
        size = 1
        while blocks and blocks[-1][0] >= mean:
            block_mean, block_weight, block_size = blocks.pop()
            mean = (block_mean * block_weight + mean * total) / (block_weight + total)
            total, size = block_weight + total, block_size + size
        blocks.append((mean, total, size))
    return np.repeat([mean for mean, _, _ in blocks], [size for _, _, size in blocks])

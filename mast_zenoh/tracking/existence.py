"""Existence probabilities of tracked objects, and what the scores of their detections tell.

Odds p / (1 - p), as in integrated probabilistic data association (Musicki, Evans, Stankovic, IEEE Transactions on
Automatic Control, 1994).

Scores are no probabilities: 0.3 may mean 90 % in one detector and 20 % in another. Only their order is used here, and
learnt how often a confirmed track lasts whose detections score like that. False detections last for a moment, objects
stay until they are out of view.
"""

from __future__ import annotations

import math
from itertools import islice
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.kalman import BOX
from mast_zenoh.tracking.tracks import (
    AGE,
    CONFIRMED,
    DUE,
    HITS,
    MISSES,
    ODDS,
    RECORD,
    ROW,
    SCORE,
    SPAN,
    XX,
    YAW_VARIANCE,
    YY,
    columns_of,
    planar,
)

#: Upper limit of the odds; keeps products of odds finite for any number of measurements.
MAX_ODDS = 1e12


@kernel
def begin_step(tracks: Floats, dt: float, yaw_drift: float, lifetime_s: float, memory_s: float) -> None:
    """Let the tracks coast for `dt` s: all of them but their mean and covariance.

    yaw_drift: rad^2/s, growth of the variance of a heading; lifetime_s: average time that an object exists
    memory_s: time constant of counts
    """
    tracks[:, ROW] = -1.0
    tracks[:, YAW_VARIANCE] += yaw_drift * dt
    tracks[:, AGE] += dt
    # p' = s p, in odds o = p / (1 - p): o' = s o / (1 + (1 - s) o), which bounds the odds by s / (1 - s).
    growth = math.exp(dt / lifetime_s)
    odds = tracks[:, ODDS]
    odds /= growth + (growth - 1.0) * odds
    tracks[:, RECORD] *= math.exp(-dt / memory_s)


@kernel
def detection_probability(tracks: Floats, prior: float, weight: float) -> Floats:
    """Detection probability (n,) of each object: its hit rate combined with a prior.

    prior: probability; weight: of the prior, in frames

    A miss is weak evidence against a rarely detected object. The result never exceeds the prior; otherwise one miss
    after a perfect hit rate would end a track.
    """
    hits = tracks[:, HITS]
    return np.asarray(np.minimum((hits + prior * weight) / (hits + tracks[:, MISSES] + weight), prior))


def update_detected(tracks: Floats, detected: Floats, log_ratio: Floats, most: float) -> None:
    """Update existence of measured tracks.

    log_ratio: (n,) ln of the density of the measurement over the density of clutter; most: upper limit of the odds
    """
    tracks[:, ODDS] = np.minimum(tracks[:, ODDS] * (detected * np.exp(log_ratio) + (1.0 - detected)), most)
    tracks[:, HITS] += 1.0


@kernel
def update_missed(tracks: Floats, detected: Floats, coasting: Ints, visible: Floats, birth: float) -> None:
    """Update existence of unmeasured tracks.

    coasting: (k,) their rows, ascending; visible: (k,) their visible fractions, 0 to 1. The odds of a
    confirmed track stay at least at `birth`, those of a new object, so that it can be recovered.
    """
    tracks[coasting, ODDS] *= 1.0 - detected[coasting] * visible
    tracks[coasting, MISSES] += visible
    tracks[:, ODDS] = np.maximum(tracks[:, ODDS], birth * tracks[:, CONFIRMED])


@kernel
def coasting_tracks(tracks: Floats, report_odds: float) -> tuple[Ints, Floats, Floats]:
    """Rows (k,) and boxes (k, 6) of the tracks without a measurement in this step; boxes of those that may occlude.

    report_odds: odds above which a confirmed track counts as an object
    """
    occluding = (tracks[:, CONFIRMED] > 0.0) & (tracks[:, ODDS] > report_odds)
    rows, boxes = (tracks[:, ROW] < 0.0).nonzero()[0], tracks[:, BOX]
    return rows, boxes[rows], boxes[occluding]


@kernel
def track_status(
    tracks: Floats,
    confirm: float,
    report: float,
    doubtful: float,
    max_age_s: float,
    max_variance: float,
    max_speed: float,
    max_reported_variance: float,
) -> tuple[Bools, Bools]:
    """Tracks (n,) to keep, and tracks (n,) to report.

    Confirms tracks with odds above `confirm`.

    report: odds above which a confirmed track is reported; doubtful: odds below which an unconfirmed one is dropped
    max_age_s: s without a measurement; max_variance, max_reported_variance: m^2, of the horizontal position, both axes
    together; max_speed: m/s
    """
    odds, confirmed = tracks[:, ODDS], tracks[:, CONFIRMED]
    np.maximum(confirmed, odds > confirm, out=confirmed)
    variance = tracks[:, XX] + tracks[:, YY]
    keep = odds >= doubtful * (1.0 - confirmed)
    keep &= tracks[:, AGE] <= max_age_s
    keep &= variance <= max_variance
    keep &= np.abs(planar(tracks[:, 6:8])) <= max_speed
    return keep, (confirmed > 0.0) & (odds > report) & (variance <= max_reported_variance)


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
SAMPLES_MEMORY = 512


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
        self._score, self._stage = np.zeros(SAMPLES_MEMORY), np.zeros(SAMPLES_MEMORY, np.int64)
        self._survived = np.zeros(SAMPLES_MEMORY, np.bool_)
        self._count = self._used = 0  # samples in all, and when the table was made
        self._table: Floats | None = None
        self._edges = np.zeros(0)

    def add(self, score: Floats, stage: Ints, survived: Bools) -> None:
        """Add n samples: mean score, stage from 0 and whether it was survived; the oldest ones are forgotten.

        Scores that are not finite are left out.
        """
        samples = zip(score.tolist(), stage.tolist(), survived.tolist(), strict=True)  # they are few
        for sample in islice((each for each in samples if math.isfinite(each[0])), SAMPLES_MEMORY):
            place = self._count % SAMPLES_MEMORY
            self._score[place], self._stage[place], self._survived[place] = sample
            self._count += 1
        if self._count - self._used >= max(INTERVALS, min(self._count, SAMPLES_MEMORY) // 16):
            self._used = self._count
            self._tabulate()

    def probability(self, tracks: Floats) -> Floats | None:
        """(n,) probability that tracks (n, WIDTH) are objects, by mean score and stage; None: nothing is known yet."""
        return None if self._table is None else calibrated(tracks, STAGES_S, self._edges, self._table)

    def _tabulate(self) -> None:
        """Make the table (STAGES + 1, intervals) of probabilities and the inner edges of its intervals of scores."""
        n = min(self._count, SAMPLES_MEMORY)
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


#: s, span of a new track at which its first stage ends.
FIRST_DUE = float(STAGES_S[0])
#: Score below which a confirmed track is doubtful as long as scores are taken for probabilities: of a real detector's
#: detections that score 0.2 to 0.25, 26 % are true, of those with 0.5 to 0.6, 92 %
#: (docs/explanation-tracking-and-fusion.md).
DOUBTFUL = 1.0 / 3.0
#: m/s, speed from which an established track is known to move. What never moves may be a lasting false detection.
MOVING = 2.0
#: Largest share of doubtful tracks among moving ones, relative to that among all, with which scores are believed.
BELIEVED_SHARE = 0.5
#: Largest share of doubtful tracks among established ones with which scores are believed.
BELIEVED_DOUBT = 0.8
#: Number of established tracks that are remembered, about.
ESTABLISHED_MEMORY = 256


def add_scores(tracks: Floats, score: Floats) -> None:
    """Add the scores (k,) of the measurements of k tracks to their means, and the time since the previous ones.

    Successive scores of one object are nearly the same, so that together they tell hardly more than one. Hence they
    are averaged, and not multiplied as likelihoods. The mean forgets as fast as the count of hits, which includes this
    measurement; AGE is still the time since the previous one.
    """
    mean = tracks[:, SCORE]
    mean += (score - mean) / tracks[:, HITS]
    tracks[:, SPAN] += tracks[:, AGE]


def tempered_probability(tracks: Floats) -> Floats:
    """(n,) probabilities of existence with discounted evidence, which rank tracks whose existence is certain.

    The odds of existence are as if detections in successive frames were independent. They are not: errors last. So
    their likelihoods count with an exponent (a power likelihood: Holmes and Walker, Biometrika 2017), which keeps the
    order. The exponent is the share of frames that are independent evidence: about one sample per second, ten frames
    (docs/explanation-metrics-and-causes.md). 1/8 is three square roots, which are equal to the last bit on any machine.
    """
    power = np.sqrt(np.sqrt(np.sqrt(tracks[:, ODDS])))
    return np.asarray(power / (1.0 + power))


class ScorePrior:
    """Takes scores for probabilities until there is evidence that they are none.

    Lasting alone does not tell an object from a lasting false detection, such as a pole; moving does. If the scores are
    probabilities, few of the tracks that move score low. They are believed while the share of low scores among moving
    tracks is at most half of that among all established tracks, and while most are not low. Scores outside 0 to 1 are
    never believed.
    """

    def __init__(self) -> None:
        self._counts = np.zeros((2, 2))  # established tracks, by whether they move, by whether they are doubtful
        self._in_range = True

    def see(self, score: Floats) -> None:
        """Learn the range of scores (m,) from detections."""
        if self._in_range and len(score):
            least, greatest = extremes(score)
            self._in_range = least >= 0.0 and greatest <= 1.0

    def add(self, tracks: Floats) -> None:
        """Learn from tracks (n, WIDTH) that have just been established."""
        cell = 2 * _moving(tracks) + (tracks[:, SCORE] < DOUBTFUL)
        self._counts += np.bincount(cell, minlength=4).reshape(2, 2)
        if self._counts.sum() > ESTABLISHED_MEMORY:
            self._counts *= 0.5

    @property
    def believed(self) -> bool:
        """Whether scores are taken for probabilities."""
        (n_certain, n_doubtful), (certain_moving, doubtful_moving) = self._counts.tolist()
        n_moving, n_doubtful = certain_moving + doubtful_moving, n_doubtful + doubtful_moving
        n = n_certain + certain_moving + n_doubtful
        expected = BELIEVED_SHARE * n_doubtful / max(n, 1.0) * n_moving
        return self._in_range and doubtful_moving <= expected + 1.0 and n_doubtful <= BELIEVED_DOUBT * n + 2.0

    def doubtful(self, tracks: Floats) -> Bools:
        """Which tracks (n, WIDTH) score too low to be reported: not if they are established and move."""
        low = tracks[:, SCORE] < DOUBTFUL
        if np.count_nonzero(low) == 0:
            return low
        return low & ~(established(tracks) & _moving(tracks)) if self.believed else np.zeros_like(low)


class ScoreEvidence:
    """What the scores of one source of detections tell about its tracks, by its own `ScoreCalibration`.

    Without differences between the scores, there is nothing to learn, and no score is doubtful.

    DUE is the span at which a track's stage ends, infinite for established tracks. It is negated once the track has
    failed. Then it gives no more samples, and if it is found again, its stage follows its span alone.
    """

    def __init__(self) -> None:
        self._calibration = ScoreCalibration()
        self._prior = ScorePrior()
        self._constant: float | None = None  # the only score so far
        self._varies = False

    def learn(self, tracks: Floats, score: Floats, report_odds: float) -> None:
        """Learn from the tracks (n, WIDTH) of a step, and set when the next stage of each is due.

        score: (m,) of the step's detections; report_odds: odds up to which a confirmed track counts as gone
        """
        self._prior.see(score)
        if not self._varies and len(score):
            if self._constant is None:
                self._constant = float(score[0])
            self._varies = bool(np.count_nonzero(score != self._constant))
        if not self._varies:
            return
        mean_score, stage, survived, newly_established = end_stages(tracks, report_odds, STAGES_S)
        if len(newly_established):
            self._prior.add(tracks[newly_established])
        if len(mean_score):
            self._calibration.add(mean_score, stage, survived)

    def probability(self, tracks: Floats) -> Floats | None:
        """(k,) probability that tracks (k, WIDTH) are objects, by their scores; None: the scores tell nothing."""
        return self._calibration.probability(tracks)

    def doubtful(self, tracks: Floats) -> Bools:
        """Which tracks (k, WIDTH) score too low to be reported: (k,), see `ScorePrior`."""
        return self._prior.doubtful(tracks) if self._varies else np.zeros(len(tracks), np.bool_)


def _moving(tracks: Floats) -> Bools:
    """Whether tracks (n, WIDTH) move: (n,)."""
    return np.asarray(np.abs(planar(tracks[:, 6:8])) > MOVING)


@kernel
def report_columns(tracks: Floats, weight: Floats, least: float) -> tuple[tuple[Any, ...], Ints]:
    """Columns of `ObjectStates`, and ROW, of the tracks (n, WIDTH) that are likely, or have survived all stages.

    weight: (n,) factors on the tempered probabilities, which give the scores, and on the probabilities of existence;
    the latter products must exceed `least`
    """
    odds = tracks[:, ODDS]
    likely = (odds / (1.0 + odds) * weight > least) | established(tracks)
    t = tracks[likely]
    return columns_of(t, tempered_probability(t) * weight[likely]), t[:, ROW].astype(np.int64)


def established(tracks: Floats) -> Bools:
    """Whether tracks (n, WIDTH) have survived all stages: (n,)."""
    return np.isinf(tracks[:, DUE])


@kernel
def end_stages(tracks: Floats, report_odds: float, stages: Floats) -> tuple[Floats, Ints, Bools, Ints]:
    """End the stages of tracks (n, WIDTH) that survive them or fail, and set when their next stages are due.

    report_odds: odds up to which a confirmed track counts as gone; stages: s, STAGES_S

    Returns the samples of `ScoreCalibration` (k,): scores, stages and whether they are survived, and the rows (m,) of
    the tracks that have just been established.
    """
    due = tracks[:, DUE]
    survived = tracks[:, SPAN] >= np.abs(due)
    failed = (tracks[:, ODDS] <= report_odds * tracks[:, CONFIRMED]) & (due > 0.0) & (due < np.inf)
    rows = (survived | failed).nonzero()[0]
    due, lasts = due[rows], survived[rows]
    stage = stages.searchsorted(np.abs(due))
    tracks[rows, DUE] = np.where(lasts, np.copysign(np.append(stages[1:], np.inf)[stage], due), -due)
    sample = (tracks[rows, CONFIRMED] > 0.0) & (due > 0.0)
    return tracks[rows[sample], SCORE], stage[sample], lasts[sample], rows[lasts & (due == stages[-1])]


@kernel
def extremes(values: Floats) -> tuple[float, float]:
    """The least and the greatest of n >= 1 values, NaN if one is."""
    return float(np.minimum.reduce(values)), float(np.maximum.reduce(values))

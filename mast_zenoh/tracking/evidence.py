"""How much evidence there is for tracks: the scores of their detections, and what their odds are worth."""

from __future__ import annotations

from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.score_calibration import STAGES_S, ScoreCalibration
from mast_zenoh.tracking.tracks import AGE, CONFIRMED, DUE, HITS, ODDS, ROW, SCORE, SPAN, columns_of, planar

#: s, span of a new track at which its first stage ends.
FIRST_DUE = float(STAGES_S[0])
#: Score below which a confirmed track is doubtful as long as scores are taken for probabilities: of a real detector's
#: detections that score 0.2 to 0.25, 26 % are true, of those with 0.5 to 0.6, 92 % (docs/tracking.md).
DOUBTFUL = 1.0 / 3.0
#: m/s, speed from which an established track is known to move. What never moves may be a lasting false detection.
MOVING = 2.0
#: Largest share of doubtful tracks among moving ones, relative to that among all, with which scores are believed.
BELIEVED_SHARE = 0.5
#: Largest share of doubtful tracks among established ones with which scores are believed.
BELIEVED_DOUBT = 0.8
#: Number of established tracks that are remembered, about.
MEMORY = 256


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
    (docs/metrics.md). 1/8 is three square roots, which are equal to the last bit on any machine.
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
        if self._counts.sum() > MEMORY:
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

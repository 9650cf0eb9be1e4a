"""How much evidence there is for tracks: the scores of their detections, and what their odds are worth."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.tracking.score_calibration import STAGES_S, ScoreCalibration
from mast_zenoh.tracking.tracks import AGE, CONFIRMED, DUE, HITS, ODDS, SCORE, SPAN

#: s, span of a new track at which its first stage ends.
FIRST_DUE = float(STAGES_S[0])
_NEXT_DUE = np.append(STAGES_S[1:], np.inf)


def add_scores(tracks: Floats, score: Floats) -> None:
    """Add the scores (k,) of the measurements of k tracks to their means, and the time since the previous ones.

    Successive scores of one object are nearly the same, so that together they tell hardly more than one. Hence they
    are averaged, and not multiplied as likelihoods. The mean forgets as fast as the count of hits, which includes this
    measurement; AGE is still the time since the previous one.
    """
    mean = tracks[:, SCORE]
    mean += (score - mean) / tracks[:, HITS]
    tracks[:, SPAN] += tracks[:, AGE]


def tempered_probability(odds: Floats) -> Floats:
    """(n,) probabilities of existence with discounted evidence, which rank tracks whose existence is certain.

    odds: (n,) of existence, as if detections in successive frames were independent. They are not: errors last. So their
    likelihoods count with an exponent (a power likelihood: Holmes and Walker, Biometrika 2017), which keeps the order.
    The exponent is the share of frames that are independent evidence: about one sample per second, ten frames
    (docs/metrics.md). 1/8 is three square roots, which are equal to the last bit on any machine.
    """
    power = np.sqrt(np.sqrt(np.sqrt(odds)))
    return np.asarray(power / (1.0 + power))


class ScoreEvidence:
    """What the scores of one source of detections tell about its tracks, by its own `ScoreCalibration`.

    Without differences between the scores, there is nothing to learn.

    DUE is the span at which a track's stage ends, infinite for established tracks. It is negated once the track has
    failed. Then it gives no more samples, and if it is found again, its stage follows its span alone.
    """

    def __init__(self) -> None:
        self._calibration = ScoreCalibration()
        self._constant: float | None = None  # the only score so far
        self._varies = False

    def learn(self, tracks: Floats, score: Floats, report_odds: float) -> None:
        """Learn from the tracks (n, WIDTH) of a step, and set when the next stage of each is due.

        score: (m,) of the step's detections; report_odds: odds up to which a confirmed track counts as gone
        """
        if not self._varies and len(score):
            if self._constant is None:
                self._constant = float(score[0])
            self._varies = bool(np.count_nonzero(score != self._constant))
        if not self._varies:
            return
        due = tracks[:, DUE]
        survived = tracks[:, SPAN] >= np.abs(due)
        failed = (tracks[:, ODDS] <= report_odds * tracks[:, CONFIRMED]) & (due > 0.0) & (due < np.inf)
        rows = (survived | failed).nonzero()[0]
        if len(rows):
            self._add(tracks, rows, survived)

    def _add(self, tracks: Floats, rows: Ints, survived: Bools) -> None:
        """Add samples of the tracks in `rows`, whose stage ends; survived: (n,) of all tracks."""
        stage, lasts, due = _stage(tracks[rows]), survived[rows], tracks[rows, DUE]
        tracks[rows, DUE] = np.where(lasts, np.copysign(_NEXT_DUE[stage], due), -due)
        sample = (tracks[rows, CONFIRMED] > 0.0) & (due > 0.0)
        self._calibration.add(tracks[rows[sample], SCORE], stage[sample], lasts[sample])

    def probability(self, tracks: Floats) -> Floats | None:
        """(k,) probability that tracks (k, WIDTH) are objects, by their scores; None: the scores tell nothing."""
        return self._calibration.probability(tracks[:, SCORE], _stage(tracks))


def established(tracks: Floats) -> Bools:
    """Whether tracks (n, WIDTH) have survived all stages: (n,)."""
    return np.isinf(tracks[:, DUE])


def _stage(tracks: Floats) -> Ints:
    """Stages (n,) of tracks (n, WIDTH), from 0."""
    return np.asarray(STAGES_S.searchsorted(np.abs(tracks[:, DUE])))

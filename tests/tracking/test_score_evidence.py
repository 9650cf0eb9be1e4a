"""Detectors whose false detections last and score lower than objects, on whatever scale."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.optimize import isotonic_regression
from tracked_objects import assert_same_bits, nanoseconds
from tracking_worlds import detected, joined, matched

from mast_zenoh.arrays.states import Detections, ObjectStates
from mast_zenoh.tracking import KalmanBoxTracker3D, tracks
from mast_zenoh.tracking.existence import (
    DOUBTFUL,
    FIRST_DUE,
    INTERVALS,
    MOVING,
    SAMPLES_MEMORY,
    STAGES,
    STAGES_S,
    ScoreCalibration,
    ScoreEvidence,
    ScorePrior,
    isotonic,
)

FRAMES, OBJECTS = 200, 12
Map = Callable[[np.ndarray], np.ndarray]
MAPS: dict[str, Map] = {
    "cubed": lambda score: score**3,
    "0.5 to 1": lambda score: 0.5 + 0.5 * score,
    "logits": lambda score: np.log(score / (1.0 - score)),
}


def logistic(value: np.ndarray) -> np.ndarray:
    return 1.0 / (1.0 + np.exp(-value))


def cars(frame: int) -> np.ndarray:
    """(OBJECTS, 2) m: half of them parked, half at 6 m/s."""
    x = np.linspace(-60.0, 60.0, OBJECTS)
    y = np.where(np.arange(OBJECTS) % 2, 30.0, -30.0)
    return np.column_stack([x + (np.arange(OBJECTS) % 2) * 0.6 * frame - 30.0 * (np.arange(OBJECTS) % 2), y])


def world(seed: int = 0, informative: bool = True) -> list[Detections]:
    """Detections by frame; false ones last 0.5 s on average and score 0.25, objects 0.65, with a wide spread."""
    random = np.random.default_rng(seed)
    offset = random.normal(0.6, 0.5, OBJECTS)
    place, worth = np.zeros((0, 2)), np.zeros(0)
    frames = []
    for frame in range(FRAMES):
        stays = random.random(len(worth)) < 0.8
        new = random.poisson(0.8)
        place = np.concatenate([place[stays], random.uniform(-80.0, 80.0, (new, 2))])
        worth = np.concatenate([worth[stays], random.normal(-1.2, 0.8, new)])
        seen = np.flatnonzero(random.random(OBJECTS) < 0.9)
        real = detected(cars(frame)[seen] + random.normal(0.0, 0.25, (len(seen), 2)))
        false = detected(place + random.normal(0.0, 0.2, place.shape))
        logit = np.concatenate([offset[seen] + random.normal(0.0, 0.5, len(seen)), worth])
        if not informative:
            logit = random.normal(0.0, 1.0, len(logit))
        frames.append(replace(joined(real, false), score=logistic(logit)))
    return frames


def errors(frames: list[Detections], scores: Map, tracker: KalmanBoxTracker3D | None = None) -> tuple[float, float]:
    """Misses and false tracks per frame, after the first 50."""
    tracker = tracker or KalmanBoxTracker3D()
    missed = false = 0
    for frame, detections in enumerate(frames):
        tracks = tracker.step(nanoseconds(frame), replace(detections, score=scores(detections.score)))
        if frame >= 50:
            pairs = len(matched(cars(frame), tracks))
            missed, false = missed + OBJECTS - pairs, false + len(tracks) - pairs
    return missed / (FRAMES - 50), false / (FRAMES - 50)


def constant(score: np.ndarray) -> np.ndarray:
    return np.full(len(score), 0.9)


@pytest.mark.parametrize("scores", MAPS.values(), ids=MAPS)
def test_false_detections_that_last_are_told_by_their_scores_on_any_scale(scores: Map) -> None:
    frames = world()
    without, with_scores = errors(frames, constant), errors(frames, scores)
    assert without[1] > 2.0
    assert with_scores[1] < 0.35 * without[1]
    assert with_scores[0] < without[0] + 0.3


def test_scores_beat_the_best_fixed_limit_of_the_detector() -> None:
    def below(limit: float) -> float:
        cut = [each.select(each.score >= limit) for each in frames]
        return sum(errors(cut, constant))

    frames = world(1)
    assert sum(errors(frames, np.copy)) < min(below(limit) for limit in (0.1, 0.2, 0.3, 0.4))


def test_scores_that_tell_nothing_change_almost_nothing() -> None:
    frames = world(2, informative=False)
    without, with_scores = errors(frames, constant), errors(frames, np.copy)
    assert with_scores[0] < without[0] + 0.3
    assert with_scores[1] <= without[1]


def states_of(frames: list[Detections], score: float) -> list[ObjectStates]:
    tracker = KalmanBoxTracker3D()
    return [
        tracker.step(nanoseconds(frame), replace(each, score=np.full(len(each), score)))
        for frame, each in enumerate(frames)
    ]


def test_constant_scores_change_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = world()[:80]
    high, low = states_of(frames, 1.0), states_of(frames, 0.1)
    monkeypatch.setattr(ScoreCalibration, "add", lambda *_: None)
    unscored = states_of(frames, 0.9)
    for one, other, third in zip(high, low, unscored, strict=True):
        assert_same_bits(one, other)
        assert_same_bits(one, third)


def test_a_false_detection_that_never_ends_does_not_make_others_with_its_score_credible() -> None:
    frames = world(3)
    bush = [replace(detected([[0.0, 0.0]]), score=np.array([0.15])) for _ in frames]
    tracker = KalmanBoxTracker3D()
    _, false = errors([joined(one, two) for one, two in zip(frames, bush, strict=True)], np.copy, tracker)
    probability = tracker._evidence._calibration.probability(rows([0.15, 0.9]))
    assert probability is not None
    assert probability[0] < 0.25
    assert probability[1] == 1.0
    assert false - 1.0 < 0.35 * errors(frames, constant)[1], "the bush itself is reported, as anything that lasts"


def rows(score: ArrayLike, stage: int = 0) -> np.ndarray:
    """Tracks with these mean scores (n,) in one stage."""
    table = tracks.empty(len(np.asarray(score)))
    table[:, tracks.SCORE], table[:, tracks.DUE] = score, [*STAGES_S, np.inf][stage]
    return table


def filled(random: np.random.Generator, n: int, score: np.ndarray | None = None) -> ScoreCalibration:
    calibration = ScoreCalibration()
    score = random.random(n) if score is None else score
    for begin in range(0, n, 10):
        part = slice(begin, begin + 10)
        survived = random.random(len(score[part])) < 0.1 + 0.8 * np.nan_to_num(score[part], posinf=0.0)
        calibration.add(score[part], random.integers(0, STAGES, len(score[part])), survived)
    return calibration


def test_the_probability_of_an_object_never_decreases_with_the_score_and_is_a_probability() -> None:
    for seed in range(20):
        calibration = filled(np.random.default_rng(seed), 40 * (1 + seed))
        for stage in range(STAGES + 1):
            probability = calibration.probability(rows(np.linspace(-1.0, 2.0, 99), stage))
            assert probability is not None
            assert (np.diff(probability) >= 0.0).all()
            assert (probability > 0.0).all()
            assert probability[-1] == 1.0


def test_any_numbers_are_survived_and_the_memory_is_bounded() -> None:
    random = np.random.default_rng(0)
    score = random.choice([np.nan, np.inf, -np.inf, 0.0, 1e300, -1e300, 5e-324], 4000)
    calibration = filled(random, 4000, score)
    probability = calibration.probability(rows(score[:50]))
    assert probability is not None
    assert np.isfinite(probability).all()
    assert len(calibration._score) == SAMPLES_MEMORY
    assert len(calibration._edges) < INTERVALS


def test_isotonic_regression_equals_that_of_scipy() -> None:
    random = np.random.default_rng(0)
    for n in (1, 2, 8, 30):
        value, weight = random.random(n), random.random(n) + 0.1
        np.testing.assert_allclose(isotonic(value, weight), isotonic_regression(value, weights=weight).x, atol=1e-12)


def test_a_track_that_is_lost_and_found_again_is_not_established_by_that() -> None:
    def learn(span_s: float, odds: float) -> float:
        """Its probability after a step."""
        track[:, tracks.SPAN], track[:, tracks.ODDS] = span_s, odds
        evidence.learn(track, np.array([0.2, 0.9]), 1.0)
        return expected(track)

    def expected(rows: np.ndarray) -> float:
        probability = evidence.probability(rows)
        assert probability is not None
        return float(probability[0])

    def of_stage(due_s: float) -> float:
        other = track.copy()
        other[:, tracks.DUE] = due_s
        return expected(other)

    evidence = ScoreEvidence()
    for stage in range(STAGES):
        score = np.repeat([0.2, 0.9], 40)
        evidence._calibration.add(score, np.full(80, stage), np.tile([True, False], 40) | (score > 0.5))
    track = tracks.empty(1)
    track[:, tracks.SCORE], track[:, tracks.DUE], track[:, tracks.CONFIRMED] = 0.2, FIRST_DUE, 1.0
    new = learn(0.3, 100.0)
    assert new < 0.5 * of_stage(np.inf)
    assert learn(0.3, 0.5) == new, "it fails"
    n_samples = evidence._calibration._count
    assert learn(0.4, 100.0) == new, "it is found again"
    assert learn(0.6, 100.0) == of_stage(STAGES_S[1])
    assert learn(1.1, 100.0) == of_stage(STAGES_S[2])
    assert learn(2.1, 100.0) == of_stage(np.inf)
    assert learn(2.1, 0.5) == of_stage(np.inf)
    assert evidence._calibration._count == n_samples, "one failure is one sample"


def test_no_stream_of_false_detections_hides_what_has_long_been_seen() -> None:
    """Ghosts that score like the parked cars, and end just before they would be established."""
    parked = np.array([[8.0 * k, 30.0] for k in range(12)])
    tracker, reported = KalmanBoxTracker3D(), []
    for frame in range(200):
        ghosts = (
            np.array([[8.0 * k, -40.0 - 8.0 * (frame // 18)] for k in range(12)]) if frame >= 30 else np.zeros((0, 2))
        )
        certain = np.array([[8.0 * k, 80.0 + 8.0 * (frame // 24)] for k in range(6)])
        scores = np.repeat([0.6, 0.6, 0.97], [len(parked), len(ghosts), len(certain)])
        places = np.concatenate([parked, ghosts, certain])
        tracks = tracker.step(nanoseconds(frame), replace(detected(places.tolist()), score=scores))
        reported.append(np.count_nonzero(np.abs(tracks.position[:, 1] - 30.0) < 1.0))
    assert min(reported[30:]) == len(parked)


def with_poles(frames: list[Detections], n: int = 12, least: float = 0.15, most: float = 0.3) -> list[Detections]:
    """With false detections at poles, which never end and score low."""
    random = np.random.default_rng(0)
    place, score = random.uniform(-70.0, 70.0, (n, 2)) * [1.0, 0.25], random.uniform(least, most, n)
    poles = [detected(place + random.normal(0.0, 0.1, place.shape)) for _ in frames]
    return [joined(one, replace(two, score=score)) for one, two in zip(frames, poles, strict=True)]


def test_false_detections_that_never_end_are_told_by_scores_that_are_probabilities() -> None:
    frames = with_poles(world())
    without, with_scores = errors(frames, constant), errors(frames, np.copy)
    assert without[1] > 12.0
    assert with_scores[1] < 0.2 * without[1]
    assert with_scores[0] < without[0] + 0.6


def test_scores_below_which_objects_move_are_not_taken_for_probabilities() -> None:
    """A detector whose objects score 0.02 to 0.3."""
    frames = world()
    without, with_scores = errors(frames, constant), errors(frames, lambda score: 0.3 * score)
    assert with_scores[0] < without[0] + 0.6


def tracks_of(score: float, speed_mps: float, n: int = 1) -> np.ndarray:
    table = tracks.empty(n)
    table[:, tracks.SCORE], table[:, 6], table[:, tracks.DUE] = score, speed_mps, np.inf
    return table


LOW, HIGH, STILL, FAST = 0.5 * DOUBTFUL, 0.9, 0.0, 2.0 * MOVING


def test_what_moves_is_reported_whatever_its_score_and_a_high_score_is_never_doubtful() -> None:
    prior = ScorePrior()
    cases = [(LOW, STILL), (LOW, FAST), (HIGH, STILL), (HIGH, FAST)]
    assert [bool(prior.doubtful(tracks_of(*case))[0]) for case in cases] == [True, False, False, False]


@pytest.mark.parametrize("score", [-0.1, 1.1, 80.0])
def test_scores_on_another_scale_are_no_probabilities(score: float) -> None:
    prior = ScorePrior()
    prior.see(np.array([0.2, score]))
    prior.see(np.array([0.2, 0.9]))
    assert not prior.believed
    assert not prior.doubtful(tracks_of(LOW, STILL)).any()


def test_scores_that_say_nothing_about_moving_tracks_are_no_probabilities() -> None:
    prior = ScorePrior()
    for _ in range(10):
        assert prior.believed or prior._counts.sum() > 8
        for case in ((LOW, STILL), (LOW, FAST), (HIGH, STILL), (HIGH, FAST)):
            prior.add(tracks_of(*case))
    assert not prior.believed


def test_lasting_false_detections_leave_the_scores_believed() -> None:
    prior = ScorePrior()
    for _ in range(40):
        prior.add(tracks_of(HIGH, STILL, 2))
        prior.add(tracks_of(HIGH, FAST))
        prior.add(tracks_of(LOW, STILL, 3))
    assert prior.believed
    assert prior._counts.sum() < 400, "the memory is bounded"

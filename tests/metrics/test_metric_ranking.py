"""AMOTA, sAMOTA and AMOTP: accuracy over recall, for tracks ranked by their scores."""

import numpy as np
import pytest

from mast_zenoh.metrics.ranking import LEVELS, ranked_accuracy

FRAMES = 20


def boxes(*tracks: tuple[int, int, float]) -> tuple[np.ndarray, ...]:
    """Tracks (object, track, score) that are in every frame with an error of 0.5 m; object -1: false."""
    rows = np.array([track for _ in range(FRAMES) for track in tracks])
    return rows[:, 0].astype(int), rows[:, 1].astype(int), rows[:, 2], np.full(len(rows), 0.5)


def plain(object_id, track_id, score, error_m, n_objects):
    """The equations of the paper, with loops."""
    mean = {track: np.mean(score[track_id == track]) for track in set(track_id.tolist())}
    amota = samota = 0.0
    motp = []
    for level in range(1, LEVELS + 1):
        r = level / LEVELS
        for limit in sorted(mean.values(), reverse=True):
            kept = [k for k in range(len(score)) if mean[track_id[k]] >= limit]
            pairs = [k for k in kept if object_id[k] >= 0]
            if len(pairs) >= r * n_objects - 1e-9:
                last, switches = {}, 0
                for k in pairs:
                    switches += last.get(object_id[k], track_id[k]) != track_id[k]
                    last[object_id[k]] = track_id[k]
                wrong = len(kept) - len(pairs) + n_objects - len(pairs) + switches
                amota += 1 - wrong / n_objects
                recall = len(pairs) / n_objects
                samota += max(0.0, 1 - (wrong - (1 - recall) * n_objects) / (recall * n_objects))
                motp.append(np.mean([error_m[k] for k in pairs]))
                break
    return amota / LEVELS, samota / LEVELS, np.mean(motp) if motp else None


def test_random_tracks_score_as_by_the_equations_of_the_paper() -> None:
    for seed in range(10):
        random = np.random.default_rng(seed)
        n = 60
        object_id, track_id = random.integers(-1, 5, n), random.integers(0, 9, n)
        score, error_m = random.random(n), random.random(n)
        result = ranked_accuracy(object_id, track_id, score, error_m, 55)
        expected = plain(object_id, track_id, score, error_m, 55)
        assert tuple(result.values()) == pytest.approx(expected, abs=1e-12)


def test_perfect_tracks_have_a_scaled_accuracy_of_one() -> None:
    result = ranked_accuracy(*boxes((1, 10, 0.9), (2, 20, 0.8)), 2 * FRAMES)
    assert result["samota"] == 1.0
    assert result["amotp_m"] == pytest.approx(0.5)
    # Half of the levels are reached with one object, half with both.
    assert result["amota"] == pytest.approx(0.75)


def test_a_false_track_with_a_low_score_costs_less_than_one_with_a_high_score() -> None:
    low = ranked_accuracy(*boxes((1, 10, 0.9), (2, 20, 0.8), (-1, 30, 0.1)), 2 * FRAMES)
    high = ranked_accuracy(*boxes((1, 10, 0.9), (2, 20, 0.8), (-1, 30, 1.0)), 2 * FRAMES)
    assert low["samota"] == 1.0
    assert high["samota"] is not None
    assert high["samota"] < 0.4


def test_scores_count_only_by_their_order() -> None:
    object_id, track_id, score, error_m = boxes((1, 10, 0.9), (2, 20, 0.8), (-1, 30, 0.85))
    one = ranked_accuracy(object_id, track_id, score, error_m, 2 * FRAMES)
    assert one == ranked_accuracy(object_id, track_id, score**5 - 3.0, error_m, 2 * FRAMES)


def test_levels_that_are_not_reached_count_as_zero() -> None:
    result = ranked_accuracy(*boxes((1, 10, 0.9)), 2 * FRAMES)
    assert result["samota"] == 0.5
    nothing = (np.zeros(0, int), np.zeros(0, int), np.zeros(0), np.zeros(0))
    assert ranked_accuracy(*nothing, 5) == {"amota": 0.0, "samota": 0.0, "amotp_m": None}
    assert ranked_accuracy(*boxes((-1, 10, 0.9)), 0) == {"amota": None, "samota": None, "amotp_m": None}

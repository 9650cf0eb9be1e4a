"""AMOTA, sAMOTA and AMOTP: accuracy over recall, for tracks ranked by their scores."""

import numpy as np
import pytest
from metric_worlds import PICTURE, cars, recorded

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.metrics import CenterDistanceAssigner, Scorer
from mast_zenoh.metrics.ranking import LEVELS, ranked_accuracy, rankings

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


def test_levels_that_are_not_reached_count_as_zero() -> None:
    result = ranked_accuracy(*boxes((1, 10, 0.9)), 2 * FRAMES)
    assert result["samota"] == 0.5
    nothing = (np.zeros(0, int), np.zeros(0, int), np.zeros(0), np.zeros(0))
    assert ranked_accuracy(*nothing, 5) == {"amota": 0.0, "samota": 0.0, "amotp_m": None}
    assert ranked_accuracy(*boxes((-1, 10, 0.9)), 0) == {"amota": None, "samota": None, "amotp_m": None}


def ranked(picture: list[ObjectStates], scored: slice, dimensions: int = 2) -> dict[str, float | None]:
    """The picture's ranking; one object stands at the origin in every frame."""
    record = recorded([cars((0.0, 0.0), id=[1])] * len(picture), {PICTURE: picture})
    scores = Scorer(assigner=CenterDistanceAssigner(dimensions=dimensions)).score(record)
    return rankings(scores, scored)[scores.every_series["ego", "picture"]]


@pytest.mark.parametrize("frame", [0, 5])
def test_false_tracks_of_frames_that_are_not_scored_do_not_count(frame: int) -> None:
    one, two = cars((0.0, 0.0), id=[7]), cars((0.0, 0.0), (30.0, 0.0), id=[7, 8])
    assert ranked([two if k == frame else one for k in range(6)], slice(1, 5))["samota"] == 1.0
    # Where the frame counts, it is one false box for six pairs with as high a score.
    assert ranked([two if k == frame else one for k in range(6)], slice(0, 6))["samota"] == pytest.approx(1 - 1 / 6)


def test_without_scored_frames_nothing_is_ranked() -> None:
    picture = [cars((30.0, 0.0), id=[8])] * 3
    assert ranked(picture, slice(0, 0)) == {"amota": None, "samota": None, "amotp_m": None}


@pytest.mark.parametrize(("dimensions", "expected"), [(2, 0.3), (3, 0.5)])
def test_the_error_of_pairs_has_the_dimensions_of_the_assignment(dimensions: int, expected: float) -> None:
    car = cars((0.3, 0.0), id=[7])
    raised = car.with_(position=cars((0.0, 0.0)).position + np.array([0.3, 0.0, 0.4]))
    assert ranked([raised] * 3, slice(0, 3), dimensions)["amotp_m"] == pytest.approx(expected)

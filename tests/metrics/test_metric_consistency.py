"""Whether estimates are as accurate as their covariances say: NEES, its bounds, and verdicts."""

import json
import math
from typing import Any

import numpy as np
import pytest
from metric_worlds import LOCAL, NOTHING, PICTURE, cars, recorded

from mast_zenoh.arrays.chi_square import mean_bounds
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.metrics import Consistency, Record, Scorer, Series
from mast_zenoh.metrics.consistency import MAX_NEES, nees
from mast_zenoh.metrics.pictures import consistency_of_pictures
from mast_zenoh.tracking import kalman, tracks

PERIOD_S = 0.1
OBJECTS, FRAMES = 20, 60


def filtered(seed: int, scale: float = 1.0) -> tuple[Floats, Ints]:
    """NEES of a Kalman filter whose model is true, and the objects; scale: factor on the covariances that it reports.

    Objects accelerate at random as the filter assumes, and are measured with the noise that it assumes.
    """
    random = np.random.default_rng(seed)
    Q = kalman.process_noise(PERIOD_S, np.full(7, 3.0), 0.2, 4e-4)
    root_q, P = np.linalg.cholesky(Q[0]), np.diag([0.16, 0.16, 0.04, 0.09, 0.09, 0.09, 9.0, 9.0, 0.25])
    R = np.diag([0.16, 0.16, 0.04, 0.09, 0.09, 0.09])
    table, truth = tracks.empty(OBJECTS), np.zeros((OBJECTS, 9))
    table[:, tracks.MEAN] = random.normal(size=(OBJECTS, 9)) @ np.linalg.cholesky(P).T
    table[:, tracks.COVARIANCE] = P.ravel()
    values = []
    for _ in range(FRAMES):
        kalman.predict(table, PERIOD_S, Q)
        truth[:, :3] += PERIOD_S * truth[:, 6:]
        truth += random.normal(size=(OBJECTS, 9)) @ root_q.T
        measured = truth[:, :6] + random.normal(size=(OBJECTS, 6)) @ np.sqrt(R)
        kalman.correct(table, measured, np.tile(R, (OBJECTS, 1, 1)))
        reported = scale * table[:, [tracks.XX, tracks.XY, tracks.YY]]
        values.append(nees(table[:, :2] - truth[:, :2], reported))
    return np.concatenate(values), np.tile(np.arange(OBJECTS), FRAMES)


def summary(values: Floats, objects: Ints, **settings: float) -> dict[str, Any]:
    return Consistency(**settings).nees_summary(values, objects, PERIOD_S)


def correlated(seed: int) -> tuple[Floats, Ints]:
    """NEES of a consistent estimate with exactly 1.1 independent samples per second and object."""
    samples = np.random.default_rng(seed).chisquare(2, (OBJECTS, 11))
    values = samples[:, np.arange(100) * 11 // 100]
    return values.ravel(), np.repeat(np.arange(OBJECTS), 100)


def share_inside(runs: list[dict[str, Any]]) -> list[float]:
    """Shares of the runs whose NEES is within its bounds, and whose two factors are 1 within their intervals."""
    inside = [run["low"] <= run["nees"] <= run["high"] for run in runs]
    factor = [run["factor_low"] <= 1.0 <= run["factor_high"] for run in runs]
    typical = [run["typical_low"] <= 1.0 <= run["typical_high"] for run in runs]
    return [float(np.mean(each)) for each in (inside, factor, typical)]


def test_an_estimate_that_is_consistent_by_construction_is_inside_the_bounds_in_about_95_percent_of_runs() -> None:
    runs = [summary(*correlated(seed)) for seed in range(300)]
    assert all(0.92 <= share <= 0.99 for share in share_inside(runs)), share_inside(runs)
    assert {run["verdict"] for run in runs} == {None}
    samples = [run["samples"] for run in runs]
    assert np.median(samples) > 180.0
    assert max(samples) <= 220.0001


def test_a_kalman_filter_whose_model_is_true_is_inside_the_bounds() -> None:
    runs = [summary(*filtered(seed)) for seed in range(40)]
    assert min(share_inside(runs)) >= 0.95, share_inside(runs)
    assert {run["verdict"] for run in runs} == {None}


@pytest.mark.parametrize(("scale", "factor", "verdict"), [(1 / 9, 3.0, "overconfident"), (9.0, 1 / 3, "overcautious")])
def test_scaled_covariances_are_reported_with_their_factor(scale: float, factor: float, verdict: str) -> None:
    for seed in range(5):
        found = summary(*filtered(seed, scale))
        assert found["factor"] == pytest.approx(factor, rel=0.1)
        assert found["typical_factor"] == pytest.approx(factor, rel=0.15)
        assert found["factor_low"] < factor < found["factor_high"]
        assert found["verdict"] == verdict


def test_one_object_that_another_track_matched_does_not_decide_the_verdict() -> None:
    values, objects = filtered(0)
    spoilt = np.where(objects == 3, values + 400.0, values)
    found = summary(spoilt, objects)
    assert found["factor_low"] > 2.0, "the mean is spoilt"
    assert found["typical_factor"] == pytest.approx(1.0, abs=0.2)
    assert found["verdict"] is None


def test_the_limit_is_a_setting() -> None:
    values, objects = filtered(0, 0.36)
    assert summary(values, objects)["verdict"] is None
    assert summary(values, objects, limit=1.2)["verdict"] == "overconfident"


def test_few_samples_give_no_verdict() -> None:
    values, objects = filtered(0, 1 / 100)
    one = objects == 0
    found = summary(values[one][:20], objects[one][:20])
    assert (found["typical_low"], found["typical_high"], found["verdict"]) == (None, None, None)
    assert found["samples"] == pytest.approx(1.1 * 2.0)


def test_frames_that_repeat_an_error_add_no_samples() -> None:
    values, objects = correlated(0)
    dense = Consistency().nees_summary(np.repeat(values, 4), np.repeat(objects, 4), PERIOD_S / 4)
    found = summary(values, objects)
    assert dense["pairs"] == 4 * found["pairs"]
    assert dense["samples"] == pytest.approx(found["samples"], rel=0.01)


def test_objects_that_come_out_differently_reduce_the_samples() -> None:
    """Half of the objects have a constant bias: their frames are not 1.1 samples per second."""
    values, objects = correlated(0)
    biased = np.where(objects % 2, values + 20.0, values)
    assert summary(biased, objects)["samples"] < 0.2 * summary(values, objects)["samples"]


def test_nees_equals_the_quadratic_form() -> None:
    random = np.random.default_rng(0)
    root = random.normal(size=(50, 2, 2))
    covariance = root @ root.transpose(0, 2, 1) + 1e-3 * np.eye(2)
    error = random.normal(size=(50, 2))
    expected = [e @ np.linalg.inv(P) @ e for e, P in zip(error, covariance, strict=True)]
    assert nees(error, covariance[:, [0, 0, 1], [0, 1, 1]]) == pytest.approx(expected)


def test_nees_is_undefined_without_a_usable_covariance_and_never_infinite() -> None:
    covariances = [[0, 0, 0], [1, 2, 1], [-1, 0, 1], [1, 0, -1], [math.nan, 0, 1], [1e-300, 0, 1e-300], [1, 0, 1]]
    values = nees(np.tile([3.0, 4.0], (7, 1)), np.array(covariances, float))
    assert np.isnan(values[:5]).all()
    assert values[5:].tolist() == [MAX_NEES, 25.0]


@pytest.mark.parametrize("samples", [5.0, 30.0, 260.5, 1e6])
def test_bounds_of_means_equal_those_of_scipy(samples: float) -> None:
    from scipy.stats import chi2

    expected = [chi2.ppf(p, 2 * samples) / samples for p in (0.025, 0.975)]
    assert mean_bounds(samples, 2) == pytest.approx(expected, rel=0.01)
    assert mean_bounds(0.0, 2) == (0.0, math.inf)


def states(position: Floats, velocity: Floats, variance: float) -> ObjectStates:
    return ObjectStates.of(
        np.column_stack([position, np.zeros(len(position))]),
        velocity=np.column_stack([velocity, np.zeros(len(position))]),
        size=np.tile([4.5, 1.8, 1.5], (len(position), 1)),
        covariance=np.tile(variance * np.eye(9), (len(position), 1, 1)),
    )


AGENTS = ("ego", "car", "pole")


def run_of(variance: float, frames: int = 60, missing: bool = False) -> tuple[Record, dict[str, Any]]:
    """A run of a car and two other agents; tracks have unit errors in x, and of 2 m/s in the velocity along y."""
    place = 20.0 * np.arange(4.0)[:, None] * np.array([1.0, 0.0])
    tracks_ = states(place + np.array([1.0, 0.0]), np.tile([0.0, 2.0], (4, 1)), variance)
    series = [(LOCAL, Series("ego", "received")), Series("car", "mission"), Series("pole", "mission"), PICTURE]
    estimates = dict.fromkeys(series, [NOTHING if missing else tracks_] * frames)
    truth = [states(place, np.zeros((4, 2)), 0.0)] * frames
    record = recorded(truth, estimates, agents=AGENTS, own=np.array([-1, 3, -1]))
    record.expect([LOCAL, PICTURE])
    return record, of_record(record)


def of_record(record: Record, scored: slice | None = None) -> dict[str, Any]:
    scores = Scorer().score(record)
    scored = slice(0, len(scores.frames)) if scored is None else scored
    found = Consistency().summary(scores.pairs, scores.series, ["ego"], scored, PERIOD_S)
    json.dumps(found, allow_nan=False)
    return found


def test_position_and_velocity_of_every_estimate_are_compared_over_matched_pairs() -> None:
    record, found = run_of(0.25)
    estimates = {agent: list(by) for agent, by in found.items()}
    assert estimates == {"ego": ["local", "picture"], "car": ["mission"], "pole": ["mission"]}
    for each in (found["ego"]["local"], found["ego"]["picture"], found["car"]["mission"]):
        assert each["position"]["nees"] == pytest.approx(4.0)
        assert each["velocity"]["nees"] == pytest.approx(16.0)
        assert (each["position"]["pairs"], each["position"]["objects"]) == (240, 4)
    assert of_record(record, slice(10, 20))["ego"]["local"]["position"]["pairs"] == 40


def test_false_tracks_do_not_count() -> None:
    local = states(np.array([[0.0, 0.0], [50.0, 0.0]]), np.zeros((2, 2)), 1e-6)
    record = recorded([cars((0.0, 0.0))] * 40, {LOCAL: [local] * 40})
    assert of_record(record)["ego"]["local"]["position"]["nees"] == 0.0


@pytest.mark.parametrize("variance", [0.0, -1.0])
def test_estimates_without_a_usable_covariance_are_counted_and_left_out(variance: float) -> None:
    found = run_of(variance)[1]["ego"]["local"]["position"]
    assert (found["pairs"], found["without_covariance"]) == (0, 240)
    assert (found["nees"], found["factor"], found["verdict"]) == (None, None, None)


def test_runs_without_frames_or_tracks_have_undefined_values() -> None:
    assert run_of(1.0, frames=0)[1]["ego"]["picture"]["position"]["nees"] is None
    found = run_of(1.0, missing=True)[1]["ego"]["picture"]["velocity"]
    assert (found["pairs"], found["nees"], found["samples"]) == (0, None, 0.0)


def test_pictures_of_agents_that_have_their_own_are_compared_one_by_one() -> None:
    """The ego's is consistent, the car's is too certain, and the pole's has no usable covariance."""
    random = np.random.default_rng(0)
    place, frames = 20.0 * np.arange(4.0)[:, None] * np.array([1.0, 0.0]), 60
    errors = random.normal(size=(frames // 10, 4, 2)).repeat(10, axis=0)  # about one independent sample per second
    variances = {"ego": 1.0, "car": 0.01, "pole": 0.0}
    estimates = {
        Series(agent, "picture"): [states(place + 0.5 * error, 0.5 * error, 0.25 * variance) for error in errors]
        for agent, variance in variances.items()
    }
    scores = Scorer().score(recorded([states(place, np.zeros((4, 2)), 0.0)] * frames, estimates, agents=AGENTS))
    part = consistency_of_pictures(
        Consistency().summary(scores.pairs, scores.series, AGENTS, slice(0, frames), PERIOD_S)
    )
    expected = (errors**2).sum(axis=2).mean()
    for quantity in ("position", "velocity"):
        found = part[quantity]
        assert list(found["agents"]) == ["ego", "car"], "of the pole, nothing can be said"
        assert found["agents"]["ego"]["nees"] == pytest.approx(expected)
        assert found["agents"]["car"]["nees"] == pytest.approx(100.0 * expected)
        assert found["nees"] == pytest.approx(50.5 * expected)
        assert (found["above"], found["below"]) == (["car"], [])


def test_agents_without_any_picture_have_no_mean_consistency() -> None:
    found = consistency_of_pictures({"ego": {"local": {}}})["position"]
    assert found == {"nees": None, "above": [], "below": [], "agents": {}}

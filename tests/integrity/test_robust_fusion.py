"""`RobustFusion`: outliers get no weight, and the rest follows the geometric median."""

from dataclasses import replace

import numpy as np
import pytest
from integrity_batches import Track, batch

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.fusion import CovarianceIntersectionFusion
from mast_zenoh.integrity import Batch, RobustFusion
from mast_zenoh.integrity.robust_fusion import leave_one_out, median_weights

AGENTS = ("a", "b", "c", "d")


def weights(stage: RobustFusion, each: Batch) -> np.ndarray:
    found = stage.assess(each).weights
    assert found is not None
    return found


def test_the_distance_is_that_from_the_mean_of_the_others() -> None:
    members = np.array([[True, True, True, False]])
    state = np.array([[[0.0, 0.0], [2.0, 0.0], [4.0, 0.0], [99.0, 99.0]]])
    covariance = np.tile(np.diag([2.0, 1.0]), (1, 4, 1, 1))
    # From the mean of two others: offset 3, variance 2 + (2 + 2) / 4 = 3; the middle one is at their mean.
    assert leave_one_out(members, state, covariance) == pytest.approx(np.array([[3.0, 0.0, 3.0, 0.0]]))


def test_the_weighted_mean_is_the_geometric_median() -> None:
    members = np.ones((1, 4), np.bool_)
    # The geometric median of a triangle's corners and a point inside is that point.
    position = np.array([[[0.0, 0.0], [4.0, 0.0], [2.0, 5.0], [2.0, 1.5]]])
    weight = median_weights(members, position)
    mean = (weight[..., None] * position).sum(axis=1) / weight.sum()
    assert mean == pytest.approx(np.array([[2.0, 1.5]]), abs=0.15), "up to the smoothing"


def test_the_one_of_three_that_is_far_off_is_left_out() -> None:
    tracks: list[Track] = [("a", 0, (0.0, 0.0)), ("b", 0, (0.2, 0.1)), ("c", 0, (1.9, 0.0))]
    found = weights(RobustFusion(gate=9.0), batch(tracks, AGENTS))
    assert (found > 0.0).tolist() == [True, True, False]
    honest: list[Track] = [("a", 0, (0.0, 0.0)), ("b", 0, (0.3, 0.2)), ("c", 0, (0.4, -0.3))]
    assert (weights(RobustFusion(gate=9.0), batch(honest, AGENTS)) > 0.0).all()


def test_a_false_velocity_is_left_out_though_the_position_fits() -> None:
    tracks: list[Track] = [("a", 0, (0.0, 0.0)), ("b", 0, (0.1, 0.0)), ("c", 0, (0.0, 0.1))]
    each = batch(tracks, AGENTS)
    velocity = each.states.velocity.copy()
    velocity[2] = (6.0, 0.0, 0.0)
    states = each.states.with_(velocity=velocity)
    found = weights(RobustFusion(), replace(each, states=states))
    assert (found > 0.0).tolist() == [True, True, False]


def test_a_track_that_claims_to_be_certain_does_not_decide() -> None:
    tracks: list[Track] = [("a", 0, (0.0, 0.0)), ("b", 0, (0.2, 0.0)), ("c", 0, (0.9, 0.0))]
    each = batch(tracks, AGENTS)
    covariance = each.states.covariance.copy()
    covariance[2] *= 1e-4
    states = each.states.with_(covariance=covariance)

    def fused(member_weights: np.ndarray | None) -> ObjectStates:
        return CovarianceIntersectionFusion().fuse(states, each.labels, member_weights)

    found = weights(RobustFusion(), replace(each, states=states))
    assert fused(None).position[0, 0] > 0.89
    assert found[2] > 0.0
    # Weiszfeld's weights are 5.0, 10 and 1.4; its information counts four times that of the others.
    assert fused(found).position[0, 0] < 0.4


def test_of_two_that_are_apart_the_better_record_is_kept() -> None:
    stage = RobustFusion(gate=5.0)
    dispute: list[Track] = [("a", 0, (0.0, 0.0)), ("c", 0, (1.9, 0.0))]
    assert (weights(stage, batch(dispute, AGENTS)) > 0.0).all(), "nobody has a record"
    others: list[Track] = [("a", 0, (0.0, 0.0)), ("b", 0, (0.1, 0.0)), ("c", 0, (1.9, 0.0)), ("d", 0, (0.0, 0.1))]
    for frame in range(1, 20):
        assert weights(stage, batch(others, AGENTS, frame=frame))[2] == 0.0
    assert (weights(stage, batch(dispute, AGENTS, frame=20)) > 0.0).tolist() == [True, False]


def test_a_dispute_of_two_is_in_nobodys_record() -> None:
    stage = RobustFusion(gate=5.0)
    for frame in range(20):
        assessment = stage.assess(batch([("a", 0, (0.0, 0.0)), ("c", 0, (1.9, 0.0))], AGENTS, frame=frame))
    assert assessment.agents.mean.tolist() == [0.5] * 4


def test_nothing_is_withheld_and_lone_tracks_keep_their_weight() -> None:
    assessment = RobustFusion().assess(batch([("a", 0, (0.0, 0.0)), ("b", 1, (9.0, 0.0))], AGENTS))
    assert not assessment.objects.withheld.any()
    assert assessment.weights is not None
    assert (assessment.weights > 0.0).all()


def test_an_impossible_covariance_breaks_nothing() -> None:
    each = batch([("a", 0, (0.0, 0.0)), ("b", 0, (0.1, 0.0)), ("c", 0, (0.0, 0.1))], AGENTS)
    for factor in (-1.0, 0.0, 1e30):
        covariance = each.states.covariance.copy()
        covariance[2] *= factor
        covariance[1] = -covariance[0] - np.diag([0.09, 0.09, 0, 0, 0, 0, 0.25, 0.25, 0.0])
        states = each.states.with_(covariance=covariance)
        found = weights(RobustFusion(), replace(each, states=states))
        assert np.isfinite(found).all(), factor
        assert (found >= 0.0).all(), factor

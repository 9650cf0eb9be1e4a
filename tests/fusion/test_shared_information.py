"""Which fusions are consistent when estimates share information, and which are too certain.

Normalised errors squared (NEES) of the full state, averaged over many trials, are compared with the two-sided 95 %
bounds of a chi-square distribution (Bar-Shalom, Li, Kirubarajan 2001, section 5.4). Covariance intersection and its
inverse promise a bound: their mean may be below, but not above.
"""

import numpy as np
import pytest

from mast_zenoh.arrays.chi_square import mean_bounds
from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.fusion import (
    CovarianceIntersectionFusion,
    Fusion,
    InverseCovarianceIntersectionFusion,
    NaiveKalmanFusion,
)
from mast_zenoh.tracking import kalman

TRIALS = 1000
CI, ICI, NAIVE = CovarianceIntersectionFusion, InverseCovarianceIntersectionFusion, NaiveKalmanFusion
CAUTIOUS = [CI(), CI(weights="optimised"), ICI(), ICI(weights="optimised")]


def of_vectors(vectors: Floats, covariance: Floats) -> ObjectStates:
    """Objects with states (n, 9) [x y z l w h vx vy vz]."""
    columns = dict(size=vectors[:, 3:6], velocity=vectors[:, 6:9], covariance=covariance)
    return ObjectStates.of(vectors[:, 0:3], id=np.arange(len(vectors)), **columns)


def vectors_of(states: ObjectStates) -> Floats:
    return np.concatenate([states.position, states.size, states.velocity], axis=1)


def covariances(random: np.random.Generator, n: int) -> Floats:
    root = random.normal(size=(n, 9, 9)) * random.uniform(0.3, 3.0, (n, 1, 9))
    return root @ root.mT + 0.05 * np.eye(9)


def drawn(random: np.random.Generator, covariance: Floats) -> Floats:
    """Errors (n, 9) with covariances (n, 9, 9)."""
    return (np.linalg.cholesky(covariance) @ random.normal(size=(len(covariance), 9, 1)))[:, :, 0]


def fuse(fusion: Fusion, estimates: list[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
    """Errors (n, 9) and covariances (n, 9, 9) of n trials, from those of each member."""
    n = len(estimates[0][0])
    errors, covariance = (np.concatenate(part) for part in zip(*estimates, strict=True))
    fused = fusion.fuse(of_vectors(errors, covariance), np.tile(np.arange(n), len(estimates)))
    return vectors_of(fused), fused.covariance


def mean_nees(estimate: tuple[Floats, Floats]) -> float:
    errors, covariance = estimate
    return float(np.vecdot(errors, np.linalg.solve(covariance, errors[:, :, None])[:, :, 0]).mean())


def sharing(random: np.random.Generator, members: int) -> list[tuple[Floats, Floats]]:
    """Estimates that are the same prior and independent measurements of the full state, each fused correctly."""
    prior = covariances(random, TRIALS)
    shared, result = drawn(random, prior), []
    for _ in range(members):
        own = covariances(random, TRIALS)
        fused = np.linalg.inv(np.linalg.inv(prior) + np.linalg.inv(own))
        vector = np.linalg.solve(prior, shared[:, :, None]) + np.linalg.solve(own, drawn(random, own)[:, :, None])
        result.append(((fused @ vector)[:, :, 0], fused))
    return result


LOW, HIGH = mean_bounds(TRIALS, 9)


@pytest.mark.parametrize("members", [2, 3, 6])
def test_of_members_with_a_common_prior_only_the_naive_fusion_is_too_certain(members):
    estimates = sharing(np.random.default_rng(members), members)
    assert LOW <= mean_nees(estimates[0]) <= HIGH  # a member is consistent itself
    for fusion in CAUTIOUS:
        assert mean_nees(fuse(fusion, estimates)) <= HIGH
    assert mean_nees(fuse(NAIVE(), estimates)) > HIGH


def test_of_independent_members_the_naive_fusion_is_consistent_and_the_others_are_cautious():
    random = np.random.default_rng(0)
    estimates = [(drawn(random, own), own) for own in (covariances(random, TRIALS) for _ in range(3))]
    assert LOW <= mean_nees(fuse(NAIVE(), estimates)) <= HIGH
    for fusion in CAUTIOUS:
        assert mean_nees(fuse(fusion, estimates)) < LOW


def test_inverse_intersection_of_members_with_a_common_prior_is_more_certain_than_covariance_intersection():
    estimates = sharing(np.random.default_rng(0), 2)
    one, other = (np.linalg.slogdet(fuse(fusion, estimates)[1])[1] for fusion in (CI(), ICI()))
    assert (other <= one + 1e-9).all()
    assert (one - other).mean() > 0.5


def largest_ratio(fusion: Fusion, A: Floats, B: Floats, cross: Floats) -> float:
    """The largest ratio of a variance to what the fusion claims, over all directions.

    A, B, cross: (9, 9) covariances of the errors of two members, and E[a b^T]
    """
    unit, none = np.eye(9), np.zeros((9, 9))
    covariance = np.tile(A, (9, 1, 1)), np.tile(B, (9, 1, 1))
    of_a, claimed = fuse(fusion, [(unit, covariance[0]), (none, covariance[1])])
    of_b, _ = fuse(fusion, [(none, covariance[0]), (unit, covariance[1])])
    K, L = of_a.T, of_b.T
    actual = K @ A @ K.T + L @ B @ L.T + K @ cross @ L.T + L @ cross.T @ K.T
    root = np.linalg.inv(np.linalg.cholesky(claimed[0]))
    return float(np.linalg.eigvalsh(root @ actual @ root.T).max())


def test_of_errors_that_are_correlated_otherwise_only_covariance_intersection_is_sure_to_be_consistent():
    """The errors of two members are the same nine random numbers, in other directions."""
    random, pairs = np.random.default_rng(0), []
    for _ in range(20):
        (A, B), turned = covariances(random, 2), np.linalg.qr(random.normal(size=(9, 9)))[0]
        pairs.append((A, B, np.linalg.cholesky(A) @ turned @ np.linalg.cholesky(B).T))
    for fusion in (CI(), CI(weights="optimised")):
        assert max(largest_ratio(fusion, *pair) for pair in pairs) <= 1.0 + 1e-9
    for fusion in (ICI(), ICI(weights="optimised"), NAIVE()):
        assert max(largest_ratio(fusion, *pair) for pair in pairs) > 1.3


def filters(std_a: float, std_b: float, frames: int = 50) -> tuple[Floats, Floats, Floats]:
    """Covariances of two filters of one car, and of both: they share its process noise, but no measurement.

    std_a, std_b: m, of their measurements of its position and size
    """
    step_s, H = 0.1, np.eye(6, 9)
    F = np.eye(9)
    F[:3, 6:] = step_s * np.eye(3)
    Q = kalman.process_noise(step_s, np.array([3.0]), 0.2, 4e-4)[0]
    P, cross = [np.diag([1.0] * 6 + [9.0] * 3)] * 2, np.zeros((9, 9))
    for _ in range(frames):
        rest = []
        for k, std in enumerate((std_a, std_b)):
            predicted = F @ P[k] @ F.T + Q
            gain = predicted @ H.T @ np.linalg.inv(H @ predicted @ H.T + std**2 * np.eye(6))
            rest.append(np.eye(9) - gain @ H)
            P[k] = rest[k] @ predicted
        cross = rest[0] @ (F @ cross @ F.T + Q) @ rest[1].T
    return 0.5 * (P[0] + P[0].T), 0.5 * (P[1] + P[1].T), cross


@pytest.mark.parametrize(("std_a", "std_b"), [(0.4, 0.4), (0.4, 1.0), (0.2, 1.5)])
def test_of_two_filters_of_one_object_only_the_naive_fusion_is_too_certain(std_a, std_b):
    """They share its process noise, which is no shared information, so inverse intersection promises nothing here."""
    for fusion in CAUTIOUS:
        assert largest_ratio(fusion, *filters(std_a, std_b)) <= 1.0 + 1e-6
    assert largest_ratio(NAIVE(), *filters(std_a, std_b)) > 1.5


def rumour_loop(fusion: Fusion, agents: int, rounds: int) -> tuple[Floats, Floats]:
    """The first agent's estimate, after each round of fusing its own with what its neighbour in a ring has sent.

    Nobody measures anything new: all information is in the first estimates, which are independent.
    """
    random = np.random.default_rng(agents)
    estimates = [(drawn(random, own), own) for own in (covariances(random, TRIALS) for _ in range(agents))]
    for _ in range(rounds):
        estimates = [fuse(fusion, [estimates[k], estimates[k - 1]]) for k in range(agents)]
    return estimates[0]


@pytest.mark.parametrize("agents", [2, 3, 5])
def test_a_rumour_that_circulates_makes_the_naive_fusion_certain_without_limit(agents):
    for fusion in (CI(), ICI()):
        assert mean_nees(rumour_loop(fusion, agents, 8)) <= HIGH
    few, many = (rumour_loop(NAIVE(), agents, rounds) for rounds in (2, 8))
    assert mean_nees(many) > 20.0 * mean_nees(few) > 20.0 * HIGH


def partly_shared(random: np.random.Generator, members: int, independent: float) -> list[tuple[Floats, Floats]]:
    """Estimates with a share `independent` of each covariance of their own; the rest is the same error in all."""
    common = drawn(random, np.broadcast_to(np.eye(9), (TRIALS, 9, 9)))
    result = []
    for _ in range(members):
        covariance = covariances(random, TRIALS)
        root = np.linalg.cholesky(covariance)
        errors = np.sqrt(1.0 - independent) * (root @ common[:, :, None])[:, :, 0]
        result.append((errors + np.sqrt(independent) * drawn(random, covariance), covariance))
    return result


@pytest.mark.parametrize("weights", ["uniform", "optimised"])
@pytest.mark.parametrize("independent", [0.3, 0.7])
@pytest.mark.parametrize("members", [2, 5])
def test_split_covariance_intersection_is_consistent_where_the_stated_share_is_independent(
    members, independent, weights
):
    estimates = partly_shared(np.random.default_rng(members), members, independent)
    split = fuse(CI(weights=weights, independent_share=independent), estimates)
    assert mean_nees(split) <= HIGH
    assert mean_nees(split) > mean_nees(fuse(CI(weights=weights), estimates)), "less cautious than for any correlation"
    assert mean_nees(fuse(NAIVE(), estimates)) > HIGH


def test_trust_counts_with_any_share():
    estimates = partly_shared(np.random.default_rng(0), 2, 0.5)
    states = of_vectors(*(np.concatenate(part) for part in zip(*estimates, strict=True)))
    labels, weights = np.tile(np.arange(TRIALS), 2), np.repeat([1.0, 1e-9], TRIALS)
    for share in (0.0, 0.5, 1.0):
        fused = CI(independent_share=share).fuse(states, labels, weights)
        assert np.allclose(vectors_of(fused), estimates[0][0], atol=1e-3)

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

TRIALS = 2000
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


def largest_ratio(fusion: Fusion, pairs: int = 20) -> float:
    """The largest ratio of a variance to what the fusion claims, over all directions, where all errors are common.

    The errors of two members are the same nine random numbers, in other directions.
    """
    random, ratio = np.random.default_rng(0), 0.0
    for _ in range(pairs):
        (A, B), turned = covariances(random, 2), np.linalg.qr(random.normal(size=(9, 9)))[0]
        roots = np.linalg.cholesky(A), np.linalg.cholesky(B) @ turned
        of_numbers, claimed = fuse(fusion, [(root.T, np.tile(root @ root.T, (9, 1, 1))) for root in roots])
        inverse_root = np.linalg.inv(np.linalg.cholesky(claimed[0]))
        actual = of_numbers.T @ of_numbers
        ratio = max(ratio, float(np.linalg.eigvalsh(inverse_root @ actual @ inverse_root.T).max()))
    return ratio


def test_of_errors_that_are_correlated_otherwise_only_covariance_intersection_is_sure_to_be_consistent():
    """The bound of covariance intersection holds in every direction, that of its inverse fails in some."""
    for fusion in (CI(), CI(weights="optimised")):
        assert largest_ratio(fusion) <= 1.0 + 1e-9
    for fusion in (ICI(), ICI(weights="optimised"), NAIVE()):
        assert largest_ratio(fusion) > 1.3


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

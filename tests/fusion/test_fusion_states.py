"""Fusing the members of clusters."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from mast_zenoh.arrays.states import CLASS_INDEX, ObjectStates, concatenate
from mast_zenoh.fusion import (
    BestMemberFusion,
    CovarianceIntersectionFusion,
    InverseCovarianceIntersectionFusion,
    NaiveKalmanFusion,
)

CI, ICI = CovarianceIntersectionFusion, InverseCovarianceIntersectionFusion
FUSIONS = [CI(), CI(weights="optimised"), ICI(), ICI(weights="optimised"), NaiveKalmanFusion(), BestMemberFusion()]


def members(n: int, seed: int = 0, spread: float = 1.0) -> ObjectStates:
    """n neighbouring states with covariances of all shapes."""
    random = np.random.default_rng(seed)
    root = random.normal(size=(n, 9, 9)) * spread * random.uniform(0.3, 3.0, (n, 1, 1))
    return ObjectStates.of(
        random.normal(size=(n, 3)),
        id=random.permutation(n),
        velocity=random.normal(size=(n, 3)),
        size=random.uniform(1, 5, (n, 3)),
        yaw=random.uniform(-0.3, 0.3, n),
        covariance=root @ root.transpose(0, 2, 1) + 0.1 * np.eye(9),
        score=random.uniform(0, 1, n),
        class_id=random.integers(0, 7, n).astype(np.uint8),
    )


def together(n: int) -> np.ndarray:
    return np.zeros(n, np.int64)


@pytest.mark.parametrize("fusion", FUSIONS)
def test_a_cluster_of_one_member_equals_that_member(fusion):
    one = members(1)
    fused = fusion.fuse(one, together(1))
    for name in ("position", "velocity", "size", "yaw", "covariance", "score"):
        np.testing.assert_allclose(getattr(fused, name), getattr(one, name), atol=1e-12)
    assert fused.id.tolist() == [0]


def test_uniform_weights_give_the_expected_formula():
    three = members(3)
    information = np.linalg.inv(three.covariance)
    P = np.linalg.inv(information.mean(axis=0))
    x = np.column_stack([three.position, three.size, three.velocity])
    mean = P @ np.einsum("nij,nj->i", information, x) / 3
    fused = CI().fuse(three, together(3))
    np.testing.assert_allclose(fused.covariance[0], P, atol=1e-9)
    np.testing.assert_allclose(fused.position[0], mean[:3], atol=1e-9)
    np.testing.assert_allclose(fused.size[0], mean[3:6], atol=1e-9)
    np.testing.assert_allclose(fused.velocity[0], mean[6:], atol=1e-9)


def least_log_volume(information: np.ndarray) -> float:
    """The least ln det of a covariance intersection of members with an information (n, 9, 9), by SciPy."""
    n = len(information)

    def log_volume(weight: np.ndarray) -> tuple[float, np.ndarray]:
        total = np.einsum("n,nij->ij", weight, information)
        return -np.linalg.slogdet(total)[1], -np.einsum("ij,nji->n", np.linalg.inv(total), information)

    def search(start: np.ndarray) -> float:
        simplex = {"type": "eq", "fun": lambda weight: weight.sum() - 1.0, "jac": np.ones_like}
        options = {"maxiter": 500, "ftol": 1e-12}
        return minimize(
            log_volume, start, jac=True, method="SLSQP", bounds=[(0, 1)] * n, constraints=simplex, options=options
        ).fun

    return min(search(start) for start in (np.full(n, 1.0 / n), *(0.1 / n + 0.9 * np.eye(n))))


@given(st.lists(st.tuples(st.integers(2, 6), st.integers(0, 10**6), st.booleans()), min_size=1, max_size=4))
def test_optimised_weights_give_a_volume_within_one_percent_of_the_least(clusters):
    """ln det is at most 0.01 above its optimum, for members alike and members of very different certainty."""
    parts, labels = [], []
    for label, (n, seed, extreme) in enumerate(clusters):
        part = members(n, seed)
        if extreme:
            scale = 10.0 ** np.random.default_rng(seed).uniform(-1.5, 1.5, (n, 9))
            part = part.with_(covariance=part.covariance * scale[:, :, None] * scale[:, None, :])
        parts.append(part)
        labels += [label] * n
    some = concatenate(parts)
    fused = CI(weights="optimised").fuse(some, np.array(labels))
    for label, part in enumerate(parts):
        least = least_log_volume(np.linalg.inv(part.covariance))
        assert np.linalg.slogdet(fused.covariance[label])[1] <= least + 0.01 + 1e-6


def test_optimised_weights_of_a_cluster_do_not_depend_on_larger_ones():
    five, many = members(5), members(70, seed=1)
    alone = CI(weights="optimised").fuse(five, together(5))
    both = CI(weights="optimised").fuse(concatenate([five, many]), np.repeat([0, 1], [5, 70]))
    np.testing.assert_allclose(both.covariance[0], alone.covariance[0], rtol=1e-9)
    equal = CI().fuse(many, together(70))
    np.testing.assert_allclose(both.covariance[1], equal.covariance[0], rtol=1e-9)


def test_optimised_weights_do_not_depend_on_units():
    """In millimetres the members have the same weights."""
    three, scale = members(3), np.repeat([1e3, 1.0, 1.0], 3)
    scaled = three.with_(position=1e3 * three.position, covariance=three.covariance * scale[:, None] * scale)
    fused, other = (CI(weights="optimised").fuse(each, together(3)) for each in (three, scaled))
    np.testing.assert_allclose(1e3 * fused.position, other.position, rtol=1e-6)


@given(st.integers(2, 5), st.integers(0, 1000), st.sampled_from(["uniform", "optimised"]))
def test_the_covariance_is_conservative_even_if_all_errors_are_shared(n, seed, weights):
    some = members(n, seed)
    # Fully correlated errors: e_i = root_i u. The fused error is P sum w_i P_i^-1 root_i u; the bound must cover it.
    fused = CI(weights=weights).fuse(some, together(n)).covariance[0]
    root = np.linalg.cholesky(some.covariance)
    shifted = some.with_(position=root[:, :3, 0], size=root[:, 3:6, 0], velocity=root[:, 6:, 0])
    error = CI(weights=weights).fuse(shifted, together(n))
    e = np.concatenate([error.position[0], error.size[0], error.velocity[0]])
    assert e @ np.linalg.solve(fused, e) <= 1.0 + 1e-9


@given(st.integers(1, 12), st.integers(0, 1000), st.sampled_from(FUSIONS), st.booleans())
def test_the_order_of_members_does_not_matter(n, seed, fusion, trusted):
    random = np.random.default_rng(seed)
    some, labels = members(n, seed), np.unique(random.integers(0, 4, n), return_inverse=True)[1]
    weights = random.choice([0.0, 0.5, 1.0], n) if trusted else None
    order = random.permutation(n)
    one = fusion.fuse(some, labels, weights)
    other = fusion.fuse(some.select(order), labels[order], None if weights is None else weights[order])
    for name, column in one.columns().items():
        assert column.tobytes() == other.columns()[name].tobytes()


@pytest.mark.parametrize("fusion", FUSIONS)
def test_clusters_do_not_affect_each_other(fusion):
    some = members(6)
    labels = np.array([0, 1, 0, 2, 1, 0])
    fused = fusion.fuse(some, labels)
    assert fused.id.tolist() == [0, 1, 2]
    for label in range(3):
        alone = fusion.fuse(some.select(labels == label), together(int(np.sum(labels == label))))
        np.testing.assert_allclose(fused.position[label], alone.position[0], atol=1e-9)


@pytest.mark.parametrize("fusion", FUSIONS)
def test_untrusted_members_are_left_out_and_so_are_clusters_without_trust(fusion):
    some = members(3)
    fused = fusion.fuse(some, np.array([0, 0, 1]), np.array([1.0, 0.0, 0.0]))
    assert fused.id.tolist() == [0]
    np.testing.assert_allclose(fused.position[0], some.position[0], atol=1e-12)


@pytest.mark.parametrize("fusion", FUSIONS)
def test_equal_trust_is_as_good_as_full_trust(fusion):
    some = members(4)
    full, half = (fusion.fuse(some, together(4), weights) for weights in (None, np.full(4, 0.5)))
    np.testing.assert_allclose(half.covariance, full.covariance, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(half.position, full.position, rtol=1e-9)


@pytest.mark.parametrize("fusion", [ICI(), NaiveKalmanFusion()])
def test_a_hardly_trusted_member_hardly_counts(fusion):
    pair = members(2)
    fused = fusion.fuse(pair, together(2), np.array([1.0, 1e-300]))
    np.testing.assert_allclose(fused.position[0], pair.position[0], atol=1e-3)


def test_inverse_covariance_intersection_equals_the_equations_of_its_paper():
    """Noack et al. 2017, with w = 1/2; members are in the order of x."""
    pair = members(2).with_(position=np.array([[0.0, 0.3, 0.1], [1.0, 0.0, 0.2]]))
    (A, B), (a, b) = pair.covariance, np.linalg.inv(pair.covariance)
    x_a, x_b = np.column_stack([pair.position, pair.size, pair.velocity])
    common = np.linalg.inv(0.5 * A + 0.5 * B)
    P = np.linalg.inv(a + b - common)
    mean = P @ (a - 0.5 * common) @ x_a + P @ (b - 0.5 * common) @ x_b
    fused = ICI().fuse(pair, together(2))
    np.testing.assert_allclose(fused.covariance[0], P, atol=1e-9)
    np.testing.assert_allclose(fused.position[0], mean[:3], atol=1e-9)
    np.testing.assert_allclose(fused.velocity[0], mean[6:], atol=1e-9)


@given(st.integers(2, 8), st.integers(0, 10**6))
def test_uniform_inverse_intersection_is_never_less_certain_than_covariance_intersection(n, seed):
    some = members(n, seed)
    cautious, fused = (fusion.fuse(some, together(n)).covariance[0] for fusion in (CI(), ICI()))
    root = np.linalg.inv(np.linalg.cholesky(cautious))
    assert np.linalg.eigvalsh(root @ fused @ root.T).max() <= 1.0 + 1e-9


@given(st.integers(0, 10**6))
def test_the_optimised_inverse_intersection_has_a_volume_within_one_percent_of_the_least(seed):
    pair = members(2, seed)
    A, B = pair.covariance

    w = np.linspace(0.0, 1.0, 201)[:, None, None]
    information = np.linalg.inv(A) + np.linalg.inv(B) - np.linalg.inv(w * A + (1.0 - w) * B)
    least = -np.linalg.slogdet(information)[1].max()
    fused = ICI(weights="optimised").fuse(pair, together(2))
    assert np.linalg.slogdet(fused.covariance[0])[1] <= least + 0.01


@given(st.integers(2, 6), st.integers(0, 10**6), st.sampled_from(["uniform", "optimised"]))
def test_inverse_intersection_is_positive_definite_and_between_the_naive_and_the_best_member(n, seed, weights):
    some = members(n, seed)
    scale = 10.0 ** np.random.default_rng(seed).uniform(-1.5, 1.5, (n, 9))
    some = some.with_(covariance=some.covariance * scale[:, :, None] * scale[:, None, :])
    fused = ICI(weights=weights).fuse(some, together(n)).covariance[0]
    naive = NaiveKalmanFusion().fuse(some, together(n)).covariance[0]
    root = np.linalg.inv(np.linalg.cholesky(naive))
    assert np.linalg.eigvalsh(root @ fused @ root.T).min() >= 1.0 - 1e-6  # never more certain than all information
    if weights == "optimised":
        assert np.linalg.slogdet(fused)[1] <= np.linalg.slogdet(some.covariance)[1].min() + 0.01 * n


def test_opposite_headings_share_an_axis_and_the_majority_sets_the_direction():
    three = members(3).with_(yaw=np.array([3.1, -3.1, 0.0]), covariance=np.tile(np.eye(9), (3, 1, 1)))
    assert abs(abs(CI().fuse(three, together(3)).yaw[0]) - np.pi) < 0.05


def test_the_class_is_the_majority_and_the_score_the_highest():
    car, truck = CLASS_INDEX["car"], CLASS_INDEX["truck"]
    three = members(3).with_(class_id=np.array([truck, car, car], np.uint8), score=np.array([0.9, 0.6, 0.7]))
    fused = CI().fuse(three, together(3))
    assert fused.class_id.tolist() == [car]
    assert fused.score.tolist() == [0.9]


def test_the_best_member_has_the_most_certain_position():
    three = members(3)
    three.covariance[:] = np.eye(9) * np.array([3.0, 1.0, 2.0])[:, None, None]
    np.testing.assert_array_equal(BestMemberFusion().fuse(three, together(3)).position[0], three.position[1])


@pytest.mark.parametrize("covariance", [np.zeros((9, 9)), -np.eye(9), np.full((9, 9), 1e300), np.eye(9) * 1e-300])
@pytest.mark.parametrize("fusion", FUSIONS)
def test_invalid_covariances_do_not_break_the_fusion(fusion, covariance):
    three = members(3)
    three.covariance[1] = covariance
    fused = fusion.fuse(three, together(3))
    assert all(np.isfinite(column).all() for column in fused.columns().values())


def test_no_members_fuse_to_no_states():
    for fusion in FUSIONS:
        assert len(fusion.fuse(ObjectStates.empty(), together(0))) == 0

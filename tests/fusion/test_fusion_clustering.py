"""Clusters are independent of order, with at most one track per agent."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays import matching
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.fusion import Clusterer, DBSCANClusterer, SampledAssignmentClusterer

#: (x, y, agent) of tracks on a coarse grid, so that distances tie.
tracks = st.lists(st.tuples(st.integers(0, 12), st.integers(0, 6), st.integers(0, 4)), max_size=25)
clusterers = st.sampled_from(
    [
        SampledAssignmentClusterer(),
        SampledAssignmentClusterer(assign_radius=0.7),
        DBSCANClusterer(),
        DBSCANClusterer(eps=1.2, min_samples=3),
    ]
)


def states(rows: list[tuple[float, float, int]]) -> tuple[ObjectStates, np.ndarray]:
    """Tracks at (x, y) and their agents; ids count up within an agent."""
    agent = np.array([row[2] for row in rows], np.int64)
    ids = np.array([np.sum(agent[:k] == agent[k]) for k in range(len(rows))], np.int64)
    position = np.array([[row[0] * 0.8, row[1] * 0.8, 0.0] for row in rows]).reshape(len(rows), 3)
    return ObjectStates.of(position, id=ids), agent


@given(tracks, clusterers, st.randoms(use_true_random=False))
def test_clusters_have_one_track_of_an_agent_are_numbered_by_their_first_and_do_not_depend_on_the_order(
    rows, clusterer, random
):
    objects, agent = states(rows)
    order = np.array(random.sample(range(len(rows)), len(rows)), int)
    labels = clusterer.cluster(objects, agent)
    np.testing.assert_array_equal(clusterer.cluster(objects.select(order), agent[order]), labels[order])
    assert len(set(zip(labels.tolist(), agent.tolist(), strict=True))) == len(rows)
    _, first = np.unique(labels[np.lexsort((objects.id, agent))], return_index=True)
    assert (np.diff(first) > 0).all()
    assert sorted(set(labels.tolist())) == list(range(len(first)))


def test_the_radius_limits_the_distance_between_centres():
    objects, agent = states([(0, 0, 0), (2, 0, 1), (4, 0, 2)])
    # 1.6 m apart each: the first two join, and their centre is 2.4 m from the third.
    assert SampledAssignmentClusterer(assign_radius=2.0).cluster(objects, agent).tolist() == [0, 0, 1]
    assert DBSCANClusterer(eps=2.0).cluster(objects, agent).tolist() == [0, 0, 0]


def test_a_sparse_point_does_not_connect_adjacent_dense_clusters():
    left, right = [(0.25 * k, 0, k) for k in range(4)], [(2.75 + 0.25 * k, 0, 5 + k) for k in range(4)]
    objects, agent = states([*left, *right, (1.75, 0, 10)])
    # The last is 0.8 m from both and is not a core point: it joins the first of the two.
    assert DBSCANClusterer(eps=0.85, min_samples=4).cluster(objects, agent).tolist() == [0] * 4 + [1] * 4 + [0]
    assert DBSCANClusterer(eps=0.85, min_samples=3).cluster(objects, agent).tolist() == [0] * 9


def nearest_first(objects: ObjectStates, agent: np.ndarray, radius: float) -> list[set[int]]:
    """`SampledAssignmentClusterer` as documented, one pair at a time."""
    order = np.lexsort((objects.id, agent))
    position, agent = objects.position[order, :2], agent[order]
    n = len(order)
    clusters = [{row} for row in range(n)]
    squared = ((position[:, None] - position[None]) ** 2).sum(axis=2)
    for nearness, i, j in sorted((squared[p, q], p, q) for p in range(n) for q in range(p + 1, n)):
        a, b = (next(one for one in clusters if row in one) for row in (i, j))
        apart = np.linalg.norm(position[list(a)].mean(axis=0) - position[list(b)].mean(axis=0))
        if nearness > radius**2 or a is b or apart > radius or {*agent[list(a)]} & {*agent[list(b)]}:
            continue
        clusters.remove(b)
        a |= b
    return sorted(({int(order[row]) for row in one} for one in clusters), key=min)


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 4), st.integers(0, 4)), max_size=14))
def test_pairs_are_joined_nearest_first(rows):
    objects, agent = states(rows)
    # Away from the radius by more than rounding errors, which depend on the order of sums.
    labels = SampledAssignmentClusterer(assign_radius=2.005).cluster(objects, agent)
    clusters = [{int(row) for row in np.flatnonzero(labels == label)} for label in range(labels.max(initial=-1) + 1)]
    assert sorted(clusters, key=min) == nearest_first(objects, agent, 2.005)


@pytest.mark.parametrize("clusterer", [SampledAssignmentClusterer(), DBSCANClusterer()])
def test_many_tracks_are_clustered_like_few(clusterer: Clusterer, monkeypatch: pytest.MonkeyPatch):
    random = np.random.default_rng(0)
    objects = ObjectStates.of(random.uniform(-40, 40, (400, 3)), id=np.arange(400) // 5)
    few = clusterer.cluster(objects, np.arange(400) % 5)
    monkeypatch.setattr(matching, "MAX_TABLE", 100)
    np.testing.assert_array_equal(clusterer.cluster(objects, np.arange(400) % 5), few)


@pytest.mark.parametrize("clusterer", [SampledAssignmentClusterer(), DBSCANClusterer()])
def test_thousands_of_tracks_at_one_position_are_clustered(clusterer: Clusterer):
    labels = clusterer.cluster(ObjectStates.of(np.zeros((5000, 3)), id=np.arange(5000) // 5), np.arange(5000) % 5)
    assert np.bincount(labels).max() <= 5


def test_an_invalid_radius_is_refused():
    with pytest.raises(ValueError, match="assign_radius: found 0"):
        SampledAssignmentClusterer(assign_radius=0.0)
    with pytest.raises(ValueError, match="eps"):
        DBSCANClusterer(eps=-1.0)


@given(
    st.lists(st.tuples(st.integers(-6, 6), st.integers(-3, 3), st.integers(0, 4)), max_size=25),
    st.sampled_from([0.0, 0.05, 0.3]),
    st.sampled_from([0.1, 1.0, 4.0]),
    st.integers(0, 99),
)
def test_isolated_groups_change_no_cluster(rows, noise_m, noise_mps, seed):
    """Rows are 2 m apart, as the radius is: at the borders of the grid's cells."""
    random = np.random.default_rng(seed)
    objects, agent = states([(x * 2.5, y * 2.5, source) for x, y, source in rows])
    shift, velocity = random.normal(size=(2, len(rows), 3))
    objects = objects.with_(position=objects.position + noise_m * shift, velocity=noise_mps * velocity)
    clusterer = SampledAssignmentClusterer()
    labels = clusterer.cluster(objects, agent)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "mast_zenoh.fusion.clustering.isolated_groups",
            lambda motion, agent, *bounds: (np.arange(len(agent)), np.zeros(len(agent), np.bool_)),
        )
        np.testing.assert_array_equal(clusterer.cluster(objects, agent), labels)
        patch.setattr(
            "mast_zenoh.fusion.clustering.merge_nearest",
            lambda motion, agent, *bounds: (np.arange(len(agent)), np.ones(len(agent), np.bool_)),
        )
        np.testing.assert_array_equal(clusterer.cluster(objects, agent), labels)


@pytest.mark.parametrize("scatter_m", [0.1, 0.3, 0.4])
def test_pairs_of_groups_apart_from_each_other_are_not_listed(monkeypatch: pytest.MonkeyPatch, scatter_m: float):
    random = np.random.default_rng(0)
    position = np.array([(20.0 * k, 0.0, 0.0) for k in range(50)])
    position = (position + random.normal(0.0, scatter_m, (100, 50, 3)) * [1.0, 1.0, 0.1]).reshape(-1, 3)
    objects = ObjectStates.of(position, id=np.tile(np.arange(50), 100))
    monkeypatch.setattr("mast_zenoh.fusion.clustering.pairs_near", None)
    labels = SampledAssignmentClusterer().cluster(objects, np.repeat(np.arange(100), 50))
    np.testing.assert_array_equal(labels, np.tile(np.arange(50), 100))

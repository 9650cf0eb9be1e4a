"""Agents that are not believed do not change the clusters of the others."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.fusion import SampledAssignmentClusterer
from mast_zenoh.fusion.clustering import believed_first


def tracks(random: np.random.Generator, n: int) -> tuple[ObjectStates, np.ndarray]:
    agent = random.integers(0, 4, n)
    position = np.column_stack([random.uniform(-8.0, 8.0, (n, 2)), np.zeros(n)])
    return ObjectStates.of(
        position, id=np.arange(n), size=np.ones((n, 3)), covariance=np.tile(np.eye(9), (n, 1, 1))
    ), agent


@given(st.integers(0, 2**32), st.integers(0, 30))
def test_clusters_of_believed_agents_are_as_if_the_others_were_not_there(seed: int, n: int) -> None:
    random = np.random.default_rng(seed)
    states, agent = tracks(random, n)
    believed = agent != 3
    clusterer = SampledAssignmentClusterer()
    labels = believed_first(clusterer, states, agent, believed)
    alone = clusterer.cluster(states.select(np.flatnonzero(believed)), agent[believed])
    together = labels[believed]
    assert ((together[:, None] == together) == (alone[:, None] == alone)).all()
    assert set(labels.tolist()) == set(range(len(set(labels.tolist()))))
    assert all(len(set(agent[labels == label].tolist())) == (labels == label).sum() for label in set(labels.tolist()))


@given(st.integers(0, 2**32), st.integers(1, 30))
def test_the_order_of_the_rows_does_not_matter(seed: int, n: int) -> None:
    random = np.random.default_rng(seed)
    states, agent = tracks(random, n)
    order = random.permutation(n)
    clusterer = SampledAssignmentClusterer()
    labels = believed_first(clusterer, states, agent, agent != 3)
    shuffled = believed_first(clusterer, states.select(order), agent[order], agent[order] != 3)
    assert shuffled.tolist() == labels[order].tolist()


def test_a_track_of_the_same_object_joins_its_cluster() -> None:
    position = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [9.0, 0.0, 0.0]])
    states = ObjectStates.of(position, id=np.arange(3), size=np.ones((3, 3)), covariance=np.tile(np.eye(9), (3, 1, 1)))
    labels = believed_first(SampledAssignmentClusterer(), states, np.array([0, 1, 1]), np.array([True, False, False]))
    assert labels.tolist() == [0, 0, 1]

"""Clusters have tracks that agree in position, height and velocity, as far as their covariances tell."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tracked_objects import INVALID_COVARIANCES, MATURE, STEP_S, cars, centre, nanoseconds

from mast_zenoh.arrays.states import ObjectStates, concatenate
from mast_zenoh.fusion import Clusterer, DBSCANClusterer, SampledAssignmentClusterer
from mast_zenoh.fusion.clustering import without_contradicted

CLUSTERERS = [SampledAssignmentClusterer(), DBSCANClusterer()]
#: Variances of a track that is three frames old.
YOUNG = np.diag([0.15, 0.15, 0.04, 0.05, 0.05, 0.05, 30.0, 4.0, 0.2])


def tracks(rows: list[tuple[float, float, float, float]], young: tuple[int, ...] = ()) -> ObjectStates:
    """Tracks of cars at (x, y, z) m with a speed along x, m/s."""
    values, covariance = np.array(rows), np.tile(MATURE, (len(rows), 1, 1))
    covariance[list(young)] = YOUNG
    velocity = np.column_stack([values[:, 3], np.zeros(len(rows))])
    return cars(values[:, :3], velocity, covariance, id=np.zeros(len(rows), np.int64))


def labels(clusterer: Clusterer, rows: list[tuple[float, float, float, float]], young: tuple[int, ...] = ()) -> list:
    """The clusters of tracks of one agent each."""
    return clusterer.cluster(tracks(rows, young), np.arange(len(rows))).tolist()


SAME_WAY, ONCOMING = (0, 0, 0.8, 12), (0.3, 1.6, 0.8, -12)
GATED = {
    "two levels of a bridge": ([(0, 0, 0.8, 10), (0.3, 0, 6.3, 10), (0.1, 0.2, 0.7, 10)], (), [0, 1, 0]),
    "vehicles that pass in opposite directions": ([SAME_WAY, ONCOMING, (0.1, 0.2, 0.8, 12)], (), [0, 1, 0]),
    "a track that has jumped to an oncoming vehicle, between the good ones": (
        [(0.5, 0, 0.8, 12), (0, 0, 0.8, -12), (1.0, 0, 0.8, -12), (0.2, 0.3, 0.8, -12)], (), [0, 1, 1, 1],
    ),
    "a young track that agrees with others than the nearest": (
        [SAME_WAY, (0.1, 0, 0.8, -9), (0.6, 0, 0.8, -12), (0.6, 0.2, 0.8, -12)], (1,), [0, 1, 1, 1],
    ),
    "an uncertain velocity": ([SAME_WAY, (0.2, 0, 0.8, 0)], (1,), [0, 0]),
    "a certain velocity": ([SAME_WAY, (0.2, 0, 0.8, 0)], (), [0, 1]),
}  # fmt: skip


@pytest.mark.parametrize("clusterer", CLUSTERERS)
@pytest.mark.parametrize(("rows", "young", "expected"), GATED.values(), ids=GATED)
def test_tracks_are_of_one_object_where_position_height_and_velocity_agree(clusterer, rows, young, expected):
    assert labels(clusterer, rows, young) == expected


@pytest.mark.parametrize("clusterer", CLUSTERERS)
def test_agents_with_a_small_pose_error_still_share_their_objects(clusterer):
    """A metre to the side, a quarter metre in height, and 3 degrees, which turn 15 m/s into 0.8 m/s across."""
    honest = tracks([(0, 0, 0.8, 15), (0.1, 0.2, 0.8, 15), (0.3, 1.0, 1.05, 15)])
    honest.velocity[2, 1] = 0.8
    assert clusterer.cluster(honest, np.arange(3)).tolist() == [0, 0, 0]


def test_the_gate_is_a_parameter():
    rows = [SAME_WAY, ONCOMING]
    assert labels(SampledAssignmentClusterer(gate=np.inf), rows) == [0, 0]
    assert labels(DBSCANClusterer(gate=np.inf), rows) == [0, 0]
    assert labels(SampledAssignmentClusterer(bias_mps=20.0), rows) == [0, 0]
    with pytest.raises(ValueError, match="bias_m: found 0"):
        SampledAssignmentClusterer(bias_m=0.0)
    with pytest.raises(ValueError, match="gate: found -1"):
        DBSCANClusterer(gate=-1)


@given(
    st.lists(st.tuples(*[st.integers(0, 4)] * 2, st.integers(0, 1), st.integers(-1, 1)), min_size=1, max_size=12),
    st.sampled_from(CLUSTERERS),
    st.randoms(use_true_random=False),
)
def test_members_agree_and_the_order_of_tracks_does_not_matter(rows, clusterer, random):
    states = tracks([(0.7 * x, 0.7 * y, 5.0 * z, 12.0 * v) for x, y, z, v in rows])
    agent = np.array([random.randrange(5) for _ in rows])
    states = states.with_(id=np.array([int(np.sum(agent[:k] == agent[k])) for k in range(len(rows))], np.int64))
    label = clusterer.cluster(states, agent)
    for one in np.unique(label):
        members = label == one
        assert len(set(agent[members].tolist())) == members.sum()
        place = states.position[members, :2]
        far = np.hypot(*(place[:, None] - place[None]).T).max()
        if far <= 2.0:
            assert np.ptp(states.position[members, 2]) == np.ptp(states.velocity[members, 0]) == 0.0
    order = np.array(random.sample(range(len(rows)), len(rows)), int)
    np.testing.assert_array_equal(clusterer.cluster(states.select(order), agent[order]), label[order])


@pytest.mark.parametrize("covariance", INVALID_COVARIANCES.values(), ids=INVALID_COVARIANCES)
@pytest.mark.parametrize("clusterer", CLUSTERERS)
def test_invalid_covariances_are_survived(clusterer, covariance):
    states = tracks([(0, 0, 0.8, 12), (0.3, 1.6, 0.8, -12), (0.1, 0.2, 0.8, 12)])
    states.covariance[1] = covariance
    assert clusterer.cluster(states, np.arange(3)).max() <= 1


@pytest.mark.parametrize("clusterer", CLUSTERERS)
def test_a_flood_of_tracks_that_contradict_each_other_is_clustered(clusterer):
    """Far from it, contradicting tracks remain apart."""
    random, n = np.random.default_rng(0), 3000
    flood = tracks([(*random.uniform(0, 2, 2), 0.8, v) for v in random.uniform(-30, 30, n)])
    pair = tracks([(100, 0, 0.8, 12), (100.2, 0, 0.8, -12)])
    states = concatenate([flood, pair]).with_(id=np.arange(n + 2))
    label = clusterer.cluster(states, np.append(np.arange(n) % 5, [0, 1]))
    assert np.bincount(label).max() <= 5
    assert label[-2] != label[-1]


def test_the_picture_keeps_vehicles_apart_that_pass_each_other():
    """Each is seen by two agents that do not see the other, 1.5 m beside it."""
    pipeline = centre()
    for frame in range(60):
        x = 12.0 * (STEP_S * frame - 3.0)
        states = tracks([(x, 0, 0.8, 12), (x + 0.2, 0.1, 0.8, 12), (-x, 1.5, 0.8, -12), (0.2 - x, 1.6, 0.8, -12)])
        picture, support = pipeline.step(nanoseconds(frame), states, np.arange(4), ("a", "b", "c", "d"))
        if frame >= 2:
            assert support.tolist() == [2, 2]
            assert picture.id.tolist() == [0, 1]
            assert sorted(np.round(picture.velocity[:, 0]).tolist()) == [-12.0, 12.0]


def test_a_track_that_jumps_to_an_oncoming_vehicle_is_neither_fused_nor_in_the_picture():
    pipeline = centre()
    for frame in range(40):
        x = -12.0 * STEP_S * frame
        states = tracks([(x, 0, 0.8, -12), (x + 0.2, 0.1, 0.8, -12), (x - 0.1, 0.1, 0.8, 12 if frame >= 20 else -12)])
        picture, support = pipeline.step(nanoseconds(frame), states, np.arange(3), ("a", "b", "c"))
        if frame >= 2:
            assert picture.id.tolist() == [0]
            assert support.tolist() == [2 if frame >= 20 else 3]
            assert picture.velocity[0, 0] == pytest.approx(-12.0, abs=0.1)


WRONG = [(0, 0, 0.8, -12), (0.3, 0, 0.8, -12), (0.1, 0, 0.8, 12)]


@pytest.mark.parametrize(
    ("rows", "agent", "label", "weights"),
    [
        (WRONG, [0, 1, 2], [0, 0, 1], [1, 1, 0]),
        ([WRONG[0], WRONG[2]], [0, 2], [0, 1], None),  # nothing says which is wrong
        (WRONG, [0, 1, 1], [0, 0, 1], None),  # agent 1 sees both
        ([(0, 0, 0.8, -12), (0.3, 0, 0.8, -12), (0.1, 1.6, 0.8, 12)], [0, 1, 2], [0, 0, 1], None),  # in the next lane
        ([(0, 0, 0.8, -12), (0.3, 0, 0.8, -12), (0.1, 0, 6.3, -12)], [0, 1, 2], [0, 0, 1], None),  # on the level above
        ([(0, 0, 0.8, -12), (0.1, 0, 0.8, -12), (0, 0.1, 2.4, 12)], [0, 1, 2], [0, 0, 1], None),  # on the deck above
        ([(0, 0, 0.8, -12), (0.3, 0, 0.8, -12), (0.1, 0, 0.8, -11)], [0, 1, 2], [0, 0, 1], None),  # no contradiction
    ],
)
def test_a_cluster_is_left_out_where_more_agents_report_another_object_at_its_place(rows, agent, label, weights):
    result = without_contradicted(tracks(rows), np.array(agent), np.array(label), None)
    assert result is weights if weights is None else result.tolist() == weights


def test_agents_that_are_not_trusted_contradict_nobody():
    """Two suspended agents against an honest one."""
    trust = np.array([0.0, 0.0, 1.0])
    result = without_contradicted(tracks(WRONG), np.arange(3), np.array([0, 0, 1]), trust)
    assert result.tolist() == [0.0, 0.0, 1.0]


def test_tracks_that_would_not_be_reported_contradict_nobody():
    """Otherwise two agents could remove what one reports, and have nothing reported in its place."""
    states = tracks(WRONG)
    vague = states.covariance.copy()
    vague[:2, :2, :2] = 0.8 * np.eye(2)
    assert without_contradicted(states.with_(covariance=vague), np.arange(3), np.array([0, 0, 1]), None) is None


def test_a_cluster_that_is_left_out_contradicts_no_other():
    """Three agents contradict two, which contradict one that is too far from the three."""
    rows = [(0, 0, 0.8, -12)] * 3 + [(0, 0.8, 0.8, 12)] * 2 + [(0, 1.6, 0.8, -12)]
    result = without_contradicted(tracks(rows), np.arange(6), np.array([5, 5, 5, 2, 2, 0]), None)
    assert result.tolist() == [1, 1, 1, 0, 0, 1]


@pytest.mark.parametrize("doubles", [10, 1020, 3000])
def test_many_doubles_by_one_agent_protect_neither_themselves_nor_others(doubles):
    """They are around two objects, each of which three honest agents report; another object has one false double."""
    objects = [(50.0 * k, 0, 0.8, -12) for k in range(3)]
    honest = [each for each in objects for _ in range(3)]
    false = [(50.0 * (k % 2), 0.001 * (k % 300), 0.8, 12) for k in range(doubles)] + [(100.0, 0, 0.8, 12)]
    agent = np.concatenate([np.tile(np.arange(3), 3), np.full(len(false), 3)])
    label = np.concatenate([np.repeat(np.arange(3), 3), np.arange(3, 3 + len(false))])
    result = without_contradicted(tracks(honest + false), agent, label, None)
    assert result.tolist() == [1.0] * 9 + [0.0] * len(false)


def test_of_many_larger_clusters_the_largest_are_compared():
    """Two agents put ten clusters around the false one of a third; four honest agents report the object."""
    false = [(0, 0.01 * k, 0.8, 12) for k in range(10) for _ in range(2)] + [(0, 0, 0.8, 12)]
    states = tracks([(0, 0, 0.8, -12)] * 4 + false)
    agent = np.array([0, 1, 2, 3, *[4, 5] * 10, 6])
    label = np.array([0] * 4 + [k for k in range(1, 11) for _ in range(2)] + [11])
    assert without_contradicted(states, agent, label, None).tolist() == [1.0] * 4 + [0.0] * 21


@given(
    st.lists(st.tuples(*[st.integers(0, 3)] * 2, st.sampled_from([-1, 1])), min_size=3, max_size=14),
    st.randoms(use_true_random=False),
)
def test_the_order_of_tracks_does_not_matter_for_contradictions(rows, random):
    states = tracks([(0.7 * x, 0.7 * y, 0.8, 12.0 * v) for x, y, v in rows])
    agent = np.array([random.randrange(6) for _ in rows])
    states = states.with_(id=np.array([int(np.sum(agent[:k] == agent[k])) for k in range(len(rows))], np.int64))
    label = SampledAssignmentClusterer().cluster(states, agent)
    order = np.array(random.sample(range(len(rows)), len(rows)), int)
    result = without_contradicted(states, agent, label, np.ones(len(rows)))
    other = without_contradicted(states.select(order), agent[order], label[order], np.ones(len(rows)))
    assert other.tolist() == result[order].tolist()

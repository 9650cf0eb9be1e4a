"""Matching against brute force, shapely and the Hungarian method; OSPA and GOSPA also against Stone Soup."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from metric_worlds import boxes, overlap
from scipy.optimize import linear_sum_assignment

from mast_zenoh.metrics import (
    Boxes,
    CenterDistanceAssigner,
    IoU3DGreedyAssigner,
    SetDistance,
    birdseye_intersection,
    iou_3d,
)
from mast_zenoh.metrics.assignment import find, occurs, pairs_within


def scattered(n: int, rng: np.random.Generator, spread: float, group=0) -> Boxes:
    position = np.column_stack([rng.uniform(0.0, spread, (n, 2)), rng.uniform(0.0, 1.0, n)])
    return boxes(position, rng.uniform(1.0, 6.0, (n, 3)), rng.uniform(-4.0, 4.0, n), group, rng.permutation(n))


@given(st.integers(0, 10**6))
def test_batched_matching_equals_the_hungarian_method_per_frame(seed):
    rng = np.random.default_rng(seed)
    frames, gate = 8, 2.0
    truth = Boxes.join([scattered(int(rng.integers(0, 25)), rng, 15.0, frame) for frame in range(frames)])
    tracks = Boxes.join([scattered(int(rng.integers(0, 25)), rng, 15.0, frame) for frame in range(frames)])
    pairs = CenterDistanceAssigner(gate_m=gate).assign(truth, tracks)
    for frame in range(frames):
        i, j = np.flatnonzero(truth.group == frame), np.flatnonzero(tracks.group == frame)
        cost = np.linalg.norm(truth.position[i][:, None, :2] - tracks.position[j][None, :, :2], axis=2)
        cost[cost > gate] = 1e4
        r, c = linear_sum_assignment(cost)
        expected = {(i[a], j[b]) for a, b in zip(r, c, strict=True) if cost[a, b] <= gate}
        assert {(a, b) for a, b in pairs.tolist() if truth.group[a] == frame} == expected


def test_in_three_dimensions_the_gate_and_the_distance_include_the_height():
    truth = boxes([[0.0, 0.0, 0.0], [0.5, 0.0, 5.0]])
    tracks = boxes([[0.5, 0.0, 0.2], [0.0, 0.0, 4.8], [9.0, 0.0, 0.0]])
    assert CenterDistanceAssigner(dimensions=3).assign(truth, tracks).tolist() == [[0, 0], [1, 1]]
    assert CenterDistanceAssigner().assign(truth, tracks).tolist() == [[0, 1], [1, 0]]
    assert len(CenterDistanceAssigner(dimensions=3).assign(truth, tracks.select(slice(2, 3)))) == 0


@pytest.mark.parametrize(
    ("truth", "tracks", "pairs"),
    [
        ([[0.0, 0.0]], [[2.0, 0.0]], [[0, 0]]),
        ([[0.0, 0.0]], [[2.0 + 1e-9, 0.0]], []),
        ([[0.0, 0.0], [1.9, 0.0]], [[0.1, 0.0], [-1.8, 0.0]], [[0, 1], [1, 0]]),
        ([[0.0, 0.0, 0.0]], [[0.0, 0.0, 50.0]], [[0, 0]]),
    ],
    ids=["the gate is inclusive", "farther", "two pairs instead of one nearer pair", "height does not count"],
)
def test_pairs_of_a_few_boxes(truth, tracks, pairs):
    assert CenterDistanceAssigner(gate_m=2.0).assign(boxes(truth), boxes(tracks)).tolist() == pairs


@pytest.mark.parametrize("assigner", [CenterDistanceAssigner(), IoU3DGreedyAssigner()])
def test_boxes_of_different_groups_are_never_paired_and_empty_sets_have_no_pairs(assigner):
    none, one = boxes(np.zeros((0, 3))), boxes([[0.0, 0.0]])
    for truth, tracks in ((one, boxes([[0.0, 0.0]], group=1)), (none, none), (none, one), (one, none)):
        assert assigner.assign(truth, tracks).shape == (0, 2)


@given(st.sampled_from([CenterDistanceAssigner(), IoU3DGreedyAssigner(threshold=0.1)]), st.integers(0, 10**6))
def test_the_order_of_the_rows_does_not_matter_even_with_ties(assigner, seed):
    rng = np.random.default_rng(seed)
    # A coarse grid makes equal distances and overlaps common.
    truth, tracks = (
        boxes(rng.integers(0, 4, (8, 2)).astype(float), group=rng.integers(0, 2, 8), id=rng.permutation(8))
        for _ in range(2)
    )
    p, q = rng.permutation(8), rng.permutation(8)
    straight = assigner.assign(truth, tracks)
    shuffled = assigner.assign(truth.select(p), tracks.select(q))
    assert {(a, b) for a, b in straight.tolist()} == {(p[a], q[b]) for a, b in shuffled.tolist()}


@given(st.integers(0, 10**6), st.sampled_from([0.0, 1e5]))
def test_overlap_agrees_with_shapely(seed, far):
    rng = np.random.default_rng(seed)
    a, b = scattered(6, rng, 5.0), scattered(6, rng, 5.0)
    a.position[:, :2] += far
    b.position[:, :2] += far
    areas = birdseye_intersection(a, b)
    volumes = iou_3d(a, b)
    for k in range(6):
        assert (areas[k], volumes[k]) == pytest.approx(overlap(a, k, b, k), abs=1e-6)


@given(st.integers(0, 7), st.integers(0, 7), st.integers(0, 10**6))
def test_the_greedy_assigner_takes_the_best_remaining_overlap(n, m, seed):
    rng = np.random.default_rng(seed)
    truth, tracks = scattered(n, rng, 5.0), scattered(m, rng, 5.0)
    left = {(i, j): overlap(truth, i, tracks, j)[1] for i in range(n) for j in range(m)}
    expected = set()
    while left:
        i, j = max(left, key=left.__getitem__)
        if left[i, j] < 0.1:
            break
        expected.add((i, j))
        left = {(a, b): value for (a, b), value in left.items() if a != i and b != j}
    assert {(a, b) for a, b in IoU3DGreedyAssigner(threshold=0.1).assign(truth, tracks).tolist()} == expected


@given(
    seed=st.integers(0, 10_000),
    radius=st.sampled_from([0.5, 5.0, 60.0]),
    spread=st.sampled_from([1.0, 50.0, 1e6]),
    far=st.booleans(),
)
def test_near_pairs_are_all_ordered_pairs_of_a_group_within_the_radius(seed, radius, spread, far) -> None:
    rng = np.random.default_rng(seed)
    sides = [boxes(rng.uniform(-spread, spread, (n, 2)), group=rng.integers(0, 4, n)) for n in rng.integers(0, 15, 2)]
    if far and len(sides[0]):
        sides[0].position[0, :2] = 1e9, -1e9
    i, j = pairs_within(*sides, radius)
    apart = np.linalg.norm(sides[0].position[:, None, :2] - sides[1].position[None, :, :2], axis=2)
    same = sides[0].group[:, None] == sides[1].group
    assert set(zip(*np.nonzero(same & (apart <= radius)), strict=True)) <= set(zip(i.tolist(), j.tolist(), strict=True))
    assert np.all(apart[i, j] <= radius * (1 + 1e-6) + 1e-5)
    assert same[i, j].all()
    assert np.array_equal(np.lexsort((j, i)), np.arange(len(i)))


@pytest.mark.parametrize("far", [1, 1 << 31, 1 << 61])
def test_find_returns_the_last_equal_row(far):
    random = np.random.default_rng(far)
    keys, among = ([random.integers(-3, 4, n) * far for _ in range(3)] for n in (200, 150))
    row = {key: k for k, key in enumerate(zip(*map(np.ndarray.tolist, among), strict=True))}
    expected = [row.get(key, -1) for key in zip(*map(np.ndarray.tolist, keys), strict=True)]
    assert max(expected) >= 0
    assert find(tuple(keys), tuple(among)).tolist() == expected
    assert occurs(tuple(keys), tuple(among)).tolist() == [each >= 0 for each in expected]


def by_brute_force(x: np.ndarray, y: np.ndarray, how: SetDistance) -> tuple[float, float]:
    """OSPA and GOSPA of (n, 2) and (m, 2), from the definitions."""
    x, y = sorted((x, y), key=len)
    m, n = len(x), len(y)
    if n == 0:
        return 0.0, 0.0
    cut = np.minimum(np.linalg.norm(x[:, None] - y[None], axis=2), how.c) ** how.p
    least = min(sum(cut[i, j] for i, j in enumerate(chosen)) for chosen in permutations(range(n), m))
    missing = how.c**how.p * (n - m)
    return ((least + missing) / n) ** (1 / how.p), (least + missing / how.alpha) ** (1 / how.p)


places = st.lists(st.tuples(st.integers(0, 12), st.integers(0, 6)), max_size=5)


@given(
    frames=st.lists(st.tuples(places, places), min_size=1, max_size=4),
    p=st.sampled_from([1.0, 1.5, 2.0]),
    c=st.sampled_from([1.5, 3.0, 8.0]),
    alpha=st.sampled_from([0.5, 1.0, 2.0]),
)
def test_the_distance_is_minimal_over_all_assignments(frames, p: float, c: float, alpha: float) -> None:
    how = SetDistance(c=c, p=p, alpha=alpha)
    sets = [[np.array(estimate, float).reshape(-1, 2) for estimate in frame] for frame in frames]
    sides = [
        boxes(
            np.concatenate([frame[k] for frame in sets]), group=np.repeat(range(len(sets)), [len(f[k]) for f in sets])
        )
        for k in (0, 1)
    ]
    estimate = np.column_stack(how.of(*sides, len(sets)))
    assert estimate == pytest.approx(np.array([by_brute_force(x, y, how) for x, y in sets]), abs=1e-6)


@pytest.mark.parametrize("p", [1.0, 2.0])
def test_distances_equal_stone_soups(p: float) -> None:
    """Stone Soup's OSPA assigns by d, not by d^p, so only p = 1 is compared."""
    ospa = pytest.importorskip("stonesoup.metricgenerator.ospametric", reason="Stone Soup is not installed")
    from stonesoup.types.state import State

    rng = np.random.default_rng(0)
    for _ in range(20):
        sets = [rng.uniform(0.0, 15.0, (rng.integers(1, 9), 2)) for _ in range(2)]
        states = [[State(place.reshape(2, 1), timestamp=0) for place in places] for places in sets]
        ours = SetDistance(c=4.0, p=p).of(boxes(sets[0]), boxes(sets[1]), 1)
        if p == 1.0:
            stone_soup = ospa.OSPAMetric(p=p, c=4.0).compute_OSPA_distance(*states[::-1])
            assert ours[0] == pytest.approx([stone_soup.value])
        stone_soup, _ = ospa.GOSPAMetric(p=p, c=4.0).compute_gospa_metric(*states[::-1])
        assert ours[1] == pytest.approx([stone_soup.value["distance"]])

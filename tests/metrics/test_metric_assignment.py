"""Matching against brute force, shapely and the Hungarian method."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
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
from mast_zenoh.metrics.boxes import find, occurs, pairs_within


def scattered(n: int, rng: np.random.Generator, spread: float, group=0) -> Boxes:
    position = np.column_stack([rng.uniform(0.0, spread, (n, 2)), rng.uniform(0.0, 1.0, n)])
    return boxes(position, rng.uniform(1.0, 6.0, (n, 3)), rng.uniform(-4.0, 4.0, n), group, rng.permutation(n))


@settings(max_examples=25)
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


@settings(max_examples=40)
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


@settings(max_examples=100)
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


@settings(max_examples=60)
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


@pytest.mark.parametrize(
    ("cls", "arguments", "problem"),
    [
        (CenterDistanceAssigner, {"gate_m": 0.0}, "gate_m: found 0"),
        (IoU3DGreedyAssigner, {"threshold": 1.5}, "threshold: found 1.5"),
        (CenterDistanceAssigner, {"dimensions": 1}, "dimensions: found 1, expected 2"),
        (SetDistance, {"dimensions": 1}, "dimensions: found 1, expected 2"),
        (SetDistance, {"c": 0.0}, "c: found 0"),
        (SetDistance, {"p": 0.5}, "p: found 0.5"),
        (SetDistance, {"alpha": 3.0}, "alpha: found 3"),
    ],
)
def test_invalid_limits_are_refused(cls, arguments, problem):
    with pytest.raises(ValueError, match=problem):
        cls(**arguments)


@settings(max_examples=100)
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

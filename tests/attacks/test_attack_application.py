"""Applying targets: insert in range, hide and displace the nearest, one to one, whatever the order of the rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from attack_worlds import ORIGIN, at, equal, world
from hypothesis import given, settings
from hypothesis import strategies as st

from mast_zenoh.attacks import ACTIONS, Targets, apply
from mast_zenoh.attacks.application import follow, nearest_first
from mast_zenoh.messages import SCHEMAS
from mast_zenoh.states import ObjectStates

NONE = ObjectStates.empty()


def targets(add=NONE, remove=NONE, move=NONE, offset=None) -> Targets:
    offset = np.zeros((len(move), 3)) if offset is None else np.asarray(offset, float)
    return Targets(add, remove, move, offset).numbered(0)


def test_no_targets_change_nothing():
    objects = world(6)
    tampering = apply(Targets.empty(), objects, ORIGIN)
    assert equal(tampering.applied_to(objects), objects)
    assert len(tampering.report) == 0


def test_false_objects_beyond_range_of_the_victim_wait():
    tampering = apply(targets(add=at((10.0, 0.0), (69.0, 0.0), (71.0, 0.0))), world(3), ORIGIN, max_range_m=70.0)
    assert tampering.added.position[:, 0].tolist() == [10.0, 69.0]
    assert len(tampering.targets.add) == 3


def test_false_objects_have_the_covariance_and_score_of_the_victims_typical_object():
    real = world(3).with_(
        score=np.array([0.6, 0.9, 0.7]), covariance=np.eye(9) * np.array([9.0, 1.0, 4.0])[:, None, None]
    )
    added = apply(targets(add=at((1.0, 1.0), (2.0, 2.0))), real, ORIGIN).added
    assert np.array_equal(added.covariance, np.tile(4.0 * np.eye(9), (2, 1, 1)))
    assert added.score.tolist() == [0.7, 0.7]


def test_false_objects_are_plausible_where_there_is_nothing_to_imitate():
    added = apply(targets(add=at((1.0, 1.0))), ObjectStates.empty(), ORIGIN).added
    assert np.all(np.linalg.eigvalsh(added.covariance) > 0.0)
    assert 0.5 < added.score[0] <= 1.0


def test_the_nearest_object_within_reach_vanishes():
    objects = at((0.0, 0.0), (4.0, 0.0), (20.0, 0.0))
    tampering = apply(targets(remove=at((3.0, 0.0), (27.0, 0.0))), objects, ORIGIN, assign_radius_m=6.0)
    assert tampering.keep.tolist() == [True, False, True]


def test_two_targets_never_take_the_same_object():
    objects = at((0.0, 0.0), (5.0, 0.0))
    tampering = apply(targets(remove=at((0.0, 1.0), (0.0, 2.0))), objects, ORIGIN)
    assert tampering.keep.tolist() == [False, False]


def test_an_object_is_either_hidden_or_displaced():
    objects = at((0.0, 0.0))
    tampering = apply(targets(remove=at((0.0, 1.0)), move=at((0.0, 0.5)), offset=[[5.0, 0.0, 0.0]]), objects, ORIGIN)
    assert tampering.keep.tolist() == [True]
    assert tampering.moved.position[0, :2].tolist() == [5.0, 0.0]


def test_a_displaced_object_keeps_all_but_its_position_and_its_target_stays_with_the_real_one():
    objects = world(4)
    goal = objects.select(slice(2, 3))
    tampering = apply(targets(move=goal, offset=[[0.0, 3.0, 0.0]]), objects, ORIGIN)
    seen = tampering.applied_to(objects)
    assert np.allclose(seen.position[2] - objects.position[2], [0.0, 3.0, 0.0])
    assert equal(seen.with_(position=objects.position), objects)
    assert np.array_equal(tampering.targets.move.position, goal.position)


def test_targets_follow_their_object_and_coast_without_one():
    believed = at((0.0, 0.0), (40.0, 0.0), velocity=np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]))
    objects = at((3.0, 0.0), velocity=np.array([[9.0, 1.0, 0.0]]))
    after = apply(targets(remove=believed), objects, ORIGIN).targets.remove
    assert after.position[:, 0].tolist() == [3.0, 40.0]
    assert after.velocity.tolist() == [[9.0, 1.0, 0.0], [2.0, 0.0, 0.0]]


def test_targets_learn_the_velocity_of_objects_that_show_none():
    held = targets(remove=at((0.0, 0.0)))
    for k in range(1, 40):
        objects = at((1.2 * k, 0.0))
        held, row, _ = follow(held.propagated(0.1), objects, elapsed_s=0.1)
        assert row.tolist() == [0]
    assert np.allclose(held.remove.velocity, [[12.0, 0.0, 0.0]], atol=0.1)


def test_the_report_says_what_was_done_before_and_after():
    objects = at((0.0, 0.0), (20.0, 0.0), velocity=np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]))
    wanted = targets(
        add=at((5.0, 5.0), velocity=np.array([[3.0, 0.0, 0.0]])),
        remove=at((0.0, 0.0)),
        move=at((20.0, 0.0)),
        offset=[[0.0, 4.0, 0.0]],
    )
    report = apply(wanted, objects, ORIGIN).report
    assert [ACTIONS[a] for a in report.action] == ["added", "removed", "moved"]
    assert report.target.tolist() == [0, 1, 2]
    assert report.before_position[:, :2].tolist() == [[0.0, 0.0], [0.0, 0.0], [20.0, 0.0]]
    assert report.after_position[:, :2].tolist() == [[5.0, 5.0], [0.0, 0.0], [20.0, 4.0]]
    assert report.velocity[:, 0].tolist() == [3.0, 1.0, 2.0]


def test_the_report_has_the_columns_of_its_message():
    report = apply(targets(add=at((5.0, 5.0))), world(2), ORIGIN).report
    columns = {column.name: column.dtype for column in SCHEMAS["attack_report"].columns}
    assert {name: str(column.dtype) for name, column in report.columns().items()} == columns


@settings(max_examples=100)
@given(st.integers(0, 15), st.integers(0, 6), st.integers(0, 6), st.randoms(use_true_random=False))
def test_what_is_seen_afterwards_does_not_depend_on_the_order_of_the_rows(n, n_remove, n_move, random):
    objects = world(n, seed=n, spread=6.0)
    wanted = replace(
        targets(
            add=world(3, seed=1), remove=world(n_remove, seed=2, spread=6.0), move=world(n_move, seed=3, spread=6.0)
        ),
        move_offset=np.arange(3.0 * n_move).reshape(n_move, 3),
    )
    order = np.array(random.sample(range(n), n), int)
    a, b = apply(wanted, objects, ORIGIN), apply(wanted, objects.select(order), ORIGIN)
    assert np.array_equal(a.keep[order], b.keep)
    assert np.array_equal(a.moved_index, order[b.moved_index])
    assert equal(a.moved, b.moved)
    assert equal(a.added, b.added)
    assert all(np.array_equal(a.report.columns()[name], column) for name, column in b.report.columns().items())
    assert equal(a.targets.remove, b.targets.remove)


@settings(max_examples=100)
@given(st.integers(0, 8), st.integers(0, 8), st.integers(0, 10**6))
def test_the_nearest_pair_left_is_always_joined_first(k, n, seed):
    rng = np.random.default_rng(seed)
    origin, goal = rng.uniform(0.0, 15.0, (k, 2)), rng.uniform(0.0, 15.0, (n, 2))
    distance = np.linalg.norm(origin[:, None] - goal[None], axis=2)
    left = {(i, j): distance[i, j] for i in range(k) for j in range(n) if distance[i, j] <= 6.0}
    expected = np.full(k, -1)
    while left:
        i, j = min(left, key=left.__getitem__)
        expected[i] = j
        left = {(a, b): d for (a, b), d in left.items() if a != i and b != j}
    assert nearest_first(origin, goal, 6.0).tolist() == expected.tolist()

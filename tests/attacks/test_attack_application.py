"""Insert, hide and displace targets in any row order, and report the changes."""

import numpy as np
import pytest
from attack_worlds import at, equal, world
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.attacks import ACTIONS, Targets, alter
from mast_zenoh.attacks.attack import carry_out

NONE = ObjectStates.empty()


def targets(add=NONE, remove=NONE, move=NONE, offset=None) -> Targets:
    offset = np.zeros((len(move), 3)) if offset is None else np.asarray(offset, float)
    return Targets(add, remove, move, offset).numbered(0)


def applied(requested: Targets, objects: ObjectStates, remove=(), move=(), order=None):
    """Apply to the objects in `order`; remove, move: the row of each target."""
    order = np.arange(len(objects)) if order is None else np.asarray(order, int)
    rows = (np.asarray(remove, np.int64), np.asarray(move, np.int64))
    return carry_out(requested, requested.add, objects.select(order), order, *rows)


def test_rows_of_targets_are_removed_and_targets_without_a_row_hide_nothing():
    objects = at((0.0, 0.0), (4.0, 0.0), (20.0, 0.0))
    tampering = applied(targets(remove=at((3.0, 0.0), (27.0, 0.0))), objects, remove=(1, -1))
    assert tampering.keep.tolist() == [True, False, True]


def test_a_displaced_object_changes_only_its_position_and_its_target_follows_the_real_one():
    objects = world(4)
    goal = objects.select(slice(2, 3))
    tampering = applied(targets(move=goal, offset=[[0.0, 3.0, 0.0]]), objects, move=(2,))
    seen = tampering.applied_to(objects)
    assert np.allclose(seen.position[2] - objects.position[2], [0.0, 3.0, 0.0])
    assert equal(seen.with_(position=objects.position), objects)
    assert np.array_equal(tampering.targets.move.position, goal.position)


def test_the_report_has_positions_before_and_after_each_change():
    objects = at((0.0, 0.0), (20.0, 0.0), velocity=np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]))
    requested = targets(
        add=at((5.0, 5.0), velocity=np.array([[3.0, 0.0, 0.0]])),
        remove=at((0.0, 0.0)),
        move=at((20.0, 0.0)),
        offset=[[0.0, 4.0, 0.0]],
    )
    report = applied(requested, objects, remove=(0,), move=(1,)).report
    assert [ACTIONS[a] for a in report.action] == ["inserted", "removed", "moved"]
    assert report.target.tolist() == [0, 1, 2]
    assert report.before_position[:, :2].tolist() == [[0.0, 0.0], [0.0, 0.0], [20.0, 0.0]]
    assert report.after_position[:, :2].tolist() == [[5.0, 5.0], [0.0, 0.0], [20.0, 4.0]]
    assert report.velocity[:, 0].tolist() == [3.0, 1.0, 2.0]


def test_an_attack_can_name_the_rows_that_it_hides_and_moves():
    objects = world(5)
    tampering = alter(objects, insert=at((1.0, 2.0)), hide=[3], move=[1], offset=np.array([[5.0, 0.0, 0.0]]))
    seen = tampering.applied_to(objects)
    assert seen.id.tolist()[:4] == objects.id[[0, 1, 2, 4]].tolist()
    assert np.allclose(seen.position[1] - objects.position[1], [5.0, 0.0, 0.0])
    assert seen.position[4, :2].tolist() == [1.0, 2.0]
    assert tampering.report.target.tolist() == [0, 1, 2]


def test_an_attack_can_change_sizes_headings_and_velocities_of_rows():
    objects = world(5)
    claims = objects.select(np.array([2, 0]))
    claims = claims.with_(size=0.6 * claims.size, yaw=claims.yaw + 1.0, velocity=claims.velocity + 2.0)
    tampering = alter(objects, hide=[3], move=[1], offset=np.array([[5.0, 0.0, 0.0]]), change=[2, 0], claims=claims)
    seen = tampering.applied_to(objects)
    assert seen.id.tolist() == objects.id[[0, 1, 2, 4]].tolist()
    for row, claim in ((2, 0), (0, 1)):
        for name in ("size", "yaw", "velocity", "position"):
            assert np.array_equal(getattr(seen, name)[row], getattr(claims, name)[claim])
    assert np.array_equal(seen.size[[1, 3]], objects.size[[1, 4]])
    assert [ACTIONS[action] for action in tampering.report.action] == ["removed", "moved", "altered", "altered"]
    assert tampering.report.target.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("rows", "wrong"),
    [
        (dict(change=[0, 1], claims=world(3)), r"claims.*3 states"),
        (dict(hide=[1], move=[1]), r"rows \[1, 1\]"),
    ],
)
def test_rows_that_do_not_fit_each_other_are_refused(rows, wrong):
    with pytest.raises(ValueError, match=wrong):
        alter(world(5), **rows)


@given(st.integers(2, 15), st.randoms(use_true_random=False))
def test_targets_refer_to_the_same_rows_in_any_order(n, random):
    message = world(n, seed=n)
    order = np.array(random.sample(range(n), n), int)
    requested = targets(remove=world(1), move=world(1), offset=[[1.0, 2.0, 0.0]])
    tampering = applied(requested, message, remove=(0,), move=(1,), order=order)
    assert np.flatnonzero(~tampering.keep).tolist() == [order[0]]
    assert tampering.moved_index.tolist() == [order[1]]
    assert np.allclose(tampering.moved.position - message.position[order[1]], [1.0, 2.0, 0.0])

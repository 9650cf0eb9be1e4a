"""Statistics of what adversaries select, independent of the object order."""

from dataclasses import replace

import numpy as np
import pytest
from attack_worlds import ORIGIN, at, coverage_of, equal, world
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays.states import ObjectStates, concatenate
from mast_zenoh.attacks import Selection, UncoordinatedSelection
from mast_zenoh.attacks.selection import CoordinatedSelection, cluster_centres, ground_height
from mast_zenoh.streams import stream

TRIALS = 2000


def draws(selection: Selection, objects: ObjectStates, agents=ORIGIN, trials: int = TRIALS):
    return [selection.select(objects, coverage_of(agents), stream(7, "adversary", trial)) for trial in range(trials)]


def test_the_number_of_false_objects_is_poisson_distributed():
    counts = np.array([len(t.add) for t in draws(UncoordinatedSelection(region="paper"), world(10))])
    assert counts.mean() == pytest.approx(5.0, abs=4 * np.sqrt(5.0 / TRIALS))
    assert counts.var() == pytest.approx(5.0, rel=0.15)


@pytest.mark.parametrize("selection", [UncoordinatedSelection, CoordinatedSelection])
def test_an_exact_number_of_false_objects_is_rounded_and_not_drawn(selection: type[UncoordinatedSelection]) -> None:
    exact = selection(region="paper", n_false_positives=8.6, exact_number=True)
    assert {len(targets.add) for targets in draws(exact, world(10), trials=50)} == {9}


def test_false_objects_are_spread_around_the_victim_and_move_along_their_heading():
    victim = np.array([200.0, -100.0, 15.0])
    selection = UncoordinatedSelection(
        region="paper", position_std_m=30.0, velocity_std_mps=10.0, max_distance_m=1000.0
    )
    some = draws(selection, world(10), victim)
    false = concatenate([t.add for t in some])
    assert np.allclose(false.position[:, :2].mean(axis=0), victim[:2], atol=1.5)
    assert np.allclose(false.position[:, :2].std(axis=0), 30.0, rtol=0.05)
    assert np.allclose(false.velocity[:, :2].std(axis=0), 10.0, rtol=0.05)
    assert np.all(false.velocity[:, 2] == 0.0)
    assert np.array_equal(false.yaw, np.arctan2(false.velocity[:, 1], false.velocity[:, 0]))


def test_coordinated_false_objects_of_the_paper_are_near_any_agent_that_the_coordinator_knows():
    coverage = replace(coverage_of(ORIGIN), agents=np.array([[0.0, 0.0, 0.0], [1000.0, 0.0, 0.0]]))
    selection = CoordinatedSelection(region="paper")
    false = concatenate([selection.select(world(10), coverage, stream(7, trial)).add for trial in range(300)])
    near_other = np.hypot(false.position[:, 0] - 1000.0, false.position[:, 1]) <= 70.0
    near_victim = np.hypot(false.position[:, 0], false.position[:, 1]) <= 70.0
    assert (near_other | near_victim).all()
    assert near_other.mean() == pytest.approx(0.5, abs=0.06)


def test_false_objects_are_on_the_same_ground_as_real_ones():
    hill = world(9)
    hill = hill.with_(position=hill.position + np.array([0.0, 0.0, 250.0]))
    targets = UncoordinatedSelection(n_false_positives=20.0, box=(4.0, 2.0, 1.6)).select(
        hill, coverage_of(ORIGIN), stream(1)
    )
    assert np.allclose(targets.add.position[:, 2], 250.0 + 0.8)
    assert ground_height(ObjectStates.empty()) == 0.0


@pytest.mark.parametrize(
    ("n", "fraction", "expected"),
    [(10, 0.2, 2), (14, 0.2, 2), (15, 0.2, 3), (3, 0.2, 1), (1, 0.2, 1), (0, 0.2, 0), (10, 0.0, 0), (7, 1.0, 7)],
)
def test_the_number_of_hidden_objects_is_rounded_down_but_at_least_one(n, fraction, expected):
    selection = UncoordinatedSelection(fraction_false_negatives=fraction)
    assert len(selection.select(world(n), coverage_of(ORIGIN), stream(1)).remove) == expected


def test_every_object_is_equally_likely_to_be_hidden():
    objects = world(10)
    selection = UncoordinatedSelection(n_false_positives=0.0, fraction_false_negatives=0.2)
    hidden = concatenate([t.remove for t in draws(selection, objects)])
    chosen = np.array([np.sum(np.all(hidden.position == p, axis=1)) for p in objects.position])
    assert chosen.sum() == 2 * TRIALS
    assert np.all(np.abs(chosen - 0.2 * TRIALS) < 4.5 * np.sqrt(TRIALS * 0.2 * 0.8))


def test_displaced_objects_are_not_hidden_and_move_by_the_configured_distance():
    selection = UncoordinatedSelection(
        fraction_false_negatives=0.5, fraction_translations=0.5, translation_m=3.0, n_false_positives=0.0
    )
    targets = selection.select(world(10), coverage_of(ORIGIN), stream(3))
    assert len(targets.remove) == len(targets.move) == 5
    both = np.concatenate([targets.remove.position, targets.move.position])
    assert len(np.unique(both, axis=0)) == 10
    assert np.allclose(np.linalg.norm(targets.move_offset, axis=1), 3.0)
    assert np.all(targets.move_offset[:, 2] == 0.0)


def test_the_hidden_fraction_does_not_affect_false_objects():
    few = UncoordinatedSelection(fraction_false_negatives=0.1).select(world(10), coverage_of(ORIGIN), stream(5))
    many = UncoordinatedSelection(fraction_false_negatives=0.9).select(world(10), coverage_of(ORIGIN), stream(5))
    assert equal(few.add, many.add)


@given(st.integers(0, 12), st.randoms(use_true_random=False))
def test_the_order_of_the_objects_does_not_matter(n, random):
    order = list(range(n))
    random.shuffle(order)
    objects = world(n, seed=n)
    selection = UncoordinatedSelection(fraction_false_negatives=0.4, fraction_translations=0.3)
    a = selection.select(objects, coverage_of(ORIGIN), stream(1))
    b = selection.select(objects.select(np.array(order, int)), coverage_of(ORIGIN), stream(1))
    assert equal(a.add, b.add)
    assert equal(a.remove, b.remove)
    assert equal(a.move, b.move)
    assert np.array_equal(a.move_offset, b.move_offset)


def test_observations_of_one_object_by_several_adversaries_are_one_cluster():
    objects = at((0.0, 0.0), (1.0, 0.0), (50.0, 0.0), (50.0, 2.0), (90.0, 0.0))
    source = np.array([0, 1, 0, 1, 1])
    clusters = cluster_centres(objects, source, 5.0)
    assert sorted(map(tuple, clusters.position[:, :2])) == [(0.5, 0.0), (50.0, 1.0), (90.0, 0.0)]


@given(st.integers(0, 25), st.integers(1, 4), st.randoms(use_true_random=False))
def test_clusters_do_not_depend_on_the_order_of_the_tracks(n, sources, random):
    objects, source = world(n, seed=n, spread=8.0), np.arange(n) % sources
    order = np.array(random.sample(range(n), n), int)
    a = cluster_centres(objects, source, 5.0)
    b = cluster_centres(objects.select(order), source[order], 5.0)
    assert equal(a, b)

"""Adversaries over time: start, consistency and reproducibility."""

from itertools import pairwise

import numpy as np
from attack_worlds import ORIGIN, SECOND, at, equal, world
from hypothesis import given, settings
from hypothesis import strategies as st

from mast_zenoh.arrays.states import ObjectStates, concatenate, propagate
from mast_zenoh.attacks import ACTIONS, PassThrough, Targets, UncoordinatedAttack, UncoordinatedSelection
from mast_zenoh.attacks.attack import CoordinatedAttack
from mast_zenoh.attacks.campaign import MarkovPropagation, StaticPropagation
from mast_zenoh.attacks.coordination import Coordinator
from mast_zenoh.attacks.imitation import Exact
from mast_zenoh.attacks.selection import CoordinatedSelection
from mast_zenoh.attacks.targets import INSERTED

PERIOD = SECOND // 10


def drive(attack, n_frames=80, *, seed=3, name="adversary_1", n=12):
    """The tamperings of an attack on twelve cars over eight seconds."""
    attack.bind(seed, name)
    first, done = world(n, spread=15.0), []
    for frame in range(n_frames):
        objects = propagate(first, frame * 0.1)
        done.append(attack.step(frame, frame * PERIOD, objects, ORIGIN))
    return done


def same(a, b) -> bool:
    return all(
        equal(x.added, y.added)
        and equal(x.moved, y.moved)
        and all(np.array_equal(column, y.report.columns()[name]) for name, column in x.report.columns().items())
        for x, y in zip(a, b, strict=True)
    )


def test_pass_through_changes_nothing():
    objects = world(9)
    for tampering in drive(PassThrough(), n=9):
        assert equal(tampering.applied_to(objects), objects)
        assert len(tampering.report) == 0


def test_a_fifth_of_the_objects_is_hidden_and_always_the_same_fifth():
    done = drive(UncoordinatedAttack())
    hidden = {tuple(np.flatnonzero(~tampering.keep)) for tampering in done[40:]}
    assert len(hidden) == 1
    assert len(hidden.pop()) == 2


def test_false_objects_keep_their_id_and_move_with_their_velocity():
    selection = UncoordinatedSelection(n_false_positives=20.0)
    done = drive(UncoordinatedAttack(selection=selection, imitation=Exact()))
    for before, after in pairwise(done[40:]):
        _, i, j = np.intersect1d(before.added.id, after.added.id, return_indices=True)
        assert len(i) > 5
        assert np.allclose(after.added.position[j], before.added.position[i] + 0.1 * before.added.velocity[i])


def test_false_ids_are_higher_than_and_distinct_from_those_of_the_victim():
    selection = UncoordinatedSelection(n_false_positives=8.0)
    attack = UncoordinatedAttack(start_s=0.0, id_gap=2, selection=selection, propagation=StaticPropagation())
    attack.bind(1, "adversary_1")
    first = world(5).with_(id=np.arange(5))
    added = attack.step(0, 0, first, ORIGIN).added
    assert added.id.min() == 6
    # The victim's own ids reach the forged range, so the forged ids move up.
    grown = first.with_(id=np.array([0, 1, 6, 7, 20]))
    after = attack.step(1, PERIOD, grown, ORIGIN).added
    assert not set(after.id) & set(grown.id)
    assert set(added.id) & set(after.id) == set(added.id) - {6, 7}


def test_a_hidden_detection_is_hidden_again_after_a_miss():
    selection = UncoordinatedSelection(n_false_positives=0.0, fraction_false_negatives=0.5)
    attack = UncoordinatedAttack(start_s=0.0, selection=selection)
    attack.bind(1, "adversary_1")
    for frame in range(60):
        fast = (1.5 * frame, 0.0)
        seen = frame < 30 or frame % 6 == 0  # five misses in a row are 9 m, beyond the radius
        objects = at(fast) if seen else ObjectStates.empty()
        assert not attack.step(frame, frame * PERIOD, objects, ORIGIN).keep.any()


def test_targets_are_selected_anew_at_the_interval():
    attack = UncoordinatedAttack(reselect_every_s=2.0, start_s=1.0, propagation=StaticPropagation())
    numbers = [set(tampering.report.target.tolist()) for tampering in drive(attack)]
    assert numbers[10] == numbers[29]
    assert not numbers[29] & numbers[30]
    assert numbers[30] == numbers[49]


def test_equal_seeds_give_equal_attacks_and_names_give_different_ones():
    def attack():
        return UncoordinatedAttack(propagation=MarkovPropagation(), reselect_every_s=1.0)

    assert same(drive(attack()), drive(attack()))
    assert not same(drive(attack()), drive(attack(), name="adversary_2"))
    assert not same(drive(attack()), drive(attack(), seed=4))


def directive(position, velocity=(0.0, 0.0, 0.0), time_ns=None) -> Targets:
    add = at(position, velocity=np.array([velocity]))
    return Targets(add, ObjectStates.empty(), ObjectStates.empty(), np.zeros((0, 3)), time_ns)


def test_a_directive_is_predicted_to_the_current_time():
    attack = CoordinatedAttack(start_s=0.0, imitation=Exact())
    initial = directive((0.0, 0.0), (10.0, 0.0, 0.0), time_ns=0)
    added = [attack.step(f, f * PERIOD, world(3), ORIGIN, initial if f < 3 else None).added for f in range(1, 6)]
    assert [round(float(a.position[0, 0]), 9) for a in added] == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert len({int(a.id[0]) for a in added}) == 1


def test_the_newest_directive_takes_precedence():
    attack = CoordinatedAttack(start_s=0.0, imitation=Exact())
    attack.step(1, PERIOD, world(3), ORIGIN, directive((5.0, 0.0), time_ns=0))
    attack.step(5, 5 * PERIOD, world(3), ORIGIN, directive((9.0, 0.0), time_ns=4 * PERIOD))
    late = attack.step(6, 6 * PERIOD, world(3), ORIGIN, directive((1.0, 0.0), time_ns=2 * PERIOD))
    assert late.added.position[0, 0] == 9.0


def test_a_directive_before_the_start_takes_effect_at_the_start():
    attack = CoordinatedAttack(start_s=1.0, imitation=Exact())
    initial = directive((0.0, 0.0), time_ns=0)
    counts = [
        len(attack.step(f, f * PERIOD, world(3), ORIGIN, initial if f == 1 else None).added) for f in range(1, 12)
    ]
    assert counts == [0] * 9 + [1, 1]


def mesh(n_adversaries, n_frames=80, coordinator=None, seed=3, imitation=None):
    """A coordinator and its adversaries; directives arrive one frame later."""
    coordinator = coordinator or Coordinator(reselect_every_s=2.0)
    coordinator.bind(seed, "coordinator")
    attacks = [CoordinatedAttack(imitation=imitation) for _ in range(n_adversaries)]
    victims = np.array([[5.0 * i, 0.0, 15.0] for i in range(n_adversaries)]).reshape(-1, 3)
    directives = [None] * n_adversaries
    first, done = world(12, spread=15.0), []
    for frame in range(n_frames):
        objects = propagate(first, frame * 0.1)
        time_ns = frame * PERIOD
        done.append([a.step(frame, time_ns, objects, victims[i], directives[i]) for i, a in enumerate(attacks)])
        seen = concatenate([objects] * n_adversaries)
        directives = coordinator.step(frame, time_ns, seen, np.repeat(np.arange(n_adversaries), len(objects)), victims)
        assert len(directives) == n_adversaries
    return done


def test_adversaries_of_one_coordinator_insert_the_same_object_at_the_same_place():
    done = mesh(3, imitation=Exact())
    shared = 0
    for tamperings in done[41:]:
        places = [
            {
                int(number): tuple(after)
                for action, number, after in zip(t.report.action, t.report.target, t.report.after_position, strict=True)
                if ACTIONS[action] == "inserted"
            }
            for t in tamperings
        ]
        for number in set(places[0]) & set(places[1]):
            assert places[0][number] == places[1][number]
            shared += 1
    assert shared > 50


def test_coordinated_false_objects_saturate_where_uncoordinated_ones_grow():
    def uncoordinated(n):
        attacks = [
            drive(UncoordinatedAttack(), 60, seed=seed, name=f"adversary_{i}") for seed in range(8) for i in range(n)
        ]
        return sum(len(t.added) for done in attacks for t in done)

    def coordinated(n):
        frames = [tamperings for seed in range(8) for tamperings in mesh(n, 60, seed=seed)]
        return sum(
            len({number for t in tamperings for number in t.report.target[t.report.action == INSERTED].tolist()})
            for tamperings in frames
        )

    assert uncoordinated(3) > 2.2 * uncoordinated(1)
    assert coordinated(3) < 1.3 * coordinated(1)


@settings(max_examples=15)
@given(st.permutations(range(12)))
def test_the_coordinator_does_not_depend_on_the_order_of_the_tracks(order):
    objects, source, order = world(12, spread=10.0), np.arange(12) % 3, np.array(order)
    selection = CoordinatedSelection(fraction_false_negatives=0.4, fraction_translations=0.3)
    results = []
    for rows in (np.arange(12), order):
        coordinator = Coordinator(selection=selection, start_s=0.0, propagation=StaticPropagation())
        coordinator.bind(1, "coordinator")
        for frame in range(3):
            directives = coordinator.step(frame, frame * PERIOD, objects.select(rows), source[rows], np.zeros((3, 3)))
        results.append(directives[0])
    a, b = results
    assert equal(a.add, b.add)
    assert equal(a.remove, b.remove)
    assert equal(a.move, b.move)

"""Checks of attacks."""

from __future__ import annotations

import copy

import numpy as np

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.attacks import Attack, Surroundings, Tampering
from mast_zenoh.attacks.surroundings import unlimited
from mast_zenoh.testing import samples
from mast_zenoh.testing.comparison import expect, expect_finite, expect_same, unchanged

#: After the start of most attacks, which follow objects for some messages before they choose.
_FIRST, _FRAMES = 95, 8
_AGENT = np.array([30.0, 30.0, 15.0])


def check_attack(attack: Attack) -> None:
    """Check that an attack keeps to what `Attack` says, on tracks and on detections: zero, one and a thousand.

    attack: as newly made; it is copied, and not changed
    Raises AssertionError.
    """
    for n in samples.COUNTS:
        for tracks in (True, False):
            what = "tracks" if tracks else "detections"
            _check_steps(attack, f"{type(attack).__name__}.step with {n} {what}", n, tracks)


def _check_steps(attack: Attack, who: str, n: int, tracks: bool) -> None:
    straight, shuffled, again = (_informed(attack) for _ in range(3))
    random = np.random.default_rng(n)
    for frame in range(_FIRST, _FIRST + _FRAMES):
        objects = samples.states(n, frame)
        if not tracks:
            objects = objects.with_(id=np.full(n, -1), velocity=np.zeros((n, 3)))
        order = random.permutation(n)
        with unchanged(who, objects=objects, agent_position=_AGENT):
            done = _step(straight, frame, objects)
        _check_tampering(who, done, objects)
        expect_same(done, _step(again, frame, objects), f"{who}: two of one seed and name do different things")
        other = _step(shuffled, frame, objects.select(order))
        text = f"{who}: depends on the order of the rows"
        expect(np.array_equal(other.keep, done.keep[order]), f"{text}: keep")
        expect(np.array_equal(order[other.moved_index], done.moved_index), f"{text}: moved_index")
        # The ids of detections are only those that the caller has given to the rows.
        expect_same((done.moved, done.added, done.report), (other.moved, other.added, other.report), text)


def _informed(attack: Attack) -> Attack:
    made = copy.deepcopy(attack)
    made.inform(Surroundings())
    made.bind(1, "adversary_1")
    return made


def _step(attack: Attack, frame: int, objects: ObjectStates) -> Tampering:
    attack.look(unlimited(_AGENT), fused=False)
    return attack.step(frame, frame * samples.PERIOD_NS, objects, _AGENT)


def _check_tampering(who: str, done: Tampering, objects: ObjectStates) -> None:
    n = len(objects)
    expect(done.keep.shape == (n,), f"{who}: keep has the shape {done.keep.shape}, expected ({n},)")
    expect(done.keep.dtype == bool, f"{who}: keep is {done.keep.dtype}, expected bool")
    expect(len(done.moved) == len(done.moved_index), f"{who}: moved and moved_index have different lengths")
    expect(done.keep[done.moved_index].all(), f"{who}: a row is moved and hidden")
    changes = len(done.moved) + len(done.added) + int((~done.keep).sum())
    expect(len(done.report) == changes, f"{who}: reports {len(done.report)} changes, expected {changes}")
    expect_finite((done.moved, done.added, done.report), who)
    with unchanged(f"{who}: applied_to", objects=objects):
        done.applied_to(objects)

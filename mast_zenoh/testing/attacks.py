"""Checks of attacks."""

from __future__ import annotations

import copy

import numpy as np

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.attacks import Attack, Surroundings, Tampering
from mast_zenoh.attacks.surroundings import unlimited
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.testing import samples
from mast_zenoh.testing.comparison import expect, expect_finite, expect_same, unchanged

#: Frames after the start of most attacks, which observe objects before they choose targets.
_FIRST, _FRAMES = 95, 8
_AGENT = np.array([30.0, 30.0, 15.0])


def check_attack(attack: Attack) -> None:
    """Check an attack on tracks and on detections, with zero, one and 1000 objects.

    It must fulfil what the documentation of `Attack` promises.

    attack: a new instance; it is copied, and not changed
    Raises AssertionError.
    """
    for n in samples.COUNTS:
        for tracks in (True, False):
            what = "tracks" if tracks else "detections"
            _check_steps(attack, f"{type(attack).__name__}.step with {n} {what}", n, tracks)


def _check_steps(attack: Attack, subject: str, n: int, tracks: bool) -> None:
    straight, shuffled, again = (_prepared_copy(attack) for _ in range(3))
    random = np.random.default_rng(n)
    for frame in range(_FIRST, _FIRST + _FRAMES):
        objects = samples.states(n, frame)
        if not tracks:
            objects = objects.with_(id=np.full(n, -1), velocity=np.zeros((n, 3)))
        order = random.permutation(n)
        with unchanged(subject, objects=objects, agent_position=_AGENT):
            tampering = _step(straight, frame, objects)
        _check_tampering(subject, tampering, objects)
        _check_forging(subject, straight, frame)
        expect_same(
            tampering, _step(again, frame, objects), f"{subject}: two instances with the same seed and name differ"
        )
        other = _step(shuffled, frame, objects.select(order))
        text = f"{subject}: depends on the order of the rows"
        expect(np.array_equal(other.keep, tampering.keep[order]), f"{text}: keep")
        expect(np.array_equal(order[other.moved_index], tampering.moved_index), f"{text}: moved_index")
        # Ids of detections are row numbers from the caller.
        expect_same(
            (tampering.moved, tampering.added, tampering.report), (other.moved, other.added, other.report), text
        )


def _prepared_copy(attack: Attack) -> Attack:
    prepared = copy.deepcopy(attack)
    prepared.inform(Surroundings())
    prepared.bind(1, "adversary_1")
    return prepared


def _step(attack: Attack, frame: int, objects: ObjectStates) -> Tampering:
    attack.look(unlimited(_AGENT), fused=False)
    return attack.step(frame, frame * samples.PERIOD_NS, objects, _AGENT)


def _check_forging(subject: str, attack: Attack, frame: int) -> None:
    """Check the view and the pose that an attack forges."""
    time_ns, free = frame * samples.PERIOD_NS, np.full((8, 90), 60.0)
    with unchanged(f"{subject}: forge_view", free=free):
        forged = attack.forge_view(frame, time_ns, SweptView(unlimited(_AGENT), free)).free
    expect(
        forged.shape == free.shape, f"{subject}: forge_view: free has the shape {forged.shape}, expected {free.shape}"
    )
    expect_finite((forged,), f"{subject}: forge_view")
    expect(bool((forged >= 0.0).all()), f"{subject}: forge_view: free is negative, expected 0 m or more")
    with unchanged(f"{subject}: forge_pose", position=_AGENT):
        position = attack.forge_pose(frame, time_ns, _AGENT)
    expect(position.shape == (3,), f"{subject}: forge_pose: the shape is {position.shape}, expected (3,)")
    expect_finite((position,), f"{subject}: forge_pose")


def _check_tampering(subject: str, tampering: Tampering, objects: ObjectStates) -> None:
    n = len(objects)
    expect(tampering.keep.shape == (n,), f"{subject}: keep has the shape {tampering.keep.shape}, expected ({n},)")
    expect(tampering.keep.dtype == bool, f"{subject}: keep is {tampering.keep.dtype}, expected bool")
    expect(
        len(tampering.moved) == len(tampering.moved_index), f"{subject}: moved and moved_index have different lengths"
    )
    expect(tampering.keep[tampering.moved_index].all(), f"{subject}: a row is moved and hidden")
    changes = len(tampering.moved) + len(tampering.added) + int((~tampering.keep).sum())
    expect(len(tampering.report) == changes, f"{subject}: reports {len(tampering.report)} changes, expected {changes}")
    expect_finite((tampering.moved, tampering.added, tampering.report), subject)
    with unchanged(f"{subject}: applied_to", objects=objects):
        tampering.applied_to(objects)

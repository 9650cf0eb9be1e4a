"""Checks of trackers, clusterers and fusions."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints, ObjectStates, concatenate
from mast_zenoh.fusion.base import Clusterer, Fusion
from mast_zenoh.testing import samples
from mast_zenoh.testing.comparison import expect, expect_finite, expect_same, unchanged
from mast_zenoh.tracking.base import Tracker

_FRAMES = 4
_AGENTS = 5


def check_tracker(tracker: Tracker) -> None:
    """Check that a tracker keeps to what `Tracker` says, with zero, one and a thousand objects.

    tracker: as newly made; it is copied, and not changed
    Raises AssertionError.
    """
    who = type(tracker).__name__
    for n in samples.COUNTS:
        for method, sample in (("step", samples.detections), ("step_states", samples.states)):
            _check_tracks(tracker, f"{who}.{method} with {n} objects", method, sample, n)
    late = copy.deepcopy(tracker)
    late.step(samples.PERIOD_NS, samples.detections(1))
    try:
        late.step(0, samples.detections(1))
    except ValueError:
        return
    raise AssertionError(f"{who}.step: accepts a time before that of the last call, expected ValueError")


def _check_tracks(tracker: Tracker, who: str, method: str, sample: Callable[[int, int], Any], n: int) -> None:
    straight, shuffled = copy.deepcopy(tracker), copy.deepcopy(tracker)
    random = np.random.default_rng(n)
    results = []
    for frame in range(_FRAMES):
        given = sample(n, frame)
        order = random.permutation(n)
        with unchanged(who, detections=given):
            tracks = getattr(straight, method)(frame * samples.PERIOD_NS, given)
        again = getattr(shuffled, method)(frame * samples.PERIOD_NS, given.select(order))
        expect_finite(tracks, who)
        expect_same(tracks, again, f"{who}: depends on the order of the rows")
        _check_matched(who, straight.matched, shuffled.matched, len(tracks), order)
        ids = tracks.id.tolist()
        expect(ids == sorted(set(ids)), f"{who}: ids are not unique and ascending")
        expect(min(ids, default=0) >= 0, f"{who}: an id is negative")
        results.append(copy.deepcopy(tracks))
    straight.reset()
    for frame, before in enumerate(results):
        text = f"{who}: after `reset` it is not as newly made"
        try:
            after = getattr(straight, method)(frame * samples.PERIOD_NS, sample(n, frame))
        except ValueError as error:
            raise AssertionError(f"{text}: {error}") from error
        expect_same(before, after, text)


def _check_matched(who: str, matched: Ints, shuffled: Ints, tracks: int, order: Ints) -> None:
    """`matched` of the rows as they are, and of the rows in another order."""
    expect(matched.shape == (tracks,), f"{who}: matched has the shape {matched.shape}, expected ({tracks},)")
    expect(((matched >= -1) & (matched < len(order))).all(), f"{who}: matched names rows that the input does not have")
    back = np.append(order, -1)[shuffled]
    expect(np.array_equal(matched, back), f"{who}: matched depends on the order of the rows")


def agents_tracks(n: int, frame: int = 0) -> tuple[ObjectStates, Ints]:
    """n tracks in all of five agents that see the same objects, in a frame, and whose each of them is."""
    per_agent = [n // _AGENTS] * _AGENTS
    per_agent[0] += n % _AGENTS
    parts = [samples.states(count, frame, source=agent) for agent, count in enumerate(per_agent)]
    return concatenate(parts), np.repeat(np.arange(_AGENTS), per_agent)


def check_clusterer(clusterer: Clusterer) -> None:
    """Check that a clusterer keeps to what `Clusterer` says, with zero, one and a thousand tracks.

    Raises AssertionError.
    """
    for n in samples.COUNTS:
        who = f"{type(clusterer).__name__}.cluster with {n} tracks"
        states, agent = agents_tracks(n)
        with unchanged(who, states=states, agent=agent):
            labels = clusterer.cluster(states, agent)
        expect(labels.shape == (n,), f"{who}: found the shape {labels.shape}, expected ({n},)")
        expect(labels.dtype == np.int64, f"{who}: found {labels.dtype}, expected int64")
        label, first = np.unique(labels, return_index=True)
        expect(np.array_equal(label, np.arange(len(label))), f"{who}: labels are not 0 to c-1")
        twice = len(np.unique(np.stack([labels, agent]), axis=1).T) < n
        expect(not twice, f"{who}: a cluster has two tracks of one agent")
        # The rows are in the order of (agent, id).
        expect((np.diff(first) > 0).all(), f"{who}: clusters are not in the order of their least (agent, id)")
        order = np.random.default_rng(n).permutation(n)
        shuffled = clusterer.cluster(states.select(order), agent[order])
        expect(np.array_equal(shuffled, labels[order]), f"{who}: depends on the order of the rows")


def check_fusion(fusion: Fusion) -> None:
    """Check that a fusion keeps to what `Fusion` says, with zero, one and a thousand tracks.

    Raises AssertionError.
    """
    for n in samples.COUNTS:
        who = f"{type(fusion).__name__}.fuse with {n} tracks"
        states, agent = agents_tracks(n)
        labels = states.id.copy()  # all see the same objects under the same ids
        clusters = len(np.unique(labels))
        weights: Floats = np.where(agent == 1, 0.0, 1.0 + agent)
        for given in (None, weights):
            with unchanged(who, states=states, labels=labels, weights=weights):
                fused = fusion.fuse(states, labels, given)
            expect_finite(fused, who)
            expect(np.array_equal(fused.id, np.arange(clusters)), f"{who}: ids are not the labels in their order")
            order = np.random.default_rng(n).permutation(n)
            shuffled = fusion.fuse(states.select(order), labels[order], None if given is None else given[order])
            expect_same(fused, shuffled, f"{who}: depends on the order of the rows")
        trusted = weights > 0.0
        without = fusion.fuse(states.select(trusted), labels[trusted], weights[trusted])
        expect_same(without, fused, f"{who}: a member of weight 0 is not left out")
        none = fusion.fuse(states, labels, np.where(labels == 0, 0.0, 1.0))
        left = np.arange(min(1, clusters), clusters)
        expect(np.array_equal(none.id, left), f"{who}: a cluster without trusted members is not left out")

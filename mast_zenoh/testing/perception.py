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
    """Check a tracker with zero, one and a thousand objects.

    It must fulfil what the documentation of `Tracker` promises.

    tracker: a new instance; it is copied, and not changed
    Raises AssertionError.
    """
    subject = type(tracker).__name__
    for n in samples.COUNTS:
        for method, sample in (("step", samples.detections), ("step_states", samples.states)):
            _check_tracks(tracker, f"{subject}.{method} with {n} objects", method, sample, n)
    late = copy.deepcopy(tracker)
    late.step(samples.PERIOD_NS, samples.detections(1))
    try:
        late.step(0, samples.detections(1))
    except ValueError:
        return
    raise AssertionError(f"{subject}.step: accepts a time before the last call's, expected ValueError")


def _check_tracks(tracker: Tracker, subject: str, method: str, sample: Callable[[int, int], Any], n: int) -> None:
    straight, shuffled = copy.deepcopy(tracker), copy.deepcopy(tracker)
    random = np.random.default_rng(n)
    results = []
    for frame in range(_FRAMES):
        detections = sample(n, frame)
        order = random.permutation(n)
        with unchanged(subject, detections=detections):
            tracks = getattr(straight, method)(frame * samples.PERIOD_NS, detections)
        again = getattr(shuffled, method)(frame * samples.PERIOD_NS, detections.select(order))
        expect_finite(tracks, subject)
        expect_same(tracks, again, f"{subject}: depends on the order of the rows")
        _check_matched(subject, straight.matched, shuffled.matched, len(tracks), order)
        ids = tracks.id.tolist()
        expect(ids == sorted(set(ids)), f"{subject}: ids are not unique and ascending")
        expect(min(ids, default=0) >= 0, f"{subject}: an id is negative")
        results.append(copy.deepcopy(tracks))
    straight.reset()
    for frame, before in enumerate(results):
        text = f"{subject}: after `reset` it differs from a new instance"
        try:
            after = getattr(straight, method)(frame * samples.PERIOD_NS, sample(n, frame))
        except ValueError as error:
            raise AssertionError(f"{text}: {error}") from error
        expect_same(before, after, text)


def _check_matched(subject: str, matched: Ints, shuffled: Ints, tracks: int, order: Ints) -> None:
    """Check `matched` of the original rows against `matched` of the shuffled rows."""
    expect(matched.shape == (tracks,), f"{subject}: matched has the shape {matched.shape}, expected ({tracks},)")
    expect(
        ((matched >= -1) & (matched < len(order))).all(), f"{subject}: matched names rows that the input does not have"
    )
    back = np.append(order, -1)[shuffled]
    expect(np.array_equal(matched, back), f"{subject}: matched depends on the order of the rows")


def agents_tracks(n: int, frame: int = 0) -> tuple[ObjectStates, Ints]:
    """n tracks of five agents that see the same objects; the agent of each track."""
    per_agent = [n // _AGENTS] * _AGENTS
    per_agent[0] += n % _AGENTS
    parts = [samples.states(count, frame, source=agent) for agent, count in enumerate(per_agent)]
    return concatenate(parts), np.repeat(np.arange(_AGENTS), per_agent)


def check_clusterer(clusterer: Clusterer) -> None:
    """Check a clusterer with zero, one and a thousand tracks.

    It must fulfil what the documentation of `Clusterer` promises.

    Raises AssertionError.
    """
    for n in samples.COUNTS:
        subject = f"{type(clusterer).__name__}.cluster with {n} tracks"
        states, agent = agents_tracks(n)
        with unchanged(subject, states=states, agent=agent):
            labels = clusterer.cluster(states, agent)
        expect(labels.shape == (n,), f"{subject}: found the shape {labels.shape}, expected ({n},)")
        expect(labels.dtype == np.int64, f"{subject}: found {labels.dtype}, expected int64")
        label, first = np.unique(labels, return_index=True)
        expect(np.array_equal(label, np.arange(len(label))), f"{subject}: labels are not 0 to c-1")
        twice = len(np.unique(np.stack([labels, agent]), axis=1).T) < n
        expect(not twice, f"{subject}: a cluster has two tracks of one agent")
        # The rows are in the order of (agent, id).
        expect((np.diff(first) > 0).all(), f"{subject}: clusters are not in the order of their least (agent, id)")
        order = np.random.default_rng(n).permutation(n)
        shuffled = clusterer.cluster(states.select(order), agent[order])
        expect(np.array_equal(shuffled, labels[order]), f"{subject}: depends on the order of the rows")


def check_fusion(fusion: Fusion) -> None:
    """Check a fusion with zero, one and a thousand tracks.

    It must fulfil what the documentation of `Fusion` promises.

    Raises AssertionError.
    """
    for n in samples.COUNTS:
        subject = f"{type(fusion).__name__}.fuse with {n} tracks"
        states, agent = agents_tracks(n)
        labels = states.id.copy()  # all agents use the same ids for the same objects
        clusters = len(np.unique(labels))
        weights: Floats = np.where(agent == 1, 0.0, 1.0 + agent)
        for used_weights in (None, weights):
            with unchanged(subject, states=states, labels=labels, weights=weights):
                fused = fusion.fuse(states, labels, used_weights)
            expect_finite(fused, subject)
            expect(np.array_equal(fused.id, np.arange(clusters)), f"{subject}: ids are not the labels in their order")
            order = np.random.default_rng(n).permutation(n)
            shuffled = fusion.fuse(
                states.select(order), labels[order], None if used_weights is None else used_weights[order]
            )
            expect_same(fused, shuffled, f"{subject}: depends on the order of the rows")
        trusted = weights > 0.0
        without = fusion.fuse(states.select(trusted), labels[trusted], weights[trusted])
        expect_same(without, fused, f"{subject}: a member of weight 0 is not left out")
        without_first = fusion.fuse(states, labels, np.where(labels == 0, 0.0, 1.0))
        remaining = np.arange(min(1, clusters), clusters)
        expect(
            np.array_equal(without_first.id, remaining), f"{subject}: a cluster without trusted members is not left out"
        )

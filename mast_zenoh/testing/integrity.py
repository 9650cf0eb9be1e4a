"""Checks of integrity stages."""

from __future__ import annotations

import copy
from collections.abc import Mapping

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_yaw
from mast_zenoh.arrays.states import Ints, ObjectStates
from mast_zenoh.integrity import Assessment, Batch, Integrity, SweptView
from mast_zenoh.integrity.base import problem_of
from mast_zenoh.integrity.views import UNKNOWN_SPACE
from mast_zenoh.testing import samples
from mast_zenoh.testing.comparison import expect, expect_finite, expect_same, unchanged
from mast_zenoh.testing.perception import agents_tracks
from mast_zenoh.tracking.view import SensorView

_AGENTS = ("ego", "infra_1", "infra_2", "mobile_1", "mobile_2")
#: Frames of a check, and the one in which the last agent is absent.
_FRAMES, _ABSENT = 14, 6


def check_integrity(stage: Integrity) -> None:
    """Check an integrity stage with zero, one and a thousand tracks, with and without views.

    It must fulfil what the documentation of `Integrity` promises.

    stage: a new instance; it is copied, and not changed
    Raises AssertionError.
    """
    for n in samples.COUNTS:
        for viewed in (True, False):
            subject = f"{type(stage).__name__}.assess with {n} tracks {'and' if viewed else 'without'} views"
            _check_batches(stage, subject, n, viewed)


def _check_batches(stage: Integrity, subject: str, n: int, viewed: bool) -> None:
    straight, shuffled, again = (copy.deepcopy(stage) for _ in range(3))
    random = np.random.default_rng(n)
    results = []
    for frame in range(_FRAMES):
        states, agent, agents, views = _tracks(n, frame, viewed)
        with unchanged(subject, states=states, agent=agent, views=tuple(views.values())):
            batch, assessment = _assess(straight, frame, states, agent, agents, views)
        _check_assessment(subject, assessment, batch)
        _expect_equal(
            assessment, _assess(again, frame, states, agent, agents, views)[1], f"{subject}: two copies differ"
        )
        order = random.permutation(len(states))
        _, other = _assess(shuffled, frame, states.select(order), agent[order], agents, views)
        text = f"{subject}: depends on the order of the rows"
        if assessment.weights is not None and other.weights is not None:
            expect_same(assessment.weights[order], other.weights, f"{text}: weights")
        _expect_equal(assessment, other, text, weights=False)
        results.append((assessment, states, agent, agents, views))
    straight.reset()
    for frame, (before, states, agent, agents, views) in enumerate(results):
        after = _assess(straight, frame, states, agent, agents, views)[1]
        _expect_equal(before, after, f"{subject}: after `reset` it is not as newly made")


def _tracks(n: int, frame: int, viewed: bool) -> tuple[ObjectStates, Ints, tuple[str, ...], Mapping[str, SweptView]]:
    """Tracks of five agents, of four in one frame, and their views; one agent has none, one's free space is unknown."""
    states, agent = agents_tracks(n, frame)
    count = len(_AGENTS) - (frame == _ABSENT)
    present = agent < count
    views: dict[str, SweptView] = {}
    for row, name in enumerate(_AGENTS[: count if viewed else 0]):
        random = np.random.default_rng(row)
        place = np.array([60.0 * row, 40.0 + 15.0 * row, 5.0])
        view = SensorView(place, rotation_from_yaw(0.5 * row), -np.pi, np.pi, -1.2, 0.4, 100.0)
        free = UNKNOWN_SPACE if row == 1 else random.uniform(5.0, 100.0, (16, 180))
        if row != 2:
            views[name] = SweptView(view, free)
    return states.select(present), agent[present], _AGENTS[:count], views


def _assess(
    stage: Integrity,
    frame: int,
    states: ObjectStates,
    agent: Ints,
    agents: tuple[str, ...],
    views: Mapping[str, SweptView],
) -> tuple[Batch, Assessment]:
    time_ns = frame * samples.PERIOD_NS
    labels = np.unique(states.id, return_inverse=True)[1].astype(np.int64)  # ids of one object are equal
    subject = f"{type(stage).__name__}.correct"
    with unchanged(subject, states=states, agent=agent, views=tuple(views.values())):
        corrected, views = stage.correct(time_ns, states, agent, agents, views)
    expect(np.array_equal(corrected.id, states.id), f"{subject}: ids or their order differ from the input's")
    expect_finite(corrected, subject)
    batch = Batch(time_ns, corrected, agent, labels, agents, tuple(views.get(name) for name in agents))
    with unchanged(f"{type(stage).__name__}.assess", batch=batch):
        return batch, stage.assess(batch)


def _check_assessment(subject: str, assessment: Assessment, batch: Batch) -> None:
    problem = problem_of(assessment, len(batch.states), len(batch.agents), batch.clusters)
    expect(not problem, f"{subject}: {problem}")


def _expect_equal(first: Assessment, second: Assessment, text: str, *, weights: bool = True) -> None:
    expect((first.weights is None) == (second.weights is None), f"{text}: weights are given only once")
    expect(first.agents.reason == second.agents.reason, f"{text}: reasons differ")
    expect_same((first.agents, first.objects), (second.agents, second.objects), text)
    if weights and first.weights is not None:
        expect_same(first.weights, second.weights, f"{text}: weights")

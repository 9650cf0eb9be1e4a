"""Checks of trackers, clusterers, fusions, pipelines, mission estimators, integrity stages, attacks and metrics.

Each handles zero, one and a thousand rows, leaves its inputs unchanged, and does not depend on their order; one that
has a state is as newly made after `reset`. A check copies the instance that it gets, and raises AssertionError.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_yaw
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates, concatenate
from mast_zenoh.attacks import Attack, Surroundings, Tampering
from mast_zenoh.attacks.surroundings import unlimited
from mast_zenoh.fusion.base import Clusterer, Fusion
from mast_zenoh.fusion.pipelines import AgentPipeline, MissionEstimator, Pipeline, Pose
from mast_zenoh.integrity import Assessment, Batch, Integrity, SweptView
from mast_zenoh.integrity.base import problem_of
from mast_zenoh.integrity.views import UNKNOWN_SPACE
from mast_zenoh.metrics.measures import FrameMetric, RunMetric
from mast_zenoh.metrics.scoring import Estimate
from mast_zenoh.sensing import LidarSensor, to_sensor
from mast_zenoh.testing import samples
from mast_zenoh.testing.comparison import expect, expect_finite, expect_same, unchanged
from mast_zenoh.tracking.base import Tracker
from mast_zenoh.tracking.view import SensorView

_FRAMES = 4
_AGENTS = ("ego", "infra_1", "infra_2", "mobile_1", "mobile_2")
_LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
#: Frames of a check of an integrity stage, and the one in which the last agent is absent.
_ASSESSED_FRAMES, _ABSENT = 14, 6
#: Frames after the start of most attacks, which observe objects before they choose targets.
_FIRST_ATTACKED, _ATTACKED_FRAMES = 95, 8
_AGENT_POSITION = np.array([30.0, 30.0, 15.0])
_PER_BOX = [field.name for field in fields(Estimate)][fields(Estimate).index(Estimate.__dataclass_fields__["frame"]) :]

Inputs = dict[str, Any]


def _check_frames(
    instance: Any,
    subject: str,
    sample: Callable[[int], Inputs],
    step: Callable[..., Any],
    permuted: Callable[[Inputs, np.random.Generator], Inputs],
    check: Callable[..., None],
    *,
    seed: int,
    resets: bool = True,
) -> None:
    """Check some frames of an algorithm with a state: unchanged inputs, any order of the rows, and `reset`.

    sample:   the inputs of a frame;  permuted: the same in another order
    step:     step(instance, frame, **inputs) returns the result
    check:    check(subject, result, **inputs)
    """
    straight, shuffled = copy.deepcopy(instance), copy.deepcopy(instance)
    random, results = np.random.default_rng(seed), []
    for frame in range(_FRAMES):
        inputs = sample(frame)
        with unchanged(subject, **inputs):
            result = step(straight, frame, **inputs)
        again = step(shuffled, frame, **permuted(inputs, random))
        check(subject, result, **inputs)
        expect_same(result, again, f"{subject}: depends on the order of the rows or of the agents")
        results.append((inputs, copy.deepcopy(result)))
    if not resets:
        return
    straight.reset()
    text = f"{subject}: after `reset` it differs from a new instance"
    for frame, (inputs, before) in enumerate(results):
        try:
            after = step(straight, frame, **inputs)
        except ValueError as error:
            raise AssertionError(f"{text}: {error}") from error
        expect_same(before, after, text)


def _check_ids(subject: str, states: Any) -> None:
    expect_finite(states, subject)
    ids = states.id.tolist()
    expect(ids == sorted(set(ids)), f"{subject}: ids are not unique and ascending")


def _agents_tracks(n: int, frame: int = 0) -> tuple[ObjectStates, Ints]:
    """n tracks of five agents that see the same objects; the agent of each track."""
    per_agent = [n // len(_AGENTS)] * len(_AGENTS)
    per_agent[0] += n % len(_AGENTS)
    parts = [samples.states(count, frame, source=agent) for agent, count in enumerate(per_agent)]
    return concatenate(parts), np.repeat(np.arange(len(_AGENTS)), per_agent)


# -- trackers ----------------------------------------------------------------------------------------------------------


def check_tracker(tracker: Tracker) -> None:
    """Check that a tracker fulfils what the documentation of `Tracker` promises.

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
    def step(tracker: Tracker, frame: int, detections: Any, order: Ints) -> Any:
        tracks = getattr(tracker, method)(frame * samples.PERIOD_NS, detections)
        matched = tracker.matched
        expect(
            matched.shape == (len(tracks),), f"{subject}: matched has the shape {matched.shape}, expected one per track"
        )
        expect(((matched >= -1) & (matched < n)).all(), f"{subject}: matched names rows that the input does not have")
        return tracks, np.append(order, -1)[matched]  # the rows as they were before they were shuffled

    def permuted(inputs: Inputs, random: np.random.Generator) -> Inputs:
        order = random.permutation(n)
        return {"detections": inputs["detections"].select(order), "order": order}

    def check(subject: str, result: Any, **inputs: Any) -> None:
        _check_ids(subject, result[0])
        expect(min(result[0].id.tolist(), default=0) >= 0, f"{subject}: an id is negative")

    _check_frames(
        tracker,
        subject,
        lambda frame: {"detections": sample(n, frame), "order": np.arange(n)},
        step,
        permuted,
        check,
        seed=n,
    )


# -- clusterers and fusions --------------------------------------------------------------------------------------------


def check_clusterer(clusterer: Clusterer) -> None:
    """Check that a clusterer fulfils what the documentation of `Clusterer` promises.

    Raises AssertionError.
    """
    for n in samples.COUNTS:
        subject = f"{type(clusterer).__name__}.cluster with {n} tracks"
        states, agent = _agents_tracks(n)
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
    """Check that a fusion fulfils what the documentation of `Fusion` promises.

    Raises AssertionError.
    """
    for n in samples.COUNTS:
        subject = f"{type(fusion).__name__}.fuse with {n} tracks"
        states, agent = _agents_tracks(n)
        labels = states.id.copy()  # all agents use the same ids for the same objects
        clusters = len(np.unique(labels))
        weights: Floats = np.where(agent == 1, 0.0, 1.0 + agent)
        order = np.random.default_rng(n).permutation(n)
        for used, used_shuffled in ((None, None), (weights, weights[order])):
            with unchanged(subject, states=states, labels=labels, weights=weights):
                fused = fusion.fuse(states, labels, used)
            expect_finite(fused, subject)
            expect(np.array_equal(fused.id, np.arange(clusters)), f"{subject}: ids are not the labels in their order")
            shuffled = fusion.fuse(states.select(order), labels[order], used_shuffled)
            expect_same(fused, shuffled, f"{subject}: depends on the order of the rows")
        trusted = weights > 0.0
        without = fusion.fuse(states.select(trusted), labels[trusted], weights[trusted])
        expect_same(without, fused, f"{subject}: a member of weight 0 is not left out")
        without_first = fusion.fuse(states, labels, np.where(labels == 0, 0.0, 1.0))
        remaining = np.arange(min(1, clusters), clusters)
        left_out = np.array_equal(without_first.id, remaining)
        expect(left_out, f"{subject}: a cluster without trusted members is not left out")


# -- pipelines ---------------------------------------------------------------------------------------------------------


def check_pipeline(pipeline: Pipeline | AgentPipeline) -> None:
    """Check that a pipeline, of the command centre or an agent, fulfils its contract.

    The mission estimator of an agent's pipeline is checked too.

    pipeline: a new instance; it is copied, and not changed
    Raises AssertionError.
    """
    for n in samples.COUNTS:
        if isinstance(pipeline, AgentPipeline):
            _check_agent(pipeline, f"{type(pipeline).__name__}.track with {n} detections", n)
        else:
            for weighted in (False, True):
                _check_center(pipeline, f"{type(pipeline).__name__}.step with {n} tracks", n, weighted)
    if isinstance(pipeline, AgentPipeline):
        check_mission_estimator(pipeline.mission)


def _check_center(pipeline: Pipeline, subject: str, n: int, weighted: bool) -> None:
    def sample(frame: int) -> Inputs:
        states, agent = _agents_tracks(n, frame)
        weights = np.where(agent == 1, 0.0, 1.0 + agent) if weighted else None
        return {"states": states, "agent": agent, "agents": _AGENTS, "weights": weights}

    def step(pipeline: Pipeline, frame: int, **inputs: Any) -> Any:
        return pipeline.step(frame * samples.PERIOD_NS, **inputs)

    def permuted(inputs: Inputs, random: np.random.Generator) -> Inputs:
        rows, names = random.permutation(n), random.permutation(len(_AGENTS))
        return {
            "states": inputs["states"].select(rows),
            "agent": np.argsort(names)[inputs["agent"]][rows],
            "agents": tuple(_AGENTS[row] for row in names),
            "weights": inputs["weights"][rows] if weighted else None,
        }

    def check(subject: str, result: Any, **inputs: Any) -> None:
        picture, support = result
        _check_ids(subject, picture)
        one_each = support.shape == (len(picture),)
        expect(one_each, f"{subject}: support has the shape {support.shape}, expected one per row")
        expect(support.dtype == np.int64, f"{subject}: support is {support.dtype}, expected int64")
        possible = ((support >= 0) & (support <= len(_AGENTS))).all()
        expect(possible, f"{subject}: support is not from 0 to {len(_AGENTS)}")

    _check_frames(pipeline, subject, sample, step, permuted, check, seed=n)


def _check_agent(pipeline: AgentPipeline, subject: str, n: int) -> None:
    mount, lidar = Pose(np.array([0.0, 0.0, 1.8]), _LEVEL), LidarSensor()

    def sample(frame: int) -> Inputs:
        position = np.array([1.0 * frame, 0.0, 0.0])
        detections = to_sensor(samples.detections(n, frame), position + mount.position, rotation_from_yaw(0.0))
        return {"detections": detections, "pose": Pose(position, _LEVEL), "mount": mount}

    def step(pipeline: AgentPipeline, frame: int, detections: Any, pose: Pose, mount: Pose) -> Any:
        return pipeline.track(frame * samples.PERIOD_NS, detections, pose, mount, lidar)

    def permuted(inputs: Inputs, random: np.random.Generator) -> Inputs:
        return inputs | {"detections": inputs["detections"].select(random.permutation(n))}

    def check(subject: str, result: Any, **inputs: Any) -> None:
        tracks, origin, rotation = result
        _check_ids(subject, tracks)
        shapes = origin.shape, rotation.shape
        expected = ((3,), (4,))
        expect(shapes == expected, f"{subject}: origin and rotation have the shapes {shapes}, expected (3,) and (4,)")
        expect(abs(np.linalg.norm(rotation) - 1.0) < 1e-6, f"{subject}: rotation is not a quaternion of length 1")

    _check_frames(pipeline, subject, sample, step, permuted, check, seed=n, resets=False)


def check_mission_estimator(estimator: MissionEstimator) -> None:
    """Check that a mission estimator fulfils its contract.

    Raises AssertionError.
    """
    for index, (own_count, count) in enumerate((own, other) for own in samples.COUNTS for other in samples.COUNTS):
        time_ns = index * samples.PERIOD_NS
        subject = f"{type(estimator).__name__}.estimate with {own_count} tracks and {count} objects of the picture"
        own, picture = samples.states(own_count, source=1), samples.states(count, source=2)
        with unchanged(subject, own=own, picture=picture):
            result = estimator.estimate(time_ns, own, picture)
        expect_finite(result, subject)
        ids = result.id.tolist()
        expect(len(set(ids)) == len(ids), f"{subject}: ids are not unique")
        random = np.random.default_rng(own_count + count)
        rows, others = (random.permutation(n) for n in (own_count, count))
        again = estimator.estimate(time_ns, own.select(rows), picture.select(others))
        text = f"{subject}: depends on the order of the rows, or ids do not last"
        expect_same(_by_id(result), _by_id(again), text)


def _by_id(states: ObjectStates) -> ObjectStates:
    order: Ints = np.argsort(states.id)
    return states.select(order)


# -- integrity stages --------------------------------------------------------------------------------------------------


def check_integrity(stage: Integrity) -> None:
    """Check an integrity stage with zero, one and a thousand tracks, with and without views, and without agents.

    It must fulfil what the documentation of `Integrity` promises.

    stage: a new instance; it is copied, and not changed
    Raises AssertionError.
    """
    for n in samples.COUNTS:
        for viewed in (True, False):
            subject = f"{type(stage).__name__}.assess with {n} tracks {'and' if viewed else 'without'} views"
            _check_batches(stage, subject, n, viewed)
    nobody = np.zeros(0, np.int64)
    batch, assessment = _assess(copy.deepcopy(stage), 0, ObjectStates.of(np.zeros((0, 3))), nobody, (), {})
    _check_assessment(f"{type(stage).__name__}.assess without agents", assessment, batch)


def _check_batches(stage: Integrity, subject: str, n: int, viewed: bool) -> None:
    straight, shuffled, again = (copy.deepcopy(stage) for _ in range(3))
    random = np.random.default_rng(n)
    results = []
    for frame in range(_ASSESSED_FRAMES):
        states, agent, agents, views = _viewed_tracks(n, frame, viewed)
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


def _viewed_tracks(
    n: int, frame: int, viewed: bool
) -> tuple[ObjectStates, Ints, tuple[str, ...], Mapping[str, SweptView]]:
    """Tracks of five agents, of four in one frame, and their views; one agent has none, one's free space is unknown."""
    states, agent = _agents_tracks(n, frame)
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


# -- attacks -----------------------------------------------------------------------------------------------------------


def check_attack(attack: Attack) -> None:
    """Check an attack on tracks and on detections, with zero, one and 1000 objects.

    It must fulfil what the documentation of `Attack` promises.

    attack: a new instance; it is copied, and not changed
    Raises AssertionError.
    """
    for n in samples.COUNTS:
        for tracks in (True, False):
            what = "tracks" if tracks else "detections"
            _check_attack_steps(attack, f"{type(attack).__name__}.step with {n} {what}", n, tracks)


def _check_attack_steps(attack: Attack, subject: str, n: int, tracks: bool) -> None:
    straight, shuffled, again = (_prepared_copy(attack) for _ in range(3))
    random = np.random.default_rng(n)
    for frame in range(_FIRST_ATTACKED, _FIRST_ATTACKED + _ATTACKED_FRAMES):
        objects = samples.states(n, frame)
        if not tracks:
            objects = objects.with_(id=np.full(n, -1), velocity=np.zeros((n, 3)))
        order = random.permutation(n)
        with unchanged(subject, objects=objects, agent_position=_AGENT_POSITION):
            tampering = _attacked(straight, frame, objects)
        _check_tampering(subject, tampering, objects)
        _check_forging(subject, straight, frame)
        expect_same(
            tampering, _attacked(again, frame, objects), f"{subject}: two instances with the same seed and name differ"
        )
        other = _attacked(shuffled, frame, objects.select(order))
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


def _attacked(attack: Attack, frame: int, objects: ObjectStates) -> Tampering:
    attack.look(unlimited(_AGENT_POSITION), fused=False)
    return attack.step(frame, frame * samples.PERIOD_NS, objects, _AGENT_POSITION)


def _check_forging(subject: str, attack: Attack, frame: int) -> None:
    """Check the view and the pose that an attack forges."""
    time_ns, free = frame * samples.PERIOD_NS, np.full((8, 90), 60.0)
    with unchanged(f"{subject}: forge_view", free=free):
        forged = attack.forge_view(frame, time_ns, SweptView(unlimited(_AGENT_POSITION), free)).free
    expect(
        forged.shape == free.shape, f"{subject}: forge_view: free has the shape {forged.shape}, expected {free.shape}"
    )
    expect_finite((forged,), f"{subject}: forge_view")
    expect(bool((forged >= 0.0).all()), f"{subject}: forge_view: free is negative, expected 0 m or more")
    with unchanged(f"{subject}: forge_pose", position=_AGENT_POSITION):
        position = attack.forge_pose(frame, time_ns, _AGENT_POSITION)
    expect(position.shape == (3,), f"{subject}: forge_pose: the shape is {position.shape}, expected (3,)")
    expect_finite((position,), f"{subject}: forge_pose")
    trust = np.array([0.2, 1.0])
    with unchanged(f"{subject}: forge_trust", trust=trust):
        forged_trust = attack.forge_trust(time_ns, "infra_1", ("ego", "infra_1"), trust)
    expect(forged_trust.shape == (2,), f"{subject}: forge_trust: the shape is {forged_trust.shape}, expected (2,)")
    expect(bool(((forged_trust >= 0.0) & (forged_trust <= 1.0)).all()), f"{subject}: forge_trust: not from 0 to 1")


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


# -- metrics -----------------------------------------------------------------------------------------------------------


def check_metric(metric: FrameMetric | RunMetric) -> None:
    """Check that a metric has a value for zero, one and 1000 boxes, in any order.

    Raises AssertionError.
    """
    expect(
        metric.label.isidentifier(), f"{type(metric).__name__}: found the label {metric.label!r}, expected a plain name"
    )
    for n in samples.COUNTS:
        for frames in (1, 20):
            _check_value(
                metric, f"{type(metric).__name__} with {n} boxes in {frames} frames", samples.estimate(n, frames)
            )


def _check_value(metric: FrameMetric | RunMetric, subject: str, estimate: Estimate) -> None:
    try:
        with unchanged(subject, estimate=estimate):
            value = metric.value(estimate)
    except Exception as error:
        raise AssertionError(f"{subject}: {type(error).__name__}: {error}") from error
    if isinstance(metric, FrameMetric):
        shape = np.asarray(value).shape
        expect(shape == estimate.frames.shape, f"{subject}: found the shape {shape}, expected {estimate.frames.shape}")
    order = np.random.default_rng(0).permutation(len(estimate.frame))
    shuffled = metric.value(replace(estimate, **{name: getattr(estimate, name)[order] for name in _PER_BOX}))
    same = value is shuffled or np.allclose(
        np.asarray(value, np.float64), np.asarray(shuffled, np.float64), rtol=1e-9, equal_nan=True
    )
    expect(same, f"{subject}: depends on the order of the boxes")

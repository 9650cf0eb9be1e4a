"""Checks of pipelines, and of the mission estimators in them."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_yaw
from mast_zenoh.arrays.states import Ints, ObjectStates
from mast_zenoh.pipelines import AgentPipeline, MissionEstimator, Pipeline, Pose
from mast_zenoh.sensing import LidarSensor, to_sensor
from mast_zenoh.testing import samples
from mast_zenoh.testing.comparison import expect, expect_finite, expect_same, unchanged
from mast_zenoh.testing.perception import agents_tracks

_FRAMES = 4
_AGENTS = ("ego", "infra_1", "infra_2", "mobile_1", "mobile_2")
_LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def check_pipeline(pipeline: Pipeline | AgentPipeline) -> None:
    """Check that a pipeline, of the command centre or an agent, fulfils its contract.

    With zero, one and a thousand tracks or detections. The mission estimator of an agent's pipeline is checked too.

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
    straight, shuffled = copy.deepcopy(pipeline), copy.deepcopy(pipeline)
    random = np.random.default_rng(n)
    results = []
    for frame in range(_FRAMES):
        states, agent = agents_tracks(n, frame)
        weights = np.where(agent == 1, 0.0, 1.0 + agent) if weighted else None
        time_ns = frame * samples.PERIOD_NS
        with unchanged(subject, states=states, agent=agent, weights=weights):
            picture, support = straight.step(time_ns, states, agent, _AGENTS, weights)
        _check_ids(subject, picture)
        expect(
            support.shape == (len(picture),), f"{subject}: support has the shape {support.shape}, expected one per row"
        )
        expect(support.dtype == np.int64, f"{subject}: support is {support.dtype}, expected int64")
        expect(
            ((support >= 0) & (support <= len(_AGENTS))).all(), f"{subject}: support is not from 0 to {len(_AGENTS)}"
        )
        rows, names = random.permutation(n), random.permutation(len(_AGENTS))
        rank = np.argsort(names)
        agents = tuple(_AGENTS[row] for row in names)
        other = None if weights is None else weights[rows]
        again = shuffled.step(time_ns, states.select(rows), rank[agent][rows], agents, other)
        expect_same((picture, support), again, f"{subject}: depends on the order of the rows or of the agents")
        results.append((picture, support, states, agent, weights))
    straight.reset()
    for frame, (picture, support, states, agent, weights) in enumerate(results):
        text = f"{subject}: after `reset` it differs from a new instance"
        try:
            after = straight.step(frame * samples.PERIOD_NS, states, agent, _AGENTS, weights)
        except ValueError as error:
            raise AssertionError(f"{text}: {error}") from error
        expect_same((picture, support), after, text)


def _check_agent(pipeline: AgentPipeline, subject: str, n: int) -> None:
    straight, shuffled = copy.deepcopy(pipeline), copy.deepcopy(pipeline)
    random = np.random.default_rng(n)
    mount, lidar = Pose(np.array([0.0, 0.0, 1.8]), _LEVEL), LidarSensor()
    for frame in range(_FRAMES):
        position = np.array([1.0 * frame, 0.0, 0.0])
        sensor = position + mount.position, rotation_from_yaw(0.0)
        detections = to_sensor(samples.detections(n, frame), *sensor)
        time_ns, pose, order = frame * samples.PERIOD_NS, Pose(position, _LEVEL), random.permutation(n)
        with unchanged(subject, detections=detections, pose=pose, mount=mount):
            result = straight.track(time_ns, detections, pose, mount, lidar)
        tracks, origin, rotation = result
        _check_ids(subject, tracks)
        shapes = origin.shape, rotation.shape
        expect(
            shapes == ((3,), (4,)), f"{subject}: origin and rotation have the shapes {shapes}, expected (3,) and (4,)"
        )
        expect(abs(np.linalg.norm(rotation) - 1.0) < 1e-6, f"{subject}: rotation is not a quaternion of length 1")
        again = shuffled.track(time_ns, detections.select(order), pose, mount, lidar)
        expect_same(result, again, f"{subject}: depends on the order of the rows")


def check_mission_estimator(estimator: MissionEstimator) -> None:
    """Check that a mission estimator fulfils its contract.

    With zero, one and a thousand objects.

    Raises AssertionError.
    """
    time_ns = 0
    for own_count in samples.COUNTS:
        for count in samples.COUNTS:
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
            expect_same(
                _by_id(result), _by_id(again), f"{subject}: depends on the order of the rows, or ids do not last"
            )
            time_ns += samples.PERIOD_NS


def _by_id(states: ObjectStates) -> ObjectStates:
    order: Ints = np.argsort(states.id)
    return states.select(order)


def _check_ids(subject: str, states: Any) -> None:
    expect_finite(states, subject)
    ids = states.id.tolist()
    expect(ids == sorted(set(ids)), f"{subject}: ids are not unique and ascending")

"""Checks of scenes and detectors."""

from __future__ import annotations

import copy

import numpy as np

from mast_zenoh.arrays.states import CLASSES, Detections, Ints, ObjectStates
from mast_zenoh.errors import MastError
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import Detector, LidarSensor
from mast_zenoh.testing import samples
from mast_zenoh.testing.comparison import expect, expect_finite, expect_same, unchanged

_SENSOR = np.array([20.0, 10.0, 15.0])
_TOLERANCE = 1e-6  # of rotations that data sets give in single precision


def check_scene(scene: Scene, *, frames: int = 3, seed: int = 0) -> None:
    """Check that a scene is repeatable, valid and of the requested length.

    scene:  a new instance; it is copied, and not changed
    frames: how many are recorded, at least 2;  seed: of its random draws
    Raises AssertionError.
    """
    subject = f"{type(scene).__name__}.record"
    first, again, short = (_recorded(scene, seed, n, subject) for n in (frames, frames, 1))
    expect(len(first) <= frames, f"{subject}: found {len(first)} frames, expected at most {frames}")
    expect_same(first, again, f"{subject}: two recordings of one seed differ")
    expect(len(short) == 1, f"{subject}: found {len(short)} frames, expected 1")
    for name in ("id", "position"):
        same = np.array_equal(getattr(first.truth_at(0), name), getattr(short.truth_at(0), name))
        expect(same, f"{subject}: the first frame depends on how many are recorded: truth.{name}")
    _check_recording(subject, first)


def _recorded(scene: Scene, seed: int, frames: int, subject: str) -> Recording:
    recording = copy.deepcopy(scene).record(seed, frames)
    try:
        recording.validate()
    except (MastError, AttributeError, TypeError, ValueError) as error:
        raise AssertionError(f"{subject}: {error}") from error
    return recording


def _check_recording(subject: str, recording: Recording) -> None:
    """Check what `Recording.validate` does not."""
    turned = recording.agent_rotation @ np.swapaxes(recording.agent_rotation, -1, -2)
    right_handed = np.linalg.det(recording.agent_rotation) > 0.0
    sound = np.allclose(turned, np.eye(3), atol=_TOLERANCE) and right_handed.all()
    expect(sound, f"{subject}: agent_rotation has a matrix that is not a rotation")
    expect((recording.truth.size > 0.0).all(), f"{subject}: truth.size has a length that is not greater than 0")
    expect((recording.truth.class_id < len(CLASSES)).all(), f"{subject}: truth.class_id: expected below {len(CLASSES)}")
    expect((recording.points >= 0).all(), f"{subject}: points has negative numbers")
    known: set[int] = set()
    before: list[int] = []  # an object may have left since a sensor measured
    for frame in range(len(recording)):
        ids = recording.truth_at(frame).id.tolist()
        known.update(ids)
        recent, before = (ids if recording.measurements is None else [*ids, *before]), ids
        for column, agent in enumerate(recording.agents):
            rows = range(len(agent.sensors))
            detected = np.concatenate([recording.detection_truth_id_at(frame, column, row) for row in rows])
            unknown = set(detected.tolist()) - {-1, *recent}
            place = f"{subject}: detection_truth_id of {agent.name} in frame {frame}"
            expect(not unknown, f"{place}: no object {min(unknown, default=0)} in this frame")
    for agent in recording.agents:
        there = agent.object_id == -1 or agent.object_id in known
        expect(
            there, f"{subject}: {agent.name}: object_id is {agent.object_id}, which no object has: expected -1 for none"
        )


def check_detector(detector: Detector) -> None:
    """Check that a detector fulfils its contract.

    With zero, one and a thousand objects.

    Raises AssertionError.
    """
    for n in samples.COUNTS:
        subject = f"{type(detector).__name__}.detect with {n} objects"
        objects = samples.states(n)
        points = np.where(np.arange(n) % 3 == 1, 0, np.arange(n) % 90).astype(np.int32)
        with unchanged(subject, objects=objects, points=points, sensor_position=_SENSOR):
            found, ids = _detected(detector, objects, points)
        count = len(ids)
        expect(isinstance(found, Detections), f"{subject}: found {type(found).__name__}, expected Detections")
        expect(len(found) == count, f"{subject}: {len(found)} detections and {count} ids, expected equal numbers")
        expect_finite(found, subject)
        expect((np.diff(found.score) <= 0.0).all(), f"{subject}: the best score is not first")
        expect(((found.score >= 0.0) & (found.score <= 1.0)).all(), f"{subject}: a score is not from 0 to 1")
        expect((found.size > 0.0).all(), f"{subject}: a size is not greater than 0")
        seen = objects.id[points > 0]
        expect(np.isin(ids, np.append(seen, -1)).all(), f"{subject}: detects an object without lidar returns")
        text = f"{subject}: two runs with the same random stream differ"
        expect_same((found, ids), _detected(detector, objects, points), text)
        order = np.random.default_rng(n).permutation(n)
        shuffled = _detected(detector, objects.select(order), points[order])
        expect_same(_sorted(found, ids), _sorted(*shuffled), f"{subject}: depends on the order of the rows")


def _detected(detector: Detector, objects: ObjectStates, points: np.ndarray) -> tuple[Detections, Ints]:
    made, random = copy.deepcopy(detector), np.random.default_rng(5)
    return made.detect(objects, points, LidarSensor(), _SENSOR, np.eye(3), 0.0, random)


def _sorted(found: Detections, ids: Ints) -> tuple[Detections, Ints]:
    """In a canonical order: detections with equal scores may come in any order."""
    order = np.lexsort((*found.position.T, found.score, ids))
    return found.select(order), ids[order]

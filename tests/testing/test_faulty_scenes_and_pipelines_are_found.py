"""Faulty scenes, detectors and pipelines are found, and their fault is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mast_zenoh import testing
from mast_zenoh.arrays.states import DETECTION_COLUMNS, Detections, concatenate
from mast_zenoh.fusion import CovarianceIntersectionFusion, GroupTrackerWrapper, SampledAssignmentClusterer
from mast_zenoh.pipelines import AgentPipeline, CommandCenterPipeline, PictureFirst
from mast_zenoh.scenes.generated.intersection import Intersection
from mast_zenoh.sensing import CleanDetector
from mast_zenoh.tracking import KalmanBoxTracker3D


class Drifting(Intersection):
    """A scene that goes on drawing where the recording before has ended."""

    random = np.random.default_rng()

    def record(self, seed: int, frames: int | None) -> Any:
        return super().record(int(self.random.integers(1 << 30)), frames)


class Endless(Intersection):
    def record(self, seed: int, frames: int | None) -> Any:
        return super().record(seed, (frames or 20) + 1)


class ChangedRecording(Intersection):
    """A scene that returns our recording with changes."""

    def changes(self, recording: Any) -> dict[str, Any]:
        return {}

    def record(self, seed: int, frames: int | None) -> Any:
        recording = super().record(seed, frames)
        return replace(recording, **self.changes(recording))


class Mirrored(ChangedRecording):
    def changes(self, recording: Any) -> dict[str, Any]:
        return {"agent_rotation": -recording.agent_rotation}


class Twins(ChangedRecording):
    def changes(self, recording: Any) -> dict[str, Any]:
        return {"truth": recording.truth.with_(id=np.zeros_like(recording.truth.id))}


class Phantoms(ChangedRecording):
    def changes(self, recording: Any) -> dict[str, Any]:
        return {"detection_truth_id": recording.detection_truth_id + 7777}


class Flat(ChangedRecording):
    def changes(self, recording: Any) -> dict[str, Any]:
        return {"points": recording.points[:, :1]}


class WorstFirst(CleanDetector):
    def detect(self, *sensed: Any) -> Any:
        found, ids = super().detect(*sensed)
        return replaced(found, score=np.linspace(0.1, 0.9, len(ids))), ids


class Clairvoyant(CleanDetector):
    def detect(self, objects: Any, points: Any, *sensed: Any) -> Any:
        return super().detect(objects, np.full_like(points, 99), *sensed)


class RowByRow(CleanDetector):
    """Draws numbers for the rows as they come."""

    def detect(self, *sensed: Any) -> Any:
        found, ids = super().detect(*sensed)
        noise = sensed[-1].normal(size=(len(ids), 3))
        return replaced(found, position=found.position + noise), ids


class Countless(CleanDetector):
    def detect(self, *sensed: Any) -> Any:
        found, ids = super().detect(*sensed)
        return found, ids[:-1]


def replaced(found: Detections, **columns: Any) -> Detections:
    return Detections(**{**{name: getattr(found, name) for name in DETECTION_COLUMNS}, **columns})


class TwoOfEach(PictureFirst):
    def estimate(self, time_ns: int, own: Any, picture: Any) -> Any:
        return concatenate([super().estimate(time_ns, own, picture)] * 2)


class EverNew(PictureFirst):
    first = 0

    def estimate(self, time_ns: int, own: Any, picture: Any) -> Any:
        merged = super().estimate(time_ns, own, picture)
        self.first += len(merged)
        return merged.with_(id=np.arange(len(merged)) + self.first)


class FirstAgentOnly(CommandCenterPipeline):
    """Takes the agents in the order in which they are listed."""

    def step(self, time_ns: int, states: Any, agent: Any, agents: Any, weights: Any = None) -> Any:
        first = agent == 0
        return super().step(
            time_ns, states.select(first), agent[first], agents, None if weights is None else weights[first]
        )


class Lasting(CommandCenterPipeline):
    def reset(self) -> None: ...


class Nowhere(AgentPipeline):
    def track(self, *sensed: Any) -> Any:
        tracks, origin, rotation = super().track(*sensed)
        return tracks, origin, 0.0 * rotation


def stages() -> dict[str, Any]:
    """The parts of a command centre's pipeline."""
    grouped = GroupTrackerWrapper(fusion=CovarianceIntersectionFusion(), tracker=KalmanBoxTracker3D())
    return {"clustering": SampledAssignmentClusterer(), "group_tracking": grouped}


@pytest.mark.parametrize(
    ("check", "faulty", "message"),
    [
        (testing.check_scene, Drifting(), "Drifting.record: two recordings of one seed differ"),
        (testing.check_scene, Endless(), "Endless.record: found 4 frames, expected at most 3"),
        (testing.check_scene, Mirrored(), "Mirrored.record: agent_rotation has a matrix that is not a rotation"),
        (testing.check_scene, Twins(), "Twins.record: .*frame 0 has two truth rows with the same id"),
        (testing.check_scene, Phantoms(), "Phantoms.record: detection_truth_id of ego in frame 0: no object 7"),
        (testing.check_scene, Flat(), "Flat.record: .*points has shape"),
        (testing.check_detector, WorstFirst(), "WorstFirst.detect with 1000 objects: the best score is not first"),
        (testing.check_detector, Clairvoyant(), "Clairvoyant.detect .*: detects an object without lidar returns"),
        (testing.check_detector, RowByRow(), "RowByRow.detect with 1000 objects: depends on the order of the rows"),
        (testing.check_detector, Countless(), "Countless.detect .*detections and .* ids, expected equal numbers"),
        (testing.check_mission_estimator, TwoOfEach(), "TwoOfEach.estimate .*: ids are not unique"),
        (testing.check_mission_estimator, EverNew(), "EverNew.estimate .*: .* or ids do not last"),
        (testing.check_pipeline, FirstAgentOnly(**stages()), "FirstAgentOnly.step .*: depends on the order of the"),
        (testing.check_pipeline, Lasting(**stages()), "Lasting.step .*: after `reset` it differs from a new instance"),
        (testing.check_pipeline, Nowhere(tracker=KalmanBoxTracker3D(), mission=PictureFirst()), "rotation is not"),
        (
            testing.check_pipeline,
            AgentPipeline(tracker=KalmanBoxTracker3D(), mission=TwoOfEach()),
            "TwoOfEach.estimate .*: ids are not unique",
        ),
    ],
    ids=lambda value: type(value).__name__ if not callable(value) and not isinstance(value, str) else "",
)
def test_the_mistake_of_a_faulty_class_is_named(check: Callable[[Any], None], faulty: Any, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check(faulty)

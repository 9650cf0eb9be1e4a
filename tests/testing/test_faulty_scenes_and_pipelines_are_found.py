"""Faulty scenes, detectors and pipelines are found, and their fault is named."""

from dataclasses import replace

import numpy as np
import pytest

from mast_zenoh import testing
from mast_zenoh.arrays.states import concatenate
from mast_zenoh.fusion import CovarianceIntersectionFusion, GroupTrackerWrapper, SampledAssignmentClusterer
from mast_zenoh.fusion.pipelines import AgentPipeline, CommandCenterPipeline, PictureFirst
from mast_zenoh.scenes.generated.intersection import Intersection
from mast_zenoh.sensing import CleanDetector
from mast_zenoh.tracking import KalmanBoxTracker3D

DRAWN = np.random.default_rng()


def scene(name: str, record):
    return type(name, (Intersection,), {"record": record})()


def changed(name: str, changes):
    """A scene that returns our recording with changes."""

    def record(self, seed, frames):
        recording = Intersection.record(self, seed, frames)
        return replace(recording, **changes(recording))

    return scene(name, record)


def detector(name: str, change):
    """A detector that changes what a clean one has found: detections, ids, and what it sensed."""

    def detect(self, *sensed):
        return change(*CleanDetector.detect(self, *sensed), sensed)

    return type(name, (CleanDetector,), {"detect": detect})()


def clairvoyant(self, objects, points, *sensed):
    return CleanDetector.detect(self, objects, np.full_like(points, 99), *sensed)


def ever_new(self, time_ns, own, picture):
    merged = PictureFirst.estimate(self, time_ns, own, picture)
    self.first = getattr(self, "first", 0) + len(merged)
    return merged.with_(id=np.arange(len(merged)) + self.first)


def first_agent_only(self, time_ns, states, agent, agents, weights=None):
    """Takes the agents in the order in which they are listed."""
    first = agent == 0
    weights = None if weights is None else weights[first]
    return CommandCenterPipeline.step(self, time_ns, states.select(first), agent[first], agents, weights)


def nowhere(self, *sensed):
    tracks, origin, rotation = AgentPipeline.track(self, *sensed)
    return tracks, origin, 0.0 * rotation


class TwoOfEach(PictureFirst):
    def estimate(self, time_ns, own, picture):
        return concatenate([super().estimate(time_ns, own, picture)] * 2)


def centre(name: str, **methods):
    grouped = GroupTrackerWrapper(fusion=CovarianceIntersectionFusion(), tracker=KalmanBoxTracker3D())
    kind = type(name, (CommandCenterPipeline,), methods)
    return kind(clustering=SampledAssignmentClusterer(), group_tracking=grouped)


def agents(kind: type = AgentPipeline, mission: PictureFirst | None = None):
    return kind(tracker=KalmanBoxTracker3D(), mission=mission or PictureFirst())


SCENES = {
    "Drifting.record: two recordings of one seed differ": scene(
        "Drifting", lambda self, seed, frames: Intersection.record(self, int(DRAWN.integers(1 << 30)), frames)
    ),
    "Endless.record: found 4 frames, expected at most 3": scene(
        "Endless", lambda self, seed, frames: Intersection.record(self, seed, (frames or 20) + 1)
    ),
    "Mirrored.record: agent_rotation has a matrix that is not a rotation": changed(
        "Mirrored", lambda recording: {"agent_rotation": -recording.agent_rotation}
    ),
    "Twins.record: .*frame 0 has two truth rows with the same id": changed(
        "Twins", lambda recording: {"truth": recording.truth.with_(id=np.zeros_like(recording.truth.id))}
    ),
    "Phantoms.record: detection_truth_id of ego in frame 0: no object 7": changed(
        "Phantoms", lambda recording: {"detection_truth_id": recording.detection_truth_id + 7777}
    ),
    "Flat.record: .*points has shape": changed("Flat", lambda recording: {"points": recording.points[:, :1]}),
}
DETECTORS = {
    "WorstFirst.detect with 1000 objects: the best score is not first": detector(
        "WorstFirst", lambda detections, ids, _: (replace(detections, score=np.linspace(0.1, 0.9, len(ids))), ids)
    ),
    "Clairvoyant.detect .*: detects an object without lidar returns": type(
        "Clairvoyant", (CleanDetector,), {"detect": clairvoyant}
    )(),
    "RowByRow.detect with 1000 objects: depends on the order of the rows": detector(
        "RowByRow",
        lambda detections, ids, sensed: (
            replace(detections, position=detections.position + sensed[-1].normal(size=(len(ids), 3))),
            ids,
        ),
    ),
    "Countless.detect .*detections and .* ids, expected equal numbers": detector(
        "Countless", lambda detections, ids, _: (detections, ids[:-1])
    ),
}
ESTIMATORS = {
    "TwoOfEach.estimate .*: ids are not unique": TwoOfEach(),
    "EverNew.estimate .*: .* or ids do not last": type("EverNew", (PictureFirst,), {"estimate": ever_new})(),
}
PIPELINES = {
    "FirstAgentOnly.step .*: depends on the order of the": centre("FirstAgentOnly", step=first_agent_only),
    "Lasting.step .*: after `reset` it differs from a new instance": centre("Lasting", reset=lambda self: None),
    "rotation is not": agents(type("Nowhere", (AgentPipeline,), {"track": nowhere})),
    "TwoOfEach.estimate .*: ids are not unique": agents(mission=TwoOfEach()),
}
CHECKS = {
    testing.check_scene: SCENES,
    testing.check_detector: DETECTORS,
    testing.check_mission_estimator: ESTIMATORS,
    testing.check_pipeline: PIPELINES,
}


@pytest.mark.parametrize(("check", "message"), [(check, text) for check, faulty in CHECKS.items() for text in faulty])
def test_the_mistake_of_a_faulty_class_is_named(check, message):
    with pytest.raises(AssertionError, match=message):
        check(CHECKS[check][message])

"""A class that does not keep to what its base class says is found, and the message says what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mast_zenoh import testing
from mast_zenoh.api.runs import Run
from mast_zenoh.arrays.states import DETECTION_COLUMNS, Detections, concatenate
from mast_zenoh.attacks import PassThrough, alter
from mast_zenoh.faults import Fault
from mast_zenoh.fusion import CovarianceIntersectionFusion, GroupTrackerWrapper, SampledAssignmentClusterer
from mast_zenoh.links import Rule
from mast_zenoh.metrics import FrameMetric
from mast_zenoh.node import Node
from mast_zenoh.pipelines import AgentPipeline, CommandCenterPipeline, PictureFirst
from mast_zenoh.scenes import Intersection
from mast_zenoh.sensing import CleanDetector
from mast_zenoh.testing.fixtures import play  # noqa: F401 (a fixture)
from mast_zenoh.tracking import KalmanBoxTracker3D


class RenumberingTracker(KalmanBoxTracker3D):
    def step(self, time_ns: int, detections: Any, view: Any = None) -> Any:
        tracks = super().step(time_ns, detections, view)
        return tracks.with_(id=np.arange(len(tracks)), score=np.resize(detections.score, len(tracks)))


class ForgetfulTracker(KalmanBoxTracker3D):
    def reset(self) -> None:
        if not hasattr(self, "started"):
            super().reset()
        self.started = True


class OneCluster(SampledAssignmentClusterer):
    def cluster(self, states: Any, agent: Any) -> Any:
        return np.zeros(len(agent), np.int64)


class UnweightedFusion(CovarianceIntersectionFusion):
    def fuse(self, states: Any, labels: Any, weights: Any = None) -> Any:
        return super().fuse(states, labels)


class RoundingFusion(CovarianceIntersectionFusion):
    def fuse(self, states: Any, labels: Any, weights: Any = None) -> Any:
        np.round(states.position, 1, out=states.position)
        return super().fuse(states, labels, weights)


class HidesFirstRow(PassThrough):
    def step(self, frame: int, time_ns: int, objects: Any, agent_position: Any, directive: Any = None) -> Any:
        return alter(objects, hide=[0] if len(objects) else [])


class Unrepeatable(PassThrough):
    def step(self, frame: int, time_ns: int, objects: Any, agent_position: Any, directive: Any = None) -> Any:
        return alter(objects, insert=objects.with_(position=np.random.default_rng().normal(size=(len(objects), 3))))


class MeanRange(FrameMetric):
    def per_frame(self, estimate: Any) -> Any:
        return np.full(len(estimate.frames), estimate.range_m.max())


class FirstBox(FrameMetric):
    def per_frame(self, estimate: Any) -> Any:
        return np.resize(estimate.range_m[:1], len(estimate.frames)) if len(estimate.range_m) else estimate.frames * 0.0


class Early(Rule):
    fate = "delayed"

    def apply(self, passage: Any, row: Any) -> Any:
        return (passage._replace(delay_ns=-1),)


class Vanish(Rule):
    fate = "vanished"

    def apply(self, passage: Any, row: Any) -> Any:
        return ()


@dataclass(frozen=True, kw_only=True)
class Fizzle(Fault):
    @property
    def over(self) -> float | None:
        return None


@dataclass(frozen=True, kw_only=True)
class Misspelt(Fizzle):
    def rules(self, lockstep: bool) -> Any:
        return [dict(type="Los", probability=0.5)]


@dataclass(frozen=True, kw_only=True)
class Explode(Fizzle):
    def events(self) -> Any:
        return [(self.at, "explode")]


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
    def estimate(self, own: Any, picture: Any) -> Any:
        return concatenate([super().estimate(own, picture)] * 2)


class OwnIds(PictureFirst):
    def estimate(self, own: Any, picture: Any) -> Any:
        merged = super().estimate(own, picture)
        return merged.with_(id=np.arange(len(merged)) + 5000)


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
    """Those of a command centre."""
    grouped = GroupTrackerWrapper(fusion=CovarianceIntersectionFusion(), tracker=KalmanBoxTracker3D())
    return {"clustering": SampledAssignmentClusterer(), "group_tracking": grouped}


@pytest.mark.parametrize(
    ("check", "faulty", "message"),
    [
        (testing.check_tracker, RenumberingTracker(), "RenumberingTracker.step .*: depends on the order of the rows"),
        (
            testing.check_tracker,
            ForgetfulTracker(),
            "ForgetfulTracker.step .*after `reset` it is not as newly made: time_ns of a step",
        ),
        (testing.check_clusterer, OneCluster(), "OneCluster.cluster with 1000 tracks: a cluster has two tracks of one"),
        (
            testing.check_fusion,
            UnweightedFusion(),
            "UnweightedFusion.fuse .*: a cluster without trusted members is not left",
        ),
        (testing.check_fusion, RoundingFusion(), "RoundingFusion.fuse .*: changed its input states.position"),
        (testing.check_attack, HidesFirstRow(), "HidesFirstRow.step .*: depends on the order of the rows: keep"),
        (testing.check_attack, Unrepeatable(), "Unrepeatable.step .*: two of one seed and name do different things"),
        (testing.check_metric, MeanRange(), "MeanRange with 0 boxes in 1 frames: ValueError: zero-size array"),
        (testing.check_metric, FirstBox(), "FirstBox with 1000 boxes .*: depends on the order of the boxes"),
        (testing.check_link_rule, Early(), "Early.apply: a message leaves before it has come"),
        (testing.check_link_rule, Vanish(), "Vanish.fate: found 'vanished', expected one of dropped, delayed"),
        (testing.check_fault, Fizzle(at=1.0, node="ego"), "Fizzle: has neither rules nor events"),
        (testing.check_fault, Misspelt(at=1.0, node="ego"), r"Misspelt.rules\[0\].type: .*did you mean 'Loss'"),
        (testing.check_scene, Drifting(), "Drifting.record: two recordings of one seed differ"),
        (testing.check_scene, Endless(), "Endless.record: found 4 frames, expected at most 3"),
        (testing.check_scene, Mirrored(), "Mirrored.record: agent_rotation has a matrix that is no rotation"),
        (testing.check_scene, Twins(), "Twins.record: .*frame 0 has two truth rows with the same id"),
        (testing.check_scene, Phantoms(), "Phantoms.record: detection_truth_id of ego in frame 0: no object 7"),
        (testing.check_scene, Flat(), "Flat.record: .*points has shape"),
        (testing.check_detector, WorstFirst(), "WorstFirst.detect with 1000 objects: the best score is not first"),
        (testing.check_detector, Clairvoyant(), "Clairvoyant.detect .*: detects an object without lidar returns"),
        (testing.check_detector, RowByRow(), "RowByRow.detect with 1000 objects: depends on the order of the rows"),
        (testing.check_detector, Countless(), "Countless.detect .*detections and .* ids, expected as many"),
        (testing.check_mission_estimator, TwoOfEach(), "TwoOfEach.estimate .*: ids are not unique"),
        (testing.check_mission_estimator, OwnIds(), "OwnIds.estimate .*: an id is neither 2 i of the picture nor"),
        (
            testing.check_pipeline,
            FirstAgentOnly(**stages()),
            "FirstAgentOnly.step .*: depends on the order of the rows or of the agents",
        ),
        (testing.check_pipeline, Lasting(**stages()), "Lasting.step .*: after `reset` it is not as newly made"),
        (
            testing.check_pipeline,
            Nowhere(tracker=KalmanBoxTracker3D(), mission=PictureFirst()),
            "Nowhere.track .*: rotation is no quaternion of length 1",
        ),
        (
            testing.check_pipeline,
            AgentPipeline(tracker=KalmanBoxTracker3D(), mission=TwoOfEach()),
            "TwoOfEach.estimate .*: ids are not unique",
        ),
        (testing.check_fault, Explode(at=1.0, node="ego"), "Explode.events: found 'explode', expected one of kill"),
    ],
    ids=lambda value: type(value).__name__ if not callable(value) and not isinstance(value, str) else "",
)
def test_what_a_class_does_wrong_is_named(check: Callable[[Any], None], faulty: Any, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check(faulty)


class Deaf(Node):
    role = "deaf"
    inputs = {"picture": "picture"}


class Babbler(Node):
    role = "babbler"
    outputs = {"words": "words"}


@pytest.mark.parametrize(
    ("node", "message"),
    [(Deaf, "Deaf has no on_picture"), (Babbler, r"Babbler.outputs\['words'\]: there is no message type 'words'")],
)
def test_a_node_with_unsuitable_ports_is_named(node: type[Node], message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        testing.check_node(node)


WATCHED = """
from mast_zenoh.node import Node
from mast_zenoh.scenario import load


class Watcher(Node):
    role = "watcher"
    inputs = {"tracks": "tracks"}

    def __init__(self):
        self.order = []

    def on_tracks(self, received, context):
        DOES

    def finish(self, context):
        return {"order": self.order}


def scenario():
    _, ours = load("baseline", ["n_infrastructure=2"])
    listen = dict(wire="agent/*/tracks", role="watcher", input="tracks")
    nodes = dict(watcher=dict(role="watcher", file="watched.py"))
    return ours | dict(nodes=nodes, keyexpr=dict(map="testbed.toml", rewrites=[dict(listen=[listen])]))
"""


def watched(folder: Path, does: str) -> Path:
    """A scenario with a node that listens to the tracks of all agents."""
    (folder / "watched.py").write_text(WATCHED.replace("DOES", does))
    return folder / "watched.py"


@pytest.mark.parametrize(
    ("does", "message"),
    [
        ("self.order.append(received.subject)", "results of nodes differ in another order of delivery"),
        ("received.body['nosuch']", "a handler has failed: .*watcher.*on_tracks"),
    ],
)
def test_what_a_node_does_wrong_is_found_by_playing_its_scenario(tmp_path: Path, does: str, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        testing.check_scenario(watched(tmp_path, does), frames=5)


def test_a_node_that_only_listens_passes(tmp_path: Path) -> None:
    testing.check_scenario(watched(tmp_path, "self.order.append(1)"), frames=5)


def test_the_fixture_runs_a_scenario_in_a_folder_of_the_test(play: Callable[..., Run], tmp_path: Path) -> None:  # noqa: F811
    run = play("baseline", frames=3, n_infrastructure=1)
    assert run.status == "ok"
    assert run.path.parent == tmp_path
    assert play("baseline", frames=3, n_infrastructure=1).path != run.path

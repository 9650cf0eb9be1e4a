"""Classes that violate their base class are found with a clear message."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mast_zenoh import testing
from mast_zenoh.api.runs import OpenedRun
from mast_zenoh.attacks import PassThrough, alter
from mast_zenoh.driving import Command, Driver
from mast_zenoh.faults import Fault
from mast_zenoh.fusion import CovarianceIntersectionFusion, SampledAssignmentClusterer
from mast_zenoh.links import Rule
from mast_zenoh.metrics import FrameMetric
from mast_zenoh.node import Node
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


class Reckless(Driver):
    def drive(self, situation: Any) -> Any:
        return Command(99.0, 0.0)


class Unsure(Driver):
    def drive(self, situation: Any) -> Any:
        return Command(float("nan") if len(situation.objects) else 0.0, 0.0)


class AfraidOfTheFirst(Driver):
    def drive(self, situation: Any) -> Any:
        objects = situation.objects
        return Command(-1.0 if len(objects) and objects.id[0] == 0 else 0.0, 0.0)


class Nervous(Driver):
    frames = [0]

    def drive(self, situation: Any) -> Any:
        self.frames[0] += 1
        return Command(-0.1 * (self.frames[0] % 3), 0.0)


class Counting(Driver):
    driven = [0]

    def drive(self, situation: Any) -> Any:
        Counting.driven[0] += situation.speed == 3.0
        return Command(-0.001 * min(self.driven[0], 1000), 0.0)


class Parking(Driver):
    def drive(self, situation: Any) -> Any:
        situation.velocity[:] = 0.0
        return Command(0.0, 0.0)


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


@pytest.mark.parametrize(
    ("check", "faulty", "message"),
    [
        (testing.check_tracker, RenumberingTracker(), r"RenumberingTracker.step.*depends.*order"),
        (testing.check_tracker, ForgetfulTracker(), "ForgetfulTracker.step .*after `reset`"),
        (testing.check_clusterer, OneCluster(), r"OneCluster.cluster.*tracks.*cluster"),
        (testing.check_fusion, UnweightedFusion(), r"UnweightedFusion.fuse.*cluster without"),
        (testing.check_fusion, RoundingFusion(), r"RoundingFusion.fuse.*changed.*states.position"),
        (testing.check_attack, HidesFirstRow(), r"HidesFirstRow.step.*depends.*rows"),
        (testing.check_attack, Unrepeatable(), r"Unrepeatable.step.*instances.*same"),
        (testing.check_driver, Reckless(), r"Reckless.drive.*refuses.*99"),
        (testing.check_driver, Unsure(), r"Unsure.drive.*objects.*numbers"),
        (testing.check_driver, AfraidOfTheFirst(), r"AfraidOfTheFirst.drive.*order.*objects"),
        (testing.check_driver, Nervous(), r"Nervous.drive.*depends.*objects"),
        (testing.check_driver, Counting(), r"Counting.drive.*deterministic.*share"),
        (testing.check_driver, Parking(), r"Parking.drive.*changed.*situation.velocity"),
        (testing.check_metric, MeanRange(), r"MeanRange.*frames: ValueError"),
        (testing.check_metric, FirstBox(), r"FirstBox.*boxes.*depends"),
        (testing.check_link_rule, Early(), r"Early.apply.*message.*arrives"),
        (testing.check_link_rule, Vanish(), r"Vanish.fate.*'vanished'.*dropped"),
        (testing.check_fault, Fizzle(at=1.0, node="ego"), r"Fizzle.*neither.*events"),
        (testing.check_fault, Misspelt(at=1.0, node="ego"), r"Misspelt.rules\[0\].type.*mean 'Loss'"),
        (testing.check_fault, Explode(at=1.0, node="ego"), r"Explode.events.*'explode'.*kill"),
    ],
    ids=lambda value: type(value).__name__ if not callable(value) and not isinstance(value, str) else "",
)
def test_faults_of_a_class_are_named(check: Callable[[Any], None], faulty: Any, message: str) -> None:
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
    [(Deaf, r"Deaf.*no on_picture"), (Babbler, r"Babbler.outputs\['words'\].*message.*'words'")],
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
    _, base = load("baseline", ["n_infrastructure=2"])
    listen = dict(wire="agent/*/tracks", role="watcher", input="tracks")
    nodes = dict(watcher=dict(role="watcher", file="watched.py"))
    return base | dict(nodes=nodes, keyexpr=dict(map="testbed.toml", rewrites=[dict(listen=[listen])]))
"""


def watched(folder: Path, does: str) -> Path:
    """A scenario with a node that listens to the tracks of all agents."""
    (folder / "watched.py").write_text(WATCHED.replace("DOES", does))
    return folder / "watched.py"


@pytest.mark.parametrize(
    ("does", "message"),
    [
        ("self.order.append(received.subject)", r"results.*another.*delivery"),
        ("received.body['nosuch']", "a handler failed: .*watcher.*on_tracks"),
    ],
)
def test_faults_of_a_node_are_found_by_playing_its_scenario(tmp_path: Path, does: str, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        testing.check_scenario(watched(tmp_path, does), frames=5)


def test_a_node_that_fails_when_another_is_lost_is_found_on_the_simulated_mesh(tmp_path: Path) -> None:
    scenario = watched(tmp_path, "pass\n\n    def left(self, node, role, context):\n        self.agents.remove(node)")
    testing.check_scenario(scenario, frames=5)
    with pytest.raises(AssertionError, match=r"watcher\.left failed"):
        testing.check_scenario(scenario, frames=5, schedules=100)


def test_a_listen_only_node_passes(tmp_path: Path) -> None:
    testing.check_scenario(watched(tmp_path, "self.order.append(1)"), frames=5, schedules=10)


def test_the_fixture_runs_a_scenario_in_a_folder_of_the_test(play: Callable[..., OpenedRun], tmp_path: Path) -> None:  # noqa: F811
    run = play("baseline", frames=3, n_infrastructure=1)
    assert run.status == "ok"
    assert run.path.parent == tmp_path
    assert play("baseline", frames=3, n_infrastructure=1).path != run.path

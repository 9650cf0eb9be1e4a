"""Every shipped class passes the checks for user-defined classes."""

import inspect
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import mast_datasets
import pytest
from fuzzing import Fuzzing

from mast_zenoh import (
    attacks,
    driving,
    faults,
    fusion,
    integrity,
    links,
    metrics,
    scenario,
    scenes,
    sensing,
    testing,
    tracking,
)
from mast_zenoh.attacks import evasion, road_ahead
from mast_zenoh.config import bundle, loading, plugins, registry
from mast_zenoh.fusion import pipelines
from mast_zenoh.testing import samples
from mast_zenoh.testing.simulation import SimulatedWorld, explore

pytestmark = [pytest.mark.heavy, pytest.mark.long]

#: Values of required parameters.
NEEDED: dict[str, Any] = {
    "azimuth_min_deg": -30.0,
    "azimuth_max_deg": 30.0,
    "places": ((20.0, 5.0, 0.75),),
    "at": 1.0,
    "until": 2.0,
    "node": "ego",
    "probability": 0.3,
    "mean_s": 0.05,
    "by_s": 0.1,
    "delay_s": 0.1,
    "offset_s": 0.2,
    "bits_per_s": 1e6,
    "good_to_bad": 0.1,
    "bad_to_good": 0.3,
    "range_m": 50.0,
    "gateways": [(0.0, 0.0, 10.0)],
    "rule": dict(type="Loss", probability=0.5),
    "mission": dict(type="PictureFirst"),
    "tracker": dict(type="KalmanBoxTracker3D"),
    "fusion": dict(type="CovarianceIntersectionFusion"),
    "clustering": dict(type="SampledAssignmentClusterer"),
    "group_tracking": dict(
        type="GroupTrackerWrapper",
        fusion=dict(type="CovarianceIntersectionFusion"),
        tracker=dict(type="KalmanBoxTracker3D"),
    ),
}


def shipped(base: type) -> list[Any]:
    """Shipped classes that can be named where a base is expected."""
    classes = registry.known_types(base).items()
    return [
        pytest.param(cls, base, id=name)
        for name, cls in classes
        if cls.__module__.startswith(("mast_zenoh.", "mast_datasets."))
    ]


def made(cls: type, base: type) -> Any:
    """An object built like in a scenario."""
    parameters = inspect.signature(cls).parameters
    own = {name: each for name, each in parameters.items() if each.kind is not each.VAR_KEYWORD}
    required = {name for name, each in own.items() if each.default is each.empty}
    arguments = {name: NEEDED[name] for name in required | (parameters.keys() & {"until", "node", "gateways"})}
    return registry.build({"type": cls, **arguments}, base, cls.__name__)


CHECKS: dict[type, Callable[[Any], None]] = {
    attacks.Attack: testing.check_attack,
    driving.Driver: testing.check_driver,
    tracking.Tracker: testing.check_tracker,
    fusion.Clusterer: testing.check_clusterer,
    fusion.Fusion: testing.check_fusion,
    integrity.Integrity: testing.check_integrity,
    metrics.Metric: testing.check_metric,
    links.Rule: testing.check_link_rule,
    faults.Fault: testing.check_fault,
    sensing.Detector: testing.check_detector,
    pipelines.Pipeline: testing.check_pipeline,
    pipelines.AgentPipeline: testing.check_pipeline,
    pipelines.MissionEstimator: testing.check_mission_estimator,
}


#: Numbers of objects for classes that would take minutes with a thousand.
COUNTS = {tracking.StoneSoupTracker: (0, 1, 40)}


@pytest.mark.parametrize(("cls", "base"), [each for base in CHECKS for each in shipped(base)])
def test_a_shipped_class_conforms(cls: type, base: type, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(samples, "COUNTS", COUNTS.get(cls, samples.COUNTS))
    CHECKS[base](made(cls, base))


@pytest.mark.parametrize(
    "attack",
    [
        road_ahead.HideAhead(what="crossing"),
        road_ahead.LaneIntrusion(into="neighbour"),
        evasion.BlindAreaConfusion(action="hide"),
    ],
)
def test_a_shipped_attack_conforms_with_its_other_setting(attack: attacks.Attack) -> None:
    testing.check_attack(attack)


@cache
def saved() -> Path:
    """A scene in a file, beside it a folder of detections: none at all."""
    folder = Path(tempfile.mkdtemp())
    recording = scenes.Intersection(n_infrastructure=1).record(0, 5)
    recording.save(folder / "scene.npz")
    for name in recording.agent_names:
        (folder / f"{name}.txt").touch()
    return folder / "scene.npz"


def replayed() -> scenes.OwnDetections:
    return scenes.OwnDetections(scene=scenes.RecordingFile(path=str(saved())), path=str(saved().parent))


SCENES: dict[str, Callable[[], scenes.Scene]] = {
    "RecordingFile": lambda: scenes.RecordingFile(path=str(saved())),
    "OwnDetections": replayed,
    "Intersection": scenes.Intersection,
    "StraightRoad": lambda: scenes.StraightRoad(case="leader"),
}


@pytest.mark.parametrize("name", SCENES)
def test_a_shipped_scene_conforms(name: str) -> None:
    testing.check_scene(SCENES[name]())


def test_every_shipped_scene_is_checked() -> None:
    """Readers of data sets are checked in plugins/datasets/tests/test_all_readers.py, which names all of them."""
    plugins.load()
    assert {each.id for each in shipped(scenes.Scene)} == SCENES.keys() | set(mast_datasets.__all__)


@pytest.mark.parametrize("mission", [dict(type="PictureFirst"), dict(type="OwnAndPicture")])
@pytest.mark.parametrize("frame", ["world", "body"])
def test_an_agents_pipeline_conforms_in_every_frame(frame: str, mission: dict[str, Any]) -> None:
    spec = dict(type="AgentPipeline", tracker=NEEDED["tracker"], mission=mission, frame=frame)
    testing.check_pipeline(registry.build(spec, pipelines.AgentPipeline, "pipeline"))


@pytest.mark.parametrize("file", sorted((bundle.ROOT / "nodes").glob("*.py")), ids=lambda file: file.stem)
def test_a_shipped_node_conforms(file: Path) -> None:
    testing.check_node(loading.node_class(file))


REALTIME = {"rogue", "sybil", "two_hosts"}
LOCKSTEP = sorted({file.stem for file in (bundle.ROOT / "scenarios").glob("*.py")} - REALTIME)


@pytest.mark.parametrize("name", LOCKSTEP)
def test_a_shipped_scenario_keeps_every_promise_on_the_simulated_mesh(name: str, fuzzing: Fuzzing) -> None:
    fewer = {"n_mobile": 6} if name == "congested" else {}
    testing.check_scenario(name, frames=10, schedules=fuzzing.draws(2, 10), **fewer)


@pytest.mark.parametrize("name", ["rogue", "sybil"])
def test_a_shipped_scenario_of_real_time_keeps_every_promise_on_the_simulated_mesh(name: str) -> None:
    world = SimulatedWorld.of(scenario.resolve(*scenario.load(name, []), frames=10))
    assert world.resolved.mode == "realtime"
    explore(world, range(10))


@pytest.mark.mesh
def test_a_shipped_scenario_is_the_same_on_the_mesh() -> None:
    testing.check_scenario("coordinated", frames=10, mesh=True, n_infrastructure=2)

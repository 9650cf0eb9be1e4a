"""Remote nodes need only the mesh, and give the same results."""

from pathlib import Path
from typing import Any

import failing
import pytest
from equal_runs import assert_equal
from launched_apart import Beside

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import HandlerFailed, VersionMismatch
from mast_zenoh.launch import conclusion
from mast_zenoh.launch import run as launcher
from mast_zenoh.launch.file_server import files_for_node

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]


def small(frames: int = 5, **run: object) -> Resolved:
    path, loaded = scenario.load("uncoordinated", ["n_infrastructure=2", "n_adversaries=1", "attack_start_s=0.1"])
    return scenario.resolve(path, loaded, frames=frames, record=True, **run)


def test_a_node_of_another_version_is_refused_and_both_versions_are_named(tmp_path: Path) -> None:
    other = Beside({"ego": "remote_node.version.version_string = lambda: '0.0.9 (sources beef)'"})
    outcome = launcher.run(small(), tmp_path / "run", engine=other)
    assert isinstance(outcome.error, VersionMismatch)
    assert "ego runs mast-zenoh 0.0.9 (sources beef), the launcher 0.1.0 (sources " in str(outcome.error)
    assert outcome.record["nodes"]["ego"]["exit"] == VersionMismatch.exit_code


SCENARIO = """
from mast_zenoh import scenario as scenarios
from mast_zenoh.fusion.clustering import SampledAssignmentClusterer
from numbers_of_mine import RADIUS


class MyClusterer(SampledAssignmentClusterer):
    def __init__(self):
        super().__init__(assign_radius=RADIUS)


def scenario(n_infrastructure=1):
    _, loaded = scenarios.load("baseline", [f"n_infrastructure={n_infrastructure}"])
    loaded["command_center"]["pipeline"]["clustering"] = dict(type="MyClusterer")
    loaded["agents"] = {"*": loaded["agents"]["*"] | dict(file="my_agent.py")}
    return loaded
"""
NODE = """
from mast_zenoh.config.bundle import ROOT
from mast_zenoh.config.loading import node_class
from numbers_of_mine import RADIUS


class MyAgent(node_class(ROOT / "nodes" / "agent.py")):
    radius = RADIUS
"""


def test_a_users_files_and_their_imports_reach_the_nodes(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    for name, text in (("my_scenario", SCENARIO), ("my_agent", NODE), ("numbers_of_mine", "RADIUS = 2.5")):
        (folder / f"{name}.py").write_text(text)
    path, loaded = scenario.load(str(folder / "my_scenario.py"), [])
    resolved = scenario.resolve(path, loaded, frames=3, record=True)
    here = launcher.run(resolved, tmp_path / "here", runtime="inproc")
    assert here.error is None
    sent = {name: dict(files_for_node(resolved, name, here.folder)) for name in ("ego", "command_center")}
    assert {path for path in sent["ego"] if path.endswith(".py")} == {
        "files/0/my_agent.py",
        "files/0/my_scenario.py",
        "files/0/numbers_of_mine.py",
    }
    there = launcher.run(resolved, tmp_path / "there", engine=Beside())
    assert there.error is None, there.error
    assert_equal(here.folder, there.folder)


def outcome_of(run: launcher.EndedRun) -> tuple[Any, ...]:
    """Failures by node, notices, and files of results."""
    failed = {
        node: [failure | {"where": Path(failure["where"]).name} for failure in failures]
        for node, failures in run.failures.items()
    }
    files = {path.relative_to(run.folder): path.read_bytes() for path in run.folder.glob("results/*/*")}
    return failed, [notice["text"] for notice in run.record["notices"]], files


def test_remote_nodes_have_the_same_failures_and_results_as_in_one_process(tmp_path: Path) -> None:
    runs = {}
    for name, error in (("attack", HandlerFailed), ("second", None)):
        resolved = scenario.resolve(*scenario.load(str(failing.write(name, tmp_path)), []), frames=8)
        runs["here"] = launcher.run(resolved, tmp_path / f"{name}_here", runtime="inproc")
        runs["there"] = launcher.run(resolved, tmp_path / f"{name}_there", engine=Beside(), secure="acl")
        for run in runs.values():
            assert type(run.error) is (error or type(None)), run.error
        here, there = (outcome_of(run) for run in runs.values())
        assert here == there
    assert {path.as_posix() for path in here[2]} >= {"results/counter/metrics.parquet", "results/counter/results.json"}


#: The process of a node ends at once when it has handed in its results; files that grow are not sent before.
ENDS_WITH_ITS_RESULTS = (
    "import os; from mast_zenoh.mesh import file_client; "
    "from mast_zenoh.mesh.zenoh_process import ZenohProcess; "
    "file_client._HAND_IN_EVERY_S = 3600.0; run = ZenohProcess.run; "
    "ZenohProcess.run = lambda self: (run(self), os._exit(0))"
)


def test_a_run_with_remote_nodes_that_end_with_their_results_equals_the_one_in_one_process(tmp_path: Path) -> None:
    resolved = small()
    here = launcher.run(resolved, tmp_path / "here", runtime="inproc")
    there = launcher.run(resolved, tmp_path / "there", engine=Beside({"recorder": ENDS_WITH_ITS_RESULTS}), secure="acl")
    assert there.error is None
    assert_equal(here.folder, there.folder)
    for node in there.record["nodes"].values():
        assert abs(node["clock"]["offset_ms"]) <= node["clock"]["round_trip_ms"], "both use the same clock"
        assert node["versions"]["numpy"] == there.record["versions"]["numpy"]


def test_arrival_times_on_a_clock_that_is_ahead_are_corrected() -> None:
    outcomes = {
        "simulator": {"sent_ns": {0: 1_000_000}, "clock": {"offset_ms": 1.0, "round_trip_ms": 0.1}},
        "evaluator": {"arrived_ns": {"cc/picture": {0: 9_000_000}}, "clock": {"offset_ms": -2.5, "round_trip_ms": 0.1}},
        "ego": {"arrived_ns": {"clock": {0: 5}}},
    }
    sent, arrived = conclusion.on_launcher_clock(outcomes)
    assert sent == {0: 0}
    assert arrived == {"simulator": {}, "evaluator": {"cc/picture": {0: 11_500_000}}, "ego": {"clock": {0: 5}}}

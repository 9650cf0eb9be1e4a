"""Nodes of ROS 2 in a process of their own take part in runs on a mesh, as in one process; also by TLS."""

import json
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from equal_runs import assert_equal
from launched import Observer, eventually
from mast_ros2.mesh import Tls
from ros2_process import ADVERSARY, AGENT, CENTER, Ros2Process
from ros2_worlds import with_ros2

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import Interrupted
from mast_zenoh.launch import live_interception
from mast_zenoh.launch import run as launcher
from mast_zenoh.launch.replay import resolution as replay
from mast_zenoh.mesh.security.authority import Authority
from mast_zenoh.mesh.security.levels import router_settings
from mast_zenoh.mesh.session import open_router
from mast_zenoh.run_folder.recording.reader import read

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]

QUIET = Path(__file__).parents[4] / "tests" / "support" / "live" / "quiet.py"


def played(resolved: Resolved, out: Path, **options: Any) -> Path:
    """The folder of a run, which must end well."""
    ended = launcher.run(resolved, out, **options)
    assert ended.error is None, ended.error
    return ended.folder


def counts(folder: Path) -> dict[str, Any]:
    """What the node of ROS 2 answered, from run.json."""
    (found,) = json.loads((folder / "run.json").read_text())["outside"].values()
    return found


def test_runs_with_nodes_of_ros_are_the_same_on_the_mesh_and_in_one_process(router, tmp_path) -> None:
    """Other places are played in one process, see test_ros2_runs."""
    resolved = with_ros2("adversary", router, record=True)
    with Ros2Process("raise", router, *ADVERSARY):
        mesh = played(resolved, tmp_path / "mesh")
        alone = played(resolved, tmp_path / "alone", runtime="inproc")
    assert_equal(mesh, alone)
    assert counts(mesh) == counts(alone)
    assert (counts(mesh)["answered"], counts(mesh)["refused"]) == (12, {})


def test_a_recorded_run_is_replayed_without_ros(router: str, tmp_path: Path) -> None:
    with Ros2Process("echo", router, *CENTER):
        recorded = played(with_ros2("center", router, record=True), tmp_path / "run", runtime="inproc")
    prepared = replay.resolve(recorded)
    again = played(prepared.resolved, tmp_path / "again", runtime="inproc")
    ours, theirs = (json.loads((folder / "metrics.json").read_text()) for folder in (recorded, again))
    assert ours["agents"]["ego"]["picture"] == theirs["agents"]["ego"]["picture"]


def test_in_real_time_a_quick_node_of_ros_is_in_time(router: str, tmp_path: Path) -> None:
    with Ros2Process("echo", router, *CENTER):
        folder = played(with_ros2("center", router, mode="realtime", record=True), tmp_path / "run")
    found = counts(folder)
    assert found["asked"] == 12
    assert found["answered"] + found["late"] > 0
    for key in ("agent/infra_1/tracks", "cc/picture"):
        frames = [message.frame for message in read(folder) if message.key == key]
        assert sorted(frames) == [*range(12)], "one message a frame"


def test_with_tls_on_both_meshes_and_certificates_on_both_sides(tmp_path: Path) -> None:
    """The run has its own authority; that of the router of ROS is another one."""
    authority = Authority("ros")
    settings = router_settings("mtls", authority.issue("router", ["127.0.0.1"]))
    session, endpoint = open_router("tls/127.0.0.1:0", security=settings)
    files = authority.issue("robot")
    tls = Tls(*(tmp_path / name for name in ("ca.pem", "robot.pem", "robot.key")))
    contents = files.authority, files.certificate, files.key
    for path, content in zip((tls.ca, tls.certificate, tls.key), contents, strict=True):
        assert path is not None
        path.write_bytes(content)
    ros2 = {"router": endpoint, "tls": {"ca": str(tls.ca), "certificate": str(tls.certificate), "key": str(tls.key)}}
    with Ros2Process("tracks", endpoint, *AGENT, tls=tls):
        folder = played(with_ros2("agent", endpoint, ros2=ros2), tmp_path / "run", secure="mtls")
    session.close()
    assert counts(folder)["answered"] == 12


def test_a_node_of_ros_is_put_into_a_wire_of_a_running_mesh(launch: Any, router: str) -> None:
    with Ros2Process("raise", router, *ADVERSARY):
        run = launch(str(QUIET), "--mode", "lockstep")
        record = run.started()
        with closing(Observer(record, "agent/infra_1/tracks")) as observer:
            eventually(lambda: observer.samples, "tracks")
            settings = (f"ros2.router={router}", "agent=infra_1")
            live_interception.intercept(
                run.out, "agent/infra_1/tracks", "ros2_adversary.py", name="thief", settings=settings
            )
            reached = len(observer.samples) + 5
            eventually(lambda: len(observer.samples) >= reached, "tracks that have passed through ROS")
        run.interrupted()
    counts_of_run = run.record()["outside"]["thief"]
    assert counts_of_run["answered"] >= 5
    assert (counts_of_run["unanswered"], counts_of_run["refused"]) == (0, {})
    numbers = [message.seq for message in read(run.out) if message.key == "agent/infra_1/tracks"]
    assert numbers == list(range(len(numbers)))


def test_a_node_of_ros_that_dies_in_a_run_costs_only_its_answers(router: str, tmp_path: Path) -> None:
    with Ros2Process("dies", router, *AGENT):
        folder = played(with_ros2("agent", router, frames=30), tmp_path / "run")
    found = counts(folder)
    assert 0 < found["answered"] < 30
    assert found["answered"] + found["unanswered"] == 30
    assert found["absent"][AGENT[2]].endswith("on: no node of ROS 2 is in domain 0")


def test_a_run_that_waits_for_ros_is_stopped_at_once(router: str, tmp_path: Path) -> None:
    resolved = with_ros2("agent", router, frames=3, wait_s=5.0)
    with Ros2Process("interrupts", router, *AGENT):
        ended = launcher.run(resolved, tmp_path / "run")
    assert isinstance(ended.error, Interrupted), ended.error
    assert ended.record["nodes"]["infra_1"]["ended"] == "ok"
    assert counts(ended.folder)["unanswered"] == 0, "a wait that the end of the run ended is not counted"

"""Swarm runs on one machine: results, recovery from failures, and cleanup."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import swarm_launch
from containers import built, join_swarm
from equal_runs import assert_equal
from launched import Launched, eventually

from mast_zenoh import scenario
from mast_zenoh.config import bundle
from mast_zenoh.deploy.docker import docker
from mast_zenoh.deploy.engine import CREDENTIALS
from mast_zenoh.deploy.swarm import Swarm, remaining_parts, remove_stack
from mast_zenoh.errors import EngineError
from mast_zenoh.launch import run as launcher

pytestmark = [pytest.mark.heavy, pytest.mark.mesh, pytest.mark.timeout(420)]


@pytest.fixture(scope="module")
def image() -> str:
    """The tag of the image; this machine is a swarm."""
    tag = built()
    join_swarm()
    return tag


@pytest.fixture(autouse=True)
def nothing_is_left_behind(image: str) -> Iterator[None]:
    """Fails if a test leaves anything of a stack behind."""

    def stacked() -> set[str]:
        names = set()
        for kind in ("service", "network", "secret", "config", "volume", "container"):
            more = ("--all",) if kind == "container" else ()
            form = f"{kind} {{{{.{'Names' if kind == 'container' else 'Name'}}}}}"
            words = (kind, "ls", *more, "--filter", "label=com.docker.stack.namespace", "--format", form)
            names |= set(docker(*words).splitlines())
        return names

    before = stacked()
    yield
    assert not (left := stacked() - before), f"left behind: {left}"


def test_a_secure_run_equals_the_one_in_one_process_and_reveals_no_key(tmp_path: Path, image: str) -> None:
    resolved = swarm_launch.resolved()
    here = launcher.run(resolved, tmp_path / "here", runtime="inproc")
    there = launcher.run(resolved, tmp_path / "there", engine=Swarm(image), secure="acl")
    assert there.error is None, there.error
    assert_equal(here.folder, there.folder)
    for name, node in there.record["nodes"].items():
        assert node["service"] == f"{there.record['deployment']['stack']}_{name}"
        assert abs(node["clock"]["offset_ms"]) <= node["clock"]["round_trip_ms"], "both use the same clock"
    assert not (there.folder / CREDENTIALS).exists()
    for path in there.folder.rglob("*"):
        assert path.is_dir() or b"PRIVATE KEY" not in path.read_bytes(), path


def test_a_killed_node_stays_down_until_started_and_messages_are_unchanged(tmp_path: Path, image: str) -> None:
    kill = dict(type="Kill", at=0.5, node="infra_2", restart_after=0.5)
    resolved = swarm_launch.resolved(frames=14, faults=[kill])
    here = launcher.run(resolved, tmp_path / "here", runtime="inproc")
    there = launcher.run(resolved, tmp_path / "there", engine=Swarm(image))
    assert there.error is None, there.error
    assert_equal(here.folder, there.folder)
    assert there.record["nodes"]["infra_2"]["restarts"] == 1
    assert there.record["steps"] == [
        {"frame": 5, "action": "kill", "node": "infra_2"},
        {"frame": 10, "action": "start", "node": "infra_2"},
    ]


PHOENIX = """
import os
import signal

from agent import Agent, main


class Phoenix(Agent):
    def on_clock(self, received, context):
        if received.frame == 8:
            print("burning", flush=True)
            os.kill(os.getpid(), signal.SIGKILL)
        super().on_clock(received, context)
"""
PATIENT = """
import threading

from agent import Agent, main


class Patient(Agent):
    seen = 0

    def joined(self, node, role, context):
        self.seen += node == "infra_2"

    def on_clock(self, received, context):
        if received.frame > 8 and self.seen < 2:
            threading.Event().wait(0.5)  # a slow step, until it has joined again
        super().on_clock(received, context)
"""
SCENARIO = """
from mast_zenoh.config import loading

_, baseline = loading.function("scenarios", "baseline", "scenario")


def scenario():
    made = baseline(n_infrastructure=2)
    each = made["agents"]["*"]
    own = {"infra_1": each | dict(file="patient.py"), "infra_2": each | dict(file="phoenix.py", on_exit="restart")}
    return made | dict(agents={"*": each} | own)
"""


def test_a_node_restarted_by_docker_rejoins_at_the_current_frame_of_a_lock_step_run(tmp_path: Path, image: str) -> None:
    shutil.copyfile(bundle.find("nodes", "agent.py", tmp_path), tmp_path / "agent.py")
    for name, content in (("phoenix", PHOENIX), ("patient", PATIENT), ("rising", SCENARIO)):
        (tmp_path / f"{name}.py").write_text(content)
    path, loaded = scenario.load(str(tmp_path / "rising.py"), [])
    resolved = scenario.resolve(path, loaded, frames=150)
    outcome = launcher.run(resolved, tmp_path / "run", engine=Swarm(image), secure="acl", allow_churn=True)
    assert outcome.error is None, outcome.error
    assert [(each["node"], each["what"]) for each in outcome.record["churn"]] == [
        ("infra_2", "lost"),
        ("infra_2", "back"),
    ]
    node = outcome.record["nodes"]["infra_2"]
    assert (node["restarts"], node["exit"], node["last_frame"]) == (1, 0, 149)
    assert node["ended"] == "killed by signal 9 (SIGKILL); ok"
    assert "burning" in (outcome.folder / "logs" / "infra_2.log").read_text(), "earlier output is kept"
    assert outcome.record["steps"] == [], "only Docker restarted it"


@pytest.fixture
def launch(image: str, start: Callable[..., Launched]) -> Callable[..., Launched]:
    """Starts runs in the swarm; removes remaining stacks."""
    program = (sys.executable, swarm_launch.__file__, image)
    return lambda **options: start(*program, json.dumps(options), afterwards=remove)


def remove(run: Launched) -> None:
    if deployment := run.record().get("deployment"):
        remove_stack(deployment["stack"])


def test_a_stopped_real_time_run_keeps_its_results_and_leaves_nothing_running(
    launch: Callable[..., Launched], capsys: pytest.CaptureFixture[str]
) -> None:
    pause = dict(type="Pause", at=1.0, until=60.0, node="infra_2")
    run = launch(frames=900, mode="realtime", secure="acl", faults=[pause])
    run.until(run.recorded, "frames are played")
    record = run.record()
    states = {entry["node"]: entry for entry in Swarm.status(run.out, record)}
    assert states.keys() == {"router", *record["nodes"]}
    assert {entry["state"] for entry in states.values()} <= {"running", "starting"}
    assert states["router"]["where"] == docker("info", "--format", "{{.Name}}").strip()
    Swarm.logs(run.out, record, "router", follow=False)
    assert "router at tls/" in capsys.readouterr().out
    container = docker("ps", "--quiet", "--filter", f"name={record['nodes']['infra_2']['service']}").strip()

    def paused() -> bool:
        return docker("inspect", "--format", "{{.State.Paused}}", container).strip() == "true"

    eventually(paused, "the scenario pauses infra_2")
    run.interrupted()
    record = run.record()
    assert record["status"] == "interrupted"
    assert {name: node["exit"] for name, node in record["nodes"].items()} == dict.fromkeys(record["nodes"], 0)
    assert json.loads((run.out / "metrics.json").read_text())["frames"] > 10
    assert remaining_parts(record["deployment"]["stack"]) == {}


def test_services_of_a_killed_launcher_end_and_down_removes_the_rest(
    launch: Callable[..., Launched],
) -> None:
    run = launch(frames=900, mode="realtime", secure="tls")
    run.until(run.recorded, "frames are played")
    record = run.record()
    run.kill()

    def gone() -> bool:
        return all(entry["state"] not in ("running", "starting") for entry in Swarm.status(run.out, record))

    eventually(gone, "all tasks have ended by themselves")
    assert remaining_parts(record["deployment"]["stack"]).keys() == {"service", "network", "secret", "container"}
    for _ in range(2):
        Swarm.down(run.out, record)
        assert remaining_parts(record["deployment"]["stack"]) == {}
    assert Swarm.status(run.out, record) == []


def test_an_impossible_run_is_refused_before_anything_is_written(tmp_path: Path, image: str) -> None:
    resolved = swarm_launch.resolved()
    with pytest.raises(EngineError, match=r"there is no image mast-zenoh:nowhere: build it with `mast deploy image`"):
        launcher.run(resolved, tmp_path / "run", engine=Swarm("mast-zenoh:nowhere"))
    with pytest.raises(EngineError, match=r"has the label mast\.host=moon"):
        launcher.run(resolved, tmp_path / "run", engine=Swarm(image, place={"infra_*": "moon"}))
    assert not (tmp_path / "run").exists()

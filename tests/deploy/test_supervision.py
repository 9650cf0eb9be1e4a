"""Nodes on each platform, with stand-ins for Docker and for hosts: what ends is noticed, named and restarted."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from launched import eventually

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.deploy import documents, swarm
from mast_zenoh.deploy.compose import Compose, Containers, connected_as
from mast_zenoh.deploy.ssh.attachment import Attachment
from mast_zenoh.deploy.ssh.engine import RemoteNodes
from mast_zenoh.deploy.ssh.hostsfile import Host, Hosts, Router
from mast_zenoh.deploy.swarm import Services, Swarm, Task
from mast_zenoh.errors import EngineError

RUN = "uncoordinated-00c0ffee"
SPEC = NodeSpec("broker", "broker.py", "Broker", {}, "fail")
STACK = documents.stack_name(RUN)


def context(folder: Path, **resolved: Any) -> Any:
    (folder / "logs").mkdir()
    return SimpleNamespace(run_id=RUN, folder=folder, resolved=SimpleNamespace(**resolved), signals=(), record={})


# -- containers --------------------------------------------------------------------------------------------------

#: A stand-in for Docker: a container runs until there is a file with its exit code.
DOCKER = """#!/bin/sh
for container; do :; done
case "$1" in
    logs) until [ -e "{codes}/$container" ]; do sleep 0.02; done; echo "$container says this";;
    inspect) if [ -e "{codes}/$container" ]; then echo "false $(cat "{codes}/$container")"; else echo "true 0"; fi;;
esac
"""


@pytest.fixture
def codes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the exit codes of containers."""
    for name in ("bin", "codes"):
        (tmp_path / name).mkdir()
    (tmp_path / "bin" / "docker").write_text(DOCKER.format(codes=tmp_path / "codes"))
    (tmp_path / "bin" / "docker").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:{os.environ['PATH']}")
    return tmp_path / "codes"


@pytest.fixture
def containers(tmp_path: Path, codes: Path) -> Any:
    """The containers of a router and of two nodes."""
    nodes = Containers(Compose(), context(tmp_path), ExitStack())
    nodes._router.follow(0.0)
    nodes.start_all({"command_center": SPEC, "broker": SPEC})
    yield nodes
    for child in (nodes._router, *nodes.children.values()):
        (codes / child.container).touch()
        child.close()


def end(codes: Path, name: str, code: int) -> None:
    (codes / "new").write_text(str(code))
    (codes / "new").rename(codes / documents.container(RUN, name))


def runs(supervisor: Any) -> int:
    try:
        return len(supervisor.running())
    except EngineError:
        return 0


def test_a_killed_router_container_is_named_instead_of_a_node(containers: Containers, codes: Path) -> None:
    assert runs(containers) == 2
    end(codes, "router", 137)
    end(codes, "command_center", 3)  # nodes exit when they have been without a launcher for a while
    eventually(lambda: not runs(containers), "the router's end is noticed", 30.0)
    with pytest.raises(EngineError, match=r"the router has ended: killed by signal 9 .*; see logs/router\.log"):
        containers.running()
    end(codes, "broker", 143)
    containers.end(30.0)
    assert {name: child.exit for name, child in containers.children.items()} == {"command_center": 3, "broker": -15}


def test_a_container_that_ends_is_returned_once_with_a_complete_log_and_runs_again(
    containers: Containers, codes: Path
) -> None:
    end(codes, "broker", 137)
    eventually(lambda: runs(containers) == 1, "the broker's end is noticed", 30.0)
    (broker,) = containers.newly_ended()
    assert (broker.name, broker.exit, containers.newly_ended()) == ("broker", -9, [])
    assert (containers.logs / "broker.log").read_text() == f"{broker.container} says this\n"
    (codes / broker.container).unlink()
    assert containers.restart(broker)
    assert runs(containers) == 2


def test_a_container_is_reconnected_with_its_former_addresses() -> None:
    aliases = {"Aliases": ["infra_1", "0a1b"], "IPAMConfig": None}
    assert connected_as(aliases) == ["--alias", "infra_1", "--alias", "0a1b"]
    fixed = {"Aliases": None, "IPAMConfig": {"IPv4Address": "192.0.2.7"}, "IPAddress": "192.0.2.7"}
    assert connected_as(fixed) == ["--ip", "192.0.2.7"]
    assert connected_as({"IPAddress": "192.0.2.7"}) == [], "an address assigned by Docker may be reassigned"


# -- hosts -------------------------------------------------------------------------------------------------------


class Alpha(Attachment):
    """A connection to a host that answers at once; the test sets its processes."""

    def __init__(self) -> None:
        self.host = Host(name="alpha", address="192.0.2.1")
        self.gone = False
        self.exits: dict[str, int] = {}

    def tell(self, do: str, **_: Any) -> str:
        return "1"

    def answer(self, command_id: str, seconds: float) -> dict[str, Any]:
        return {}

    def state(self, name: str, start: str) -> dict[str, Any]:
        return {"pid": 1, "exit": self.exits.get(name)}


def test_a_router_that_ended_on_a_host_is_named_with_its_host_instead_of_a_node(tmp_path: Path) -> None:
    alpha, specs = Alpha(), {"broker": SPEC, "ego": SPEC}
    with ExitStack() as stack:
        hosts = Hosts("hosts.toml", {"alpha": alpha.host}, Router("alpha"))
        nodes = RemoteNodes(hosts, context(tmp_path, nodes=specs), stack)
        nodes.attachments, nodes.router_start = {"alpha": alpha}, (alpha, "1")
        nodes._command = lambda node, host: {}  # type: ignore[method-assign]
        nodes.start_all(specs)
        assert runs(nodes) == 2
        alpha.exits = {"@router": -9, "broker": 3}
        killed = r"the router on host alpha \(192.0.2.1:22\) has ended: killed by signal 9 .*see logs/@router\.log"
        with pytest.raises(EngineError, match=killed):
            nodes.running()
        alpha.exits, alpha.gone = {}, True
        with pytest.raises(EngineError, match=killed):
            nodes.running()
        nodes.end(1.0)
        assert {child.exit for child in nodes.children.values()} == {-9}, "a lost host's processes count as killed"


# -- services of a swarm -----------------------------------------------------------------------------------------

KILLED = "task: non-zero exit (137)"


@pytest.mark.parametrize(
    ("state", "error", "code", "refused"),
    [
        ("Running 3 seconds ago", "", None, ""),
        ("Preparing less than a second ago", "", None, ""),
        ("Complete 2 seconds ago", "", 0, ""),
        ("Failed 2 seconds ago", "task: non-zero exit (3)", 3, ""),
        ("Failed 2 seconds ago", KILLED, -9, ""),
        ("Failed 1 second ago", f"{KILLED}: dockerexec: unhealthy container", -9, ""),
        ("Rejected 1 second ago", "No such image: x", 125, "here: No such image: x; no registry has it"),
        ("Shutdown 1 second ago", "", -15, ""),
    ],
)
def test_the_exit_code_of_a_task_is_read_from_docker(state: str, error: str, code: int | None, refused: str) -> None:
    name = f"{documents.service_name(RUN, 'infra_1')}.1"
    line = "\t".join(["t1", name, "here", "Running", state, f'"{error}"' if error else ""])
    (task,) = swarm.parse_tasks(STACK, [line])["infra_1"]
    assert task.exit == code
    assert task.refused.partition(": `docker save`")[0] == refused


@given(st.lists(st.text(max_size=80)))
def test_any_output_of_docker_is_parsed_without_an_error(lines: list[str]) -> None:
    for history in swarm.parse_tasks(STACK, lines).values():
        assert all(isinstance(task.exit, int | None) and isinstance(task.refused, str) for task in history)


class Dockerd:
    """A stand-in for Docker: scripted task states, recorded commands."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.tasks: list[Task] = []
        self.told: list[tuple[str, ...]] = []
        self.now = 0.0
        self.router = Task("r1", "router", "here", "running", "running", "")
        monkeypatch.setattr(swarm, "docker", self.docker)
        monkeypatch.setattr(swarm, "tasks_of", lambda stack: {"infra_2": list(self.tasks), "router": [self.router]})
        monkeypatch.setattr(swarm, "_append_log", lambda task, path, refused: self.told.append(("log", task)))
        monkeypatch.setattr(swarm.time, "monotonic", lambda: self.now)

    def docker(self, *words: str, **_: Any) -> str:
        self.told.append(words)
        return "x"

    def say(self, *states: tuple[str, str, str]) -> None:
        self.now += 1.0
        self.tasks = [Task(identity, "infra_2", "here", "running", state, error) for identity, state, error in states]


@pytest.fixture
def dockerd(monkeypatch: pytest.MonkeyPatch) -> Dockerd:
    return Dockerd(monkeypatch)


@pytest.fixture
def services(tmp_path: Path, dockerd: Dockerd) -> Services:
    """A stack with one node, infra_2, which Docker restarts."""
    nodes = Services(Swarm(), context(tmp_path, mode="lockstep"), ExitStack())
    nodes._here = "here"
    nodes.start_all({"infra_2": NodeSpec("agent", "agent.py", "Agent", {}, "restart")})
    return nodes


def test_a_node_restarted_by_docker_has_ended_and_runs_again(services: Services, dockerd: Dockerd) -> None:
    (child,) = services.children.values()
    dockerd.say(("t1", "running", ""))
    assert services.running() == [child]
    assert services.newly_ended() == []
    dockerd.say(("t2", "preparing", ""), ("t1", "failed", KILLED))
    assert services.running() == []
    assert services.newly_ended() == [child]
    assert (child.exit, services.newly_ended()) == (-9, [])
    assert services.restart(child)
    assert (child.exit, child.restarts) == (None, 1)
    assert dockerd.told == [("log", "t1")], "nothing was scaled"
    dockerd.say(("t2", "complete", ""), ("t1", "failed", KILLED))
    services.running()
    assert services.newly_ended() == [child]
    assert child.exit == 0


def test_a_node_that_fails_twice_between_two_polls_has_ended_twice(services: Services, dockerd: Dockerd) -> None:
    (child,) = services.children.values()
    dockerd.say(("t3", "running", ""), ("t2", "failed", "task: non-zero exit (3)"), ("t1", "failed", KILLED))
    codes = []
    while not services.running():
        assert services.newly_ended() == [child]
        codes.append(child.exit)
        assert services.restart(child)
    assert codes == [-9, 3]


def test_a_node_without_a_suitable_machine_ends_the_run_with_the_reason(services: Services, dockerd: Dockerd) -> None:
    dockerd.say(("t1", "pending", "no suitable node (insufficient resources on 1 node)"))
    assert services.running()
    dockerd.now += 31.0
    with pytest.raises(EngineError, match=r"infra_2: Docker has found no machine .* \(insufficient resources on 1"):
        services.running()


def test_a_lock_step_run_does_not_survive_its_router_and_a_real_time_run_waits_for_it_for_a_limited_time(
    services: Services, dockerd: Dockerd
) -> None:
    ended = pytest.raises(EngineError, match=r"the router has ended: killed by signal 9 .*; see logs/router\.log")
    there, failed = dockerd.router, dockerd.router._replace(state="failed", error=KILLED)
    dockerd.say(("t1", "running", ""))
    assert services.running()
    dockerd.router = failed
    dockerd.say(("t1", "running", ""))
    with ended:
        services.running()
    services.context.resolved.mode = "realtime"  # type: ignore[misc]
    for dockerd.router in (there, failed, failed, there, failed, failed, failed):
        dockerd.say(("t1", "running", ""))
        assert services.running()
    dockerd.now += 10.0
    with ended:
        services.running()


def test_killing_a_node_on_another_machine_is_refused_with_the_reason(services: Services, dockerd: Dockerd) -> None:
    (child,) = services.children.values()
    dockerd.say(("t1", "running", ""))
    dockerd.tasks = [task._replace(machine="there") for task in dockerd.tasks]
    services.running()
    for doing in (services.kill, services.pause):
        with pytest.raises(EngineError, match=r"infra_2 cannot be .*: Docker does that only on its own.*on there"):
            doing(child)
    assert dockerd.told == []


def test_docker_may_be_unavailable_only_for_a_short_time(
    services: Services, dockerd: Dockerd, monkeypatch: pytest.MonkeyPatch
) -> None:
    dockerd.say(("t1", "running", ""))
    services.running()

    def silent(stack: str) -> None:
        raise EngineError("the Docker engine cannot be reached")

    monkeypatch.setattr(swarm, "tasks_of", silent)
    dockerd.now += 10.0
    assert services.running()
    dockerd.now += 30.0
    with pytest.raises(EngineError, match="cannot be reached"):
        services.running()


def test_a_machine_without_a_swarm_has_only_containers_of_a_stack(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    answers = {"info": "inactive"}
    monkeypatch.setattr(swarm, "docker", lambda *words, **_: (asked.append(words[0]), answers.get(words[0], ""))[1])
    swarm.remove_stack("mast-1")
    assert asked == ["info", "container", "network"]

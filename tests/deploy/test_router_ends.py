"""When a run's router ends, the error names the router and not the nodes."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from launched import eventually

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.deploy.compose.containers import Containers
from mast_zenoh.deploy.ssh.nodes import RemoteNodes
from mast_zenoh.errors import EngineError

#: A stand-in for Docker: starts what it is told to, and reports deaths from a file.
DOCKER = """#!/bin/sh
case "$1" in
    events) exec tail -f -n +1 "{deaths}";;
    *) exit 0;;
esac
"""
DIED = '{{"timeNano": {time}, "Actor": {{"Attributes": {{"name": "{name}", "exitCode": "{code}"}}}}}}\n'
SPEC = NodeSpec("broker", "broker.py", "Broker", {}, "fail")


@pytest.fixture
def deaths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file in which each line is the death of a container."""
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "docker").write_text(DOCKER.format(deaths=tmp_path / "deaths"))
    (tmp_path / "bin" / "docker").chmod(0o755)
    (tmp_path / "deaths").touch()
    (tmp_path / "logs").mkdir()
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:{os.environ['PATH']}")
    return tmp_path / "deaths"


def composed(tmp_path: Path) -> Containers:
    return Containers("run=r", "r-{}".format, tmp_path / "logs", router="r-router")


def runs(supervisor: Any) -> bool:
    try:
        return bool(supervisor.running())
    except EngineError:
        return False


def test_a_killed_router_container_is_named_instead_of_a_node(tmp_path: Path, deaths: Path) -> None:
    with composed(tmp_path) as supervisor:
        supervisor.start_all({"command_center": SPEC, "broker": SPEC})
        assert len(supervisor.running()) == 2
        # The nodes exit when they have been without a launcher for a while.
        deaths.write_text(
            DIED.format(time=1, name="r-router", code=137) + DIED.format(time=2, name="r-command_center", code=3)
        )
        eventually(lambda: not runs(supervisor), "the router's end is noticed", 30.0)
        with pytest.raises(EngineError, match=r"the router has ended: killed by signal 9 .*; see logs/router\.log"):
            supervisor.running()


def test_nodes_are_stopped_even_if_the_router_has_ended(tmp_path: Path, deaths: Path) -> None:
    with composed(tmp_path) as supervisor:
        supervisor.start_all({"broker": SPEC})
        deaths.write_text(DIED.format(time=1, name="r-router", code=1))
        eventually(lambda: not runs(supervisor), "the router's end is noticed", 30.0)
        with deaths.open("a") as more:
            more.write(DIED.format(time=2, name="r-broker", code=143))
        supervisor.end(30.0)
        assert supervisor.children["broker"].exit == -15


def test_a_container_with_another_name_is_not_mistaken_for_the_router(tmp_path: Path, deaths: Path) -> None:
    with composed(tmp_path) as supervisor:
        supervisor.start_all({"broker": SPEC, "ego": SPEC})
        deaths.write_text(DIED.format(time=1, name="r-broker", code=137))
        eventually(lambda: len(supervisor.running()) == 1, "the broker's end is noticed", 30.0)
        assert [child.name for child in supervisor.newly_ended()] == ["broker"]


class Host:
    """A stand-in for the connection to a host; the test sets its processes."""

    def __init__(self) -> None:
        self.host = SimpleNamespace(name="alpha", called="alpha")
        self.gone = False
        self.exits: dict[str, int] = {}

    def tell(self, do: str, **_: Any) -> str:
        return "1"

    def answer(self, which: str, seconds: float) -> dict[str, Any]:
        return {}

    def state(self, name: str, start: str) -> dict[str, Any]:
        return {"pid": 1, "exit": self.exits.get(name)}


@pytest.fixture
def host() -> Host:
    return Host()


def remote(tmp_path: Path, host: Any) -> RemoteNodes:
    (tmp_path / "logs").mkdir()
    placed, changed = {"broker": "alpha", "ego": "alpha"}, threading.Condition()
    nodes = RemoteNodes({"alpha": host}, placed, lambda *_: ([], {}), tmp_path / "logs", changed, router=(host, "1"))
    nodes.start_all(dict.fromkeys(placed, SPEC))
    return nodes


def test_a_killed_router_on_a_host_is_named_with_its_host_instead_of_a_node(tmp_path: Path, host: Host) -> None:
    nodes = remote(tmp_path, host)
    assert len(nodes.running()) == 2
    host.exits = {"@router": -9, "broker": 3}
    with pytest.raises(EngineError, match=r"the router on alpha has ended: killed by signal 9 .*see logs/@router\.log"):
        nodes.running()
    nodes.end(1.0)


def test_the_router_of_a_lost_host_counts_as_ended(tmp_path: Path, host: Host) -> None:
    nodes = remote(tmp_path, host)
    host.gone = True
    with pytest.raises(EngineError, match=r"the router on alpha has ended: killed by signal 9"):
        nodes.running()

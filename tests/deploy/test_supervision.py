"""Nodes on each platform, with stand-ins for Docker and for hosts: what ends is noticed, named and restarted."""

import os
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from launched import eventually

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.deploy import documents
from mast_zenoh.deploy.compose import Compose, Containers, connected_as
from mast_zenoh.deploy.ssh.connection import WardenAttachment
from mast_zenoh.deploy.ssh.engine import RemoteNodes
from mast_zenoh.deploy.ssh.hostsfile import HostsFile, Router, SshHost
from mast_zenoh.errors import EngineError

RUN = "uncoordinated-00c0ffee"
SPEC = NodeSpec("broker", "broker.py", "Broker", {}, "fail")


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
    with pytest.raises(EngineError, match=r"router.*ended.*logs/router\.log"):
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


class Alpha(WardenAttachment):
    """A connection to a host that answers at once; the test sets its processes."""

    def __init__(self) -> None:
        self.host = SshHost(name="alpha", address="192.0.2.1")
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
        hosts = HostsFile("hosts.toml", {"alpha": alpha.host}, Router("alpha"))
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

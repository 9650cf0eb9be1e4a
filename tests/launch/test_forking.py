"""Nodes that are forked are processes like any other."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import psutil
import pytest
from launched import eventually

from mast_zenoh import scenario
from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.errors import StartError
from mast_zenoh.launch.processes import Forked, ForkServer, Processes, can_fork_nodes

pytestmark = [
    pytest.mark.mesh,
    pytest.mark.skipif(not can_fork_nodes(), reason="this system cannot wait for processes of others"),
]

#: Arguments of a node without a run folder, which fails at once with exit code 2.
COMMAND = [sys.executable, "-P", "-m", "mast_zenoh.mesh"]


@pytest.fixture
def server() -> Iterator[ForkServer]:
    server = ForkServer({"OMP_NUM_THREADS": "1"})  # a small environment leaves little room for the names of nodes
    yield server
    server.close()


def started(server: ForkServer, folder: Path, *words: str) -> Forked:
    with (folder / "node.log").open("ab", buffering=0) as log:
        return server.start([*COMMAND, *words], folder, log)


def test_nodes_are_processes_with_the_exit_code_and_the_output_of_their_commands(
    server: ForkServer, tmp_path: Path
) -> None:
    (tmp_path / "other").mkdir()
    node, other = started(server, tmp_path, "nodes/agent.py"), started(server, tmp_path / "other", "--help")
    assert node.pid != other.pid
    assert node.wait(30) == node.poll() == 2
    assert other.wait(30) == 0
    assert "--run-folder" in (tmp_path / "other" / "node.log").read_text()
    alone = subprocess.run([*COMMAND, "nodes/agent.py"], capture_output=True, text=True, check=False)
    assert alone.returncode == 2
    last_lines = [
        text.splitlines()[-1].partition("error:")[2] for text in ((tmp_path / "node.log").read_text(), alone.stderr)
    ]
    assert last_lines[0] == last_lines[1] != ""


def test_a_node_has_a_session_a_folder_a_name_and_signals_of_its_own(server: ForkServer, tmp_path: Path) -> None:
    resolved = scenario.resolve(*scenario.load("baseline", []), frames=1)
    resolved.write(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as silent:  # the node waits for its answer
        router = f"tcp/127.0.0.1:{silent.getsockname()[1]}"
        words = ("--run-folder", str(tmp_path), "--name", "infra_1", "--endpoint", router, "--run", "one")
        node = started(server, tmp_path, resolved.nodes["infra_1"].file, *words)
        silent.accept()[0].close()
        process = psutil.Process(node.pid)
        command = [*COMMAND, resolved.nodes["infra_1"].file, *words]
        assert [*filter(None, process.cmdline())] == command
        assert os.getsid(node.pid) == node.pid
        assert process.cwd() == str(tmp_path)
        node.send_signal(signal.SIGKILL)
        assert node.wait(30) == -signal.SIGKILL
        node.kill()  # again, without effect


def test_nodes_import_nothing_after_they_are_forked(tmp_path: Path) -> None:
    scenario.resolve(*scenario.load("baseline", []), frames=20).write(tmp_path)
    code = (
        "import argparse, sys, pathlib; from mast_zenoh.launch import fork_server; fork_server.preload();"
        "from mast_zenoh.config.resolved import Resolved; from mast_zenoh.mesh.inproc import InProcess;"
        "before = set(sys.modules); argparse.ArgumentParser().parse_args([]);"
        "InProcess(Resolved.read(pathlib.Path())).run();"
        "print(*(set(sys.modules) - before))"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert run.stdout.split() == []


def test_after_the_server_ended_nodes_go_on_and_starting_one_raises_start_error(
    server: ForkServer, tmp_path: Path
) -> None:
    node = started(server, tmp_path, "nodes/agent.py")
    server._process.kill()
    server._process.wait()
    assert node.wait(30) == 2
    with pytest.raises(StartError, match=r"process.*starts.*nodes"):
        started(server, tmp_path, "--help")


def test_starting_a_node_raises_start_error_if_the_server_does_not_answer(
    server: ForkServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started(server, tmp_path, "--help").wait(30)
    server._process.send_signal(signal.SIGSTOP)
    server._socket.settimeout(0.1)
    with pytest.raises(StartError, match="does not answer"):
        started(server, tmp_path, "--help")
    server._process.send_signal(signal.SIGCONT)


def test_nodes_draw_different_numbers_from_numpys_global_generator(server: ForkServer, tmp_path: Path) -> None:
    file = tmp_path / "draws.py"
    file.write_text("import numpy as np\nprint(np.random.normal())\nraise SystemExit\n")
    resolved = scenario.resolve(*scenario.load("baseline", []), frames=1)
    resolved.nodes["infra_1"] = replace(resolved.nodes["infra_1"], file=str(file))
    resolved.write(tmp_path)
    words = ("--run-folder", str(tmp_path), "--name", "infra_1", "--endpoint", "tcp/127.0.0.1:1", "--run", "one")
    for _ in range(2):
        assert started(server, tmp_path, str(file), *words).wait(30) == 0
    assert len(set((tmp_path / "node.log").read_text().split())) == 2


class Stubborn(Processes):
    """Its nodes take no notice of being asked to leave."""

    def command(self, name: str, spec: NodeSpec) -> list[str]:
        ignoring = "import signal, time; signal.signal(15, signal.SIG_IGN); print('there', flush=True); time.sleep(60)"
        return [sys.executable, "-c", ignoring]


def test_a_node_that_does_not_leave_is_killed(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    processes = Stubborn(tmp_path, "one", "tcp/127.0.0.1:1")
    processes.start("ego", NodeSpec("agent", "", "", {}, "continue"))
    eventually(lambda: (tmp_path / "logs" / "ego.log").read_text(), "it has begun")
    processes.end(0.1)
    (child,) = processes.children.values()
    assert "terminate; told to leave by kill; " in child.ended
    assert child.ended.endswith("(SIGKILL)")

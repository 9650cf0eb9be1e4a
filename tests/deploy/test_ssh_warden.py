"""A host's supervisor without SSH: commands run once, nothing remains."""

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from launched import eventually

pytestmark = pytest.mark.mesh
SLEEP = "import signal, sys; print('up', flush=True); signal.pause()"


class Attached:
    """A connection to a supervisor, like the launcher's."""

    def __init__(self, folder: Path, **offsets: int) -> None:
        self.folder = folder
        self.there = socket.socket(socket.AF_UNIX)
        self.there.settimeout(30.0)
        self.there.connect(str(folder / "control"))
        self.lines = self.there.makefile("r")
        self.heard: list[dict[str, Any]] = []
        self.send({"as": "launcher", "logs": offsets})
        self.wait(lambda event: "warden" in event)

    def send(self, message: dict[str, Any]) -> None:
        self.there.sendall(json.dumps(message).encode() + b"\n")

    def wait(self, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """The next received event that satisfies the condition."""
        for line in self.lines:
            self.heard.append(json.loads(line))
            if condition(self.heard[-1]):
                return self.heard[-1]
        raise AssertionError(f"the connection has ended; heard {self.heard}")

    def request(self, which: str, do: str, **more: Any) -> dict[str, Any]:
        """Send a command and return the answer."""
        self.send({"id": which, "do": do, **more})
        return self.wait(lambda event: event.get("answer") == which)

    def wait_until_closed(self) -> bool:
        """Wait until the peer has closed the connection."""
        for line in self.lines:
            self.heard.append(json.loads(line))
        return True

    def close(self) -> None:
        self.lines.close()
        self.there.close()


@pytest.fixture
def serve() -> Iterator[Callable[..., Attached]]:
    """Starts a supervisor in a short folder, as socket paths are limited, and connects to it."""
    top = Path(tempfile.mkdtemp(prefix="mast_w"))

    def start(patience_s: float = 600.0, umask: int = -1) -> Attached:
        folder = top / "runs" / "r" / "h"
        (top / "runs").mkdir()
        command = [sys.executable, "-m", "mast_zenoh.deploy.ssh.warden", str(folder), str(patience_s)]
        subprocess.run(command, check=True, timeout=60, umask=umask)
        return Attached(folder)

    yield start
    for control in top.glob("runs/r/h/control"):
        with contextlib.suppress(OSError):
            attached = Attached(control.parent)
            attached.request("at last", "leave", grace_s=1.0)
            attached.close()
    deadline = time.monotonic() + 20.0
    while (left := of(top)) and time.monotonic() < deadline:
        threading.Event().wait(0.05)
    for process in left:
        process.kill()
    shutil.rmtree(top)
    assert not left


def of(top: Path) -> list[psutil.Process]:
    """The running supervisors and nodes in a folder."""
    pids = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            words = [*process.cmdline(), process.environ().get("TMPDIR", "")]
            if process.status() != psutil.STATUS_ZOMBIE and any(str(top) in word for word in words):
                pids.append(process)
    return pids


def started(attached: Attached, name: str, program: str = SLEEP) -> int:
    argv = [sys.executable, "-c", program]
    answer = attached.request(f"start {name}", "start", name=name, argv=argv, env={"WORD": "given"})
    return int(answer["pid"])


def has_ended(pid: int) -> bool:
    return not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE


def test_a_repeated_command_is_executed_once(serve) -> None:
    first = serve()
    pid = started(first, "ego")
    first.close()  # the answer may have been lost
    again = Attached(first.folder)
    assert started(again, "ego") == pid
    assert "already running" in again.request("another", "start", name="ego", argv=["true"], env={})["error"]
    assert "error" in again.request("none", "start", name="other", argv=["/does/not/exist"], env={})
    again.request("leave", "leave", grace_s=10.0)
    assert again.wait_until_closed()
    eventually(lambda: has_ended(pid), "its node has ended", 30.0)
    assert not first.folder.parent.exists(), "only files that other runs may need remain"
    assert first.folder.parent.parent.exists()


def test_a_node_gets_its_environment_and_folder_which_only_the_owner_can_read_and_reports_its_exit_code(serve) -> None:
    attached = serve(umask=0)
    program = (
        "import os, pathlib, sys; pathlib.Path('written').touch()\n"
        "print(os.environ['WORD'], os.environ['TMPDIR'], os.getcwd(), flush=True); sys.exit(5)"
    )
    started(attached, "ego", program)
    assert attached.wait(lambda event: event.get("node") == "ego")["exit"] == 5
    output = "".join(line["text"] for line in attached.heard if line.get("log") == "ego")
    folder = attached.folder
    assert output == f"given {folder}/tmp/ego {folder}\n", "output arrives before the exit event"
    permissions = {path: path.stat().st_mode & 0o777 for path in (folder.parent, folder, *folder.rglob("*"))}
    assert {"control", "logs", "ego.log", "@warden.log", "written"} <= {path.name for path in permissions}
    assert {str(path): oct(mode) for path, mode in permissions.items() if mode & 0o077} == {}


def test_logs_continue_from_the_last_connection(serve) -> None:
    first = serve()
    program = "for i in range(10_000): print(i, 'ä' * 20)\nprint('end', flush=True)\nimport signal; signal.pause()"
    started(first, "ego", program)
    pieces = [first.wait(lambda event: "log" in event)]
    first.close()
    offset = pieces[0]["offset"] + len(pieces[0]["text"].encode("latin-1"))
    second = Attached(first.folder, ego=offset)
    content = pieces[0]["text"]
    while not content.endswith("end\n"):
        content += second.wait(lambda event: "log" in event)["text"]
    expected = "".join(f"{i} {'ä' * 20}\n" for i in range(10_000)) + "end\n"
    assert content.encode("latin-1").decode() == expected


def test_nodes_that_do_not_exit_are_killed_after_the_grace_period_even_if_stopped(serve) -> None:
    attached = serve()
    program = (
        "import signal\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\nprint('up', flush=True)\nwhile 1: signal.pause()"
    )
    pids = [started(attached, "deaf", program), started(attached, "still")]
    for _ in range(2):
        attached.wait(lambda event: event.get("text") == "up\n")
    attached.request("stop", "signal", names=["still"], number=int(signal.SIGSTOP))
    attached.request("leave", "leave", grace_s=0.5)
    codes = {event["node"]: event["exit"] for event in attached.heard if "node" in event}
    assert codes == {"deaf": -signal.SIGKILL, "still": -signal.SIGTERM}
    eventually(lambda: all(map(has_ended, pids)), "both have ended", 30.0)


def test_without_a_launcher_it_ends_all_nodes_even_if_a_stopped_one_saw_the_launcher(serve) -> None:
    attached = serve(patience_s=1.0)
    pid = started(attached, "ego")
    (attached.folder / "tmp" / "ego" / "mast-up").touch()
    attached.wait(lambda event: event.get("text") == "up\n")
    os.kill(pid, signal.SIGSTOP)
    attached.close()
    eventually(lambda: has_ended(pid), "its node has ended", 30.0)
    eventually(lambda: not attached.folder.exists(), "it has removed its folder", 30.0)


def test_it_survives_without_a_connection_while_a_node_sees_the_launcher(serve) -> None:
    attached = serve(patience_s=0.5)
    started(attached, "ego")
    (attached.folder / "tmp" / "ego" / "mast-up").touch()
    attached.close()
    threading.Event().wait(2.0)  # several times its timeout
    again = Attached(attached.folder)
    assert again.request("state", "state")["nodes"][0]["exit"] is None


def test_its_nodes_die_with_it(serve) -> None:
    attached = serve()
    pid = started(attached, "ego")
    os.kill(attached.heard[0]["warden"], signal.SIGKILL)
    eventually(lambda: has_ended(pid), "its node has ended", 30.0)

"""A secure run has the same bytes as an open one, and leaks no keys."""

import stat
import subprocess
import sys
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import psutil
import pytest
from equal_runs import assert_equal, run_alone
from launched import MAST, Launched, eventually

from mast_zenoh import scenario
from mast_zenoh.mesh.security.authority import Authority

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]
FRAMES = "6"
WHAT = ("coordinated", "n_infrastructure=2", "n_adversaries=1", "attack_start_s=0.2")


def command_of(pid: int) -> list[str]:
    """The command of a node's process; [] as long as it has that of the process that forked it."""
    command = psutil.Process(pid).cmdline()
    return command if "--name" in command else []


def credentials(record: dict) -> list[Path]:
    """The credential folders of a run's processes."""
    folders = []
    for node in record["nodes"].values():
        command = eventually(partial(command_of, node["pid"]), "the node's process has its own command")
        assert not any("PRIVATE" in word for word in command)
        folders.append(Path(command[command.index("--credentials") + 1]))
    return folders


def test_a_secure_run_equals_the_open_one_exactly(launch, tmp_path: Path) -> None:
    plain = run_alone(tmp_path / "plain", *WHAT, frames=int(FRAMES), record=True)
    settings = [word for setting in WHAT[1:] for word in ("--set", setting)]
    run: Launched = launch(WHAT[0], "--frames", FRAMES, "--secure", *settings)
    folders = credentials(run.started())
    run.ended()
    assert_equal(plain, run.out)
    assert run.record()["security"] == "acl"
    assert run.record()["endpoint"].startswith("tls/")
    assert all(not node["foreign"] and not node["rejected"] for node in run.record()["nodes"].values())
    assert len(set(folders)) == len(folders)
    assert not any(folder.exists() for folder in (*folders, folders[0].parent))
    assert not [path for path in run.out.rglob("*") if path.is_file() and b"PRIVATE KEY" in path.read_bytes()]


def test_a_killed_launcher_leaves_no_keys_even_while_nodes_start(launch) -> None:
    run: Launched = launch("baseline", "--mode", "realtime", "--secure", "--set", "n_infrastructure=1", "--no-record")
    folders = credentials(run.started())
    assert all((folder / "key.pem").is_file() for folder in folders)
    run.kill()
    eventually(lambda: not folders[0].parent.exists(), "the nodes have deleted their keys")


def test_a_node_with_invalid_credentials_reports_the_fault_and_exits(tmp_path: Path) -> None:
    resolved = scenario.resolve(*scenario.load("baseline", ["n_infrastructure=1"]), frames=2)
    resolved.write(tmp_path)
    now = datetime.now(UTC)
    ends = now - timedelta(hours=1)
    folder = Authority("r").issue("ego", begins=now - timedelta(hours=2), ends=ends).write(tmp_path / "keys")
    words = {"run-folder": tmp_path, "name": "ego", "run": "r", "endpoint": "tls/127.0.0.1:1", "credentials": folder}
    command = [
        sys.executable,
        resolved.nodes["ego"].file,
        "--stay",
        *(f"--{key}={value}" for key, value in words.items()),
    ]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 16, ended.stderr
    assert f"{folder}: the certificate expired at {ends:%Y-%m-%d %H:%M:%S} UTC" in ended.stderr


LAX = ("sh", "-c", 'umask 000; exec "$@"', "sh", *MAST)
SMALL = ("--set", "n_infrastructure=1", "--out")


def modes(*folders: Path) -> dict[Path, int]:
    """Permissions of folders and their content, without symbolic links."""
    paths: Iterable[Path] = (path for folder in folders for path in (folder, *folder.rglob("*")))
    return {path: stat.S_IMODE(path.stat().st_mode) for path in paths if not path.is_symlink()}


def writable_by_others(permissions: dict[Path, int]) -> dict[str, str]:
    return {str(path): oct(mode) for path, mode in permissions.items() if mode & 0o022}


def test_runs_reports_and_the_cache_are_not_writable_by_others(start, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    run = start(*LAX, "run", "baseline", "--frames", "12", *SMALL)
    assert run.end()[0] == 0
    permissions = modes(run.out, tmp_path / "cache")
    names = {path.name for path in permissions}
    assert {"run.json", "messages.mcap", "metrics.json", "report.html", "scene.npz", "broker.log", "scenes"} <= names
    assert writable_by_others(permissions) == {}

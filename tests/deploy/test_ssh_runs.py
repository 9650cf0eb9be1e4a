"""Runs on three SSH hosts: results, recovery from failures, and cleanup."""

import json
import os
import signal
import stat
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
import ssh_hosts
import ssh_launch
from equal_runs import assert_equal
from launched import Launched, eventually
from ssh_hosts import NAMES, SshHosts

from mast_zenoh.deploy import wheel
from mast_zenoh.errors import EngineError
from mast_zenoh.launch import run as launcher
from mast_zenoh.run_folder.recording.reader import read

pytestmark = [pytest.mark.heavy, pytest.mark.long, pytest.mark.mesh, pytest.mark.timeout(300)]
PROGRAM = [sys.executable, ssh_launch.__file__]
LONG = 600  #: frames, which last a minute in real time: longer than any test lets such a run go on
PLACES = {"beta": 'nodes = ["ego", "infra_4", "infra_5"]', "gamma": 'nodes = ["infra_[1-3]"]'}


@pytest.fixture(scope="module")
def hosts(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SshHosts]:
    ssh_hosts.require()
    wheel.third_party(wheel.cache())  # built here because the launcher's network has no package index
    with SshHosts(tmp_path_factory.mktemp("hosts")) as started:
        yield started


def remnants_on(hosts: SshHosts) -> list[str]:
    """Remnants of runs: processes in hosts, except SSH servers, and files."""
    remnants = []
    for name in NAMES:
        words = [" ".join(_cmdline(process)) for process in hosts.processes(name)]
        remnants += [f"{name}: {line}" for line in words if not line.startswith("sshd:")]
        remnants += [str(path) for path in (hosts.home(name) / "runs").glob("*")]
        # not `rglob`: it fails if a folder disappears meanwhile
        files = [Path(folder, file) for folder, _, files in os.walk(hosts.home(name)) for file in files]
        remnants += [str(path) for path in files if path.suffix == ".pem" and "certifi" not in path.parts]
    return remnants


def _cmdline(process: psutil.Process) -> list[str]:
    try:
        return process.cmdline()
    except psutil.NoSuchProcess:
        return []


@pytest.fixture
def launch(hosts: SshHosts, start: Callable[..., Launched], tmp_path: Path) -> Callable[..., Launched]:
    """Starts runs; fails if anything of them remains after the test."""
    temporary = tmp_path / "tmp"
    temporary.mkdir()

    def run(text: str = "", places: dict[str, str] | None = None, **options: Any) -> Launched:
        toml = hosts.hosts_toml("hosts.toml", text, **(PLACES if places is None else places))
        command = [*hosts.inside, *PROGRAM, "run", str(toml), json.dumps(options)]
        return start(*command, afterwards=nothing_is_left, TMPDIR=str(temporary))

    def nothing_is_left(_: Launched) -> None:
        eventually(lambda: not remnants_on(hosts), f"nothing is left: {remnants_on(hosts)}", 30.0)
        assert [path for path in temporary.rglob("*") if path.suffix in (".pem", ".whl")] == []

    return run


def test_a_secure_run_on_three_hosts_equals_a_run_in_one_process(launch, hosts: SshHosts, tmp_path: Path) -> None:
    """With a router on one host, and with nodes that are killed and restarted."""
    steps = ((5, "kill", "infra_1"), (6, "leave", "infra_2"), (9, "start", "infra_2"), (10, "start", "infra_1"))
    run: Launched = launch('[router]\non = "beta"', secure="acl", frames=15, steps=steps)
    keys = run.until(lambda: [*hosts.folder.glob("*_home/runs/*/*/credentials/*/key.pem")], "keys arrive on the hosts")
    modes = {stat.S_IMODE(os.stat(place).st_mode) for key in keys for place in (key.parent, key.parent.parent)}
    assert modes == {0o700}
    assert {stat.S_IMODE(os.stat(key).st_mode) for key in keys} == {0o600}
    run.ended()
    record = run.record()
    assert [step["node"] for step in record["steps"]] == ["infra_1", "infra_2", "infra_2", "infra_1"]
    assert {name: node["restarts"] for name, node in record["nodes"].items() if node["restarts"]} == {
        "infra_1": 1,
        "infra_2": 1,
    }
    assert {node["host"] for node in record["nodes"].values()} == set(NAMES)
    assert sum(node["role"] == "agent" for node in record["nodes"].values()) == 8
    for node in record["nodes"].values():
        assert abs(node["clock"]["offset_ms"]) <= node["clock"]["round_trip_ms"], "both use the same clock"
    here = launcher.run(ssh_launch.resolved(15, steps=steps), tmp_path / "here", runtime="inproc")
    assert_equal(here.folder, run.out, taps=False)
    assert "router at tls/" in (run.out / "logs" / "@router.log").read_text()


def test_a_host_cut_off_for_five_seconds_rejoins(launch, hosts: SshHosts) -> None:
    """A lost SSH connection alone is restored without effect on the nodes."""
    steps = ((20, "pause", "infra_7"), (30, "resume", "infra_7"))
    run: Launched = launch(mode="realtime", frames=110, steps=steps)
    run.until(run.recorded, "frames are played")
    pids = {name: node["pid"] for name, node in run.record()["nodes"].items()}
    assert hosts.drop_connections("beta") > 0
    hosts.link("gamma", "down")
    threading.Event().wait(5.0)
    hosts.link("gamma", "up")
    run.ended()
    record = run.record()
    assert {node["exit"] for node in record["nodes"].values()} == {0}
    assert {node["restarts"] for node in record["nodes"].values()} == {0}
    assert {name: node["pid"] for name, node in record["nodes"].items() if pids[name]}.items() <= {
        name: node["pid"] for name, node in record["nodes"].items()
    }.items()
    assert record["deployment"]["hosts"]["beta"]["reattached"] >= 1
    assert sorted(step["action"] for step in record["steps"]) == ["pause", "resume"]
    frames: dict[str, set[int]] = {}
    for message in read(run.out):
        if message.wire.endswith("/tracks"):
            frames.setdefault(message.publisher, set()).add(message.frame)
    away = range(min(frames["infra_1"]) + 1, max(frames["infra_1"]))
    missing = [frame for frame in away if frame not in frames["infra_1"]]
    assert len(missing) >= 20, "it was away"
    assert frames["ego"].intersection(missing), "the other agents continued"
    assert max(frames["infra_1"]) > max(missing), "it has returned"
    for name in ("infra_1", "infra_2", "infra_3"):
        assert record["nodes"][name]["last_frame"] == 109


def test_remnants_of_a_killed_launchers_run_are_listed_and_can_be_removed(launch, hosts: SshHosts) -> None:
    """Also with a home directory shared by the hosts."""
    shared = {name: f'folder = "{hosts.home("alpha")}"' for name in ("beta", "gamma")}
    run: Launched = launch("patience_s = 600", mode="realtime", frames=LONG, n_infrastructure=1, places=shared)
    run.until(run.recorded, "frames are played")
    run.kill()
    status = json.loads(hosts.run(*PROGRAM, "status", str(run.out)).stdout)
    assert {entry["state"] for entry in status} == {"running"}
    assert {entry["node"] for entry in status} == set(run.record()["nodes"])
    before = hosts.run(*PROGRAM, "logs", str(run.out))
    assert before.returncode == 0, before.stderr
    for _ in range(2):  # removing what does not exist has no effect
        done = hosts.run(*PROGRAM, "down", str(run.out))
        assert done.returncode == 0, done.stderr
        assert remnants_on(hosts) == []
    assert {entry["state"] for entry in json.loads(hosts.run(*PROGRAM, "status", str(run.out)).stdout)} == {"not there"}


def test_remnants_of_a_killed_launchers_run_end_by_themselves(launch, hosts: SshHosts) -> None:
    """Also with a suspended node, which cannot notice that the launcher is gone."""
    run: Launched = launch("patience_s = 1", mode="realtime", frames=LONG, n_infrastructure=1, places={}, secure="acl")
    run.until(run.recorded, "frames are played")
    os.kill(run.until(lambda: run.record()["nodes"]["infra_1"]["pid"], "its process is known"), signal.SIGSTOP)
    run.kill()
    eventually(lambda: not remnants_on(hosts), "nothing is left", 60.0)


def test_ctrl_c_during_startup_leaves_nothing_on_hosts(launch, hosts: SshHosts) -> None:
    run: Launched = launch(n_infrastructure=1, places={}, secure="acl")
    run.until(lambda: [*hosts.folder.glob("*_home/runs/*/*/control")], "the first supervisor is running")
    run.interrupted()
    assert run.record()["status"] == "interrupted"


def test_a_killed_supervisor_ends_its_nodes_and_is_reported(launch, hosts: SshHosts) -> None:
    run: Launched = launch(mode="realtime", frames=LONG, n_infrastructure=1, places={"beta": 'nodes = ["broker"]'})
    run.until(run.recorded, "frames are played")
    for process in hosts.processes("beta"):
        if "mast_zenoh.deploy.ssh.warden" in _cmdline(process):
            process.kill()
    output = run.ended(22)
    assert "broker killed by signal 9" in output
    assert hosts.run(*PROGRAM, "down", str(run.out)).returncode == 0, "its folder"


def test_an_unreachable_router_is_reported_before_nodes_start(launch) -> None:
    run: Launched = launch('[router]\naddress = "10.78.0.99"', n_infrastructure=1, places={})
    output = run.ended(EngineError.exit_code)
    assert "cannot reach the router at tcp/10.78.0.99:7447" in output
    assert "router.address" in output
    assert run.record()["nodes"] == {}


def test_unsuitable_hosts_are_refused_before_anything_starts(hosts: SshHosts, tmp_path: Path) -> None:
    old = tmp_path / "old_python"
    old.write_text("#!/bin/sh\necho 3.9 x86_64\n")
    old.chmod(0o755)
    (tmp_path / "closed").write_text("")
    codecs = {path: path.read_text() for path in hosts.home("alpha").glob("releases/*/mast_zenoh/messages/codec.py")}
    assert codecs, "an earlier run has installed it there"
    broken = {
        "fine": "",
        "key": f'known_hosts = "{hosts.swap_keys("alpha", "beta")}"',
        "unknown": f'known_hosts = "{tmp_path}/closed"',
        "refused": f'key = "{hosts.folder}/alpha_host"',
        "port": "port = 2222",
        "nowhere": "",
        "python": 'python = "python4"',
        "old": f'python = "{old}"',
        "full": "",
        "closed": "",
    }
    files = {name: hosts.hosts_toml(f"{name}.toml", alpha=more) for name, more in broken.items()}
    _replace(files["nowhere"], '"10.78.0.2"', '"10.78.0.77"')
    _replace(files["full"], str(hosts.home("alpha")), str(hosts.full))
    _replace(files["closed"], str(hosts.home("alpha")), f"{tmp_path}/closed")
    try:
        done = hosts.run(*PROGRAM, "check", *map(str, files.values()))
        assert done.returncode == 0, done.stderr
        for codec in codecs:
            codec.write_text(codec.read_text() + "\n")
        other = hosts.run(*PROGRAM, "check", str(files["fine"]))
    finally:
        for codec, text in codecs.items():
            codec.write_text(text)
    content = json.loads(done.stdout)
    assert content.pop("fine") == [0, ""]
    assert content.pop("full")[0] == 28, "DiskFull"
    assert {code for code, _ in content.values()} == {EngineError.exit_code}, content
    assert all("host alpha (root@10.78.0." in message for _, message in content.values())
    expected = {
        "key": "its host key is not the one in",
        "unknown": "its host key is not the one in",
        "refused": "refuses our login with",
        "port": "out of reach",
        "nowhere": "out of reach",
        "python": "there is no python4",
        "old": "is Python 3.9, expected 3.11 or newer",
        "closed": "Not a directory",
    }
    assert {name: expected[name] for name, (_, message) in content.items() if expected[name] in message} == expected
    (code, message) = json.loads(other.stdout)["fine"]
    assert code == 29, "VersionMismatch"
    assert message.count("(sources ") == 2, "both versions are named"
    assert remnants_on(hosts) == []


def _replace(file: Path, old: str, new: str) -> None:
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))

"""Impossible deployments are refused before anything is started or written."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.control import files
from mast_zenoh.control.codec import Message
from mast_zenoh.deploy import doctor, engines, space
from mast_zenoh.deploy.compose import document
from mast_zenoh.deploy.compose.containers import connected_as
from mast_zenoh.errors import BackendError, ConfigurationError, DiskFull, EngineError, RunError
from mast_zenoh.launch import run
from mast_zenoh.launch.file_server import files_for_node, with_local_imports
from mast_zenoh.messagelog.writer import MessageLog
from mast_zenoh.runtime.file_client import FileClient, files_written_by


def small(name: str = "baseline") -> Resolved:
    path, loaded = scenario.load(name, ["n_infrastructure=1"])
    return scenario.resolve(path, loaded, frames=2, record=True)


def up(out: Path, environment: Mapping[str, str], *words: str) -> subprocess.CompletedProcess[str]:
    command = [
        sys.executable,
        "-m",
        "mast_zenoh",
        "deploy",
        "up",
        "baseline",
        "--frames",
        "2",
        "--out",
        str(out),
        *words,
    ]
    return subprocess.run(
        command, capture_output=True, text=True, env={**os.environ, **environment}, timeout=120, check=False
    )


def test_an_unreachable_engine_is_reported(tmp_path: Path) -> None:
    docker = tmp_path / "bin" / "docker"
    docker.parent.mkdir()
    docker.write_text("#!/bin/sh\necho 'Cannot connect to the Docker daemon' >&2; exit 1\n")
    docker.chmod(0o755)
    process = up(tmp_path / "run", {"PATH": f"{docker.parent}:{os.environ['PATH']}"})
    assert process.returncode == EngineError.exit_code, process.stdout + process.stderr
    assert "the Docker engine cannot be reached" in process.stderr
    assert "Cannot connect to the Docker daemon" in process.stderr
    assert not (tmp_path / "run").exists()


def test_a_machine_without_an_engine_gets_install_instructions(tmp_path: Path) -> None:
    process = up(tmp_path / "run", {"PATH": str(tmp_path)})
    assert process.returncode == EngineError.exit_code
    assert "there is no `docker` on this machine: install docker.io" in process.stderr
    assert not (tmp_path / "run").exists()


def unplugged(until: float = 2.0, rate: float = 1.0) -> Resolved:
    path, loaded = scenario.load("baseline", ["n_infrastructure=1"])
    loaded |= dict(faults=[dict(type="Unplug", at=0.5, until=until, node="infra_1")])
    return scenario.resolve(path, loaded, frames=60, mode="realtime", rate=rate)


@pytest.mark.parametrize(
    ("engine", "runtime", "where"),
    [("swarm", "mesh", "engine swarm"), ("", "mesh", "processes of this machine"), ("", "inproc", "one process")],
)
def test_a_disconnect_fault_on_an_unable_engine_is_refused_before_anything_starts(
    tmp_path: Path, engine: str, runtime: str, where: str
) -> None:
    with pytest.raises(BackendError, match=rf"'infra_1' \(before frame 5\).*compose.*found {where}; use Partition"):
        run.run(unplugged(), tmp_path / "run", runtime=runtime, engine=engines.load(engine)() if engine else None)
    assert not (tmp_path / "run").exists()


def test_nodes_on_ssh_hosts_cannot_be_disconnected() -> None:
    assert [name for name in engines.names() if engines.load(name).unplugs] == ["compose"]


def test_a_disconnected_node_waits_longer_for_the_launcher() -> None:
    compose_file = document.document(unplugged(until=4.5, rate=0.5), "a-run", image="any", patience_s=10.0)
    waits = {name: service["command"][-1] for name, service in compose_file["services"].items()}
    assert waits.pop("infra_1") == "18", "4 s of scene time at half speed"
    assert set(waits.values()) == {"10"}


def test_a_container_is_reconnected_with_its_former_addresses() -> None:
    assert connected_as({"Aliases": ["infra_1", "0a1b"], "IPAMConfig": None}) == [
        "--alias",
        "infra_1",
        "--alias",
        "0a1b",
    ]
    fixed = {"Aliases": None, "IPAMConfig": {"IPv4Address": "192.0.2.7"}, "IPAddress": "192.0.2.7"}
    assert connected_as(fixed) == ["--ip", "192.0.2.7"]
    assert connected_as({"IPAddress": "192.0.2.7"}) == [], "an address assigned by Docker may be reassigned"


def test_a_full_disk_is_reported_before_anything_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needed = space.needed(small())
    monkeypatch.setattr(os, "statvfs", lambda path: SimpleNamespace(f_bavail=needed // 512, f_frsize=512))
    space.check(tmp_path / "not" / "there", needed)
    with pytest.raises(DiskFull, match=r"MiB are free, \d+ MiB may be needed"):
        space.check(tmp_path / "not" / "there", needed + 512)
    assert not (tmp_path / "not").exists()


def test_an_option_unsupported_by_the_engine_is_a_usage_error(tmp_path: Path) -> None:
    process = up(tmp_path / "run", {}, "--hosts", "hosts.toml")
    assert process.returncode == 2
    assert "engine compose has no such option" in " ".join(process.stderr.split())


def test_an_unknown_engine_is_refused_with_the_nearest() -> None:
    with pytest.raises(EngineError, match="did you mean 'compose'"):
        engines.load("composed")
    assert engines.names() == ("compose", "ssh", "swarm")


ENGINES = """
from mast_zenoh.launch.engine import Engine

class {first}(Engine):
    def __init__(self, *, racks: int = 1, place: str = "here") -> None:
        self.racks = racks
    check = join = lambda self, *arguments: None
    status = logs = down = classmethod(lambda cls, *arguments, **more: [])

class {second}({first}):
    pass
"""


@pytest.fixture
def engine_file(tmp_path: Path) -> Path:
    """A file that defines two engines."""
    (tmp_path / "lab.py").write_text(ENGINES.format(first="Rack", second="Blade"))
    return tmp_path / "lab.py"


def test_an_engine_is_found_in_its_defining_file(engine_file: Path) -> None:
    kind = engines.load(f"{engine_file}:Rack")
    assert kind.name == f"{engine_file}:Rack"
    assert engines.load(kind.name) is kind
    engine = engines.make(kind, engines.options(kind, ["racks=3"]))
    assert engine.racks == 3


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("{file}", "found the engines Blade, Rack, expected one, or --engine .*lab.py:NAME"),
        ("{file}:Rak", "defines no engine 'Rak'; did you mean 'Rack'"),
        ("{folder}/nosuch.py", "nosuch.py: no such file, expected one that defines a subclass of"),
    ],
)
def test_a_file_without_the_requested_engine_is_refused(engine_file: Path, name: str, message: str) -> None:
    with pytest.raises(EngineError, match=message):
        engines.load(name.format(file=engine_file, folder=engine_file.parent))


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("rack=3", "--option rack=3: engine .*lab.py:Rack has no such parameter; did you mean 'racks'"),
        ("racks", "--option racks: expected KEY=VALUE"),
        ("racks=many", "engine .*lab.py:Rack.racks: found 'many', expected a whole number"),
    ],
)
def test_an_invalid_parameter_of_an_engine_is_named(engine_file: Path, option: str, message: str) -> None:
    kind = engines.load(f"{engine_file}:Rack")
    with pytest.raises(ConfigurationError, match=message):
        engines.make(kind, engines.options(kind, [option]))


def test_the_doctor_finds_the_mesh_and_suggests_fixes_for_missing_tools() -> None:
    findings = {finding.name: finding for finding in doctor.examine()}
    assert findings["python"].ok
    assert findings["zenoh"].ok
    assert all(finding.fix for finding in findings.values() if not finding.ok)


def test_the_doctor_diagnoses_a_certificate(tmp_path: Path) -> None:
    *_, last = doctor.examine(tmp_path)
    assert last.name == "certificates"
    assert last.ok is False
    assert "is missing" in last.detail


# -- files that remote nodes receive and send ----------------------------------------------------------------------


def test_a_node_gets_only_its_own_file_and_imports(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("import near, package.inside\nfrom os import path\n")
    (tmp_path / "near.py").write_text("from further import x\n")
    (tmp_path / "further.py").write_text("import mine\nx = 1\n")
    (tmp_path / "secret.py").write_text("")
    (tmp_path / "package").mkdir()
    for name in ("__init__", "inside"):
        (tmp_path / "package" / f"{name}.py").write_text("")
    names = {path.relative_to(tmp_path).as_posix() for path in with_local_imports(tmp_path / "mine.py")}
    assert names == {"mine.py", "near.py", "further.py", "package/__init__.py", "package/inside.py"}


def test_the_scene_is_served_only_to_the_driver(tmp_path: Path) -> None:
    resolved = small()
    files = {name: {path for path, _ in files_for_node(resolved, name, tmp_path)} for name in resolved.nodes}
    assert files["simulator"] == {"scenario.json", "wiring.json", "files/0/simulator.py", "scene.npz"}
    assert files["ego"] == {"scenario.json", "wiring.json", "files/0/agent.py"}
    served = dict(files_for_node(resolved, "ego", tmp_path))["scenario.json"]
    assert isinstance(served, bytes)
    assert str(Path(__file__).parents[2]).encode() not in served, "no path of the launcher's machine"


def test_only_a_recorder_may_send_a_log() -> None:
    resolved = small()
    assert {name: files_written_by(resolved, name) for name in resolved.nodes if files_written_by(resolved, name)} == {
        "recorder": (str(MessageLog().path),)
    }


class Launcher(FileClient):
    """A launcher that names one empty file for a node."""

    def __init__(self, path: str) -> None:
        super().__init__(None, "run", "node")  # type: ignore[arg-type]
        self.path = path

    def ask(self, what: str, request: Message, seconds: float, kind: type[Any]) -> Any:
        is_clock = isinstance(request, files.Clock)
        return files.LauncherTime(time.time_ns()) if is_clock else files.NodeFiles({self.path: 0}, [])


@settings(deadline=None)
@given(st.text(st.sampled_from("./ab~\\"), min_size=1, max_size=12))
def test_file_names_cannot_escape_the_folder(name: str) -> None:
    with tempfile.TemporaryDirectory() as around:
        folder = Path(around) / "a" / "b" / "folder"
        folder.mkdir(parents=True)
        if Path(name).is_absolute():
            with pytest.raises(RunError, match="leads outside the run folder"):
                Launcher(name).fetch(folder, 1.0)
        with suppress(RunError, IsADirectoryError):
            Launcher(name).fetch(folder, 1.0)
        written = [path for path in Path(around).rglob("*") if path.is_file()]
        assert all(path.is_relative_to(folder) for path in written)

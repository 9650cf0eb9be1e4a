"""Impossible deployments are refused before anything is started or written."""

import json
import os
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import commands_in_process
import pytest
from typer.testing import CliRunner

from mast_zenoh import kernels, scenario
from mast_zenoh.cli.app import app
from mast_zenoh.config import plugins
from mast_zenoh.deploy import doctor, engines, wheel
from mast_zenoh.deploy.engine import check_space, needed_space, numeric_environment
from mast_zenoh.errors import BackendError, ConfigurationError, DiskFull, EngineError, PluginError
from mast_zenoh.launch import liveness, run


def up(out: Path, *words: str) -> commands_in_process.Ended:
    return commands_in_process.command("deploy", "up", "baseline", "--frames", "2", "--out", str(out), *words)


def test_an_engine_whose_dependency_is_missing_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "asyncssh", None)
    for module in ("engine", "connection"):
        monkeypatch.delitem(sys.modules, f"mast_zenoh.deploy.ssh.{module}", raising=False)
    with pytest.raises(EngineError, match=r"asyncssh .*mast-zenoh\[deploy\]"):
        engines.load("ssh")


def test_a_missing_or_unreachable_engine_is_reported_before_anything_is_written(tmp_path: Path, monkeypatch) -> None:
    docker = tmp_path / "bin" / "docker"
    docker.parent.mkdir()
    docker.write_text("#!/bin/sh\necho 'Cannot connect to the Docker daemon' >&2; exit 1\n")
    docker.chmod(0o755)
    for path, messages in (
        (f"{docker.parent}:{os.environ['PATH']}", ["Docker engine cannot be reached", "Cannot connect to the Docker"]),
        (str(tmp_path), ["there is no `docker` on this machine: install docker.io"]),
    ):
        monkeypatch.setenv("PATH", path)
        ended = up(tmp_path / "run")
        assert ended.code == EngineError.exit_code, ended
        assert all(message in ended.err for message in messages)
        assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("engine", "runtime", "where"),
    [("ssh", "mesh", "engine ssh"), ("", "mesh", r"processes.*machine"), ("", "inproc", "one process")],
)
def test_a_disconnect_fault_on_an_unable_engine_is_refused_before_anything_starts(
    tmp_path: Path, engine: str, runtime: str, where: str
) -> None:
    path, loaded = scenario.load("baseline", ["n_infrastructure=1"])
    loaded |= dict(faults=[dict(type="Unplug", at=0.5, until=2.0, node="infra_1")])
    unplugged = scenario.resolve(path, loaded, frames=60, mode="realtime", rate=1.0)
    with pytest.raises(BackendError, match=rf"'infra_1'.*5.*{where}"):
        run.run(unplugged, tmp_path / "run", runtime=runtime, engine=engines.load(engine)() if engine else None)
    assert not (tmp_path / "run").exists()


def test_a_full_disk_is_reported_before_anything_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, loaded = scenario.load("baseline", ["n_infrastructure=1"])
    needed = needed_space(scenario.resolve(path, loaded, frames=2, record=True))
    monkeypatch.setattr(os, "statvfs", lambda path: SimpleNamespace(f_bavail=needed // 512, f_frsize=512))
    check_space(tmp_path / "not" / "there", needed)
    with pytest.raises(DiskFull, match=r"MiB.*MiB.*needed"):
        check_space(tmp_path / "not" / "there", needed + 512)
    assert not (tmp_path / "not").exists()


def test_an_option_unsupported_by_the_engine_is_a_usage_error(tmp_path: Path) -> None:
    ended = up(tmp_path / "run", "--hosts", "hosts.toml")
    assert ended.code == 2
    assert "engine compose" in " ".join(ended.err.split())


# -- engines of users --------------------------------------------------------------------------------------------

ENGINES = """
from mast_zenoh.launch.engine import Engine

class Rack(Engine):
    def __init__(self, *, racks: int = 1, place: str = "here") -> None:
        self.racks = racks
    check = join = lambda self, *arguments: None
    status = logs = down = classmethod(lambda cls, *arguments, **more: [])

class Blade(Rack):
    pass
"""


@pytest.fixture
def engine_file(tmp_path: Path) -> Path:
    """A file that defines two engines."""
    (tmp_path / "lab.py").write_text(ENGINES)
    return tmp_path / "lab.py"


def test_an_engine_is_found_by_its_name_or_in_its_defining_file(engine_file: Path) -> None:
    assert sorted(engines.names()) == ["compose", "ssh"]
    assert [name for name in engines.names() if engines.load(name).unplugs] == ["compose"]
    kind = engines.load(f"{engine_file}:Rack")
    assert kind.name == f"{engine_file}:Rack"
    assert engines.load(kind.name) is kind
    engine = engines.make(kind, engines.options(kind, ["racks=3"]))
    assert engine.racks == 3  # type: ignore[attr-defined]


def test_an_engine_of_a_plugin_is_found_by_the_name_of_its_class(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "racks_of_somebody.py").write_text(ENGINES.replace("Rack", "Shelf").replace("Blade", "Board"))
    monkeypatch.syspath_prepend(tmp_path)
    installed = (plugins.Plugin("racks", "racks_of_somebody", "racks 1.0"),)
    monkeypatch.setattr(plugins, "installed", lambda: installed)
    plugins.load.cache_clear()
    try:
        assert engines.load("Shelf").name == "Shelf"
        assert set(engines.names()) == {"compose", "ssh", "Shelf", "Board"}
        with pytest.raises(EngineError, match=r"engine 'Shelv'.*'Shelf'"):
            engines.load("Shelv")
    finally:
        plugins.load.cache_clear()


def test_a_run_whose_engine_is_of_a_plugin_that_is_not_installed_names_the_plugin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plugins, "_expected", {})
    record = {"id": "x-1", "deployment": {"engine": "Gentle"}, "launcher": liveness.identity()}
    for plugin, error, message in (
        ({}, EngineError, "there is no engine 'Gentle'; known: compose, ssh"),
        (
            {"engine_plugin": "racks 0.4"},
            PluginError,
            "it is in the plugin racks 0.4, which this host does not have",
        ),
    ):
        (tmp_path / "run.json").write_text(json.dumps(record | plugin))
        with pytest.raises(error, match=message):
            CliRunner().invoke(app, ["deploy", "status", str(tmp_path)], catch_exceptions=False)


def test_the_swarm_engine_names_what_serves_instead_also_to_a_run_that_it_started(tmp_path: Path) -> None:
    message = "engine swarm is gone: --engine compose runs the nodes on this machine, --engine ssh on several"
    with pytest.raises(EngineError, match=message):
        engines.load("swarm")
    record = {"id": "x-1", "deployment": {"engine": "swarm", "stack": "mast-1"}, "launcher": liveness.identity()}
    (tmp_path / "run.json").write_text(json.dumps(record))
    for command in ("status", "logs", "down"):
        with pytest.raises(EngineError, match=message):
            CliRunner().invoke(app, ["deploy", command, str(tmp_path)], catch_exceptions=False)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("composed", [], r"engine 'composed'.*'compose'"),
        ("{file}", [], "Blade, Rack.*lab.py:NAME"),
        ("{file}:Rak", [], r"defines.*'Rak'.*'Rack'"),
        ("{folder}/nosuch.py", [], r"nosuch.py.*defines.*subclass"),
        ("{file}:Rack", ["rack=3"], "rack=3.*lab.py:Rack.*'racks'"),
        ("{file}:Rack", ["racks"], r"--option racks.*KEY=VALUE"),
        ("{file}:Rack", ["racks=many"], "lab.py:Rack.racks: found 'many'"),
    ],
)
def test_an_unknown_engine_or_an_invalid_parameter_of_it_is_named(
    engine_file: Path, name: str, options: list[str], message: str
) -> None:
    def make(name: str) -> object:
        kind = engines.load(name)
        return engines.make(kind, engines.options(kind, options))

    with pytest.raises(ConfigurationError if options else EngineError, match=message):
        make(name.format(file=engine_file, folder=engine_file.parent))


# -- images -----------------------------------------------------------------------------------------------------

#: What Docker writes when it cannot pull the base image: its reason is not on the last line.
_NOT_PULLED = """Unable to find image 'python:3.12-slim' locally
docker: Error response from daemon: Get "https://images.example/v2/": dial tcp: lookup images.example: no such host
{advice}
"""


def fake_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, errors: str, code: int) -> None:
    """Put a command first on the path that writes errors and fails."""
    (tmp_path / "errors").write_text(errors)
    (tmp_path / name).write_text(f"#!/bin/sh\ncat '{tmp_path}/errors' >&2\nexit {code}\n")
    (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")


@pytest.mark.parametrize(
    "advice", ["See 'docker run --help'.", "\nRun 'docker run --help' for more information", "exit status 1"]
)
def test_an_image_that_cannot_be_built_says_why_in_the_engines_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, advice: str
) -> None:
    fake_command(tmp_path, monkeypatch, "docker", _NOT_PULLED.format(advice=advice), 125)
    answer = CliRunner().invoke(app, ["deploy", "image"])
    assert isinstance(answer.exception, EngineError)
    assert "lookup images.example: no" in str(answer.exception)


def test_wheels_that_cannot_be_downloaded_name_the_broken_connection(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    errors = (
        "WARNING: Retrying (Retry) after connection broken by 'Error(Name or service not known)'\n"
        "ERROR: No matching distribution found for numpy==1.0\n"
    )
    fake_command(tmp_path, monkeypatch, "python", errors, 1)
    monkeypatch.setattr(wheel.sys, "executable", str(tmp_path / "python"))
    with pytest.raises(EngineError, match=r"service.*matching distribution"):
        wheel.third_party(tmp_path / "wheels", required=["numpy==1.0"])


def test_remote_nodes_get_only_the_variables_that_affect_floating_point_results() -> None:
    ours = {"OPENBLAS_CORETYPE": "Haswell", "OPENBLAS_NUM_THREADS": "2", "HOME": "/somewhere"}
    environment = numeric_environment(ours)
    assert environment.pop("MAST_KERNELS", kernels.USED) == kernels.USED
    assert environment == {"OPENBLAS_CORETYPE": "Haswell"}


# -- mast doctor -------------------------------------------------------------------------------------------------


def test_the_doctor_finds_the_mesh_and_suggests_fixes(tmp_path: Path) -> None:
    findings: dict[str, Any] = {finding.name: finding for finding in doctor.examine(tmp_path)}
    assert [findings[name].ok for name in ("python", "zenoh", "certificates")] == [True, True, False]
    assert "is missing" in findings["certificates"].detail
    del findings["certificates"]
    assert all(finding.fix for finding in findings.values() if not finding.ok)


def test_a_bug_report_has_what_is_needed_and_nothing_personal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "Mary Major"
    home.mkdir()
    monkeypatch.chdir(home)
    monkeypatch.setattr(doctor.platform, "node", lambda: "workbench.example.org")
    monkeypatch.setattr(doctor.pwd, "getpwuid", lambda uid: SimpleNamespace(pw_name="mmajor"))
    for name, value in {
        "HOME": str(home),
        "DOCKER_HOST": "ssh://joe:pw77@engine.example.org:2375",
        "TOKEN": "s3cret",
    }.items():
        monkeypatch.setenv(name, value)
    told = (
        f"cannot connect to {os.environ['DOCKER_HOST']} as mmajor@workbench (workbench.example.org) with s3cret: "
        f"no file {home}/.docker/config.json, '/srv/data/mary', unix:///run/user/1000/docker.sock, "
        'ssh -l joe -- engine.example.org, lookup engine.example.org with pw77, context "lab-of-mary", '
        "ssh://mary@10.1.2.3, tcp/192.0.2.7:7447, tcp/[fe80::1c2d:3]:7447, [::1]; engine 29.1.3, 3 GiB"
    )
    findings = [doctor.Diagnosis("python", True, "3.12.1"), doctor.Diagnosis("docker", None, told)]
    report = doctor.report(findings)
    personal = (
        "joe",
        "pw77",
        "mary",
        "mmajor",
        "workbench",
        "example.org",
        "s3cret",
        "192.0.2.7",
        "10.1.2.3",
        "fe80",
        "::1",
    )
    assert not [word for word in (*personal, str(tmp_path), "/srv", "/run/") if word.lower() in report.lower()], report
    assert "ok python     3.12.1\n-- docker     cannot connect to $DOCKER_HOST as <user>@<host> (<host>)" in report
    assert "engine 29.1.3, 3 GiB" in report
    for fact in ("Linux", "processors", "GiB of memory", "eclipse-zenoh 1.", "numpy 2.", "cryptography "):
        assert fact in report


def test_a_bug_report_has_a_line_for_every_check_and_the_exit_code_of_the_doctor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    usable = [doctor.python, doctor.compiled_kernels, doctor.disk_space]
    for checks, code in ((usable, 0), ([lambda: doctor.Diagnosis("disk", False, "full", "make room")], 1)):
        monkeypatch.setattr(doctor, "CHECKS", checks)
        result = CliRunner().invoke(app, ["doctor", "--report"])
        assert result.exit_code == code, result.output
        names = [line.split()[1] for line in result.output.splitlines()]
        assert names == [*(check().name for check in checks), "system", "packages"], result.output
    refused = CliRunner().invoke(app, ["doctor", "--report", "--credentials", "folder"])
    assert refused.exit_code == 2

"""Nodes with an interpreter of their own: what is refused before a run starts."""

import sys
from pathlib import Path
from typing import Any

import pytest
from tiny_world import tiny

from mast_zenoh.config.loading import AllowedCode
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.deploy import engines
from mast_zenoh.errors import ConfigurationError, UntrustedCode, VersionMismatch
from mast_zenoh.launch import run
from mast_zenoh.launch.processes import check_interpreters
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.scenario.nodes import node_spec


def resolved(python: object) -> Resolved:
    return tiny(frames=2, edit=lambda content: content.update(broker=content.get("broker", {}) | dict(python=python)))


def script(folder: Path, line: str) -> Path:
    """An interpreter that is a script."""
    file = folder / "python"
    file.write_text(f"#!/bin/sh\n{line}\n")
    file.chmod(0o755)
    return file


def test_a_path_is_relative_to_the_scenario_and_links_stay(tmp_path: Path) -> None:
    (tmp_path / "python").symlink_to(sys.executable)
    spec = node_spec(tmp_path / "mine.py", "broker", "broker", {"python": "python"})
    assert spec.python == str(tmp_path / "python")
    assert "python" not in spec.config
    assert node_spec(tmp_path / "mine.py", "broker", "broker", {}).python == ""


def test_without_one_nothing_is_written_and_with_one_it_is_read_again() -> None:
    plain, own = tiny(frames=2), resolved(sys.executable)
    assert not any("python" in spec for spec in plain.to_json()["nodes"].values())
    again = Resolved.from_json(own.to_json() | {"steps": [], "idle": []}, own.wiring)
    assert again.nodes["broker"].python == sys.executable


@pytest.mark.parametrize(
    ("python", "message"),
    [
        ("nowhere/python", r"baseline\.py: broker\.python: found no file .*nowhere/python, expected an interpreter"),
        (__file__, r"broker\.python: found the file .*test_own_interpreters\.py, which cannot be executed"),
        (3, r"broker\.python: found 3, expected the path"),
    ],
)
def test_what_is_no_interpreter_is_named(python: object, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        resolved(python)


def test_an_interpreter_without_mast_is_named_with_the_reason(tmp_path: Path) -> None:
    without = script(tmp_path, f'unset PYTHONPATH; exec {sys.executable} -I -S "$@"')
    message = r"broker\.python: .* cannot import mast-zenoh: ModuleNotFoundError: .*expected"
    with pytest.raises(ConfigurationError, match=message):
        run.run(resolved(str(without)), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_an_interpreter_with_another_mast_is_named_with_both_versions(tmp_path: Path) -> None:
    other = script(tmp_path, "echo '0.0.9 (sources 012345)'")
    with pytest.raises(
        VersionMismatch, match=r"broker\.python: .* has mast-zenoh 0\.0\.9 .*, expected 0\.1\.0 \(sources"
    ):
        check_interpreters(resolved(str(other)).nodes)
    check_interpreters(resolved(sys.executable).nodes)


def test_a_file_that_is_no_program_is_named(tmp_path: Path) -> None:
    file = tmp_path / "python"
    file.write_bytes(b"\x7fnothing")
    file.chmod(0o755)
    with pytest.raises(ConfigurationError, match=r"broker\.python: .*python cannot be used: "):
        check_interpreters(resolved(str(file)).nodes)


def test_one_process_and_engines_refuse_it(tmp_path: Path) -> None:
    own = resolved(sys.executable)
    with pytest.raises(ConfigurationError, match=r"broker\.python: found .*, expected none in one process: .*mesh"):
        run.run(own, tmp_path / "run", runtime="inproc")
    with pytest.raises(ConfigurationError, match="expected none in one process"):
        InProcess(own)
    compose = engines.load("compose")
    engine: Any = compose.__new__(compose)
    with pytest.raises(ConfigurationError, match="expected none with engine compose"):
        run.run(own, tmp_path / "run", engine=engine)
    assert not (tmp_path / "run").exists()


def test_a_run_folder_of_a_stranger_starts_no_interpreter_that_it_names(tmp_path: Path) -> None:
    mark = tmp_path / "begun"
    own = resolved(str(script(tmp_path, f"touch {mark}")))
    folder = tmp_path / "run"
    folder.mkdir()
    own.write(folder)
    read = Resolved.read(folder)
    with pytest.raises(UntrustedCode, match="python"):
        check_interpreters(read.nodes)
    assert not mark.exists()
    trusted = Resolved.read(folder, AllowedCode(confirmed=True))
    assert trusted.nodes["broker"].python == str(tmp_path / "python")

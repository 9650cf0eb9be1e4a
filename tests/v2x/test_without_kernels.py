"""Without compiled kernels, runs with CPMs or CAMs are refused before they start, and all others work."""

import os
import subprocess
import sys

import pytest

import mast_zenoh as mast
from mast_zenoh import kernels, scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError, MessageError
from mast_zenoh.launch import run as launcher
from mast_zenoh.launch.checks.evidence import RunEvidence
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.messages import codec
from mast_zenoh.run_folder.recording.reader import read
from mast_zenoh.runs.recorded import open_recorded
from mast_zenoh.v2x import cpm

SMALL = ("n_infrastructure=1", "n_mobile=1")
REASON = r" needs compiled kernels, which are not used: "


def peers(*settings: str) -> Resolved:
    path, content = scenario.load("peers", [*SMALL, *settings])
    return scenario.resolve(path, content, frames=2)


def switch_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """As MAST_KERNELS=numpy does."""
    monkeypatch.setattr(kernels, "USED", "numpy")


@pytest.mark.parametrize(
    ("setting", "wire"),
    [("codec=cpm", r"codec cpm on 'agent/ego/broadcast'"), ("awareness=true", r"codec cam on 'agent/ego/awareness'")],
)
def test_a_scenario_with_a_codec_is_refused_with_the_wire_and_the_remedy(monkeypatch, setting, wire):
    switch_off(monkeypatch)
    disabled = REASON + "MAST_KERNELS=numpy disables them; to use them, unset MAST_KERNELS"
    with pytest.raises(ConfigurationError, match=r"peers\.py: " + wire + disabled):
        peers(setting)
    monkeypatch.setattr(kernels, "COMPILED", {})
    with pytest.raises(ConfigurationError, match=wire + REASON + r".*; to use them, install .*make kernels"):
        peers(setting)


def test_a_resolved_scenario_is_refused_before_its_run_has_a_folder(monkeypatch, tmp_path):
    resolved = peers("codec=cpm")
    switch_off(monkeypatch)
    for runtime in ("inproc", "mesh"):
        with pytest.raises(ConfigurationError, match="^peers: codec cpm on" + ".*" + REASON):
            launcher.run(resolved, tmp_path / "run", runtime=runtime)
    with pytest.raises(ConfigurationError, match="codec cpm on"):
        InProcess(resolved)
    assert not (tmp_path / "run").exists()


def test_a_recording_with_a_codec_is_refused_and_its_messages_are_as_those_of_a_stranger(monkeypatch, tmp_path):
    """A node without kernels must not fail because of a message that no wire of its run has."""
    resolved = peers("codec=cpm")
    mast.run("peers", frames=2, codec="cpm", n_infrastructure=1, n_mobile=1, out=tmp_path / "run", runtime="inproc")
    cpms = [message for message in read(tmp_path / "run") if message.wire.endswith("/broadcast")]
    assert len(codec.decode(cpms[-1].payload, "tracks").body["id"])
    switch_off(monkeypatch)
    with pytest.raises(MessageError, match=r"cpm.*it.*MAST_KERNELS"):
        codec.decode(cpms[-1].payload, "tracks")
    with pytest.raises(ConfigurationError, match="run: codec cpm"):
        open_recorded(tmp_path / "run")
    with pytest.raises(ConfigurationError, match="run: codec cpm"):
        RunEvidence.read(tmp_path / "run", resolved)


def test_without_kernels_bytes_are_neither_read_nor_written() -> None:
    program = cpm.LAYOUT.program
    for name, what in (("decode_values", "reading"), ("encode_values", "writing")):
        with pytest.raises(ConfigurationError, match=f"{what} CPMs.*CAMs"):
            kernels.REFERENCES[name](program, b"")


@pytest.mark.parametrize(("setting", "code"), [("codec=cpm", 10), ("codec=columns", 0)])
def test_the_command_ends_with_one_line_and_the_code_of_a_configuration_error(tmp_path, setting, code):
    settings = [word for each in (setting, *SMALL) for word in ("--set", each)]
    options = ["--frames", "2", "--runtime", "inproc", "--no-report", "--out", str(tmp_path / "run")]
    process = subprocess.run(
        [sys.executable, "-m", "mast_zenoh", "run", "peers", *settings, *options],
        env=os.environ | {"MAST_KERNELS": "numpy"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == code, process.stderr
    assert (tmp_path / "run").exists() == (code == 0)
    if code:
        (line,) = process.stderr.splitlines()
        assert "'agent/ego/broadcast' needs compiled" in line

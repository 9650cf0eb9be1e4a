"""An installed wheel works outside the checkout."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from mast_zenoh import kernels

ROOT = Path(__file__).parents[2]
pytestmark = [pytest.mark.heavy, pytest.mark.mesh]


def mast(site: Path, folder: Path, *words: str, code: int = 0) -> str:
    """The output of a command of an installed wheel, which ends with a code."""
    environment = {name: value for name, value in os.environ.items() if name != "MAST_KERNELS"}
    command = [sys.executable, "-c", "from mast_zenoh.cli.app import main; main()", *words]
    options = {"cwd": folder, "env": environment | {"PYTHONPATH": str(site)}, "capture_output": True, "text": True}
    process = subprocess.run(command, check=False, **options)
    assert process.returncode == code, process.stdout + process.stderr
    return process.stdout + process.stderr


def test_a_wheel_in_an_empty_folder_runs_everything(tmp_path: Path) -> None:
    subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path / "dist"), str(ROOT)],
        check=True,
        capture_output=True,
    )
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    assert wheel.name.endswith("-py3-none-any.whl") == (not kernels.COMPILED)
    site, work = tmp_path / "site", tmp_path / "work"
    work.mkdir()
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
        tops = {name.split("/")[0] for name in archive.namelist()}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"mast_zenoh"}, "no generic names"

    mast(site, work, "run", "coordinated", "--frames", "20", "--out", "run")
    scenario = (work / "run" / "scenario.json").read_text()
    assert str(site) in scenario, "the wheel's nodes are used"
    assert str(ROOT) not in scenario
    assert json.loads((work / "run" / "run.json").read_text())["versions"]["kernels"] == kernels.USED
    assert (work / "run" / "report.html").is_file()
    assert "[adversary_1]" in mast(site, work, "wiring", "uncoordinated")
    study = ("study", "case_study", "--frames", "10", "--runtime", "inproc", "--out", "study")
    assert "report:" in mast(site, work, *study)


def test_without_a_compiler_the_wheel_is_pure_python_and_runs(tmp_path: Path) -> None:
    process = subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path), str(ROOT)],
        env=os.environ | {"CC": "/bin/false"},
        check=True,
        capture_output=True,
        text=True,
    )
    assert "kernels not compiled, NumPy will do" in process.stdout + process.stderr
    (wheel,) = tmp_path.glob("*-py3-none-any.whl")
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    mast(site, tmp_path, "run", "baseline", "--frames", "3", "--no-report", "--out", "run")
    assert json.loads((tmp_path / "run" / "run.json").read_text())["versions"]["kernels"] == "numpy"
    settings = [word for each in ("codec=cpm", "n_infrastructure=1", "n_mobile=1") for word in ("--set", each)]
    refusal = mast(site, tmp_path, "run", "peers", *settings, "--out", "refused", code=10)
    assert "needs compiled kernels, which are not used: the C compiler failed" in refusal
    assert not (tmp_path / "refused").exists()

"""The fingerprint changes exactly with the sources that nodes run."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import mast_zenoh
from mast_zenoh import version
from mast_zenoh.layers import LAYERS, run_by_nodes
from mast_zenoh.study import trial

PACKAGE = Path(mast_zenoh.__file__).parent


def fingerprint_after_change(folder: Path, changed: str) -> str:
    """The fingerprint of a copy of the package with one line added to a file."""
    shutil.copytree(PACKAGE, folder / "copy", ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    with (folder / "copy" / changed).open("a") as file:
        file.write("# changed\n")
    return version.fingerprint(folder / "copy")


@pytest.mark.parametrize(
    "changed", ["kernels/tracks.pyx", "kernels/arrays.pxd", "tracking/kalman.py", "node.py", "effects/passages.py"]
)
def test_the_fingerprint_changes_with_sources_that_nodes_run(changed: str, tmp_path: Path) -> None:
    assert fingerprint_after_change(tmp_path, changed) != version.fingerprint()


@pytest.mark.parametrize("changed", ["report/page.py", "cli/app.py", "launch/run.py", "__main__.py"])
def test_the_fingerprint_ignores_other_files(changed: str, tmp_path: Path) -> None:
    assert fingerprint_after_change(tmp_path, changed) == version.fingerprint()


def test_nodes_run_every_layer_below_the_checks() -> None:
    below = run_by_nodes()
    assert {"runtime", "scenario", "kernels", "tracking", "pipelines"} <= below
    assert not {"__main__", "cli", "study", "report", "deploy", "launch", "checks"} & below
    assert below <= LAYERS.keys()


def test_a_trial_is_run_again_when_the_fingerprint_changes() -> None:
    assert trial.environment()["code"] == version.fingerprint()

"""The fingerprint changes exactly with the sources that nodes run."""

from __future__ import annotations

import shutil
from pathlib import Path

import mast_zenoh
from mast_zenoh import version
from mast_zenoh.layers import LAYERS, run_by_nodes
from mast_zenoh.study import trial

PACKAGE = Path(mast_zenoh.__file__).parent


RUN_BY_NODES = (
    "kernels/tracks.pyx",
    "kernels/arrays.pxd",
    "tracking/kalman.py",
    "node.py",
    "evaluation/effects/passages.py",
)
OTHERS = ("show/page.py", "cli/app.py", "launch/run.py", "__main__.py")


def test_the_fingerprint_changes_exactly_with_the_sources_that_nodes_run(tmp_path: Path) -> None:
    copy = shutil.copytree(PACKAGE, tmp_path / "copy", ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    for changed in (*OTHERS, *RUN_BY_NODES):
        before = version.fingerprint(copy)
        with (copy / changed).open("a") as file:
            file.write("# changed\n")
        version.fingerprint.cache_clear()
        assert (version.fingerprint(copy) != before) == (changed in RUN_BY_NODES), changed
    assert version.fingerprint(PACKAGE) == version.fingerprint()


def test_nodes_run_every_layer_below_the_launcher() -> None:
    below = run_by_nodes()
    assert {"mesh", "scenario", "kernels", "tracking", "fusion"} <= below
    assert not {"__main__", "cli", "study", "show", "deploy", "launch"} & below
    assert below <= LAYERS.keys()


def test_a_trial_is_run_again_when_the_fingerprint_changes() -> None:
    assert trial.environment([])["code"] == version.fingerprint()

"""Runs on the mesh are bitwise equal to each other and to one process."""

from __future__ import annotations

import json
import os
import tarfile
from pathlib import Path

import pytest
from equal_runs import assert_equal, run_alone
from launched import Launched

from mast_zenoh.run_folder.recording.reader import read

pytestmark = pytest.mark.mesh
DATA = Path(os.environ.get("MAST_DATA") or Path(__file__).parents[3] / "shared" / "data")
FRAMES = 8


def on_mesh(launch, name: str, *settings: str) -> Path:
    """The run folder of a fully recorded run on the mesh."""
    words = [word for setting in settings for word in ("--set", setting)]
    run: Launched = launch(name, "--frames", str(FRAMES), *words)
    run.ended()
    assert run.record()["recorded"] == {"messages": len(list(read(run.out))), "malformed": 0, "lost": 0}
    return run.out


def test_two_runs_on_the_mesh_and_one_in_one_process_are_equal(launch, tmp_path: Path) -> None:
    what = ("coordinated", "n_infrastructure=5", "n_adversaries=2", "attack_start_s=0.2")
    first, second = on_mesh(launch, *what), on_mesh(launch, *what)
    assert any(message.message == "attack_report" for message in read(first)), "a difference could show"
    assert_equal(first, second)
    assert_equal(first, run_alone(tmp_path / "inproc", *what, frames=FRAMES, record=True))


def test_the_reference_scene_is_the_same_on_the_mesh_and_in_one_process(launch, tmp_path: Path) -> None:
    archive = DATA / "scene_a.tar.gz"
    if not archive.exists():
        pytest.skip(f"no reference data: {archive} is missing (set MAST_DATA)")
    with tarfile.open(archive) as tar:
        tar.extractall(tmp_path, filter="data")
    what = ("uncoordinated", f"scene=avstack:{tmp_path / 'scene_a'}", "attack_start_s=0.2")
    assert_equal(on_mesh(launch, *what), run_alone(tmp_path / "inproc", *what, frames=FRAMES, record=True))


FAULTS = [
    dict(type="Partition", at=0.2, until=0.4, node="infra_1"),
    dict(type="Loss", at=0.1, node="ego", probability=0.4),
    dict(type="BandwidthLimit", at=0.0, nodes=["ego", "infra_3"], bits_per_s=300_000.0),
    dict(type="Delay", at=0.1, node="infra_2", mean_s=0.15, jitter_s=0.1),
]
LIES = ("n_adversaries=1", "attack_start_s=0.2")


@pytest.mark.parametrize(
    "what",
    [
        ("peers", *LIES, "on=pair", "relays=true", "gossip=true", "n_slanderers=1"),
        ("congested", "n_mobile=2", *LIES),
        ("two_centres",),
    ],
    ids=lambda what: what[0],
)
def test_cooperation_without_a_centre_with_links_and_faults_is_the_same_on_the_mesh_and_in_one_process(
    launch, tmp_path: Path, what
) -> None:
    what = (*what, f"faults={json.dumps(FAULTS)}")
    mesh = on_mesh(launch, *what)
    assert any(message.message == "link_report" for message in read(mesh))
    assert_equal(mesh, run_alone(tmp_path / "inproc", *what, frames=FRAMES, record=True))

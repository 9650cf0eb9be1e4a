"""Sensors at different rates give the same bytes on the mesh and in one process."""

from pathlib import Path

import pytest

from mast_zenoh import scenario
from mast_zenoh.launch import run as launcher
from mast_zenoh.messagelog.difference import compare
from mast_zenoh.messagelog.explain import explain
from mast_zenoh.messagelog.reader import read

pytestmark = pytest.mark.mesh
FRAMES = 8
NARROW = "agent/infra_1/detections/narrow"


def test_a_run_with_several_rates_is_equal_on_the_mesh_and_in_one_process(launch, tmp_path: Path) -> None:
    mesh = launch("rates", "--frames", str(FRAMES), "--set", "n_infrastructure=2")
    code, output = mesh.end()
    assert code == 0, output
    path, content = scenario.load("rates", ["n_infrastructure=2"])
    settled = scenario.resolve(path, content, frames=FRAMES, record=True)
    process = launcher.run(settled, tmp_path / "inproc", runtime="inproc")
    difference = compare(mesh.out, process.folder)
    assert difference.first is None, "\n".join(explain(difference))
    frames = [message.frame for message in read(mesh.out) if message.key == NARROW]
    assert frames == list(range(FRAMES)), "the narrow sensor measures in every frame"

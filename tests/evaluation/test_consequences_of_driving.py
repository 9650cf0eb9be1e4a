"""What happened to a driven car is measured from the truth on the wires: a collision that an attack causes, too."""

import json

import numpy as np
import pytest
import shapely

from mast_zenoh import scenario
from mast_zenoh.arrays.geometry import box_corners
from mast_zenoh.launch import run
from mast_zenoh.scenes import Recording

pytestmark = pytest.mark.heavy

SEIZED = 'attack={"type": "SeizedCommands", "acceleration": 2.0, "end_s": 12.0}'


@pytest.mark.parametrize("attacked", [True, False])
def test_a_car_that_is_made_to_accelerate_hits_the_one_ahead_and_its_twin_does_not(attacked, tmp_path):
    settings = ["scene_index=2", "n_infrastructure=1", *([SEIZED, "attack_start_s=2.0"] if attacked else [])]
    path, content = scenario.load("driving", settings)
    ended = run.run(
        scenario.resolve(path, content, seed=2, frames=120, record=True), tmp_path / "run", runtime="inproc"
    )
    assert ended.error is None
    scene = Recording.load(ended.folder / "scene.npz")
    first: dict[int, int] = {}
    for frame in range(120):
        truth = scene.truth_at(frame)
        outlines = shapely.polygons(box_corners(truth.position, truth.size, truth.yaw)[:, :4, :2])
        own = int(np.flatnonzero(truth.id == scene.agents[0].object_id)[0])
        for row in np.flatnonzero(shapely.area(shapely.intersection(outlines[own], outlines)) > 1e-6):
            if row != own:
                first.setdefault(int(truth.id[row]), frame)
    (driven,) = json.loads((ended.folder / "metrics.json").read_text())["driven"].values()
    assert {hit["object"]: hit["frame"] for hit in driven["collisions"]} == first
    assert bool(first) is attacked
    assert (driven["rss_unsafe_s"] > 1.0) is attacked
    assert not any(hit["hidden"] for hit in driven["collisions"])  # the driver saw it, and was not asked

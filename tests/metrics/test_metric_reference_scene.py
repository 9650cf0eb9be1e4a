"""The reference scene: truth and labelled detections match published counts."""

from __future__ import annotations

import json
import os
import tarfile
from pathlib import Path

import numpy as np
import pytest

from mast_zenoh.arrays.geometry import rotation_from_quaternion, to_world
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.metrics import Record, Scorer, Series
from mast_zenoh.metrics.measures import per_frame, summary_of
from mast_zenoh.metrics.record import Snapshot

DATA = Path(os.environ.get("MAST_DATA", Path(__file__).parents[3] / "shared" / "data"))
AGENTS = ("ego", "infra_1", "infra_2", "infra_3", "infra_4")
EGO = 99999


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    archive = DATA / "scene_a.tar.gz"
    if not archive.is_file():
        pytest.skip(f"the reference scene is absent: no file {archive} (set MAST_DATA to the folder it is in)")
    folder = tmp_path_factory.mktemp("scene_a")
    names = ["truth.json", "agents.jsonl", "detections.jsonl"]
    with tarfile.open(archive) as tar:
        for name in names:
            tar.extract(f"scene_a/{name}", folder, filter="data")
    truth, *lines = ((folder / "scene_a" / name).read_text() for name in names)
    agents, detections = (
        {(row["frame"], row["agent"]): row for row in map(json.loads, text.splitlines())} for text in lines
    )
    return json.loads(truth), agents, detections


def test_the_egos_detections_score_as_labelled(scene):
    truth, agents, detections = scene
    run, labelled, clutter = Record(AGENTS), {}, {}
    for key, rows in truth.items():
        frame = int(key)
        ids = np.array([row[0] for row in rows])
        objects = ObjectStates.of(np.array([row[1:4] for row in rows]), id=ids)
        points = np.array([[5 if a in row[8] else 0 for a in range(5)] for row in rows])
        places = np.array([agents[frame, a]["x"] for a in range(5)])
        run.add_truth(frame, objects, points, places, np.array([EGO, -1, -1, -1, -1]))
        ego, detected = agents[frame, 0], detections[frame, 0]["detections"]
        local = np.array([[d["x"], d["y"], d["z"]] for d in detected]).reshape(-1, 3)
        # The scene's quaternions are passive: its transpose turns the lidar's components into the world's.
        seen = to_world(local, np.array(ego["lidar_x"]), rotation_from_quaternion(np.array(ego["q"])).T)
        run.add(frame, [Series("ego", "local")], Snapshot.of(ObjectStates.of(seen)))
        near = np.hypot(*(objects.position[:, :2] - places[0, :2]).T) <= 100.0
        heard = np.hypot(*(seen[:, :2] - places[0, :2]).T) <= 100.0
        true = np.isin([d["gt"] for d in detected], ids[near])
        labelled[frame], clutter[frame] = int(np.sum(true & heard)), int(np.sum(~true & heard))
    scores = Scorer().score(run)
    scored = slice(6, -10)
    frames = scores.frames[scored]
    assert frames.tolist() == list(range(7, 141))
    # Other evaluations of this scene report sums of 1.93 FN + 11.93 TP, and 1.44 + 12.42.
    assert (scores.fn + scores.tp)[:, scored].mean() == pytest.approx(13.86, abs=0.005)
    table = {name: column[np.isin(per_frame(scores)["frame"], frames)] for name, column in per_frame(scores).items()}
    for k, frame in enumerate(table["frame"]):
        # Clutter at the position of an undetected object counts as its detection.
        assert labelled[frame] <= table["tp"][k] <= labelled[frame] + clutter[frame]
        assert table["fp"][k] <= clutter[frame]
    assert sum(table["tp"]) - sum(labelled[frame] for frame in table["frame"]) <= 3
    assert summary_of(scores, scored)["ego"]["local"]["rmse_m"] == pytest.approx(0.3 * np.sqrt(2.0), rel=0.05)

"""Effects of an inserted node are measured and attributed to it alone."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from launched import Observer, eventually

from mast_zenoh.launch.interception import client
from mast_zenoh.launch.tables import read_table

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]
SHOVER = """
import numpy as np

from mast_zenoh.node import Node


class Shover(Node):
    role = "adversary"
    inputs = {"clock": "clock", "tracks": "tracks"}
    outputs = {"tracks_out": "tracks"}

    def on_clock(self, received, context): ...

    def on_tracks(self, received, context):
        moved = received.body["position"] + np.array([0.0, 5.0, 0.0])
        context.relay("tracks_out", received, {**received.body, "position": moved})
"""


def test_an_inserted_node_is_measured_from_then_on_and_credited_alone(launch, tmp_path: Path) -> None:
    """adversary_1 is on infra_1's detections, but its attack starts after the end."""
    (tmp_path / "shover.py").write_text(SHOVER)
    settings = ("n_infrastructure=1", "n_adversaries=1", "attack_start_s=1000")
    options = [word for setting in settings for word in ("--set", setting)]
    run = launch("uncoordinated", *options, "--mode", "realtime", "--rate", "2", "--frames", "150")
    observer = Observer(run.started())
    try:
        eventually(lambda: observer.frame() > 3, "frames are played")
        done = client.intercept(run.out, "agent/infra_1/tracks", str(tmp_path / "shover.py"), name="mallory")
        assert done["frame"] < 120, "time remains for the attack"
        code, output = run.end()
    finally:
        observer.close()
    assert code == 0, output
    metrics = json.loads((run.out / "metrics.json").read_text())
    attacks, objects = read_table(run.out / "attacks.parquet"), read_table(run.out / "objects.parquet")
    assert set(attacks["interposer"]) == {"mallory"}
    assert set(attacks["wire"]) == {"agent/infra_1/tracks"}
    moved = attacks["effect"] == "moved"
    first = done["frame"] - 1  # messages about a frame may be late and take the new path
    assert attacks["frame"][moved].min() >= first
    assert attacks["frame"][moved].max() >= 148, "until the end"
    offset = np.column_stack([attacks[f"after_{axis}"] - attacks[f"before_{axis}"] for axis in "xyz"])[moved]
    np.testing.assert_allclose(offset, np.tile([0.0, 5.0, 0.0], (len(offset), 1)), atol=1e-9)
    verdicts = {name: verdict["agreement"] for name, verdict in metrics["interposers"].items()}
    assert verdicts == {"adversary_1": "nothing to report", "mallory": "silent"}
    blamed = objects["by"] != ""
    assert set(objects["by"][blamed]) == {"mallory"}
    assert objects["frame"][blamed].min() >= first
    assert metrics["agents"]["infra_1"]["received"]["fp_split"]["attack"] > 0.0
    assert metrics["agents"]["infra_1"]["local"]["fp_split"]["attack"] == 0.0

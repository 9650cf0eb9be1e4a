"""One attacked run of five agents, its unattacked and shorter twin, and a copy with a live interception."""

import json
import shutil
from pathlib import Path

import pytest
from film_samples import ATTACK, FRAMES

import mast_zenoh as mast


@pytest.fixture(scope="session")
def attacked(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """Two adversaries insert and remove detections from frame 8 on."""
    out = tmp_path_factory.mktemp("film") / "attacked"
    return mast.run("uncoordinated", frames=FRAMES, seed=3, attack_start_s=0.1 * ATTACK, out=out)


@pytest.fixture(scope="session")
def unattacked(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """The same scene without adversaries, ten frames shorter."""
    return mast.run("baseline", frames=FRAMES - 10, seed=3, out=tmp_path_factory.mktemp("film") / "unattacked")


@pytest.fixture
def edited(attacked: mast.Run, tmp_path: Path) -> Path:
    """A copy of the attacked run whose files may be changed."""
    return Path(shutil.copytree(attacked.path, tmp_path / "edited"))


@pytest.fixture
def intercepted(edited: Path) -> Path:
    """The attacked run, recorded as if both adversaries had been inserted live and one of them released."""
    record = json.loads((edited / "run.json").read_text())
    wires = {"adversary_1": "agent/infra_1/detections", "adversary_2": "agent/infra_2/detections"}
    events = [("intercept", "adversary_1", 8), ("intercept", "adversary_2", 10), ("release", "adversary_1", 20)]
    record["interceptions"] = [
        {"action": action, "node": node, "wires": [wires[node]], "frame": frame, "took_ms": 1.0}
        for action, node, frame in events
    ]
    (edited / "run.json").write_text(json.dumps(record))
    return edited

"""Plays a shipped scenario in this process, on a scene by its short name."""

import json
from pathlib import Path
from typing import Any

from mast_zenoh import scenario
from mast_zenoh.launch import run

SCENARIOS = ("baseline", "coordinated", "uncoordinated")


def play_scored(folder: Path, name: str, scene: str, frames: int) -> dict[str, Any]:
    """The summary of the metrics by agent and estimator, of a run with two poles and two cars besides the ego.

    Attacks, if any, begin in the fourth frame.
    """
    settings = [f"scene={scene}", "n_infrastructure=2", "n_mobile=2"]
    path, content = scenario.load(name, settings + ["attack_start_s=0.3"] * (name != "baseline"))
    resolved = scenario.resolve(path, content, frames=frames, seed=0)
    outcome = run.run(resolved, folder / "run", runtime="inproc")
    assert outcome.error is None, outcome.error
    agents: dict[str, Any] = json.loads((outcome.folder / "metrics.json").read_text())["agents"]
    return agents

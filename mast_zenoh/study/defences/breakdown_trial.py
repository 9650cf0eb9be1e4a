"""What decides whether the defence broke in one run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.config.resolved import RECORDING
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.study.defences.bound import honest_majority


def evaluate(folder: Path, metrics: Mapping[str, Any]) -> dict[str, Any]:
    """The part `defence` of a trial's metrics, from its run folder.

    honest_majority: share of the objects that more honest agents see than compromised ones; 1.0 without adversaries
    compromised: names of the agents with an adversary, whether it lied or not
    frames_s: s of scene time of each frame
    """
    recording = Recording.load(folder / RECORDING)
    nodes = run_folder.read_json(folder / "scenario.json")["nodes"].values()
    compromised = {agent for node in nodes if node["role"] == "adversary" for agent in _agents(node["config"])}
    times_s = (recording.times_ns - recording.times_ns[0]) * 1e-9
    return {
        "honest_majority": honest_majority(recording.points, [name in compromised for name in recording.agent_names]),
        "compromised": sorted(compromised),
        "frames_s": np.round(times_s, 9).tolist(),
    }


def _agents(config: Mapping[str, Any]) -> list[str]:
    agent = config.get("agent", ())
    return [agent] if isinstance(agent, str) else list(agent)

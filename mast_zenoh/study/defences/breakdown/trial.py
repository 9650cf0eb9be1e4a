"""What decides whether the defence broke in one run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.config.resolved import RECORDING
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.study.defences.bound import honest_majority


def evaluate(folder: Path, metrics: Mapping[str, Any], compromised: Sequence[str]) -> dict[str, Any]:
    """The part `defence` of a trial's metrics, from its run folder.

    compromised: names of the agents with an adversary, whether it lied or not

    The result:
    honest_majority: share of the objects that more honest agents see than compromised ones; 1.0 without adversaries
    compromised: as above
    frames_s: s of scene time of each frame
    """
    recording = Recording.load(folder / RECORDING)
    times_s = (recording.times_ns - recording.times_ns[0]) * 1e-9
    return {
        "honest_majority": honest_majority(recording.points, [name in compromised for name in recording.agent_names]),
        "compromised": sorted(compromised),
        "frames_s": np.round(times_s, 9).tolist(),
    }

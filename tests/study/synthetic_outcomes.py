"""Synthetic outcomes of trials: metrics.json and metrics.parquet."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.study.definition import Configuration, Study, StudyScene
from mast_zenoh.study.trial import Trial, TrialOutcome

FRAMES = 4


def study(points: dict[str, dict[str, Any]], scenes: int = 2) -> Study:
    """A study of a baseline and a configuration per label and grid point."""
    configurations = [Configuration("baseline", "baseline", "baseline", (), ())]
    configurations += [
        Configuration(label, "attacked", "attacked", (), tuple(point.items())) for label, point in points.items()
    ]
    places = tuple(StudyScene(f"scene {index}", ()) for index in range(scenes))
    return Study(Path("made.py"), "made", tuple(configurations), "baseline", places, None, 0, None, None)


def trial(configuration: str, scene: int, seed: int) -> Trial:
    return Trial(
        f"{configuration}{scene}{seed}", configuration, f"scene {scene}", seed, "x", (), None, "inproc", "", ()
    )


def outcome(
    configuration: str,
    scene: int,
    seed: int,
    *,
    fp: float = 1.0,
    agents: dict[str, Any] | None = None,
    achieved: dict[str, Any] | None = None,
    driving: dict[str, Any] | None = None,
    driven: dict[str, Any] | None = None,
    own_metrics: dict[str, Any] | None = None,
) -> TrialOutcome:
    """A trial of one agent with `fp` false objects in every frame.

    agents: other metrics, by estimator"""
    series = {"local": 0.0, "picture": fp, "mission": fp}
    summary: dict[str, Any] = {}
    for estimator, mean in series.items():
        counts = {name: {"mean": mean if name == "fp" else 2.0, "std": 0.0} for name in ("fn", "fp", "tp")}
        summary[estimator] = counts | {"rmse_m": 0.3 + 0.01 * mean, "id_switches": 1}
        summary[estimator] |= (agents or {}).get(estimator, {})
    per_frame = {
        "frame": np.tile(np.arange(FRAMES + 2), len(series)),
        "agent": np.full((FRAMES + 2) * len(series), "ego"),
        "estimator": np.repeat(list(series), FRAMES + 2),
        **{
            name: np.repeat([mean if name == "fp" else 2.0 for mean in series.values()], FRAMES + 2)
            for name in ("fn", "fp", "tp")
        },
    }
    metrics = {
        "frames": FRAMES + 2,
        "scored_frames": [1, FRAMES],
        "agents": {"ego": summary},
        "achieved": achieved or {},
        "driving": driving or {},
        "driven": driven or {},
        "own_metrics": own_metrics or {},
        "latency_ms": {"sim_to_picture": {"p50": 3.0}},
    }
    return TrialOutcome(trial(configuration, scene, seed), metrics, per_frame)

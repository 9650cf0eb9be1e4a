"""What is evaluated in each trial of a study of defences, by the name that its cells have."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any


def evaluate(name: str, folder: Path, metrics: Mapping[str, Any]) -> dict[str, Any]:
    """The part `defence` of a trial's metrics, from its run folder.

    name: lies (a matrix of defences), drift or breakdown
    """
    from mast_zenoh.study.defences import breakdown_trial, drift_trial, lies  # each is needed in few workers

    by_name = {"lies": lies.evaluate, "drift": drift_trial.evaluate, "breakdown": breakdown_trial.evaluate}
    return by_name[name](folder, metrics)

"""Synthetic outcomes of trials of studies of defences."""

from __future__ import annotations

from typing import Any

from mast_zenoh.study.trial import Trial, TrialOutcome


def outcome(
    configuration: str, scene: str, seed: int, metrics: dict[str, Any], per_frame: dict[str, Any] | None = None
) -> TrialOutcome:
    """A trial; metrics: with the part `defence`."""
    trial = Trial("", configuration, scene, seed, "x", (), None, "inproc", "", ())
    return TrialOutcome(trial, metrics, per_frame or {})

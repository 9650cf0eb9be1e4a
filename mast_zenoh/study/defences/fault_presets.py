"""Faults that a defence may mistake for lies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mast_zenoh.errors import ConfigurationError, nearest

#: Prefix of a fault in the list of adversaries.
PREFIX = "fault:"

#: By name, an entry of a scenario's `faults`, without its time and its targets.
FAULTS: dict[str, dict[str, Any]] = {
    "pose": {"type": "Impair", "rule": {"type": "PoseError", "bias_m": (0.7, 0.4), "bias_yaw_rad": 0.01}},
    "delay": {"type": "Delay", "mean_s": 0.2, "jitter_s": 0.05},
    "skew": {"type": "Impair", "rule": {"type": "ClockSkew", "offset_s": 0.1}},
    "loss": {"type": "BurstLoss", "good_to_bad": 0.1, "bad_to_good": 0.3},
    "blind": {"type": "BlindSector", "azimuth_min_deg": -20.0, "azimuth_max_deg": 20.0},
    "ghosts": {"type": "GhostDetections", "frame": "sensor", "places": [(25.0, 4.0, 0.75), (35.0, -6.0, 0.75)]},
}


def check_fault(name: str) -> None:
    """Raise ConfigurationError for an unknown fault."""
    if name not in FAULTS:
        raise ConfigurationError(f"fault: found {name!r}{nearest(name, FAULTS)}")


def faults_of(name: str | None, agents: Sequence[str], at_s: float) -> list[dict[str, Any]]:
    """The `faults` of a scenario in which agents have the fault from a time, s, on; None, or no agents: none."""
    if name is None or not agents:
        return []
    check_fault(name)
    return [FAULTS[name] | {"at": at_s, "nodes": list(agents)}]

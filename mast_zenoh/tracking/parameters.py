"""Checks of the parameters of trackers and fusion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_PROBABILITIES = (
    "detection_probability", "report_probability", "confirm_probability", "min_probability", "jump_probability",
)  # fmt: skip
_POSITIVE = (
    "position_std_m", "vertical_std_m", "size_std_m", "yaw_std_rad", "clutter_per_m2", "birth_odds", "lifetime_s",
    "memory_s", "max_std_m", "jump_std_m", "acceleration_scale",
)  # fmt: skip


def check(parameters: Mapping[str, Any]) -> None:
    """Raise ValueError for a probability outside (0, 1), or another number that must be positive and is not."""
    for name in _PROBABILITIES:
        if not 0.0 < parameters[name] < 1.0:
            raise ValueError(f"{name}: found {parameters[name]}, expected more than 0 and less than 1")
    check_positive({name: parameters[name] for name in _POSITIVE})


def check_positive(parameters: Mapping[str, float]) -> None:
    """Raise ValueError for the first number that is not positive."""
    for name, value in parameters.items():
        if not value > 0.0:
            raise ValueError(f"{name}: found {value}, expected more than 0")

"""Named profiles of typical links. docs/links.md gives the sources of the numbers."""

from __future__ import annotations

import copy
from typing import Any

from mast_zenoh.errors import ConfigurationError, nearest

#: Rules for messages from an agent (up) and to it (down), as in a scenario.
PROFILES: dict[str, dict[str, list[dict[str, Any]]]] = {
    "perfect": {"up": [], "down": []},
    "wired": {
        direction: [
            dict(type="Bandwidth", bits_per_s=1e9, queue_s=0.05),
            dict(type="Delay", mean_s=0.002, jitter_s=0.0005, distribution="gamma"),
            dict(type="Loss", probability=1e-5),
        ]
        for direction in ("up", "down")
    },
    "wireless_v2x": {
        direction: [
            dict(type="RangeLimit", range_m=320.0),
            dict(type="Bandwidth", bits_per_s=6e6, queue_s=0.1),
            dict(type="GilbertElliott", good_to_bad=0.02, bad_to_good=0.4, loss_good=0.01, loss_bad=1.0),
            dict(type="Delay", mean_s=0.02, jitter_s=0.01, distribution="gamma"),
        ]
        for direction in ("up", "down")
    },
}


def profile(name: str) -> dict[str, list[dict[str, Any]]]:
    """A copy of a profile's rules by direction; raises ConfigurationError if unknown."""
    if name not in PROFILES:
        raise ConfigurationError(f"no link profile {name!r}{nearest(name, PROFILES)}")
    return copy.deepcopy(PROFILES[name])

"""One valid dict of every shipped link rule, by name, each of which acts within a second."""

from typing import Any

RULES: dict[str, dict[str, Any]] = {
    "Bandwidth": dict(bits_per_s=1e5, queue_s=0.3),
    "BlindSector": dict(azimuth_min_deg=-30.0, azimuth_max_deg=30.0),
    "ClockSkew": dict(offset_s=-0.15, drift=0.2),
    "Corrupt": dict(probability=0.4, flips=3),
    "Cut": dict(at=0.4, until=0.6),
    "Delay": dict(mean_s=0.1, jitter_s=0.1),
    "Duplicate": dict(probability=0.4, copies=2),
    "Flood": dict(copies=2, until=0.3),
    "GhostDetections": dict(places=[[20.0, 5.0, 0.75]]),
    "GilbertElliott": dict(good_to_bad=0.3, bad_to_good=0.5),
    "Hold": dict(at=0.2, until=0.5),
    "Loss": dict(probability=0.3),
    "PoseError": dict(position_std_m=1.0, yaw_std_rad=0.1),
    "RangeLimit": dict(range_m=35.0, gateways=[[20.0, 25.0, 15.0]]),
    "Reorder": dict(probability=0.4, by_s=0.15),
}

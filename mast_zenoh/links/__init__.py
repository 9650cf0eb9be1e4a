"""Network effects: rules that act on messages in transit, and profiles of rules.

    base      messages and detections in transit, base class of rules
    transit   delayed, lost and repeated messages: Delay, Bandwidth, Reorder, Hold; Loss, GilbertElliott, RangeLimit,
              Cut; Duplicate, Flood
    content   changed messages: ClockSkew, PoseError, Corrupt; changed detections: BlindSector, GhostDetections
    chain     the sequence of rules of one wire; profiles: wired, wireless_v2x, …

`nodes/link.py` applies them. See docs/how-to-scenarios.md#links.
"""

from mast_zenoh.links.base import Passage, Rule, SenderPose, Sensed
from mast_zenoh.links.chain import PROFILES, Chain, PassageOutcome, profile
from mast_zenoh.links.content import (
    BlindSector,
    ClockSkew,
    Corrupt,
    GhostDetections,
    PoseError,
    displaced,
    flipped,
    has_frame,
)
from mast_zenoh.links.transit import (
    Bandwidth,
    Cut,
    Delay,
    Duplicate,
    Flood,
    GilbertElliott,
    Hold,
    Loss,
    RangeLimit,
    Reorder,
)

#: Types of messages that link reports tell apart: they have indices into this tuple; its length stands for any other.
WIRES = ("tracks", "status", "picture", "detections", "collated", "view", "relayed", "gossip", "command")
#: The effects on a message; link reports contain indices into this tuple.
FATES = ("dropped", "delayed", "duplicated", "corrupted", "altered", "edited")


def type_number(message: str) -> int:
    """The number of a message type in link reports."""
    return WIRES.index(message) if message in WIRES else len(WIRES)


__all__ = [
    "FATES",
    "PROFILES",
    "WIRES",
    "Bandwidth",
    "BlindSector",
    "Chain",
    "ClockSkew",
    "Corrupt",
    "Cut",
    "Delay",
    "Duplicate",
    "Flood",
    "GhostDetections",
    "GilbertElliott",
    "Hold",
    "Loss",
    "Passage",
    "PassageOutcome",
    "PoseError",
    "RangeLimit",
    "Reorder",
    "Rule",
    "SenderPose",
    "Sensed",
    "displaced",
    "flipped",
    "has_frame",
    "profile",
    "type_number",
]

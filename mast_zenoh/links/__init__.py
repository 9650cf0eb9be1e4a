"""Network effects: rules that act on messages in transit, and profiles of rules.

    base      messages in transit, base class of rules
    timing    delays: Delay, Bandwidth, Reorder, Hold
    loss      lost messages: Loss, GilbertElliott, RangeLimit, Cut
    copies    repeated messages: Duplicate, Flood
    content   changed messages: ClockSkew, PoseError, Corrupt
    sensed    detections in transit, and the pose of their sensor
    sensors   changed detections: BlindSector, GhostDetections
    chain     the sequence of rules of one wire
    profiles  wired, wireless_v2x, …

`nodes/link.py` applies them. See docs/links.md.
"""

from mast_zenoh.links.base import Passage, Rule
from mast_zenoh.links.chain import Chain, Outcome
from mast_zenoh.links.content import ClockSkew, Corrupt, PoseError, displaced, flipped, has_frame
from mast_zenoh.links.copies import Duplicate, Flood
from mast_zenoh.links.loss import Cut, GilbertElliott, Loss, RangeLimit
from mast_zenoh.links.profiles import PROFILES, profile
from mast_zenoh.links.sensed import SenderPose, Sensed
from mast_zenoh.links.sensors import BlindSector, GhostDetections
from mast_zenoh.links.timing import Bandwidth, Delay, Hold, Reorder

#: The ports of a link that messages pass through; link reports contain indices into this tuple.
WIRES = ("tracks", "status", "picture", "detections", "collated", "view")
#: The effects on a message; link reports contain indices into this tuple.
FATES = ("dropped", "delayed", "duplicated", "corrupted", "altered", "edited")

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
    "Outcome",
    "Passage",
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
]

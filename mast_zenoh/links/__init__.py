"""What a network does to messages: rules that act on a message on its way, in their order, and profiles of them.

    base      a message to the network, and what a rule is
    timing    later: Delay, Bandwidth, Reorder, Hold
    loss      not at all: Loss, GilbertElliott, RangeLimit, Cut
    copies    more than once: Duplicate, Flood
    content   with other content: ClockSkew, PoseError, Corrupt
    chain     the rules of one wire, one after the other
    profiles  wired, wireless_v2x, …

`nodes/link.py` hosts them. See docs/links.md.
"""

from mast_zenoh.links.base import Passage, Rule
from mast_zenoh.links.chain import Chain, Outcome
from mast_zenoh.links.content import ClockSkew, Corrupt, PoseError, displaced, flipped
from mast_zenoh.links.copies import Duplicate, Flood
from mast_zenoh.links.loss import Cut, GilbertElliott, Loss, RangeLimit
from mast_zenoh.links.profiles import PROFILES, profile
from mast_zenoh.links.timing import Bandwidth, Delay, Hold, Reorder

#: The ports of a link through which messages pass, by their index in a link report.
WIRES = ("tracks", "status", "picture", "detections", "collated")
#: What can happen to a message, by its index in a link report.
FATES = ("dropped", "delayed", "duplicated", "corrupted", "altered")

__all__ = [
    "FATES",
    "PROFILES",
    "WIRES",
    "Bandwidth",
    "Chain",
    "ClockSkew",
    "Corrupt",
    "Cut",
    "Delay",
    "Duplicate",
    "Flood",
    "GilbertElliott",
    "Hold",
    "Loss",
    "Outcome",
    "Passage",
    "PoseError",
    "RangeLimit",
    "Reorder",
    "Rule",
    "displaced",
    "flipped",
    "profile",
]

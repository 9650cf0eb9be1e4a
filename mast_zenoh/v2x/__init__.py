"""V2X: when a vehicle sends which objects, and what its radio channel carries.

    channel      airtime of frames, busy ratio of the channel, and which frames arrive
    congestion   how often stations may send: base class CongestionControl; Unlimited, ReactiveDcc, AdaptiveDcc

Arrays in, arrays out: no class here knows of nodes. Times are int64 ns, as in clocks.
"""

from mast_zenoh.v2x.channel import FrameTiming, RadioChannel, Transmissions, arrivals
from mast_zenoh.v2x.congestion import AdaptiveDcc, CongestionControl, ReactiveDcc, Unlimited

__all__ = [
    "AdaptiveDcc",
    "CongestionControl",
    "FrameTiming",
    "RadioChannel",
    "ReactiveDcc",
    "Transmissions",
    "Unlimited",
    "arrivals",
]

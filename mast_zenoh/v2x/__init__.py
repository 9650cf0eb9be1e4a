"""V2X: when a vehicle sends which objects, and what its radio channel carries.

    generation   when a station sends which objects: base class GenerationRules; EveryFrame, CpmGeneration
    redundancy   objects that others have reported: base class RedundancyRule; FrequencyRedundancy, DynamicsRedundancy,
                 DistanceRedundancy
    awareness    when a station says where it is: CamGeneration
    congestion   how often stations may send: base class CongestionControl; Unlimited, ReactiveDcc, AdaptiveDcc
    channel      airtime of frames, busy ratio of the channel, and which frames arrive

Arrays in, arrays out: no class here knows of nodes. Times are int64 ns, as in clocks.
"""

from mast_zenoh.v2x.awareness import CamDecision, CamGeneration
from mast_zenoh.v2x.channel import FrameTiming, RadioChannel, Transmissions, arrivals
from mast_zenoh.v2x.congestion import AdaptiveDcc, CongestionControl, ReactiveDcc, Unlimited
from mast_zenoh.v2x.generation import (
    CpmGeneration,
    EveryFrame,
    Generation,
    GenerationRules,
    Perception,
    quality_of_score,
)
from mast_zenoh.v2x.redundancy import (
    DistanceRedundancy,
    DynamicsRedundancy,
    FrequencyRedundancy,
    HeardObjects,
    RedundancyRule,
)

__all__ = [
    "AdaptiveDcc",
    "CamDecision",
    "CamGeneration",
    "CongestionControl",
    "CpmGeneration",
    "DistanceRedundancy",
    "DynamicsRedundancy",
    "EveryFrame",
    "FrameTiming",
    "FrequencyRedundancy",
    "Generation",
    "GenerationRules",
    "HeardObjects",
    "Perception",
    "RadioChannel",
    "ReactiveDcc",
    "RedundancyRule",
    "Transmissions",
    "Unlimited",
    "arrivals",
    "quality_of_score",
]

"""V2X: standard messages of vehicles as wire formats, when they are sent, and what their radio channel carries.

Messages:

    asn1/                field tables of the standards, and their bytes
    cpm, cam             messages as columns and integers, in the standard's units, and their field tables
    perceived_objects    objects of a CPM as columns of integers; how well a station perceives its objects, 0 to 15
    reference_position   reference positions, and the plane around an origin
    tracks               tracks to CPM and back, in as many segments as a limit of bytes needs; a vehicle to CAM and
                         back

Sending:

    generation   when a station sends which objects: base class GenerationRules; EveryFrame, CpmGeneration; what a
                 station remembers of each object; what a Vehicle knows of itself, and when it says so: CamGeneration
    redundancy   objects that others have reported: base class RedundancyRule; FrequencyRedundancy, DynamicsRedundancy,
                 DistanceRedundancy, SelfAnnouncementRedundancy
    congestion   how often stations may send: base class CongestionControl; NoCongestionControl, ReactiveDcc,
                 AdaptiveDcc
    channel      airtime, busy ratio of the channel, and which transmissions arrive; stations that load the channel
                 but are not in the scene
    station      what one station sends: its rules, under its congestion control

Arrays in, arrays out: no class here knows of nodes. Times are int64 ns, as in clocks.
"""

from mast_zenoh.v2x.channel import BackgroundStations, OfdmTiming, RadioChannel, Transmissions, arrivals
from mast_zenoh.v2x.congestion import AdaptiveDcc, CongestionControl, NoCongestionControl, ReactiveDcc
from mast_zenoh.v2x.generation import (
    CamDecision,
    CamGeneration,
    CpmGeneration,
    EveryFrame,
    Generation,
    GenerationRules,
    Perception,
    Vehicle,
)
from mast_zenoh.v2x.perceived_objects import quality_of_score
from mast_zenoh.v2x.redundancy import (
    DistanceRedundancy,
    DynamicsRedundancy,
    FrequencyRedundancy,
    HeardObjects,
    RedundancyRule,
    SelfAnnouncementRedundancy,
)

__all__ = [
    "AdaptiveDcc",
    "BackgroundStations",
    "CamDecision",
    "CamGeneration",
    "CongestionControl",
    "CpmGeneration",
    "DistanceRedundancy",
    "DynamicsRedundancy",
    "EveryFrame",
    "FrequencyRedundancy",
    "Generation",
    "GenerationRules",
    "HeardObjects",
    "NoCongestionControl",
    "OfdmTiming",
    "Perception",
    "RadioChannel",
    "ReactiveDcc",
    "RedundancyRule",
    "SelfAnnouncementRedundancy",
    "Transmissions",
    "Vehicle",
    "arrivals",
    "quality_of_score",
]

"""V2X: standard messages of vehicles as wire formats, when they are sent, and what their radio channel carries.

Bytes:

    asn1_types                kinds of ASN.1 types; the field tables are written with them
    cdd, cdd_awareness        field tables of the common data dictionary, TS 102 894-2 v2.4.1
    cpm_fields, cam_fields    field tables of TS 103 324 v2.1.1 and TS 103 900 v2.3.1
    layout                    field tables as programs for the codec, and the place of each field in flat values
    codec_kernels             references of the compiled codec
    uper                      flat values to bytes and back: unaligned packed encoding rules, ITU-T X.691
    plain                     flat values as dicts and lists, for people and export
    perceived_objects, correlations   objects of a CPM as columns of integers, and their correlation matrices
    cpm, cam                  messages as such columns and integers, in the standard's units
    reference_position        reference positions, and the plane around an origin
    tracks                    tracks to CPM and back, in as many segments as a limit of bytes needs

Sending:

    generation   when a station sends which objects: base class GenerationRules; EveryFrame, CpmGeneration
    redundancy   objects that others have reported: base class RedundancyRule; FrequencyRedundancy, DynamicsRedundancy,
                 DistanceRedundancy
    quality      how well a station perceives its objects, 0 to 15: PerceptionQuality
    object_table what a station remembers of each object
    awareness    when a station says where it is: CamGeneration
    congestion   how often stations may send: base class CongestionControl; NoCongestionControl, ReactiveDcc,
                 AdaptiveDcc
    channel      airtime, busy ratio of the channel, and which transmissions arrive
    input_limit  how many objects fusion gets from each agent: base class InputLimit; NoInputLimit, FairInput

Arrays in, arrays out: no class here knows of nodes. Times are int64 ns, as in clocks.
"""

from mast_zenoh.v2x.awareness import CamDecision, CamGeneration
from mast_zenoh.v2x.channel import OfdmTiming, RadioChannel, Transmissions, arrivals
from mast_zenoh.v2x.congestion import AdaptiveDcc, CongestionControl, NoCongestionControl, ReactiveDcc
from mast_zenoh.v2x.generation import (
    CpmGeneration,
    EveryFrame,
    Generation,
    GenerationRules,
    Perception,
)
from mast_zenoh.v2x.input_limit import FairInput, InputLimit, NoInputLimit, Selection
from mast_zenoh.v2x.quality import PerceptionQuality, quality_of_score
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
    "FairInput",
    "FrequencyRedundancy",
    "Generation",
    "GenerationRules",
    "HeardObjects",
    "InputLimit",
    "NoCongestionControl",
    "NoInputLimit",
    "OfdmTiming",
    "Perception",
    "PerceptionQuality",
    "RadioChannel",
    "ReactiveDcc",
    "RedundancyRule",
    "Selection",
    "Transmissions",
    "arrivals",
    "quality_of_score",
]

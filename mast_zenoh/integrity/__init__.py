"""Integrity: judges the agents' tracks before they are fused.

base        what a stage gets and returns; STATES of agents
views       what the agents' sensors cover
rays        what the rays of sensors say about boxes
visibility  which sensors should see an object, and which see through it
memory      follows objects and agents from batch to batch
clusters    one box for each cluster
disputes    contradictions between agents about an object
existence   which objects exist, as far as the agents that are believed see them
offsets     how far each agent's tracks are from the others'; offset_sums: over time
cumulative  sums of evidence, and when they are alarms
reputation  how often each agent's claims have held up
faults      what a fault does to tracks and views; fault_fit, fault_estimate: how it is found
soundness   whether an assessment of a stage is one
calibration seeds and scenes on which thresholds were chosen, and which no test may use

Stages, one a file: KOfN, Plausibility, FreeSpace, RobustFusion, Mate, SequentialConsistency, TruthDiscovery,
FaultOrLie.
"""

from mast_zenoh.integrity.base import (
    STATES,
    AgentTrust,
    Assessment,
    Batch,
    Integrity,
    NoIntegrity,
    ObjectTrust,
    trust_columns,
)
from mast_zenoh.integrity.fault_or_lie import FaultOrLie
from mast_zenoh.integrity.free_space import FreeSpace
from mast_zenoh.integrity.k_of_n import KOfN
from mast_zenoh.integrity.mate import Mate
from mast_zenoh.integrity.plausibility import Plausibility
from mast_zenoh.integrity.robust_fusion import RobustFusion
from mast_zenoh.integrity.sequential import SequentialConsistency
from mast_zenoh.integrity.truth_discovery import TruthDiscovery
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.integrity.visibility import Sightings, sightings

__all__ = [
    "STATES",
    "AgentTrust",
    "Assessment",
    "Batch",
    "FaultOrLie",
    "FreeSpace",
    "Integrity",
    "KOfN",
    "Mate",
    "NoIntegrity",
    "ObjectTrust",
    "Plausibility",
    "RobustFusion",
    "SequentialConsistency",
    "Sightings",
    "SweptView",
    "TruthDiscovery",
    "sightings",
    "trust_columns",
]

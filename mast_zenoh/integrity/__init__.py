"""Integrity: judges the agents' tracks before they are fused.

base       what a stage gets and returns; STATES of agents
views      what the agents' sensors cover
visibility who should see an object, and who sees through it
memory     follows objects and agents from batch to batch
clusters   one box for each cluster
disputes   who contradicts whom
offsets    how far each agent's tracks are from the others'
cumulative sums of evidence, and when they are alarms
record     how often each agent's claims have held up
calibration seeds and scenes on which thresholds were chosen, and which no test may use

Stages, one a file: KOfN, Plausibility, FreeSpace, RobustFusion, Mate, SequentialConsistency, TruthDiscovery,
FaultOrLie (with fault_fit).
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

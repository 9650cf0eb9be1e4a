"""Integrity: judges the agents' tracks before they are fused.

base         what a stage gets and returns, one box for each cluster, STATES of agents; NoIntegrity
views        what the agents' sensors cover
visibility   what the rays of sensors say about boxes: which should see an object, and which see through it
memory       follows objects and agents from batch to batch; how often each agent's claims have held up
disputes     what agents say of each object, who contradicts whom, and who must or may be lying
existence    which objects exist, given that
deviations   how far each agent's tracks are from the others', for how long, and how usual that is; what a fault does
             to tracks and views; medians of columns, groups and members of clusters
alarms       cumulative sums of evidence, and when they are alarms
calibration  the seeds and junctions on which thresholds were chosen
relative_faults  how the tracks of each pair of agents differ, and which agents are faulty
voting       which objects exist; the stages KOfN and FreeSpace
consensus    groups of agents, counted checks of them, and what the admission of agents means for their objects;
             matched boxes of two sets, and their Jaccard index

The other stages have a file each: Plausibility, RobustFusion, Mate, SequentialConsistency, TruthDiscovery, FaultOrLie,
Hearsay, and those after the field's published defences, Robosac, Pasac, Made, Prbi, PoseGuard, Cad.
"""

from mast_zenoh.integrity.base import (
    STATES,
    AgentTrust,
    Assessment,
    Batch,
    ClusterBoxes,
    Integrity,
    NoIntegrity,
    ObjectTrust,
    trust_columns,
)
from mast_zenoh.integrity.cad import Cad
from mast_zenoh.integrity.fault_or_lie import FaultOrLie
from mast_zenoh.integrity.hearsay import Hearsay
from mast_zenoh.integrity.made import Made
from mast_zenoh.integrity.mate import Mate
from mast_zenoh.integrity.pasac import Pasac
from mast_zenoh.integrity.plausibility import Plausibility
from mast_zenoh.integrity.pose_guard import PoseGuard
from mast_zenoh.integrity.prbi import Prbi
from mast_zenoh.integrity.robosac import Robosac
from mast_zenoh.integrity.robust_fusion import RobustFusion
from mast_zenoh.integrity.sequential import SequentialConsistency
from mast_zenoh.integrity.truth_discovery import TruthDiscovery
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.integrity.visibility import Sightings, sightings
from mast_zenoh.integrity.voting import FreeSpace, KOfN

__all__ = [
    "STATES",
    "AgentTrust",
    "Assessment",
    "Batch",
    "Cad",
    "ClusterBoxes",
    "FaultOrLie",
    "FreeSpace",
    "Hearsay",
    "Integrity",
    "KOfN",
    "Made",
    "Mate",
    "NoIntegrity",
    "ObjectTrust",
    "Pasac",
    "Plausibility",
    "PoseGuard",
    "Prbi",
    "Robosac",
    "RobustFusion",
    "SequentialConsistency",
    "Sightings",
    "SweptView",
    "TruthDiscovery",
    "sightings",
    "trust_columns",
]

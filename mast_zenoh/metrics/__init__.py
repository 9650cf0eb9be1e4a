"""Metrics: estimates of agents compared with the truth.

    estimates   the estimates of a run: their keys and names
    record      truth and estimates of a run (mast_zenoh.evaluation runs the complete evaluation)
    assignment  matching of tracks and truth objects; OSPA, GOSPA; boxes and positions of many frames: pairs,
                neighbours, overlap, look-up of rows
    scoring     counts per agent, estimator and frame; one estimate of one agent, as metrics of users get it
    scores      matched pairs, tables, and the summary in metrics.json
    consistency whether estimates are as accurate as their covariances say
    ranking     AMOTA: accuracy over recall, for tracks ranked by their scores
    causes, attributor
                the cause of every false and every missed object of every estimate; manipulated objects, and
                the estimates that they can influence
    cut_off     objects known only to disconnected agents
    achievement results of each adversary
    driving     effects of errors on driving
    trust       the command centre's trust compared with the agents' conduct; ROC curves
    measures    every metric as a class: key, words, unit, range, and what it computes
    increments  errors added by an attack
    study_results    the results of studies, as reports show them

See docs/explanation-metrics-and-causes.md.
"""

from mast_zenoh.arrays.boxes import Boxes
from mast_zenoh.metrics.assignment import (
    Assigner,
    CenterDistanceAssigner,
    IoU3DGreedyAssigner,
    SetDistance,
    birdseye_intersection,
    iou_3d,
)
from mast_zenoh.metrics.attributor import AttributionLimits, Attributor
from mast_zenoh.metrics.causes import (
    ATTACK_CAUSES,
    CAUSES,
    DEFENCE_CAUSES,
    FAULT_CAUSES,
    Manipulations,
    cause_names,
    causes_of,
)
from mast_zenoh.metrics.consistency import Consistency
from mast_zenoh.metrics.cut_off import CutOff, CutOffObjects, Presence
from mast_zenoh.metrics.driving import Driving
from mast_zenoh.metrics.estimates import ESTIMATORS
from mast_zenoh.metrics.increments import increments
from mast_zenoh.metrics.measures import FrameMetric, MessageMetric, Metric, RunMetric
from mast_zenoh.metrics.named_metrics import ErrorsNearby, LongestMiss
from mast_zenoh.metrics.record import Record, Series
from mast_zenoh.metrics.scores import OUTCOMES, Scores, Table
from mast_zenoh.metrics.scoring import Estimate, Scorer

__all__ = [
    "ATTACK_CAUSES",
    "CAUSES",
    "DEFENCE_CAUSES",
    "ESTIMATORS",
    "FAULT_CAUSES",
    "OUTCOMES",
    "Assigner",
    "AttributionLimits",
    "Attributor",
    "Boxes",
    "CenterDistanceAssigner",
    "Consistency",
    "CutOff",
    "CutOffObjects",
    "Driving",
    "ErrorsNearby",
    "Estimate",
    "FrameMetric",
    "IoU3DGreedyAssigner",
    "LongestMiss",
    "Manipulations",
    "MessageMetric",
    "Metric",
    "Presence",
    "Record",
    "RunMetric",
    "Scorer",
    "Scores",
    "Series",
    "SetDistance",
    "Table",
    "birdseye_intersection",
    "cause_names",
    "causes_of",
    "increments",
    "iou_3d",
]

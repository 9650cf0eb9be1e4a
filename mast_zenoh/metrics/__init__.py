"""Metrics: what agents believe against the truth.

    record      what an evaluator collects while a run goes on (mast_zenoh.evaluation puts all of this together)
    boxes, overlap, assignment    which track is which truth object, for all frames in one call
    scoring     counts per agent, estimator and frame
    ospa        distances between sets: OSPA, GOSPA
    scores      tables, and the summary in metrics.json
    manipulations    what interposers did to objects, and which estimates it can influence
    attribution, histories, causes, blame   the cause of every false and every missed object of every estimate
    cut_off     which objects only agents that were cut off or down could have reported
    achievement what each adversary achieved
    driving, braking, consequences   what errors would have meant for driving
    user_metrics  user-defined metrics
    increments  what an attack adds

See docs/metrics.md.
"""

from mast_zenoh.metrics import achievement, consequences, user_metrics
from mast_zenoh.metrics.assignment import Assigner, CenterDistanceAssigner, IoU3DGreedyAssigner
from mast_zenoh.metrics.attribution import Attribution
from mast_zenoh.metrics.blame import causes_of
from mast_zenoh.metrics.boxes import Boxes
from mast_zenoh.metrics.causes import ATTACK_CAUSES, CAUSES, FAULT_CAUSES, named
from mast_zenoh.metrics.cut_off import CutOff, Presence, Severed
from mast_zenoh.metrics.driving import Driving
from mast_zenoh.metrics.increments import increments
from mast_zenoh.metrics.manipulations import Manipulations
from mast_zenoh.metrics.ospa import SetDistance
from mast_zenoh.metrics.overlap import birdseye_intersection, iou_3d
from mast_zenoh.metrics.record import ESTIMATORS, Record, Series
from mast_zenoh.metrics.scores import OUTCOMES, Scores, Table
from mast_zenoh.metrics.scoring import Scorer
from mast_zenoh.metrics.user_metrics import Estimate, FrameMetric, Metric, RunMetric

__all__ = [
    "ATTACK_CAUSES",
    "CAUSES",
    "ESTIMATORS",
    "FAULT_CAUSES",
    "OUTCOMES",
    "Assigner",
    "Attribution",
    "Boxes",
    "CenterDistanceAssigner",
    "CutOff",
    "Driving",
    "Estimate",
    "FrameMetric",
    "IoU3DGreedyAssigner",
    "Manipulations",
    "Metric",
    "Presence",
    "Record",
    "RunMetric",
    "Scorer",
    "Scores",
    "Series",
    "SetDistance",
    "Severed",
    "Table",
    "achievement",
    "birdseye_intersection",
    "causes_of",
    "consequences",
    "increments",
    "iou_3d",
    "named",
    "user_metrics",
]

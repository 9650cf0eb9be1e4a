"""Metrics: estimates of agents compared with the truth.

    record      truth and estimates of a run (mast_zenoh.evaluation runs the complete evaluation)
    boxes, overlap, assignment    matching of tracks and truth objects, for all frames in one call
    scoring     counts per agent, estimator and frame
    ospa        distances between sets: OSPA, GOSPA
    matched_pairs, consistency    whether estimates are as accurate as their covariances say
    ranking     AMOTA: accuracy over recall, for tracks ranked by their scores
    scores      tables, and the summary in metrics.json
    manipulations    manipulated objects, and the estimates that they can influence
    attributor, attribution_limits, histories, causes, blame
                the cause of every false and every missed object of every estimate
    cut_off     objects known only to disconnected agents
    withheld    objects and agents that the command centre kept out of the picture
    achievement results of each adversary
    driving, braking, consequences   effects of errors on driving
    trust/      the command centre's trust compared with the agents' conduct; ROC curves
    user_metrics  user-defined metrics
    increments  errors added by an attack

See docs/metrics.md.
"""

from mast_zenoh.metrics import achievement, achievement_summary, consequences, user_metrics
from mast_zenoh.metrics.assignment import Assigner, CenterDistanceAssigner, IoU3DGreedyAssigner
from mast_zenoh.metrics.attribution_limits import AttributionLimits
from mast_zenoh.metrics.attributor import Attributor
from mast_zenoh.metrics.blame import causes_of
from mast_zenoh.metrics.boxes import Boxes
from mast_zenoh.metrics.causes import ATTACK_CAUSES, CAUSES, DEFENCE_CAUSES, FAULT_CAUSES, cause_names
from mast_zenoh.metrics.consistency import Consistency
from mast_zenoh.metrics.cut_off import CutOff, CutOffObjects, Presence
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
    "Table",
    "achievement",
    "achievement_summary",
    "birdseye_intersection",
    "cause_names",
    "causes_of",
    "consequences",
    "increments",
    "iou_3d",
    "user_metrics",
]

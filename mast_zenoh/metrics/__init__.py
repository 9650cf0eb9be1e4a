"""Metrics: what agents believe against the truth.

    record      what an evaluator collects while a run goes on
    boxes, overlap, assignment    which track is which truth object, for all frames in one call
    scoring     counts per agent, estimator and frame
    ospa        distances between sets: OSPA, GOSPA
    scores      tables, and the summary in metrics.json
    attribution, lies    the cause of every false and every missed object of the picture
    severed     which objects only agents could have told of who were cut off or down
    increments  what an attack adds

See docs/metrics.md.
"""

from mast_zenoh.metrics.assignment import Assigner, CenterDistanceAssigner, IoU3DGreedyAssigner
from mast_zenoh.metrics.attribution import ATTACK_CAUSES, CAUSES, FAULT_CAUSES, Attribution
from mast_zenoh.metrics.blame import cause_counts, split, time_to_first_false
from mast_zenoh.metrics.boxes import Boxes
from mast_zenoh.metrics.increments import increments
from mast_zenoh.metrics.ospa import SetDistance
from mast_zenoh.metrics.overlap import birdseye_intersection, iou_3d
from mast_zenoh.metrics.record import Record
from mast_zenoh.metrics.scores import OUTCOMES, Scores, Table
from mast_zenoh.metrics.scoring import Scorer
from mast_zenoh.metrics.severed import Reach, Severed, down, stopped

__all__ = [
    "ATTACK_CAUSES",
    "CAUSES",
    "FAULT_CAUSES",
    "OUTCOMES",
    "Assigner",
    "Attribution",
    "Boxes",
    "CenterDistanceAssigner",
    "IoU3DGreedyAssigner",
    "Reach",
    "Record",
    "Scorer",
    "Scores",
    "SetDistance",
    "Severed",
    "Table",
    "birdseye_intersection",
    "cause_counts",
    "down",
    "increments",
    "iou_3d",
    "split",
    "stopped",
    "time_to_first_false",
]

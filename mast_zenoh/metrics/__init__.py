"""Metrics: what agents believe against the truth.

    record      what an evaluator collects while a run goes on
    boxes, overlap, assignment    which track is which truth object, for all frames in one call
    scoring     counts per agent, estimator and frame
    scores      tables, and the summary in metrics.json
    increments  what an attack adds

See docs/metrics.md.
"""

from mast_zenoh.metrics.assignment import Assigner, CenterDistanceAssigner, IoU3DGreedyAssigner
from mast_zenoh.metrics.boxes import Boxes
from mast_zenoh.metrics.increments import increments
from mast_zenoh.metrics.overlap import birdseye_intersection, iou_3d
from mast_zenoh.metrics.record import Record
from mast_zenoh.metrics.scores import OUTCOMES, Scores, Table
from mast_zenoh.metrics.scoring import Scorer

__all__ = [
    "OUTCOMES",
    "Assigner",
    "Boxes",
    "CenterDistanceAssigner",
    "IoU3DGreedyAssigner",
    "Record",
    "Scorer",
    "Scores",
    "Table",
    "birdseye_intersection",
    "increments",
    "iou_3d",
]

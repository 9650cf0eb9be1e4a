"""Evaluates a run: computes metrics.json and the tables from the messages on its wires. Pure.

    heard         data collected from the messages
    from_effects  manipulations, from the measured effects of interposers (mast_zenoh.effects)
    poses         manipulations of poses
    downstream    estimates that an interposer can influence
    evaluation    the complete evaluation with mast_zenoh.metrics
    tables        attacks.parquet

See docs/metrics.md and docs/effects.md.
"""

from mast_zenoh.evaluation.evaluation import Evaluation
from mast_zenoh.evaluation.heard import Heard

__all__ = ["Evaluation", "Heard"]

"""Evaluates a run: computes metrics and tables from its messages. Pure.

    run_data      data collected from the messages
    from_effects  manipulations, from the measured effects of interposers (mast_zenoh.effects)
    poses         manipulations of poses
    downstream    estimates that an interposer can influence
    evaluation    the complete evaluation with mast_zenoh.metrics
    tables        attacks.parquet
    trust         what the command centre's trust was worth

See docs/metrics.md and docs/effects.md.
"""

from mast_zenoh.evaluation.evaluation import Evaluation
from mast_zenoh.evaluation.run_data import RunData

__all__ = ["Evaluation", "RunData"]

"""Evaluates a run: computes metrics and tables from its messages. Pure.

    evaluation    the complete evaluation with mast_zenoh.metrics, of the data collected from the messages
    from_effects  manipulations, from the measured effects of interposers (mast_zenoh.effects)
    driven        what happened to the cars that drivers drove
    driver_wires  on which keys the messages of drivers are, also of those that a replay plays
    trust         what the command centre's trust was worth

See docs/metrics.md and docs/effects.md.
"""

from mast_zenoh.evaluation.evaluation import Evaluation, RunData, ego_of

__all__ = ["Evaluation", "RunData", "ego_of"]

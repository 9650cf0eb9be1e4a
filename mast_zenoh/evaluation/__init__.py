"""Evaluates a run: computes metrics and tables from its messages. Pure.

    run_data      the data collected from the messages
    evaluation    the evaluation of some frames with mast_zenoh.metrics
    run_scoring   the evaluation of a run, block by block of its frames
    estimate_wires  which estimates are on the wires, and what can affect them
    from_effects  manipulations, from the measured effects of interposers (mast_zenoh.evaluation.effects)
    driven        what happened to the cars that drivers drove; on which keys the messages of drivers are, also of
                  those that a replay plays
    trust         what the command centre's trust was worth

See docs/explanation-metrics-and-causes.md.
"""

from mast_zenoh.evaluation.evaluation import Evaluation
from mast_zenoh.evaluation.run_data import RunData, ego_of
from mast_zenoh.evaluation.run_scoring import RunScoring

__all__ = ["Evaluation", "RunData", "RunScoring", "ego_of"]

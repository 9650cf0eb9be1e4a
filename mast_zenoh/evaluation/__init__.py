"""The evaluation of a run: from the messages on its wires to metrics.json and the tables. Pure.

    heard         what is kept of the messages
    from_effects  measured effects of interposers (mast_zenoh.effects) as what the metrics need of them
    downstream    which estimates an interposer can influence
    evaluation    everything together: mast_zenoh.metrics over what was heard
    tables        attacks.parquet

See docs/metrics.md and docs/effects.md.
"""

from mast_zenoh.evaluation.evaluation import Evaluation
from mast_zenoh.evaluation.heard import Heard

__all__ = ["Evaluation", "Heard"]

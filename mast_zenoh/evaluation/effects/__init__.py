"""Effects of interposers, measured by comparing their inputs and outputs.

The measurement does not rely on the reports of the interposers themselves.

    passages  all interposers of a run: matching of received and sent messages, and their effects
    rows      comparison of the objects in messages before and after an interposer
    table     table of effects in the world frame; inserted objects over time
    reports   comparison with the reports of the interposers

See docs/explanation-metrics-and-causes.md.
"""

from mast_zenoh.evaluation.effects.passages import MESSAGE_EFFECTS, Meter
from mast_zenoh.evaluation.effects.table import CODE, EFFECTS, Effects, Poses, ReportedPose, effects_of

__all__ = ["CODE", "EFFECTS", "MESSAGE_EFFECTS", "Effects", "Meter", "Poses", "ReportedPose", "effects_of"]

"""Effects of interposers, measured by comparing their inputs and outputs.

The measurement does not rely on the reports of the interposers themselves.

    rows             comparison of the objects in messages before and after an interposer
    objects          changed objects
    passages         one interposer on one wire: matching of received and sent messages
    passage_effects  its effects: delayed, dropped, repeated, damaged, forged and changed messages
    meter            all interposers of a run
    table            table of effects, in the world frame
    episodes         inserted objects over time
    reports          comparison with the reports of the interposers

See docs/effects.md.
"""

from mast_zenoh.effects.message_effects import MESSAGE_EFFECTS
from mast_zenoh.effects.meter import Meter
from mast_zenoh.effects.table import EFFECTS, Effects, Pose, Poses, effects_of

__all__ = ["EFFECTS", "MESSAGE_EFFECTS", "Effects", "Meter", "Pose", "Poses", "effects_of"]

"""What interposers do to the messages that pass them: measured on the wires, by comparing what they send with what they
receive. Nothing here depends on what an interposer says about itself.

    rows             the objects of one message before and behind an interposer
    objects          what is kept of a message whose objects were changed
    passages         one interposer on one wire: which message was sent on as which
    passage_effects  what it did to each: delayed, dropped, repeated, damaged, forged, changed
    meter            all interposers of a run
    table            their effects as one table, in the world frame

See docs/effects.md.
"""

from mast_zenoh.effects.message_effects import MESSAGE_EFFECTS
from mast_zenoh.effects.meter import Meter
from mast_zenoh.effects.table import EFFECTS, Effects, Pose, Poses, effects_of

__all__ = ["EFFECTS", "MESSAGE_EFFECTS", "Effects", "Meter", "Pose", "Poses", "effects_of"]

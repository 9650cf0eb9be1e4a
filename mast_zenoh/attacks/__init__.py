"""Attacks on what agents perceive and report: false objects, hidden objects, displaced objects.

    selection     what to add, hide and move
    propagation   how false objects move
    campaign      the two together over time
    application   doing it to one message
    imitation     making false objects look like the victim's own
    adversary     the state machine on one wire
    coordination  the one above several adversaries

Everything is in the world frame; nodes convert. See docs/attacks.md.
"""

from mast_zenoh.attacks.adversary import Attack, CoordinatedAttack, PassThrough, UncoordinatedAttack
from mast_zenoh.attacks.application import apply
from mast_zenoh.attacks.coordination import Coordination, Coordinator
from mast_zenoh.attacks.propagation import MarkovPropagation, Propagation, StaticPropagation, TrajectoryPropagation
from mast_zenoh.attacks.selection import CoordinatedSelection, Selection, UncoordinatedSelection
from mast_zenoh.attacks.targets import ACTIONS, Changes, Tampering, Targets

__all__ = [
    "ACTIONS",
    "Attack",
    "Changes",
    "CoordinatedAttack",
    "CoordinatedSelection",
    "Coordination",
    "Coordinator",
    "MarkovPropagation",
    "PassThrough",
    "Propagation",
    "Selection",
    "StaticPropagation",
    "Tampering",
    "Targets",
    "TrajectoryPropagation",
    "UncoordinatedAttack",
    "UncoordinatedSelection",
    "apply",
]

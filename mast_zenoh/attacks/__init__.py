"""Attacks on what agents perceive and report: false objects, hidden objects, displaced objects.

    surroundings  what an attacker knows of the scene in advance
    coverage      where false objects could be real
    regions       where they are put
    selection     what to insert, hide and move
    conflict      which object matters most
    clusters      what several adversaries see, one row per object
    propagation   how false objects move
    campaign      selection and propagation over time
    following     keeping targets with their objects
    statistics    what the victim's rows are like
    imitation     making false objects look like the victim's own
    application   doing it to one message
    adversary     the state machine on one wire
    coordination  the one above several adversaries

Everything is in the world frame; nodes convert. See docs/attacks.md.
"""

from mast_zenoh.attacks.adversary import Attack, CoordinatedAttack, PassThrough, UncoordinatedAttack
from mast_zenoh.attacks.application import apply
from mast_zenoh.attacks.conflict import ConflictSelection
from mast_zenoh.attacks.coordination import Coordination, Coordinator
from mast_zenoh.attacks.coverage import Coverage, coverage_of
from mast_zenoh.attacks.imitation import Exact, Imitation, VictimLike
from mast_zenoh.attacks.propagation import MarkovPropagation, Propagation, StaticPropagation, TrajectoryPropagation
from mast_zenoh.attacks.selection import CoordinatedSelection, Selection, UncoordinatedSelection
from mast_zenoh.attacks.surroundings import Surroundings
from mast_zenoh.attacks.targets import ACTIONS, Changes, Tampering, Targets

__all__ = [
    "ACTIONS",
    "Attack",
    "Changes",
    "ConflictSelection",
    "CoordinatedAttack",
    "CoordinatedSelection",
    "Coordination",
    "Coordinator",
    "Coverage",
    "Exact",
    "Imitation",
    "MarkovPropagation",
    "PassThrough",
    "Propagation",
    "Selection",
    "StaticPropagation",
    "Surroundings",
    "Tampering",
    "Targets",
    "TrajectoryPropagation",
    "UncoordinatedAttack",
    "UncoordinatedSelection",
    "VictimLike",
    "apply",
    "coverage_of",
]

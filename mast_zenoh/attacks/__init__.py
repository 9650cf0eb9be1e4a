"""Attacks on perception: inserted, hidden and displaced objects.

    surroundings  prior knowledge of the scene
    coverage      where false objects are plausible
    regions       where false objects are placed
    selection     which objects to insert, hide and move
    conflict      selection of the objects most relevant to the ego
    clusters      clustering of the adversaries' observations
    campaign      selection and propagation over time
    following     tracking of targets
    statistics    noise and misses of the victim's rows
    imitation     false objects that resemble the victim's own
    application   tampering with one message
    attack        attacks: one step per intercepted message
    coordination  coordinator of several adversaries

Everything is in the world frame; the nodes convert. See docs/attacks.md.
"""

from mast_zenoh.attacks.application import alter, apply
from mast_zenoh.attacks.attack import Attack, CoordinatedAttack, PassThrough, UncoordinatedAttack
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
    "alter",
    "apply",
    "coverage_of",
]

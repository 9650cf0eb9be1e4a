"""Attacks on perception: inserted, hidden and displaced objects.

    surroundings  prior knowledge of the scene
    knowledge     what an attacker knows of the command centre's trust
    coverage      where false objects are plausible
    ego_path      the ego's path ahead
    regions       where false objects are placed
    selection     which objects to insert, hide and move
    conflict      selection of the objects most relevant to the ego
    clusters      clustering of the adversaries' observations
    campaign      selection and propagation over time
    following     tracking of targets
    statistics    noise and misses of the victim's rows
    imitation     false objects that resemble the victim's own
    application   tampering with one message
    free_space    views that agree with the lies about objects
    base          base class of attacks: one step per intercepted message
    attack        attacks that follow targets
    coordination  coordinator of several adversaries
    adaptive/     attacks that know how they are judged

Everything is in the world frame; the nodes convert. See docs/attacks.md.
"""

from mast_zenoh.attacks.adaptive import (
    AdaptiveAttack,
    BlindSpot,
    ColludingSelection,
    Collusion,
    Framing,
    GhostAhead,
    Lies,
    Mimic,
    Moment,
    Overconfidence,
    PoseDrift,
    Replay,
    Sleeper,
    SlowDrift,
    StatePerturbation,
)
from mast_zenoh.attacks.application import alter, apply
from mast_zenoh.attacks.attack import CoordinatedAttack, UncoordinatedAttack
from mast_zenoh.attacks.base import Attack, PassThrough
from mast_zenoh.attacks.conflict import ConflictSelection
from mast_zenoh.attacks.coordination import Coordination, Coordinator
from mast_zenoh.attacks.coverage import Coverage, coverage_of
from mast_zenoh.attacks.imitation import Exact, Imitation, VictimLike
from mast_zenoh.attacks.knowledge import Trust
from mast_zenoh.attacks.propagation import MarkovPropagation, Propagation, StaticPropagation, TrajectoryPropagation
from mast_zenoh.attacks.selection import CoordinatedSelection, Selection, UncoordinatedSelection
from mast_zenoh.attacks.surroundings import Surroundings
from mast_zenoh.attacks.targets import ACTIONS, Changes, Tampering, Targets

__all__ = [
    "ACTIONS",
    "AdaptiveAttack",
    "Attack",
    "BlindSpot",
    "Changes",
    "ColludingSelection",
    "Collusion",
    "ConflictSelection",
    "CoordinatedAttack",
    "CoordinatedSelection",
    "Coordination",
    "Coordinator",
    "Coverage",
    "Exact",
    "Framing",
    "GhostAhead",
    "Imitation",
    "Lies",
    "MarkovPropagation",
    "Mimic",
    "Moment",
    "Overconfidence",
    "PassThrough",
    "PoseDrift",
    "Propagation",
    "Replay",
    "Selection",
    "Sleeper",
    "SlowDrift",
    "StatePerturbation",
    "StaticPropagation",
    "Surroundings",
    "Tampering",
    "Targets",
    "TrajectoryPropagation",
    "Trust",
    "UncoordinatedAttack",
    "UncoordinatedSelection",
    "VictimLike",
    "alter",
    "apply",
    "coverage_of",
]

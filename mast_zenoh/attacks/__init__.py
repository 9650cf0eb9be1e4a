"""Attacks on perception: inserted, hidden and displaced objects.

    surroundings  what attackers know of the scene, and where objects are in view
    knowledge     what an attacker knows of the command centre's trust
    targets       what is done to which objects; tampering, reports and forged views
    regions       where false objects are placed
    selection     which objects to insert, hide and move
    campaign      selection and motion of targets over time
    following     tracking of targets
    imitation     false objects that resemble the victim's own
    attack        base class of attacks: one step per intercepted message; attacks that follow targets; what an
                  adversary keeps of a compromised agent; an attack on what drivers tell their cars
    coordination  coordinators of several adversaries
    adaptive      base class of attacks that know how they are judged
    phantoms      adaptive attacks that invent vehicles
    real_objects  adaptive attacks about real objects
    disputes     attacks about which one agent's word stands against another's; an attack on what agents say about
                 whom they trust
    evasion      attacks that stay below what a defence looks for
    flood        an attack on the time of the command centre
    road_ahead    attacks on the road ahead of a car that is driven
    spoofers        where spoofers of a lidar are, and how well they aim
    point_attacks   attacks on points: base class, removal of a sector, scans of another time
    point_phantoms  attacks on points: phantoms, walls, mirrors and forged meshes

Everything is in the world frame; the nodes convert. See docs/explanation-threat-model.md.
"""

from mast_zenoh.attacks import disputes, evasion, flood, phantoms, point_phantoms, real_objects  # noqa: F401 (by name)
from mast_zenoh.attacks.adaptive import AdaptiveAttack, Lies, Moment
from mast_zenoh.attacks.attack import Attack, PassThrough, UncoordinatedAttack, alter
from mast_zenoh.attacks.campaign import Propagation
from mast_zenoh.attacks.coordination import Coordination
from mast_zenoh.attacks.imitation import Imitation
from mast_zenoh.attacks.point_attacks import PointAttack
from mast_zenoh.attacks.road_ahead import FalseTraffic, FollowingEgo
from mast_zenoh.attacks.selection import Selection, UncoordinatedSelection
from mast_zenoh.attacks.spoofers import Spoofer
from mast_zenoh.attacks.surroundings import Surroundings
from mast_zenoh.attacks.targets import ACTIONS, Tampering, Targets

__all__ = [
    "ACTIONS",
    "AdaptiveAttack",
    "Attack",
    "Coordination",
    "FalseTraffic",
    "FollowingEgo",
    "Imitation",
    "Lies",
    "Moment",
    "PassThrough",
    "PointAttack",
    "Propagation",
    "Selection",
    "Spoofer",
    "Surroundings",
    "Tampering",
    "Targets",
    "UncoordinatedAttack",
    "UncoordinatedSelection",
    "alter",
]

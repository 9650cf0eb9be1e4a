"""Attacks that know how they are judged, and lie where it is not seen.

    budget    lies per second
    base      base class: a budget, views that agree with the lies, knowledge
    phantoms  false objects that are kept alive one by one
    chosen    real objects that are lied about

The attacks themselves have a file each. See docs/attacks.md.
"""

from mast_zenoh.attacks.adaptive.base import AdaptiveAttack, Lies, Moment
from mast_zenoh.attacks.adaptive.blind_spot import BlindSpot
from mast_zenoh.attacks.adaptive.collusion import ColludingSelection, Collusion
from mast_zenoh.attacks.adaptive.framing import Framing
from mast_zenoh.attacks.adaptive.ghost_ahead import GhostAhead
from mast_zenoh.attacks.adaptive.mimic import Mimic
from mast_zenoh.attacks.adaptive.overconfidence import Overconfidence
from mast_zenoh.attacks.adaptive.pose_drift import PoseDrift
from mast_zenoh.attacks.adaptive.replay import Replay
from mast_zenoh.attacks.adaptive.sleeper import Sleeper
from mast_zenoh.attacks.adaptive.slow_drift import SlowDrift
from mast_zenoh.attacks.adaptive.state_perturbation import StatePerturbation

__all__ = [
    "AdaptiveAttack",
    "BlindSpot",
    "ColludingSelection",
    "Collusion",
    "Framing",
    "GhostAhead",
    "Lies",
    "Mimic",
    "Moment",
    "Overconfidence",
    "PoseDrift",
    "Replay",
    "Sleeper",
    "SlowDrift",
    "StatePerturbation",
]

"""Cars that react: how they move, how they are driven, and what happens to them.

    motion        a car along its lane and beside it; commands, and what a car can do; which of the commands that
                  arrive a car carries out; bounds of accelerations, jerks and turns
    following     car following: the intelligent driver model
    driver        base class of drivers, and the one that follows its lane and the car ahead; own sensors overrule
                  what others made of the mission estimate
    proposals     the driver that simulates several ways to drive on and takes the best
    corridor      what is ahead of a car, along its lane
    consequences  what happened to a car: collisions, near misses, comfort, progress; where outlines overlap:
                  collisions, and post-encroachment times
    braking       when it brakes, what made that needful, and whether the truth did
    followers     what happens to the traffic behind it

Arrays in, arrays out; `nodes/world.py` and `nodes/driver.py` connect them. See docs/explanation-driving.md.
"""

from mast_zenoh.driving.driver import Driver, FollowingDriver, Situation, steering
from mast_zenoh.driving.following import IntelligentDriverModel
from mast_zenoh.driving.motion import Actuation, CarLimits, Command, RouteAhead
from mast_zenoh.driving.proposals import ProposalDriver

__all__ = [
    "Actuation",
    "CarLimits",
    "Command",
    "Driver",
    "FollowingDriver",
    "IntelligentDriverModel",
    "ProposalDriver",
    "RouteAhead",
    "Situation",
    "steering",
]

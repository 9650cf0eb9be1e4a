"""A mesh without processes: plays whole runs in one thread and in virtual time, and looks for broken promises.

world       what is simulated: `World.of(resolved)`; what disturbs it: `random_schedule(seed, world)`
simulation  `play(world, schedule)`: the run with the protocols of the nodes, the driver and the launcher
            network: messages, tokens, declarations;  processes: of nodes
promises    `check`: what must hold of every run;  `explore`: many seeds;  `simplest`: fewer disturbances;
            `undisturbed`: the run with which others are compared
"""

from mast_zenoh.testing.simulation.promises import check, explore, find, simplest, undisturbed
from mast_zenoh.testing.simulation.simulation import SimulationOutcome, play
from mast_zenoh.testing.simulation.world import Disturbance, Schedule, SimulatedWorld, random_schedule

__all__ = [
    "Disturbance",
    "Schedule",
    "SimulatedWorld",
    "SimulationOutcome",
    "check",
    "explore",
    "find",
    "play",
    "random_schedule",
    "simplest",
    "undisturbed",
]

"""Puts a recorded run back on a mesh: recorded nodes before a cut, live nodes after it.

cut         which nodes are played and which are live, and their wires, fitted to changed nodes
scripts     what each played node sent, read from the recording, and what the recording lacks
live        the live nodes, as recorded or changed by settings or a scenario file
resolution  resolve: all that a replay needs before processes start
"""

from mast_zenoh.launch.replay.cut import PLAYED_ROLES
from mast_zenoh.launch.replay.resolution import ResolvedReplay, resolve

__all__ = ["PLAYED_ROLES", "ResolvedReplay", "resolve"]

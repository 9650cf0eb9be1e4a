"""Actions of a timeline on processes, frame by frame."""

from __future__ import annotations

from typing import NamedTuple

#: kill: at once, without results; leave: requested to finish; start: for the first time, or again;
#: pause, resume: stopped and continued by signals; disconnect, connect: from and to its networks.
ACTIONS = ("kill", "leave", "start", "pause", "resume", "disconnect", "connect")

#: Actions that end a node.
LEAVING = ("kill", "leave")

#: Actions only for real time: in lock-step, the run waits for every node.
REALTIME = ("pause", "resume", "disconnect", "connect")

#: Actions that last until another one ends them, with that other action.
UNDONE_BY = {"pause": "resume", "disconnect": "connect"}


class ProcessStep(NamedTuple):
    """One action, of ACTIONS, on `node` at the boundary before frame `frame`."""

    frame: int
    action: str
    node: str

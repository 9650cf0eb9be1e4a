"""What a timeline does to processes, frame by frame."""

from __future__ import annotations

from typing import NamedTuple

#: kill: at once, nothing is handed in; leave: asked to finish; start: for the first time, or again;
#: pause, resume: stopped and continued by signals; disconnect, connect: taken off its networks and put back.
ACTIONS = ("kill", "leave", "start", "pause", "resume", "disconnect", "connect")

#: In lock-step everybody is waited for: these are for real time only.
REALTIME = ("pause", "resume", "disconnect", "connect")

#: What lasts until it is undone, and by what.
UNDONE_BY = {"pause": "resume", "disconnect": "connect"}


class ProcessStep(NamedTuple):
    """Done to `node` at the boundary before frame `frame`; `action` is one of ACTIONS."""

    frame: int
    action: str
    node: str

"""What a timeline does to processes, frame by frame."""

from __future__ import annotations

from typing import NamedTuple

#: kill: at once, nothing is handed in; leave: asked to finish; start: for the first time, or again;
#: pause, resume: stopped and continued by signals (real time only).
ACTIONS = ("kill", "leave", "start", "pause", "resume")


class ProcessStep(NamedTuple):
    """Done to `node` at the boundary before frame `frame`; `action` is one of ACTIONS."""

    frame: int
    action: str
    node: str

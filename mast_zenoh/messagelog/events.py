"""What a recording says beside its messages: how the run changed while it went on. Kept as MCAP metadata records."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

#: Name of the metadata record of an event.
EVENT = "event"
#: Name of the metadata record before a chunk: by place in the chunk, the steps of messages not sent in their own frame.
STEPS = "steps"
#: The same for messages that share key and frame with another one: in which order they were sent.
ORDER = "order"

#: What may happen: a node comes or goes; messages take other ways (the first such event is of the beginning).
JOINED, LEFT, REWIRED = "joined", "left", "rewired"


@dataclass(frozen=True, slots=True)
class Event:
    """Something that changed after a frame.

    what:   JOINED, LEFT or REWIRED
    frame:  the newest frame when it happened; -1: before the first
    node, role: the node that joined or left
    wiring: the new wiring, as in wiring.json
    """

    what: str
    frame: int
    node: str = ""
    role: str = ""
    wiring: Mapping[str, Any] = field(default_factory=dict)

    def to_metadata(self) -> dict[str, str]:
        """As MCAP metadata, which is text."""
        told = {"what": self.what, "frame": str(self.frame)}
        if self.what == REWIRED:
            return told | {"wiring": json.dumps(self.wiring, separators=(",", ":"))}
        return told | {"node": self.node, "role": self.role}

    @classmethod
    def from_metadata(cls, told: Mapping[str, str]) -> Event:
        """Of what `to_metadata` wrote; raises KeyError or ValueError for anything else."""
        if told["what"] == REWIRED:
            wiring = json.loads(told["wiring"])
            if not isinstance(wiring, dict):
                raise ValueError("wiring: expected an object")
            return cls(REWIRED, int(told["frame"]), wiring=wiring)
        if told["what"] not in (JOINED, LEFT):
            raise ValueError(f"what: found {told['what'][:20]!r}, expected {JOINED}, {LEFT} or {REWIRED}")
        return cls(told["what"], int(told["frame"]), told["node"], told["role"])

"""Changes of a run as events of its recording: MCAP metadata records."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mast_zenoh.run_files import parse_json

#: Name of the metadata record of an event.
EVENT = "event"
#: Name of the metadata record before a chunk: the steps of messages not sent in their own frame, by place in the chunk.
STEPS = "steps"
#: The same for the sending order of messages that share key and frame with another one.
ORDER = "order"

#: Kinds of events: a node joins or leaves; the wiring changes (the first such event has the initial wiring).
JOINED, LEFT, REWIRED = "joined", "left", "rewired"


@dataclass(frozen=True, slots=True)
class Event:
    """A change of the run after a frame.

    what:   JOINED, LEFT or REWIRED
    frame:  the latest frame when it happened; -1: before the first
    node, role: the node that joined or left
    wiring: the new wiring, as in wiring.json
    """

    what: str
    frame: int
    node: str = ""
    role: str = ""
    wiring: Mapping[str, Any] = field(default_factory=dict)

    def to_metadata(self) -> dict[str, str]:
        """The event as MCAP metadata, which is text."""
        values = {"what": self.what, "frame": str(self.frame)}
        if self.what == REWIRED:
            return values | {"wiring": json.dumps(self.wiring, separators=(",", ":"))}
        return values | {"node": self.node, "role": self.role}

    @classmethod
    def from_metadata(cls, values: Mapping[str, str]) -> Event:
        """The event that `to_metadata` wrote; raises KeyError or ValueError otherwise."""
        if values["what"] == REWIRED:
            wiring = parse_json(values["wiring"])
            if not isinstance(wiring, dict):
                raise ValueError("wiring: expected an object")
            return cls(REWIRED, int(values["frame"]), wiring=wiring)
        if values["what"] not in (JOINED, LEFT):
            raise ValueError(f"what: found {values['what'][:20]!r}, expected {JOINED}, {LEFT} or {REWIRED}")
        return cls(values["what"], int(values["frame"]), values["node"], values["role"])

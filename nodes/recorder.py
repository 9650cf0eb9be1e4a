"""The recorder: writes down every message on every key, tap legs included, as it was sent.

Nothing listens to it, so it can change nothing; and nobody waits for it but at the end of the run. It does no I/O: the
log is handed to it.
"""

from __future__ import annotations

from typing import Any

from mast_zenoh.errors import MessageError
from mast_zenoh.messagelog.events import JOINED, LEFT, REWIRED, Event
from mast_zenoh.messagelog.writer import MessageLog
from mast_zenoh.messages import codec
from mast_zenoh.node import Context, Node, Overheard
from mast_zenoh.runtime.mesh.main import main
from mast_zenoh.wiring.model import ANY


class Recorder(Node):
    """log: what it writes into, a path in the run folder."""

    role = "recorder"
    inputs = {"everything": ANY}

    def __init__(self, log: MessageLog) -> None:
        self.log = log

    def start(self, context: Context) -> None:
        """All keys are known before the first message, except those of nodes inserted later."""
        self.log.begin(context.hears)
        self.rewired(context)

    def rewired(self, context: Context) -> None:
        """From the next frame on messages take other ways."""
        self.log.add_event(Event(REWIRED, context.frame, wiring=context.wiring.to_json()))

    def joined(self, node: str, role: str, context: Context) -> None:
        """Another node is there from the next frame on."""
        self.log.add_event(Event(JOINED, context.frame, node, role))

    def left(self, node: str, role: str, context: Context) -> None:
        """Another node has gone."""
        self.log.add_event(Event(LEFT, context.frame, node, role))

    def on_everything(self, overheard: Overheard, context: Context) -> None:
        """A message, sound or not; of its body it is only asked that it is whole."""
        payload = overheard.payload
        try:
            header = overheard.header
            codec.decode_header(payload, overheard.wire.message)
        except MessageError:
            self.log.add_malformed(overheard.key, payload, max(context.frame, 0), context.time_ns, overheard.step)
        else:
            self.log.add(overheard.key, payload, header, overheard.step)

    def finish(self, context: Context) -> dict[str, Any]:
        """How many there were, how many could not be written, and why."""
        self.log.close()
        recorded = {name: getattr(self.log, name) for name in ("messages", "malformed", "lost")}
        if self.log.problem:
            context.log.error("%s: %d messages are lost", self.log.problem, self.log.lost)
            recorded |= {"problem": self.log.problem, "disk_full": self.log.disk_full}
        return {"recorded": recorded}


if __name__ == "__main__":
    main(Recorder)

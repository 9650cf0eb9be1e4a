"""The recorder: records every message on every key, including tap legs, as sent.

It publishes nothing, so it cannot influence the run, and the run waits for it only at its end. It does no I/O itself:
the log is a parameter.
"""

from __future__ import annotations

from typing import Any

from mast_zenoh.errors import MessageError
from mast_zenoh.mesh.hosting import main
from mast_zenoh.messages import codec
from mast_zenoh.node import Context, Node, Overheard
from mast_zenoh.run_folder.recording.format import JOINED, LEFT, REWIRED, RecordedEvent, records_scans
from mast_zenoh.run_folder.recording.writer import MessageLog
from mast_zenoh.wiring.model import ANY


class Recorder(Node):
    """Records messages.

    log:    a path in the run folder
    points: whether scans of lidars are recorded, too: a megabyte each; None: those on wires with an interposer, so that
            what it did can be measured again
    """

    role = "recorder"
    inputs = {"everything": ANY}

    def __init__(self, log: MessageLog, points: bool | None = None) -> None:
        self.log = log
        self.points = points
        self.scans: set[str] = set()  # keys whose scans are recorded

    def start(self, context: Context) -> None:
        """Open the log with all keys so far; nodes that are inserted later add theirs."""
        self.log.begin(context.subscriptions)
        self.rewired(context)

    def rewired(self, context: Context) -> None:
        """Record a change of the wiring."""
        recorded = [wire for wire in context.wiring.wires if records_scans(wire, self.points)]
        self.scans = {leg.key for wire in recorded for leg in wire.every_leg}
        self.log.add_event(RecordedEvent(REWIRED, context.frame, wiring=context.wiring.to_json()))

    def joined(self, node: str, role: str, context: Context) -> None:
        """Record that a node has joined."""
        self.log.add_event(RecordedEvent(JOINED, context.frame, node, role))

    def left(self, node: str, role: str, context: Context) -> None:
        """Record that a node has left."""
        self.log.add_event(RecordedEvent(LEFT, context.frame, node, role))

    def on_everything(self, overheard: Overheard, context: Context) -> None:
        """Record a message, valid or not; of its body only completeness is checked."""
        if overheard.wire.message == "points" and overheard.key not in self.scans:
            return
        payload = overheard.payload
        try:
            header = overheard.header
            codec.decode_header(payload, overheard.wire.message)
        except MessageError:
            self.log.add_malformed(overheard.key, payload, max(context.frame, 0), context.time_ns, overheard.step)
        else:
            self.log.add(overheard.key, payload, header, overheard.step)

    def finish(self, context: Context) -> dict[str, Any]:
        """Numbers of recorded and lost messages, and why they were lost."""
        self.log.close()
        recorded = {name: getattr(self.log, name) for name in ("messages", "malformed", "lost")}
        if self.log.problem:
            context.log.error("%s: %d messages were lost", self.log.problem, self.log.lost)
            recorded |= {"problem": self.log.problem, "disk_full": self.log.disk_full}
        return {"recorded": recorded}


if __name__ == "__main__":
    main(Recorder)

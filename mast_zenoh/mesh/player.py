"""Players: nodes that stand for those of a recorded run, and send what these sent.

A player has the name, the role and the wires of its recorded counterpart, so all other nodes see the mesh of the
recorded run. It sends the recorded bytes, in the frame in which they were sent.
"""

from __future__ import annotations

from typing import Any

from mast_zenoh.node import Context, Node, Received, Source, Unopened
from mast_zenoh.run_folder.recording.script import Script


class Player(Node):
    """Sends what a recorded node sent in the frame of each clock.

    script:   what it sends
    recorded: file, type and configuration of the recorded node, for reports
    """

    inputs = {"clock": "clock", "unused": "tracks"}
    unopened = ("unused",)

    def __init__(self, script: Script, recorded: dict[str, Any] | None = None) -> None:
        self.script = script
        self.outputs = script.ports  # type: ignore[misc]  # its ports are those of the recorded node

    def on_clock(self, received: Received, context: Context) -> None:
        """Send the messages of a frame."""
        _send(self.script, received.frame, context)

    def on_unused(self, received: Received, context: Context) -> None:
        """Ignore what the recorded node received: its answers are recorded."""


class ScenePlayer(Source):
    """Sends what the recorded simulator sent; it drives the replay.

    script, recorded: as of `Player`
    """

    def __init__(self, script: Script, recorded: dict[str, Any] | None = None) -> None:
        self.script = script
        self.period_ns = script.period_ns
        self.outputs = script.ports  # type: ignore[misc]  # its ports are those of the recorded node
        self.clock = next(output.port for output in script.outputs if output.message == "clock")
        self.next_frame = 0

    def advance(self, context: Context) -> bool:
        """Publish the clock of the next frame, and send its messages."""
        frame = self.next_frame
        if frame >= self.script.frames:
            return False
        self.next_frame += 1
        context.publish(self.clock, {}, frame=frame, time_ns=self.script.time_ns(frame))
        _send(self.script, frame, context)
        return True


def _send(script: Script, frame: int, context: Context) -> None:
    for output, payload in script.messages(frame):
        original = Unopened(output.message, output.subject, payload, frame)  # type: ignore[arg-type]  # see Unopened
        context.relay(output.port, original, payload=payload)

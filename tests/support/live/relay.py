"""A user-written interposer that forwards messages and can delay a third."""

from mast_zenoh.mesh.hosting import main
from mast_zenoh.node import Context, Node, Received


class Relay(Node):
    """keeps: whether every third message is delayed until the next clock."""

    role = "adversary"
    inputs = {"clock": "clock", "tracks": "tracks", "detections": "detections"}
    outputs = {"tracks_out": "tracks", "detections_out": "detections"}

    def __init__(self, keeps: bool = False) -> None:
        self.keeps = keeps
        self.kept: list[tuple[str, Received]] = []

    def on_clock(self, received: Received, context: Context) -> None:
        """Forward the delayed messages."""
        for port, kept in self.kept:
            context.relay(port, kept)
        self.kept.clear()

    def on_tracks(self, received: Received, context: Context) -> None:
        """Forward a message."""
        self.pass_on("tracks_out", received, context)

    def on_detections(self, received: Received, context: Context) -> None:
        """Forward a message."""
        self.pass_on("detections_out", received, context)

    def pass_on(self, port: str, received: Received, context: Context) -> None:
        """Forward a message now or at the next clock."""
        if self.kept or (self.keeps and received.message.header.seq % 3 == 0):
            self.kept.append((port, received))
        else:
            context.relay(port, received)


if __name__ == "__main__":
    main(Relay)

"""A user-defined link to one agent with deterministic loss and delay."""

from mast_zenoh.node import Context, Node, Received


class LossyLink(Node):
    """agent: whose poses and detections it carries; doubles: duplicate some."""

    role = "lossy"
    inputs = {"pose": "pose", "detections": "detections"}
    outputs = {"pose_out": "pose", "detections_out": "detections"}

    def __init__(self, agent: str, doubles: bool = False) -> None:
        self.agent = agent
        self.doubles = doubles
        self.kept: Received | None = None

    def on_pose(self, received: Received, context: Context) -> None:
        """Drop every third message."""
        if received.frame % 3 != 2:
            context.relay("pose_out", received)

    def on_detections(self, received: Received, context: Context) -> None:
        """Of every five messages drop one and delay one by a frame."""
        if self.kept is not None:
            context.relay("detections_out", self.kept)
            self.kept = None
        if received.frame % 5 == 1:
            self.kept = received
        elif received.frame % 5 != 3:
            for _ in range(2 if self.doubles and received.frame % 5 == 4 else 1):
                context.relay("detections_out", received)

"""A user-written adversary that displaces detections by all agents' poses."""

from mast_zenoh.gather import Gather
from mast_zenoh.mesh.hosting import main
from mast_zenoh.node import Context, Node, Received


class Shadow(Node):
    """agent: the victim; heard: the agents whose poses it waits for."""

    role = "adversary"
    inputs = {"clock": "clock", "detections": "detections", "poses": "pose"}
    outputs = {"detections_out": "detections"}

    def __init__(self, agent: str, heard: tuple[str, ...]) -> None:
        self.agent = agent
        self.gather: Gather[str, Received] = Gather({"detections", *heard})

    def on_clock(self, received: Received, context: Context) -> None:
        """Forward incomplete frames unchanged."""
        for _, items in self.gather.expired(received.frame):
            if "detections" in items:
                context.relay("detections_out", items["detections"])

    def on_poses(self, received: Received, context: Context) -> None:
        """Record an agent's position."""
        self.take(received.subject, received, context)

    def on_detections(self, received: Received, context: Context) -> None:
        """Record the victim's detections."""
        self.take("detections", received, context)

    def take(self, name: str, received: Received, context: Context) -> None:
        """Displace the detections when the frame is complete."""
        items = self.gather.add(received.frame, name, received)
        if items is not None:
            detections = items.pop("detections")
            offset = sum(items[name].body["position"] for name in sorted(items)) * 0.01
            body = {**detections.body, "position": detections.body["position"] + offset}
            context.relay("detections_out", detections, body)


if __name__ == "__main__":
    main(Shadow)

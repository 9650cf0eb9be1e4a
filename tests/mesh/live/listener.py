"""A user's own evaluator: says which messages it has heard, in the order in which they came."""

from mast_zenoh.node import Context, Node, Received
from mast_zenoh.runtime.process import main


class Listener(Node):
    """agents: their names."""

    role = "evaluator"
    inputs = {"tracks": "tracks", "mission": "tracks", "reports": "attack_report"}

    def __init__(self, agents: tuple[str, ...]) -> None:
        self.heard: list[tuple[str, int, int]] = []

    def on_tracks(self, received: Received, context: Context) -> None:
        """Of an agent."""
        self.note(f"agent/{received.subject}/tracks", received)

    def on_mission(self, received: Received, context: Context) -> None:
        """Of an agent."""
        self.note(f"agent/{received.subject}/mission", received)

    def on_reports(self, received: Received, context: Context) -> None:
        """Of an adversary."""
        self.note(f"attack/{received.subject}/report", received)

    def note(self, wire: str, received: Received) -> None:
        """Another message."""
        self.heard.append((wire, received.message.header.seq, received.frame))

    def finish(self, context: Context) -> dict:
        """What was heard, in order."""
        wires, numbers, frames = zip(*self.heard, strict=True)
        return {
            "metrics": {"frames": max(frames) + 1},
            "tables": {"heard": {"wire": wires, "seq": numbers, "frame": frames}},
        }


if __name__ == "__main__":
    main(Listener)

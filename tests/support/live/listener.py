"""A user-written evaluator: returns all received messages in order."""

from typing import Any

from mast_zenoh.node import Context, Node, Overheard
from mast_zenoh.runtime.mesh.hosting import main
from mast_zenoh.wiring.model import ANY


class Listener(Node):
    """agents: their names."""

    role = "evaluator"
    inputs = {"everything": ANY}

    def __init__(self, agents: tuple[str, ...]) -> None:
        self.heard: list[tuple[str, int, int]] = []

    def on_everything(self, message: Overheard, context: Context) -> None:
        """Record a message of an agent or adversary, not on tap legs."""
        if message.wire.message in ("tracks", "attack_report") and "@tap" not in message.key:
            self.heard.append((message.key, message.header.seq, message.header.frame))

    def finish(self, context: Context) -> dict[str, Any]:
        """The received messages, in order."""
        wires, numbers, frames = zip(*self.heard, strict=True)
        return {
            "metrics": {"frames": max(frames) + 1},
            "tables": {"heard": {"wire": wires, "seq": numbers, "frame": frames}},
        }


if __name__ == "__main__":
    main(Listener)

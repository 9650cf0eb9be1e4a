"""A user-written evaluator that takes little time."""

from typing import Any

from mast_zenoh.mesh.hosting import main
from mast_zenoh.node import Context, Node, Overheard
from mast_zenoh.wiring.model import ANY


class Listener(Node):
    """agents: their names."""

    role = "evaluator"
    inputs = {"everything": ANY}

    def __init__(self, agents: tuple[str, ...]) -> None:
        self.frames = 0

    def on_everything(self, message: Overheard, context: Context) -> None:
        """Count the frames."""
        self.frames = max(self.frames, message.header.frame + 1)

    def finish(self, context: Context) -> dict[str, Any]:
        """The number of frames."""
        return {"metrics": {"frames": self.frames}}


if __name__ == "__main__":
    main(Listener)

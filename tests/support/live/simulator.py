"""A user-written simulator: repeats the scene 200 times as one long scene."""

from typing import Any

from mast_zenoh.config import bundle, loading
from mast_zenoh.mesh.hosting import main
from mast_zenoh.node import Context
from mast_zenoh.scenes.recording import Recording

TIMES = 200


class Later:
    """A context that shifts frames by an offset."""

    def __init__(self, context: Context, frames: int, period_ns: int) -> None:
        self.context, self.frames, self.time_ns = context, frames, frames * period_ns

    def publish(self, port: str, body: Any, *, frame: int | None = None, time_ns: int = 0, **more: Any) -> None:
        """Publish the clock with the shifted frame."""
        if frame is not None:
            more |= {"frame": frame + self.frames, "time_ns": time_ns + self.time_ns}
        self.context.publish(port, body, **more)

    def connected(self, port: str, subject: str | None = None) -> bool:
        """Whether a wire is connected to an output port."""
        return self.context.connected(port, subject)


class Endless(loading.node_class(bundle.ROOT / "nodes" / "simulator.py")):
    """Like the shipped simulator."""

    def __init__(self, recording: Recording, frames: int | None = None) -> None:
        super().__init__(recording, frames)
        self.played = 0

    def advance(self, context: Context) -> bool:
        """Play the next frame."""
        if self.next_frame >= self.frames:
            self.next_frame = 0
            self.played += 1
        return self.played < TIMES and super().advance(Later(context, self.played * self.frames, self.period_ns))


if __name__ == "__main__":
    main(Endless)

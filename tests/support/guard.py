"""A user-written, listen-only defence that records agents' tracks."""

from typing import Any

from mast_zenoh.mesh.hosting import main
from mast_zenoh.node import Context, Node, Received


class Guard(Node):
    """heard: (subject, frame, payload) of every message in order of arrival."""

    role = "defence"
    inputs = {"tracks": "tracks"}

    def __init__(self) -> None:
        self.heard: list[tuple[str, int, bytes]] = []

    def on_tracks(self, received: Received, context: Context) -> None:
        """Record an agent's tracks."""
        self.heard.append((received.subject, received.frame, received.encoded))

    def finish(self, context: Context) -> dict[str, Any]:
        """The number of messages from each agent."""
        subjects = [subject for subject, _, _ in self.heard]
        return {"heard": {subject: subjects.count(subject) for subject in sorted(set(subjects))}}


if __name__ == "__main__":
    main(Guard)

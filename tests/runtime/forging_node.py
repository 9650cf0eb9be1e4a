"""A node that sends columns on a wire whose messages travel in another format."""

from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Message
from mast_zenoh.node import Context, Node, Received


class Forger(Node):
    """Sends the columns of each message as they are."""

    role = "forger"
    inputs = {"clock": "clock", "tracks": "tracks"}
    outputs = {"tracks_out": "tracks"}

    def on_clock(self, received: Received, context: Context) -> None:
        """Nothing to do."""

    def on_tracks(self, received: Received, context: Context) -> None:
        """Send its columns."""
        columns = Message(received.message.header, dict(received.body))
        context.relay("tracks_out", received, payload=codec.encode(columns))

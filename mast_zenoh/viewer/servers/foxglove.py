"""The WebSocket server of Foxglove and Lichtblick, for finished runs and for live ones."""

from __future__ import annotations

import threading

import foxglove
from foxglove.websocket import (
    Capability,
    ChannelView,
    Client,
    PlaybackCommand,
    PlaybackControlRequest,
    PlaybackState,
    PlaybackStatus,
    ServerListener,
)

from mast_zenoh.viewer.export.foxglove import RunChannels
from mast_zenoh.viewer.frame import Frame, FramedRun
from mast_zenoh.viewer.loopback import LOOPBACK, unusable_port
from mast_zenoh.viewer.servers.playback import Playback, Status

#: Messages that wait for a client: beyond it, the oldest are dropped; a client that reads none at all is disconnected.
BACKLOG = 1024
#: Time within which a client makes all its subscriptions, and they take effect, s.
_SUBSCRIBING_S = 0.2
_STATUS = {
    Status.PLAYING: PlaybackStatus.Playing,
    Status.PAUSED: PlaybackStatus.Paused,
    Status.ENDED: PlaybackStatus.Ended,
}


class FoxgloveServer:
    """Serves frames to Foxglove and Lichtblick on the loopback address; `publish` never waits for a client.

    run:      what is shown;  port: 0 for any free one
    playback: of a finished run, which clients may pause and seek; None: the run is live

    Raises ConfigurationError if the port cannot be used.
    """

    def __init__(self, run: FramedRun, port: int = 0, playback: Playback | None = None) -> None:
        self.run, self.playback = run, playback
        self._context = context = foxglove.Context()  # channels do not keep it alive
        self._channels = RunChannels(run, context)
        self._lock = threading.Lock()
        self._latest: Frame | None = None
        self._buildings_due = True
        self._subscribed = threading.Event()  # set by the first subscription
        self._lacking = threading.Event()  # a client has subscribed, and lacks what was sent before
        self._closed = threading.Event()
        try:
            self._server = foxglove.start_server(
                name=f"mast {run.id}",
                host=LOOPBACK,
                port=port,
                capabilities=[Capability.Time],
                server_listener=_Listener(self),
                context=context,
                playback_time_range=(playback.first_ns, playback.last_ns) if playback else None,
                message_backlog_size=BACKLOG,
            )
        except (OSError, RuntimeError) as error:
            raise unusable_port(port, error if isinstance(error, OSError) else OSError(str(error))) from None

        self._resending = threading.Thread(target=self._resend, daemon=True)
        self._resending.start()
        if playback is not None:
            playback.on_change = self.publish_state

    @property
    def url(self) -> str:
        """The address for "Foxglove WebSocket" connections."""
        return f"ws://{LOOPBACK}:{self._server.port}"

    def serve(self) -> None:
        """Send all frames: of a live run as they come, of a finished one from the first subscription until `close`."""
        if self.playback is not None:
            self._subscribed.wait()
        for frame in self.run if self.playback is None else self.playback.frames():
            self.publish(frame)

    def publish(self, frame: Frame) -> None:
        """Send a frame to all clients."""
        with self._lock:
            self._latest = frame
            self._send(frame)

    def _send(self, frame: Frame) -> None:
        if self._buildings_due:
            self._channels.write_buildings(frame.time_ns)
            self._buildings_due = False
        self._channels.write(frame)
        self._server.broadcast_time(frame.time_ns)

    def _resend(self) -> None:
        """Send the latest frame and the buildings again whenever a client has subscribed, which lacks them."""
        while self._lacking.wait() and not self._closed.wait(_SUBSCRIBING_S):
            self._lacking.clear()
            with self._lock:
                self._buildings_due = True
                if self._latest is not None:
                    self._send(self._latest)

    def publish_state(self) -> None:
        """Tell all clients what the playback is doing."""
        if self.playback is not None:
            self._server.broadcast_playback_state(self.state(self.playback))

    def state(self, playback: Playback, *, seek: bool = False, request: str | None = None) -> PlaybackState:
        """What the playback is doing, in the words of the protocol.

        seek: whether a client has asked for another time;  request: the id of its request
        """
        return PlaybackState(_STATUS[playback.status], playback.position_ns(), playback.rate, seek, request)

    def note_subscription(self) -> None:
        """A client has subscribed to a channel."""
        self._subscribed.set()
        self._lacking.set()

    def close(self) -> None:
        """End the server, and `serve` of a finished run."""
        self._closed.set()
        self.note_subscription()
        if self.playback is not None:
            self.playback.stop()
        self._resending.join()
        self._server.stop()


class _Listener(ServerListener):
    """Receives what clients ask for, in threads of the server."""

    def __init__(self, server: FoxgloveServer) -> None:
        self._server = server

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Note that a client lacks what was sent before."""
        self._server.note_subscription()

    def on_playback_control_request(self, playback_control_request: PlaybackControlRequest) -> PlaybackState | None:
        """Play, pause or seek."""
        playback, request = self._server.playback, playback_control_request
        if playback is None:
            return None
        playback.control(
            play=request.playback_command == PlaybackCommand.Play,
            rate=request.playback_speed,
            seek_ns=request.seek_time,
        )
        return self._server.state(playback, seek=request.seek_time is not None, request=request.request_id)

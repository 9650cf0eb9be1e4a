"""The WebSocket server of Foxglove and Lichtblick, for finished runs and for live ones."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from enum import Enum

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


class Status(Enum):
    """What a playback is doing."""

    PLAYING, PAUSED, ENDED = "playing", "paused", "ended"


class Playback:
    """Plays frames at the pace of the scene's time; other threads may pause, seek and end it.

    run:   a finished run;  rate: s of the scene per s;  loop: begin again at the end instead of pausing there
    clock: s, monotonic

    Raises RunFolderError if the run has no frame.
    """

    def __init__(
        self, run: FramedRun, *, rate: float = 1.0, loop: bool = False, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.run, self.rate, self.loop, self.clock = run, rate, loop, clock
        times = [frame.time_ns for frame in run]
        self.first_ns, self.last_ns = min(times), max(times)
        self.status = Status.PLAYING
        #: Called when the playback has ended or begun again by itself.
        self.on_change: Callable[[], None] = lambda: None
        self._changed = threading.Condition()
        self._shown_ns = self._begin_ns = self.first_ns
        self._begin_s = clock()
        self._seeks = 0
        self._stopped = False

    def position_ns(self) -> int:
        """The time of the scene that is shown, ns."""
        return self._shown_ns

    def control(self, *, play: bool | None = None, rate: float | None = None, seek_ns: int | None = None) -> None:
        """Play or pause, at another rate, from another time; None: as before."""
        with self._changed:
            if seek_ns is None and play and self.status is Status.ENDED:
                seek_ns = self.first_ns
            if seek_ns is not None:
                self._shown_ns = min(max(seek_ns, self.first_ns), self.last_ns)
                self._seeks += 1
                self.status = Status.PAUSED if self.status is Status.ENDED else self.status
            if play is not None and self.status is not Status.ENDED:
                self.status = Status.PLAYING if play else Status.PAUSED
            if rate is not None and rate > 0:
                self.rate = rate
            self._begin_ns, self._begin_s = self._shown_ns, self.clock()
            self._changed.notify_all()

    def stop(self) -> None:
        """End the iteration over the frames."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def frames(self) -> Iterator[Frame]:
        """The frames, each when it is due: again and again, also after the end, until `stop`.

        After a seek comes the latest frame that is not after the new time, also while paused.
        """
        while not self._stopped:
            seeks, begin_ns = self._seeks, self._shown_ns
            before = None
            for frame in self.run:
                if frame.time_ns <= begin_ns:
                    before = frame
                    continue
                if before is not None:
                    yield before
                    before = None
                if not self._wait_for(frame.time_ns, seeks):
                    break
                yield frame
            else:
                if before is not None:
                    yield before
                self._wait_at_end(seeks)

    def _wait_for(self, time_ns: int, seeks: int) -> bool:
        """Wait until a frame is due; False: it is not wanted any more."""
        with self._changed:
            while not self._stopped and self._seeks == seeks:
                due_s = self._begin_s + (time_ns - self._begin_ns) / 1e9 / self.rate
                left_s = due_s - self.clock()
                if self.status is Status.PLAYING and left_s <= 0:
                    self._shown_ns = time_ns
                    return True
                self._changed.wait(left_s if self.status is Status.PLAYING else None)
            return False

    def _wait_at_end(self, seeks: int) -> None:
        """Begin again, or wait for a seek."""
        with self._changed:
            if self._stopped or self._seeks != seeks:
                return
            if self.loop and self.status is Status.PLAYING:
                self._shown_ns = self._begin_ns = self.first_ns
                self._begin_s = self.clock()
            else:
                self.status = Status.ENDED
        self.on_change()
        with self._changed:
            while self.status is Status.ENDED and not self._stopped and self._seeks == seeks:
                self._changed.wait()


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

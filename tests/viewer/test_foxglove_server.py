"""Foxglove's WebSocket server: what clients get, play, pause and seek, and a client that stops reading."""

from __future__ import annotations

import asyncio
import json
import struct
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import psutil
import pytest
from plain_record import PlainRecord
from tornado.websocket import WebSocketClientConnection, websocket_connect

import mast_zenoh as mast
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.viewer.recorded import RecordedRun
from mast_zenoh.viewer.servers import foxglove as foxglove_server
from mast_zenoh.viewer.servers.foxglove import FoxgloveServer
from mast_zenoh.viewer.servers.playback import Playback, Status

PLAYING, PAUSED, ENDED = 0, 1, 3
MESSAGE, TIME, STATE = 1, 2, 5


def run_apart(work: Any) -> None:
    """Run a coroutine in a thread of its own: playwright may have an event loop in this one."""
    with ThreadPoolExecutor(1) as pool:
        pool.submit(asyncio.run, work).result()


@pytest.fixture(scope="module")
def run(recorded: mast.Run) -> RecordedRun:
    return RecordedRun.load(recorded.path)


class Client:
    """A client of the protocol foxglove.sdk.v1 that subscribes to everything."""

    def __init__(self, connection: WebSocketClientConnection) -> None:
        self.connection = connection
        self.topics: list[str] = []

    @classmethod
    async def connect(cls, server: FoxgloveServer, count: int) -> Client:
        client = cls(await websocket_connect(server.url, subprotocols=["foxglove.sdk.v1"]))
        assert json.loads(await client.read())["op"] == "serverInfo"
        identities = []
        while len(client.topics) < count:
            for channel in json.loads(await client.read())["channels"]:
                client.topics.append(channel["topic"])
                identities.append(channel["id"])
        wanted = [{"id": number, "channelId": channel} for number, channel in enumerate(identities)]
        await client.connection.write_message(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        return client

    async def read(self) -> Any:
        return await asyncio.wait_for(self.connection.read_message(), 30)

    async def until_state(self, status: int, last_ns: int | None = None) -> tuple[dict[str, list[int]], list[int]]:
        """By topic the times of its messages, and the times of the server, up to a state of the playback.

        last_ns: also up to the picture and the server's time of the last frame, which the state may overtake
        """
        messages: dict[str, list[int]] = {}
        times: list[int] = []
        reached = False
        while not reached or (last_ns and not messages.get("/cc/picture", [0])[-1] == last_ns == times[-1]):
            data = await self.read()
            if data[0] == MESSAGE:
                number, time_ns = struct.unpack("<IQ", data[1:13])
                messages.setdefault(self.topics[number], []).append(time_ns)
            elif data[0] == TIME:
                times.append(struct.unpack("<Q", data[1:9])[0])
            elif data[0] == STATE:
                reached |= data[1] == status
        return messages, times

    async def control(self, *, play: bool, seek_ns: int) -> None:
        request = struct.pack("<BBfBQI", 3, not play, 50.0, True, seek_ns, 1) + b"r"
        await self.connection.write_message(request, binary=True)


def number_of_channels(run: RecordedRun) -> int:
    scenes = 2 * len(run.topics) - 1 + 2
    return scenes + 2 + len(run.agents) + 1 + len(run.scored)


@pytest.fixture
def server(run: RecordedRun) -> Iterator[FoxgloveServer]:
    """Plays a finished run, faster than in reality."""
    running = FoxgloveServer(run, 0, Playback(run, rate=50.0))
    thread = threading.Thread(target=running.serve)
    thread.start()
    yield running
    running.close()
    thread.join(20)
    assert not thread.is_alive()


def test_a_client_gets_every_frame_and_may_go_back_when_it_has_ended(
    server: FoxgloveServer, run: RecordedRun, record: PlainRecord
) -> None:
    times = [frame.time_ns for frame in run]

    async def scenario() -> None:
        client = await Client.connect(server, number_of_channels(run))
        messages, _ = await client.until_state(ENDED, times[-1])
        assert messages["/cc/picture"][-1] == times[-1]
        assert set(messages["/cc/picture"]) <= set(times)
        await client.control(play=True, seek_ns=times[10])
        await client.until_state(PLAYING)
        messages, server_times = await client.until_state(ENDED, times[-1])
        assert messages["/cc/picture"] == server_times == times[10:]
        await client.control(play=False, seek_ns=times[5] + 1)
        await client.until_state(PAUSED)
        while (data := await client.read())[0] != TIME:
            pass
        assert struct.unpack("<Q", data[1:9])[0] == times[5]
        late = await Client.connect(server, number_of_channels(run))
        seen = set()
        while "/scene/buildings" not in seen or "/cc/picture" not in seen:
            data = await late.read()
            if data[0] == MESSAGE:
                seen.add(late.topics[struct.unpack("<I", data[1:5])[0]])

    run_apart(scenario())


@pytest.mark.heavy
def test_a_client_that_stops_reading_is_disconnected_and_memory_does_not_grow(
    run: RecordedRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(foxglove_server, "BACKLOG", 64)
    frames, rounds = list(run), 16  # several times what the buffers of the system hold
    server = FoxgloveServer(run)
    process = psutil.Process()

    async def stalled() -> None:
        server.publish(frames[0])
        client = await Client.connect(server, number_of_channels(run))
        while (await client.read())[0] != TIME:
            pass
        grown = []
        for _ in range(rounds):  # this client's event loop does not run meanwhile
            for frame in frames:
                server.publish(frame)
            grown.append(process.memory_info().rss)
        assert grown[-1] - grown[2] < 4 << 20
        count = 0
        while await client.read() is not None:  # what is still in the buffers of the system, then the end
            count += 1
        assert count < len(frames) * rounds * len(run.topics)

    try:
        run_apart(stalled())
    finally:
        server.close()


def test_a_port_in_use_is_refused_by_name(run: RecordedRun, server: FoxgloveServer) -> None:
    port = int(server.url.rpartition(":")[2])
    with pytest.raises(ConfigurationError, match=f"--port: found {port}, which cannot be used"):
        FoxgloveServer(run, port)


def test_a_playback_keeps_to_the_time_of_the_scene(run: RecordedRun) -> None:
    now = [100.0]
    playback = Playback(run, rate=2.0, clock=lambda: now[0])
    times = [frame.time_ns for frame in run]
    frames = playback.frames()
    assert next(frames).time_ns == times[0]
    now[0] += (times[3] - times[0]) / 2e9 + 1e-6
    assert [next(frames).time_ns for _ in range(3)] == times[1:4]
    playback.control(seek_ns=times[-1] + 5)
    assert next(frames).time_ns == times[-1]
    playback.loop = True
    assert next(frames).time_ns == times[0]
    assert playback.status is Status.PLAYING

"""The radio channel that all agents share: who hears whom, and how busy the channel is.

It is part of the world, like the simulator: it listens to what all peers broadcast, their agents' tracks and where they
are themselves, and tells each peer in the next frame which of the messages were lost, how busy the channel was, and how
long its own messages were on the air. Where stations are is what the simulator says, not what they claim. Stations in
the background, which are not in the scene, can load the channel too.
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np

from mast_zenoh.gather import LatestBefore
from mast_zenoh.mesh.hosting import main
from mast_zenoh.messages.packed import Packed
from mast_zenoh.messages.schemas import text
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.v2x import BackgroundStations, OfdmTiming, RadioChannel, Transmissions, arrivals

#: Ports of the two kinds of messages, which are lost separately.
KINDS = ("sent", "awareness")


class Sent(NamedTuple):
    """A message on the air. frame: in which it was sent; kind: row of KINDS; sizes: bytes of its frames"""

    frame: int
    kind: int
    seq: int
    sender: str
    sizes: tuple[int, ...]


class Channel(Node):
    """Lets messages arrive by distance and load.

    radio: of all stations, and what is between them; None: RadioChannel()
    timing: how long frames are on the air; None: OfdmTiming()
    background: stations besides, which load the channel; None: none
    """

    role = "channel"
    inputs = {"clock": "clock", "pose": "pose", "sent": "tracks", "awareness": "tracks"}
    outputs = {"reception": "reception"}
    affects = {"sent": {}, "awareness": {}}  # what is said does not change who hears it

    def __init__(
        self,
        radio: RadioChannel | None = None,
        timing: OfdmTiming | None = None,
        background: BackgroundStations | None = None,
    ) -> None:
        self.radio = radio or RadioChannel()
        self.timing = timing or OfdmTiming()
        self.background = background or BackgroundStations(stations=0)
        self.stations: list[str] = []
        self.positions: dict[str, LatestBefore[np.ndarray]] = {}
        self.sent: list[Sent] = []
        self.before_ns: int | None = None  # time of the frame before
        self.busy: list[float] = []
        self.counts = Counter(dict.fromkeys(("frames", "bytes", "arrived", "lost"), 0))

    def start(self, context: Context) -> None:
        """All stations whose broadcasts it hears."""
        self.stations = sorted({each.subject for each in context.subscriptions.values() if each.port in KINDS})

    def on_pose(self, received: Received, context: Context) -> None:
        """Where a station is."""
        positions = self.positions.setdefault(received.subject, LatestBefore())
        positions.add(context.frame, received.body["position"][:2], received.frame)

    def on_sent(self, received: Received, context: Context) -> None:
        """What a station sends, its tracks or what it says of itself, is on the air, unless it has no bytes."""
        if sizes := sizes_of(received):
            # Counted here, because no frame comes after the last one.
            self.counts["frames"] += len(sizes)
            self.counts["bytes"] += sum(sizes)
            kind, seq = KINDS.index(received.port), received.message.header.seq
            self.sent.append(Sent(context.frame, kind, seq, received.subject, sizes))

    on_awareness = on_sent

    def on_clock(self, received: Received, context: Context) -> None:
        """Tell all stations what arrived of what was sent in the frame before."""
        frame, time_ns = received.frame, received.time_ns
        sent = sorted(each for each in self.sent if each.frame < frame)
        self.sent = [each for each in self.sent if each.frame >= frame]
        nowhere = np.full(2, np.nan)  # neither hears nor is heard
        latest = [self.positions[name].get(frame) if name in self.positions else None for name in self.stations]
        position = np.array([nowhere if item is None else item[1] for item in latest]).reshape(-1, 2)
        row_of = {name: row for row, name in enumerate(self.stations)}
        frames = [(each.kind, row_of[each.sender], size) for each in sent for size in each.sizes]
        kind, sender, sizes = np.array(frames, np.int64).reshape(-1, 3).T
        airtime = self.timing.airtime_ns(sizes)
        began_ns = time_ns if self.before_ns is None else self.before_ns
        window_ns = time_ns - began_ns or None
        transmissions = Transmissions(sender, np.full(len(sender), began_ns), airtime)
        self.before_ns = time_ns
        n = len(self.stations)
        busy, chance = self.load(position, transmissions, time_ns, window_ns, context)
        arrived = arrivals(chance, sender, lambda row: context.rng("arrivals", frame, self.stations[row]))
        missed = np.zeros((2, n, n), bool)  # by kind, sender and receiver: a frame of the message did not arrive
        np.logical_or.at(missed, (kind, sender), ~arrived)
        sending = np.zeros((2, n), bool)
        sending[kind, sender] = True
        own_airtime = np.bincount(sender, airtime, n)
        self.note(busy, sending, missed)
        for row, name in enumerate(self.stations):
            lost, lost_awareness = (np.flatnonzero(of_kind) for of_kind in sending & missed[:, :, row])
            body = {
                "lost": text([self.stations[other] for other in lost if other != row]),
                "lost_awareness": text([self.stations[other] for other in lost_awareness if other != row]),
                "busy_ratio": busy[row : row + 1],
                "sent": np.array([sending[:, row].sum()], np.int64),
                "airtime_ns": np.array([own_airtime[row]], np.int64),
            }
            context.publish("reception", body, subject=name, frame=frame, time_ns=time_ns)

    def load(
        self, position: np.ndarray, sent: Transmissions, time_ns: int, window_ns: int | None, context: Context
    ) -> tuple[np.ndarray, np.ndarray]:
        """Busy ratio (n,) at the stations, and probability (n, n) that a message of the row's arrives at the column's.

        position: (n, 2) m; sent: what they sent in the last window_ns before time_ns, to which the background adds
        """
        n, background = len(position), self.background
        present = position[np.isfinite(position).all(axis=1)]
        if not background.begun and window_ns is not None and len(present):
            background.begin(time_ns - window_ns, window_ns, present.mean(axis=0), context.rng("background"))
        if background.begun and window_ns is not None:
            others = background.transmit(time_ns - window_ns, self.timing)
            others = others._replace(sender=others.sender + n)
            sent = Transmissions(*map(np.concatenate, zip(sent, others, strict=True)))
            position = np.concatenate([position, background.position])
        busy = self.radio.busy_ratio(position, sent, time_ns, window_ns)
        background.measure(time_ns, busy[n:])
        return busy[:n], self.radio.reception(position, sent, time_ns, window_ns)[:n, :n]

    def note(self, busy: np.ndarray, sending: np.ndarray, missed: np.ndarray) -> None:
        """Count for the results. busy: (n,); sending: (2, n); missed: (2, n, n)"""
        self.busy.append(float(busy.mean()) if len(busy) else 0.0)
        pairs = int(sending.sum()) * (len(self.stations) - 1)
        lost = int(missed[sending].sum()) - int(missed.diagonal(axis1=1, axis2=2)[sending].sum())
        self.counts["arrived"] += pairs - lost
        self.counts["lost"] += lost

    def finish(self, context: Context) -> dict[str, object]:
        """Frames and bytes on the air, messages that arrived and were lost, and the mean and greatest busy ratio.

        Whether messages of the last frame arrived is not known: they are among the frames and bytes alone.
        """
        busy = self.busy or [0.0]
        ratios = {"busy_ratio_mean": sum(busy) / len(busy), "busy_ratio_max": max(busy)}
        background = len(self.background.position)
        return {"channel": {"stations": len(self.stations), "background": background, **self.counts, **ratios}}


def sizes_of(received: Received) -> tuple[int, ...]:
    """Bytes of the frames of a message: its segments, or all of it where its wire has no codec."""
    body = received.body
    return tuple(map(len, body.segments)) if isinstance(body, Packed) else (len(received.encoded),)


if __name__ == "__main__":
    main(Channel)

"""Stations that load the channel but are not in the scene: those of the streets around it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.v2x.channel import OfdmTiming, Transmissions
from mast_zenoh.v2x.congestion import AdaptiveDcc, CongestionControl

#: By which a frame may be early and still count as due, ns; times of frames are rounded.
TOLERANCE_NS = 1_000_000


@dataclass(kw_only=True, eq=False)
class BackgroundStations:
    """Stations that stand around the scene and send messages of one size, as often as congestion control lets them.

    They are switched on within the first second, as the stations of the scene are. Nobody uses what they send.

    stations: their number
    radius_m: m, of the disc around the middle of the scene's stations in which they stand, evenly spread
    message_bytes: bytes of a message; 360 is a Collective Perception Message with ten objects
    interval_s: s, least time between two messages of a station (T_GenCpmMin; TS 103 324 v2.1.1, clause 6.1.3)
    congestion: of all of them
    """

    stations: int = 150
    radius_m: float = 150.0
    message_bytes: int = 360
    interval_s: float = 0.1
    congestion: CongestionControl = field(default_factory=AdaptiveDcc)

    def __post_init__(self) -> None:
        check("0 or more", stations=self.stations, message_bytes=self.message_bytes)
        check("more than 0, finite", radius_m=self.radius_m, interval_s=self.interval_s)
        self._position: Floats = np.zeros((0, 2))
        self._next_ns: Ints = np.zeros(0, np.int64)  # when each may send again, as far as `interval_s` says
        self.congestion.reset(0)

    @property
    def begun(self) -> bool:
        """Whether they have places and are switched on."""
        return len(self._next_ns) == self.stations

    @property
    def position(self) -> Floats:
        """(n, 2) m; none before they begin."""
        return self._position

    def begin(self, time_ns: int, period_ns: int, centre: Floats, generator: np.random.Generator) -> None:
        """Take places around a centre (2,) m, and begin within a second of a time. period_ns: ns between frames"""
        n = self.stations
        radius, angle = self.radius_m * np.sqrt(generator.random(n)), 2.0 * np.pi * generator.random(n)
        self._position = centre + np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
        start_ns = time_ns + (1e9 * generator.random(n)).astype(np.int64)
        self.congestion.reset(n, start_ns, period_ns)
        self._next_ns = start_ns

    def transmit(self, time_ns: int, timing: OfdmTiming) -> Transmissions:
        """What they send at a time, whose gates are open."""
        sent = self.congestion.may_send(time_ns) & (time_ns >= self._next_ns)
        airtime_ns = timing.airtime_ns(np.full(len(sent), self.message_bytes))
        self.congestion.note_sent(time_ns, airtime_ns, sent)
        interval_ns = round(self.interval_s * 1e9) - TOLERANCE_NS
        self._next_ns = np.where(sent, time_ns + interval_ns, self._next_ns)
        senders = sent.nonzero()[0]
        return Transmissions(senders, np.full(len(senders), time_ns), airtime_ns[senders])

    def measure(self, time_ns: int, busy_ratio: Floats) -> None:
        """Note the busy ratio (n,) of the channel where they stand; nothing before they begin."""
        if self.begun:
            self.congestion.measure(time_ns, busy_ratio)

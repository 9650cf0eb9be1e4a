"""The radio channel of ITS-G5: airtime of transmissions, busy ratio of the channel, and which transmissions arrive.

A model for studies of load, not a radio simulator: all stations send with one power and one bit rate, transmissions
are about equally long, and no obstacle shadows them. What it leaves out is listed at `RadioChannel`.

Stations that load the channel but are not in the scene: those of the streets around it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.v2x.congestion import AdaptiveDcc, CongestionControl

#: Data bits in an OFDM symbol, by bit rate in Mbit/s (IEEE 802.11-2020, table 17-4, channels of 10 MHz).
BITS_PER_SYMBOL = {3.0: 24, 4.5: 36, 6.0: 48, 9.0: 72, 12.0: 96, 18.0: 144, 24.0: 192, 27.0: 216}
PREAMBLE_NS = 40_000  #: preamble (32 µs) and SIGNAL field (8 µs) at 10 MHz (IEEE 802.11-2020, table 17-5)
SYMBOL_NS = 8_000  #: one OFDM symbol at 10 MHz
SERVICE_AND_TAIL_BITS = 16 + 6  #: bits around the data of a transmission (IEEE 802.11-2020, 17.3.2)
#: Backoff slots of best effort, which carries CAM and CPM: CWmin + 1 (EN 302 663, table B.2).
BACKOFF_SLOTS = 16
#: Probability that a station that waits sends in a slot (Bianchi, IEEE JSAC 18(3) 2000, equation 8 without doubling).
SLOT_PROBABILITY = 2 / (BACKOFF_SLOTS + 1)


@dataclass(frozen=True, kw_only=True)
class OfdmTiming:
    """Durations of transmissions of IEEE 802.11 at 10 MHz.

    bit_rate_mbps: Mbit/s, one of 3, 4.5, 6, 9, 12, 18, 24 and 27
    overhead_bytes: bytes around the message: GeoNetworking, BTP, security and MAC
    """

    bit_rate_mbps: float = 6.0
    overhead_bytes: int = 140

    def __post_init__(self) -> None:
        if self.bit_rate_mbps not in BITS_PER_SYMBOL:
            rates = ", ".join(f"{rate:g}" for rate in BITS_PER_SYMBOL)
            raise ValueError(f"bit_rate_mbps: found {self.bit_rate_mbps}, expected one of {rates}")
        check("0 or more", overhead_bytes=self.overhead_bytes)

    def airtime_ns(self, message_bytes: Ints) -> Ints:
        """(m,) ns that the channel is busy with transmissions of messages of (m,) bytes.

        Data is padded to whole symbols (IEEE 802.11-2020, 17.4.3).
        """
        bits = (np.asarray(message_bytes, np.int64) + self.overhead_bytes) * 8 + SERVICE_AND_TAIL_BITS
        symbols = -(-bits // BITS_PER_SYMBOL[self.bit_rate_mbps])
        return np.asarray(PREAMBLE_NS + symbols * SYMBOL_NS)


class Transmissions(NamedTuple):
    """m transmissions on the air.

    sender: (m,) rows of stations; start_ns: (m,) ns; airtime_ns: (m,) ns
    """

    sender: Ints
    start_ns: Ints
    airtime_ns: Ints

    def total_ns(self, now_ns: int, stations: int, window_ns: int) -> Ints:
        """(n,) ns of the last `window_ns` in which each of n stations transmits."""
        end = np.minimum(self.start_ns + self.airtime_ns, now_ns)
        within = np.maximum(end - np.maximum(self.start_ns, now_ns - window_ns), 0)
        total = np.zeros(stations, np.int64)
        np.add.at(total, self.sender, within)
        return total


@dataclass(frozen=True, kw_only=True)
class RadioChannel:
    """Which stations hear each other, and which transmissions arrive at which load.

    Path loss: free space up to 1 m, then two slopes (Cheng et al., IEEE JSAC 25(8) 2007, data set 1: 5.9 GHz, between
    cars, in a suburb). Fading: Nakagami, so that power is Gamma distributed about its mean. Collisions: see
    `clear_probability`.

    power_dbm: of a sender with its antenna (EN 302 571 allows 33)
    loss_1m_db: dB, path loss at 1 m; 47.86 in free space at 5.9 GHz
    near_exponent, far_exponent: of the path loss before and after the breakpoint
    breakpoint_m: m, distance at which the slope changes
    fading_shape: Nakagami's m, a whole number: 1 is Rayleigh fading, larger is milder
    sensitivity_dbm: power at which a transmission is decoded; -82 at 6 Mbit/s (IEEE 802.11-2020, table 17-18)
    busy_dbm: mean power from which the channel counts as busy (TS 102 687, clause 4)
    window_s: s, over which the busy ratio is measured
    hidden_terminals: whether stations that a sender does not hear destroy its transmissions

    Left out: obstacles, antennas and heights; capture (of two colliding transmissions, both are lost); unequal lengths
    and priorities; the interference of many far stations.
    """

    power_dbm: float = 23.0
    loss_1m_db: float = 47.86
    near_exponent: float = 2.1
    far_exponent: float = 3.8
    breakpoint_m: float = 100.0
    fading_shape: int = 3
    sensitivity_dbm: float = -82.0
    busy_dbm: float = -85.0
    window_s: float = 0.1
    hidden_terminals: bool = True

    def __post_init__(self) -> None:
        check("more than 0, finite", near_exponent=self.near_exponent, far_exponent=self.far_exponent)
        check("more than 0, finite", window_s=self.window_s)
        check("1 or more", breakpoint_m=self.breakpoint_m, fading_shape=self.fading_shape)
        check("a whole number", fading_shape=self.fading_shape)
        check("True or False", hidden_terminals=self.hidden_terminals)

    def mean_power_dbm(self, distance: Floats) -> Floats:
        """Mean received power, dBm, at distances, m, of any shape; nearer than 1 m as at 1 m."""
        near = np.log10(np.clip(distance, 1.0, self.breakpoint_m))
        far = np.log10(np.maximum(distance / self.breakpoint_m, 1.0))
        loss = 10.0 * (self.near_exponent * near + self.far_exponent * far)
        return np.asarray(self.power_dbm - self.loss_1m_db - loss)

    @cached_property
    def sensing_range_m(self) -> float:
        """Distance, m, up to which a station's channel is busy with a transmission; 0 if not even at 1 m."""
        margin = (self.power_dbm - self.loss_1m_db - self.busy_dbm) / 10.0
        to_breakpoint = self.near_exponent * np.log10(self.breakpoint_m)
        if margin < 0.0:
            return 0.0
        if margin <= to_breakpoint:
            return float(10.0 ** (margin / self.near_exponent))
        return float(self.breakpoint_m * 10.0 ** ((margin - to_breakpoint) / self.far_exponent))

    def decoding_probability(self, distance: Floats) -> Floats:
        """Probability that a transmission is decoded at distances, m, of any shape, if no other disturbs it.

        P(power >= sensitivity) for power ~ Gamma(m, mean/m): exp(-x) (1 + x + ... + x^(m-1)/(m-1)!), where
        x = m * sensitivity / mean.
        """
        x = self.fading_shape * np.exp((self.sensitivity_dbm - self.mean_power_dbm(distance)) * (np.log(10.0) / 10.0))
        term, total = np.ones_like(x), np.ones_like(x)
        for k in range(1, self.fading_shape):
            term = term * x / k
            total += term
        return np.asarray(np.exp(-x) * total)

    def audible(self, position: Floats) -> Bools:
        """(n, n) whether stations at `position` (n, 2) m sense each other's transmissions; each its own."""
        return self._audible(_distance(position))

    def _audible(self, distance: Floats) -> Bools:
        """(n, n) whether stations sense each other at distances (n, n), m; each itself."""
        audible = distance <= self.sensing_range_m
        np.fill_diagonal(audible, True)
        return np.asarray(audible)

    def busy_ratio(self, position: Floats, sent: Transmissions, now_ns: int, window_ns: int | None = None) -> Floats:
        """(n,) channel busy ratio at stations at `position` (n, 2) m.

        sent: transmissions up to now_ns; window_ns: ns before it that they cover, by default `window_s`. Where they are
            those of one frame, it is the time between two frames, or the load would be that of another time

        A station's own transmissions count. Those that overlap in time count twice, so that the ratio is a little too
        high where stations do not hear each other; it is at most 1.
        """
        window_ns = window_ns or self._window_ns
        airtime_ns = sent.total_ns(now_ns, len(position), window_ns)
        return np.minimum(_sums(self.audible(position), airtime_ns) / window_ns, 1.0)

    def reception(self, position: Floats, sent: Transmissions, now_ns: int, window_ns: int | None = None) -> Floats:
        """(n, n) probability that a transmission of the row's station arrives at the column's; 0 on the diagonal.

        position: (n, 2) m; sent, window_ns: what loads the channel, see `busy_ratio`
        """
        window_ns = window_ns or self._window_ns
        airtime_ns = sent.total_ns(now_ns, len(position), window_ns)
        distance = _distance(position)
        clear = clear_probability(self._audible(distance), airtime_ns, window_ns, self.hidden_terminals)
        chance = self.decoding_probability(distance) * clear
        np.fill_diagonal(chance, 0.0)
        return chance

    @property
    def _window_ns(self) -> int:
        return round(self.window_s * 1e9)


def _distance(position: Floats) -> Floats:
    """(n, n) m between positions (n, 2) m."""
    x, y = np.asarray(position, np.float64).T[:2]
    return np.asarray(np.hypot(x[:, None] - x, y[:, None] - y))


def _sums(audible: Bools, airtime_ns: Ints) -> Floats:
    """(n,) airtime, ns, that each station hears. Sums of whole numbers are exact, in any order of stations."""
    return np.asarray(audible.astype(np.float64) @ airtime_ns.astype(np.float64))


def clear_probability(audible: Bools, airtime_ns: Ints, window_ns: int, hidden_terminals: bool = True) -> Floats:
    """(n, n) probability that no other transmission collides with one of the row's station at the column's.

    audible: (n, n) symmetric, with a true diagonal
    airtime_ns: (n,) ns of the last `window_ns` in which each station transmits

    Two causes, for Poisson arrivals of transmissions of equal length.

    Stations that hear each other collide if their backoff ends in the same slot: see `same_slot`. The tests simulate
    it: the probability is right to 0.03 up to a load of 1, and to 0.1 up to 2.

    Hidden terminals, which the receiver hears and the sender does not, collide as in pure ALOHA, if they start within
    one airtime before or after: exp(-2 h), where h is their load (Abramson 1970; Tobagi and Kleinrock 1975).
    """
    heard_ns = _sums(audible, airtime_ns)
    sending = (airtime_ns > 0).astype(np.int64)
    senders = _sums(audible, sending) - sending
    waiting = np.minimum(same_slot((heard_ns - airtime_ns) / window_ns) / SLOT_PROBABILITY, senders)
    clear = np.repeat(((1.0 - SLOT_PROBABILITY) ** waiting)[:, None], len(airtime_ns), axis=1)
    if hidden_terminals:
        hears = audible.astype(np.float64)
        common_ns = (hears * airtime_ns) @ hears  # heard by the row's station and the column's
        clear *= np.exp(-2.0 * (heard_ns - common_ns) / window_ns)
    return np.asarray(clear)


def same_slot(load: Floats) -> Floats:
    """(n,) mean number c of stations that send in the same slot as one that hears a load (n,) of others.

    Each of w stations that wait sends in a slot with SLOT_PROBABILITY p: c = p w. They wait as in a queue with constant
    service: w = q² / (2 (1 - q)) (Pollaczek and Khinchine). Its load q is less than that of the channel, as stations
    that collide take the time of one: q = load / (1 + c). Together, 2 c (1 + c) (1 + c - load) = p load², which has one
    solution above 0 and load - 1, and below load.
    """
    low, high = np.maximum(load - 1.0, 0.0), np.asarray(load, np.float64)
    for _ in range(50):
        middle = (low + high) / 2.0
        above = 2.0 * middle * (1.0 + middle) * (1.0 + middle - load) > SLOT_PROBABILITY * load**2
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return (low + high) / 2.0


def arrivals(chance: Floats, sender: Ints, generator: Callable[[int], np.random.Generator]) -> Bools:
    """(m, n) whether each of m transmissions arrives at each of n stations.

    chance: (n, n) probability by sender and receiver, see `RadioChannel.reception`
    sender: (m,) rows of stations, those of one sender in the order in which it sends
    generator: random generator of a sender in this frame, such as `stream(seed, "channel", frame, name)`

    Draws depend on nothing but the sender: neither on the order of senders, nor on who else sends, nor on the chance.
    """
    arrived = np.zeros((len(sender), chance.shape[1]), bool)
    for station in np.unique(sender).tolist():
        rows = (sender == station).nonzero()[0]
        arrived[rows] = generator(station).random((len(rows), chance.shape[1])) < chance[station]
    return arrived


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

"""Decentralised congestion control (ETSI TS 102 687): how often stations may send, given how busy the channel is.

All classes control n independent stations at once; the arrays have one entry for each. They measure the channel busy
ratio in slots of 100 ms, and have a gate for each station: closed after a transmission for as long as the rule says.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints

SLOT_NS = 100_000_000  #: between two measurements of the busy ratio (TS 102 687 v1.2.1, clause 5.2)
#: Slots that one measurement can stand for. After a longer pause, the channel counts as it was in the last minute.
MAX_SLOTS = 600
#: Limits on the time between two transmissions of a station (TS 102 687 v1.2.1, annex B).
MIN_INTERVAL_NS, MAX_INTERVAL_NS = 25_000_000, 1_000_000_000
_NEVER_NS = -(2**62)


class CongestionControl(ABC):
    """Limits how often each of n stations sends.

    Call `measure` once in each frame, then `may_send`, then `note_sent` for what was sent.
    """

    def reset(self, stations: int = 1, start_ns: Ints | None = None, period_ns: int = 0) -> None:
        """Start anew with n stations, on a channel that was idle.

        start_ns: (n,) ns, at which each station is switched on, by default all at once
        period_ns: ns between frames, if stations act at frames only. A gate that opens between two frames lets a
            message through in the second, and the next wait counts from when it opened. Otherwise all waits would be
            rounded up to whole frames, and stations that once sent in one frame would do so forever: a channel that is
            overloaded and idle in turn
        """
        self._period_ns = period_ns
        self._start_ns: Ints = np.full(stations, _NEVER_NS) if start_ns is None else np.asarray(start_ns, np.int64)
        self._sent_ns = self._start_ns
        self._wait_ns: Ints = np.zeros(stations, np.int64)
        self._airtime_ns: Ints = np.zeros(stations, np.int64)
        self._slot: int | None = None
        self.begin(stations)

    def measure(self, time_ns: int, busy_ratio: Floats) -> None:
        """Note the busy ratio (n,) measured at a time; it holds for all slots since the last measurement.

        Only the first measurement in a slot counts.
        """
        busy = np.where(time_ns >= self._start_ns, np.clip(busy_ratio, 0.0, 1.0), 0.0)
        slot = time_ns // SLOT_NS
        first = slot if self._slot is None else max(self._slot + 1, slot - MAX_SLOTS + 1)
        for current in range(first, slot + 1):
            self.note_slot(current, busy, time_ns)
            self._slot = current

    def may_send(self, time_ns: int) -> Bools:
        """(n,) whether each station's gate is open."""
        return np.asarray(time_ns - self._sent_ns >= self._wait_ns)

    def note_sent(self, time_ns: int, airtime_ns: Ints, sent: Bools) -> None:
        """Close the gates of the stations that send now.

        airtime_ns: (n,) ns of their transmissions; sent: (n,) which of them send
        """
        opened_ns = self._sent_ns + self._wait_ns
        just_opened = (time_ns - self._period_ns < opened_ns) & (opened_ns < time_ns)
        self._sent_ns = np.where(sent, np.where(just_opened, opened_ns, time_ns), self._sent_ns)
        self._wait_ns = np.where(sent, self.interval_ns(airtime_ns), self._wait_ns)
        self._airtime_ns = np.where(sent, airtime_ns, self._airtime_ns)

    @abstractmethod
    def interval_ns(self, airtime_ns: Ints) -> Ints:
        """(n,) least time from the start of one transmission to that of the next, ns.

        airtime_ns: (n,) ns, of the first
        """

    @abstractmethod
    def begin(self, stations: int) -> None:
        """Begin with n stations."""

    @abstractmethod
    def note_slot(self, slot: int, busy: Floats, time_ns: int) -> None:
        """Note the busy ratio (n,) of one slot."""


class NoCongestionControl(CongestionControl):
    """No congestion control: every gate is always open."""

    def __init__(self) -> None:
        self.reset()

    def interval_ns(self, airtime_ns: Ints) -> Ints:
        return np.zeros(len(self._sent_ns), np.int64)

    def begin(self, stations: int) -> None:
        pass

    def note_slot(self, slot: int, busy: Floats, time_ns: int) -> None:
        pass


@dataclass(kw_only=True, eq=False)
class ReactiveDcc(CongestionControl):
    """Reactive congestion control: a table from busy ratio to interval (TS 102 687 v1.1.1, C2C-CC profile 1.2).

    A station's state rises when the least busy ratio of a second is above a bound, and falls when the greatest of five
    seconds is below one.

    bounds: busy ratios between the states, ascending: relaxed, active 1 to 5, restrictive
    intervals_s: s, least time between two transmissions in each state, one more than bounds
    rise_s, fall_s: s, how long the channel must be busier, or quieter, before the state changes
    """

    bounds: tuple[float, ...] = (0.19, 0.27, 0.35, 0.43, 0.51, 0.59)
    intervals_s: tuple[float, ...] = (0.06, 0.1, 0.18, 0.26, 0.34, 0.42, 0.46)
    rise_s: float = 1.0
    fall_s: float = 5.0

    def __post_init__(self) -> None:
        if len(self.intervals_s) != len(self.bounds) + 1:
            expected = f"{len(self.bounds) + 1}, one more than bounds"
            raise ValueError(f"intervals_s: found {len(self.intervals_s)} values, expected {expected}")
        check("0 to 1", **{f"bounds[{i}]": bound for i, bound in enumerate(self.bounds)})
        if list(self.bounds) != sorted(set(self.bounds)):
            raise ValueError(f"bounds: found {self.bounds}, expected an ascending order")
        check("0 or more, finite", **{f"intervals_s[{i}]": s for i, s in enumerate(self.intervals_s)})
        check("more than 0 and at most 1000", rise_s=self.rise_s, fall_s=self.fall_s)
        self._bounds = np.array(self.bounds)
        self._intervals_ns = np.round(np.array(self.intervals_s) * 1e9).astype(np.int64)
        self._rise, self._fall = (max(round(s * 1e9 / SLOT_NS), 1) for s in (self.rise_s, self.fall_s))
        self.reset()

    @property
    def state(self) -> Ints:
        """(n,) state of each station: 0 is relaxed, the last one restrictive."""
        return self._state

    def interval_ns(self, airtime_ns: Ints) -> Ints:
        return np.asarray(self._intervals_ns[self._state])

    def begin(self, stations: int) -> None:
        self._busy = np.zeros((max(self._rise, self._fall), stations))  # the newest slot first
        self._state = np.zeros(stations, np.int64)

    def note_slot(self, slot: int, busy: Floats, time_ns: int) -> None:
        self._busy = np.vstack([busy, self._busy[:-1]])
        at_least, at_most = self._busy[: self._rise].min(axis=0), self._busy[: self._fall].max(axis=0)
        rise_to, fall_to = (np.searchsorted(self._bounds, busy, side="right") for busy in (at_least, at_most))
        self._state = np.minimum(np.maximum(self._state, rise_to), np.maximum(rise_to, fall_to))
        self._wait_ns = np.asarray(self._intervals_ns[self._state])


@dataclass(kw_only=True, eq=False)
class AdaptiveDcc(CongestionControl):
    """Adaptive congestion control, LIMERIC: stations approach equal shares of a target (TS 102 687 v1.2.1, clause 5.4).

    Every 200 ms, each station moves its duty cycle: delta = (1 - alpha) delta + limited(beta (target - busy)), where
    busy is half its old value and half the mean of the two newest measurements. The fixed point for n stations that
    hear each other is delta = beta target / (alpha + n beta). Their load stays below the target, the nearer the more
    there are.

    alpha, beta: gains of the filter and of the error
    target: busy ratio that is aimed at
    least, most: limits of the duty cycle
    most_gain, most_loss: greatest change of the duty cycle by beta in one step, up and down
    period_slots: slots of 100 ms between two steps

    The gate waits airtime / delta, 25 ms to 1 s; when delta changes, what is left of the wait changes in proportion
    (annex B, equations B.1 and B.2). A station starts at the middle of the limits.
    """

    alpha: float = 0.016
    beta: float = 0.0012
    target: float = 0.68
    least: float = 0.0006
    most: float = 0.03
    most_gain: float = 0.0005
    most_loss: float = 0.00025
    period_slots: int = 2

    def __post_init__(self) -> None:
        check("more than 0 and less than 1", alpha=self.alpha, beta=self.beta)
        check("more than 0 and at most 1", target=self.target, least=self.least, most=self.most)
        check("more than 0, finite", most_gain=self.most_gain, most_loss=self.most_loss)
        check("1 or more", period_slots=self.period_slots)
        check("a whole number", period_slots=self.period_slots)
        if self.least > self.most:
            raise ValueError(f"least: found {self.least}, expected at most `most`, which is {self.most}")
        self.reset()

    @property
    def delta(self) -> Floats:
        """(n,) duty cycle that each station may use."""
        return self._delta

    def interval_ns(self, airtime_ns: Ints) -> Ints:
        return np.asarray(np.clip(airtime_ns / self._delta, MIN_INTERVAL_NS, MAX_INTERVAL_NS), np.int64)

    def begin(self, stations: int) -> None:
        self._delta = np.full(stations, (self.least + self.most) / 2.0)
        self._mean = np.zeros(stations)
        self._newest = np.zeros((self.period_slots, stations))

    def note_slot(self, slot: int, busy: Floats, time_ns: int) -> None:
        self._newest = np.vstack([busy, self._newest[:-1]])
        if slot % self.period_slots:
            return
        self._mean = 0.5 * self._mean + 0.5 * self._newest.mean(axis=0)
        change = np.clip(self.beta * (self.target - self._mean), -self.most_loss, self.most_gain)
        self._delta = np.clip((1.0 - self.alpha) * self._delta + change, self.least, self.most)
        self._adapt_waits(time_ns)

    def _adapt_waits(self, time_ns: int) -> None:
        """Shorten or prolong the waits of closed gates (equation B.2)."""
        passed = time_ns - self._sent_ns
        share_left = 1.0 - passed / np.maximum(self._wait_ns, 1)
        wait = self._airtime_ns / self._delta * share_left + passed
        wait_ns = np.clip(wait, MIN_INTERVAL_NS, MAX_INTERVAL_NS).astype(np.int64)
        closed = (share_left > 0.0) & (self._wait_ns > 0)
        self._wait_ns = np.where(closed, wait_ns, self._wait_ns)

"""What one station sends: its generation rules, under its congestion control."""

from __future__ import annotations

from collections import deque

import numpy as np

from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.v2x.congestion import CongestionControl, NoCongestionControl
from mast_zenoh.v2x.generation import CamGeneration, EveryFrame, Generation, GenerationRules, Perception
from mast_zenoh.v2x.redundancy import HeardObjects

#: Reports of others are kept for this long, ns: the window of the redundancy rules.
_REPORTS_NS = 1_000_000_000
_MOST_REPORTS = 20_000


class Station:
    """One station on the channel.

    rules: when it sends which objects; None: all in every frame; congestion: how often it may send; None: always
    awareness: when it says where it is itself; None: never
    """

    def __init__(
        self,
        rules: GenerationRules | None = None,
        congestion: CongestionControl | None = None,
        awareness: CamGeneration | None = None,
    ) -> None:
        self.rules = rules or EveryFrame()
        self.awareness = awareness
        self.congestion = congestion or NoCongestionControl()
        self._uncontrolled = isinstance(self.congestion, NoCongestionControl)
        self._on_ns = 0
        self._first_ns: int | None = None  # time of its first frame
        self._running = False  # whether it knows the time between two frames
        self._reports: deque[HeardObjects] = deque()
        self._airtime = np.zeros(1, np.int64)  # ns, of its last message

    def switch_on(self, share: float) -> None:
        """Set when it is switched on: a share of the first second, different for each station.

        Stations under congestion control that began together would send in the same frames for ever.
        """
        self._on_ns = round(share * 1e9)

    def hear(self, time_ns: int, states: ObjectStates, sender_position: Floats) -> None:
        """Note what another station reports: n objects, world frame, at a time. sender_position: (3,) m"""
        if not self.rules.uses_heard:
            return
        place = np.broadcast_to(sender_position, (len(states), 3))
        self._reports.append(HeardObjects(np.full(len(states), time_ns), states.position, states.velocity, place))
        while sum(map(len, self._reports)) > _MOST_REPORTS:
            self._reports.popleft()

    def measure(self, time_ns: int, busy_ratio: float, sent_ns: int, airtime_ns: int) -> None:
        """Note the busy ratio of the channel, and the airtime of what the station sent at `sent_ns`; 0: nothing."""
        if self._first_ns is None:
            self._first_ns = time_ns
        elif not self._running:
            on_ns = np.array([self._first_ns + self._on_ns], np.int64)
            self.congestion.reset(1, on_ns, time_ns - self._first_ns)
            self._running = True
        if self._running:
            if airtime_ns > 0:
                self._airtime[0] = airtime_ns
                self.congestion.note_sent(sent_ns, self._airtime, np.array([True]))
            self.congestion.measure(time_ns, np.array([busy_ratio]))

    def transmit(self, time_ns: int, objects: ObjectStates, position: Floats) -> Generation:
        """What to send now. objects: n own ones, world frame; position: (3,) m, of the station"""
        if not self.may_send(time_ns):
            return Generation.nothing()
        while self._reports and (self._reports[0].time_ns < time_ns - _REPORTS_NS).all():
            self._reports.popleft()
        columns = zip(*((r.time_ns, r.position, r.velocity, r.sender_position) for r in self._reports), strict=True)
        heard = HeardObjects(*map(np.concatenate, columns)) if self._reports else HeardObjects.empty()
        return self.rules.generate(Perception.of(time_ns, objects, position=position, heard=heard))

    def announce(self, time_ns: int, itself: ObjectStates) -> bool:
        """Whether to say now where it is. itself: its own state, one row, world frame

        A gate that is open is open for both kinds of messages of a frame, and the next wait counts the airtime of both.
        """
        if self.awareness is None or not self.may_send(time_ns):
            return False
        yaw = float(itself.yaw[0])
        return self.awareness.generate(time_ns, itself.position[0], itself.velocity[0], yaw).generated

    def may_send(self, time_ns: int) -> bool:
        """Whether congestion control lets it send now."""
        return self._uncontrolled or (self._running and bool(self.congestion.may_send(time_ns)[0]))

"""What all interposers of a run do to the messages that pass them, measured while the run goes on."""

from __future__ import annotations

from dataclasses import replace

from mast_zenoh.effects.message_effects import Interval
from mast_zenoh.effects.passages import PassageMeter
from mast_zenoh.wiring.model import Passage, Wiring
from mast_zenoh.wiring.received import Overheard


class Meter:
    """Compares what every interposer sends with what it receives, on every wire; knows nothing of what they are.

    It is given every message on every key of the run, in any order that keeps the order of each key.
    """

    def __init__(self) -> None:
        self._meters: list[PassageMeter] = []
        self._active: dict[Passage, PassageMeter] = {}
        self._into: dict[str, list[PassageMeter]] = {}
        self._out_of: dict[str, list[PassageMeter]] = {}

    @property
    def meters(self) -> list[PassageMeter]:
        """One for each passage that was ever part of the wiring, in the order in which they came."""
        return self._meters

    def keys(self) -> set[str]:
        """The keys of which it has to be given every message."""
        return self._into.keys() | self._out_of.keys()

    def follow(self, wiring: Wiring, first_step: int) -> None:
        """From frame `first_step` on, messages take the ways of a wiring."""
        now = dict.fromkeys(wiring.passages())
        for passage in self._active.keys() - now.keys():
            meter = self._active.pop(passage)
            meter.interval = replace(meter.interval, end=first_step)
        for passage in now:
            if passage not in self._active:
                meter = PassageMeter(passage, Interval(first_step))
                self._active[passage] = meter
                self._meters.append(meter)
                self._into.setdefault(passage.received, []).append(meter)
                self._out_of.setdefault(passage.sent, []).append(meter)

    def add(self, message: Overheard) -> None:
        """Add a message; messages from outside the run are ignored."""
        key, step = message.key, message.step
        if step < 0:
            return
        if key in self._into:
            for meter in self._into[key]:
                if meter.interval.has(step):
                    meter.take_received(message)
        if key in self._out_of:
            for meter in self._out_of[key]:
                if meter.interval.has(step):
                    meter.take_sent(message)

    def close(self, last_step: int) -> None:
        """The run is over; `last_step` was its last frame."""
        for meter in self._meters:
            meter.close(last_step)

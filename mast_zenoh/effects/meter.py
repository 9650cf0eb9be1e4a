"""Measures the effects of all interposers during a run."""

from __future__ import annotations

from dataclasses import replace

from mast_zenoh.effects.message_effects import Interval
from mast_zenoh.effects.passages import PassageMeter
from mast_zenoh.wiring.model import Passage, Wiring
from mast_zenoh.wiring.received import Overheard


class Meter:
    """Compares the sent with the received messages of every interposer on every wire.

    It needs every message on the relevant keys, in any order that preserves the order on each key.
    """

    def __init__(self) -> None:
        self._meters: list[PassageMeter] = []
        self._active: dict[Passage, PassageMeter] = {}
        self._into: dict[str, list[PassageMeter]] = {}
        self._out_of: dict[str, list[PassageMeter]] = {}

    @property
    def meters(self) -> list[PassageMeter]:
        """The meters of all passages ever in the wiring, in order of appearance."""
        return self._meters

    def keys(self) -> set[str]:
        """The keys whose messages it needs."""
        return self._into.keys() | self._out_of.keys()

    def follow(self, wiring: Wiring, first_step: int) -> None:
        """Use a wiring from frame `first_step` onwards."""
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
                if meter.interval.contains(step):
                    meter.take_received(message)
        if key in self._out_of:
            for meter in self._out_of[key]:
                if meter.interval.contains(step):
                    meter.take_sent(message)

    def close(self, last_step: int) -> None:
        """End the measurement after the last frame `last_step`."""
        for meter in self._meters:
            meter.close(last_step)

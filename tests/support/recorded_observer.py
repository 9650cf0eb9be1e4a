"""An observer of a run that is not there: it has the frames of a recording."""

from __future__ import annotations

from collections import deque
from types import SimpleNamespace

import mast_zenoh as mast
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.messagelog.reader import read
from mast_zenoh.viewer.frames import RunFrames
from mast_zenoh.viewer.live.measurement import FrameMeter, MeasuredFrame
from mast_zenoh.viewer.live.observer import Insertion
from mast_zenoh.viewer.live.reception import Sample
from mast_zenoh.viewer.live.wires import WireState
from mast_zenoh.wiring.model import Wiring

NUMBERS = (9, 10, 22)


class RecordedObserver:
    """An observer that measures the frames NUMBERS of a recording."""

    def __init__(self, run: mast.Run) -> None:
        resolved = Resolved.read(run.path)
        self.wiring = Wiring.from_json(resolved.wiring)
        self.meter = FrameMeter(resolved)
        self.run = SimpleNamespace(scene=RunFrames.load(run.path).scene, id="run-1", resolved=resolved)
        self.insertions: list[Insertion] = []
        self.down: list[str] = []
        self.frame = NUMBERS[-1]
        messages = [(m.frame, (m.key, Sample(m.step, m.payload))) for m in read(run.path)]
        roles = {name: spec.role for name, spec in resolved.nodes.items()}
        self.waiting: deque[MeasuredFrame | None] = deque([None])
        for number in NUMBERS:
            own = [sample for frame, sample in messages if frame == number]
            self.waiting += [self.meter.measure(number, own, self.wiring, roles), None]

    def advance(self) -> MeasuredFrame | None:
        return self.waiting.popleft() if self.waiting else None

    def is_over(self) -> bool:
        return not self.waiting

    def wires(self) -> list[WireState]:
        return []

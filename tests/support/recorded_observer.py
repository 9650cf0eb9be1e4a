"""An observer of a run that is not there: it has the frames of a recording."""

from collections import deque
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.run_folder.recording.reader import read
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.live.measurement import FrameMeter, seen
from mast_zenoh.runs.live.reception import Sample, WireState
from mast_zenoh.runs.recorded import open_recorded
from mast_zenoh.wiring.model import Wiring

NUMBERS = (9, 10, 22)


class RecordedObserver:
    """An observer that measures some frames of the recording of the run in a folder."""

    def __init__(
        self, folder: Path, numbers: Sequence[int] = NUMBERS, wires: Sequence[WireState] = (), *, has_scene: bool = True
    ) -> None:
        resolved = Resolved.read(folder)
        self.wiring = Wiring.from_json(resolved.wiring)
        self.meter = FrameMeter(resolved)
        scene = open_recorded(folder).files.scene if has_scene else None  # a user's own simulator prepares none
        self.address: Any = SimpleNamespace(scene=scene, id="run-1", resolved=resolved)
        self.run = seen(self.address, self.wiring, self.meter.agents)
        self.interceptions: list[dict[str, Any]] = []
        self.down: list[str] = []
        self.frame = numbers[-1]
        self._due, self._effort_s, self._share = 0.0, 0.0, 1.0
        self._wires = [*wires]
        messages = [(m.frame, (m.key, Sample(m.step, m.payload))) for m in read(folder)]
        self.roles = {name: spec.role for name, spec in resolved.nodes.items()}
        self._assembler = None
        self.waiting: deque[Frame | None] = deque([None])
        for number in numbers:
            own = [sample for frame, sample in messages if frame == number]
            self.waiting += [self.meter.measure(self.run, number, own, self.wiring, self.roles), None]

    def advance(self) -> Frame | None:
        return self.waiting.popleft() if self.waiting else None

    def last_frame(self) -> Frame | None:
        return None

    def is_over(self) -> bool:
        return not self.waiting

    def wires(self) -> list[WireState]:
        return self._wires

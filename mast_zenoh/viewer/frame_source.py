"""What other viewers need of a run, finished or live."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol

from mast_zenoh.metrics.record import Series
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.viewer.frames import Frame


class FrameSource(Protocol):
    """Frames of a run, one after the other: `RunFrames` of a finished one, or those of a live one as they come.

    agents: their names, the main agent (`ego`) first;  topics: by series of objects, its key expression
    scored: agents and estimates with scores;  scene: buildings, sensors and cameras; None: not known
    name:   the run's own id

    All but the frames stay the same. Iterating over a live run blocks until there is a frame, and ends with the run.
    """

    @property
    def agents(self) -> tuple[str, ...]: ...
    @property
    def ego(self) -> str: ...
    @property
    def topics(self) -> Mapping[Series, str]: ...
    @property
    def scored(self) -> Sequence[Series]: ...
    @property
    def scene(self) -> Recording | None: ...
    @property
    def name(self) -> str: ...
    def __iter__(self) -> Iterator[Frame]: ...

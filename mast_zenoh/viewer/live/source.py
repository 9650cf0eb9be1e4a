"""A running run as a source of frames, for servers to other viewers."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping

from mast_zenoh.launch.tables import as_read
from mast_zenoh.metrics.record import LOCAL, MISSION, PICTURE, PICTURE_RECEIVED, RECEIVED, Series
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.viewer import routes
from mast_zenoh.viewer.evaluated import ChangeTable, Judgements, ScoreTable
from mast_zenoh.viewer.frame import Frame, frame_of
from mast_zenoh.viewer.live.measurement import MeasuredFrame
from mast_zenoh.viewer.live.observer import POLL_S, Observer


class LiveFrames:
    """The frames of an observed run as they come; implements `viewer.frame.FrameSource`.

    stop: ends the iteration when it is set

    Topics are those of the wiring at the beginning. A node that is inserted later is seen by its changes.
    """

    def __init__(self, observer: Observer, stop: threading.Event) -> None:
        self._observer, self._stop = observer, stop
        self.agents = tuple(sorted(observer.meter.agents, key=lambda name: name != "ego"))
        self.topics: Mapping[Series, str] = routes.in_order(routes.topics(observer.wiring, self.agents), self.agents)
        known = {series.estimator for series in self.topics}
        estimators = [name for name in (LOCAL, RECEIVED, PICTURE, PICTURE_RECEIVED, MISSION) if name in known]
        shared = (PICTURE,)
        self.scored = [
            Series(agent, name)
            for agent in self.agents
            for name in estimators
            if name in shared or Series(agent, name) in self.topics
        ]

    @property
    def ego(self) -> str:
        """The main agent."""
        return self.agents[0]

    @property
    def scene(self) -> Recording | None:
        """Buildings, sensors and cameras; None: not known."""
        return self._observer.run.scene

    @property
    def name(self) -> str:
        """The run's own id."""
        return self._observer.run.id

    def __iter__(self) -> Iterator[Frame]:
        """All frames that are measured, until the run ends."""
        while not self._stop.is_set():
            measured = self._observer.advance()
            if measured is not None:
                yield self._frame(measured)
            elif self._observer.is_over():
                return
            self._stop.wait(POLL_S)

    def _frame(self, measured: MeasuredFrame) -> Frame:
        tables = {name: as_read(columns) for name, columns in measured.tables.items()}
        return frame_of(
            self,
            measured.number,
            measured.time_ns,
            measured.bodies,
            Judgements(tables["objects"], measured.same_as),
            ScoreTable(tables["metrics"]),
            ChangeTable(tables["attacks"]),
        )
